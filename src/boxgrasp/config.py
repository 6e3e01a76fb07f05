"""One configuration: each stage's own settings composed, read strictly, printed back, hashed.

The stages never import this module. Names, defaults and ranges stand in their own files alone.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import resources
from os import PathLike, fspath
from pathlib import Path
from typing import Any, ClassVar, Final

from boxgrasp.errors import ConfigError, GripperError, require
from boxgrasp.grasps.candidates import CandidatesConfig
from boxgrasp.grasps.checks import ChecksConfig
from boxgrasp.grasps.gripper import Gripper
from boxgrasp.mapping.local_map import MappingConfig
from boxgrasp.perception.box_fit import BoxConfig
from boxgrasp.perception.scene_config import SceneConfig
from boxgrasp.ranking.ranker import SHIPPED, ranker_names
from boxgrasp.strict import Source, build, parse_yaml, plain, read_yaml, to_yaml, validate_types

_HANDS: Final = resources.files("boxgrasp.grasps") / "hands"  # a YAML file each


@dataclass(frozen=True)
class Config:
    """Everything that can be set; `boxgrasp config` prints it.

    Attributes:
        scene: how objects are found.
        box: how the target's box is fitted.
        mapping: the local map.
        candidates: which grasps are considered.
        gripper: the hand.
        checks: what a candidate must keep.
        ranker: name of what orders the candidates.
        models: folder of an SVM ranker's trained models, None for those that ship.
        unchecked: take the ranker's first candidate, whatever the checks say.

    Raises:
        ConfigError: no ranker has that name.
    """

    scene: SceneConfig = field(default_factory=SceneConfig)
    box: BoxConfig = field(default_factory=BoxConfig)
    mapping: MappingConfig = field(default_factory=MappingConfig)
    candidates: CandidatesConfig = field(default_factory=CandidatesConfig)
    gripper: Gripper = field(default_factory=Gripper)
    checks: ChecksConfig = field(default_factory=ChecksConfig)
    ranker: str = "clearance"
    models: str | None = None
    unchecked: bool = False

    RENAMED: ClassVar[dict[str, str]] = {
        "options": "candidates",
        "occupancy": "mapping",
        "check": "checks",
        "chooser": "ranker",
    }

    def __post_init__(self) -> None:
        validate_types(self, "configuration", ConfigError)
        if self.ranker not in SHIPPED and self.ranker not in ranker_names():
            raise ConfigError(f"unknown ranker: {self.ranker}; valid: {', '.join(ranker_names())}")


def load_config(source: Config | Mapping[str, Any] | Source | None = None) -> Config:
    """The configuration of a YAML file, a mapping or a Config; what is not said is the default.

    Args:
        source: a path, nested names and values, a Config, or None for all defaults.

    Returns:
        The whole configuration, every value checked.

    Raises:
        ConfigError: unreadable or faulty YAML, an unknown or renamed key at any depth, a wrong
            type, a value out of its range.
    """
    if source is None:
        return Config()
    if isinstance(source, Config):
        return build(Config, plain(source), "configuration", ConfigError)
    if isinstance(source, Mapping):
        return build(Config, _with_hand(source), "configuration", ConfigError)
    valid = "a YAML file's path, names and values, a Config, or None"
    require(source, (str, PathLike), "configuration", valid, ConfigError)
    return build(Config, _with_hand(read_yaml(source, ConfigError)), fspath(source), ConfigError)


def _with_hand(data: Any) -> Any:
    """The data with the sizes of a hand that it only names."""
    if not isinstance(data, Mapping) or not isinstance(data.get("gripper"), str):
        return data
    return {**data, "gripper": plain(load_gripper(data["gripper"]))}


def gripper_names() -> tuple[str, ...]:
    """The hands that ship.

    Returns:
        Names that `load_gripper` takes, sorted, the default first.
    """
    files = (entry.name for entry in _HANDS.iterdir())
    names = sorted(name.removesuffix(".yaml") for name in files if name.endswith(".yaml"))
    return tuple(sorted(names, key=lambda name: name != Gripper.name))


def load_gripper(source: Source) -> Gripper:
    """A gripper that ships, or that of a YAML file with the keys of the configuration's `gripper`.

    Args:
        source: a name of `gripper_names`, or the path of a file.

    Returns:
        The gripper.

    Raises:
        GripperError: as `load_config`, and where the gripper cannot hold anything.
    """
    valid = "a name, or a YAML file's path"
    require(source, (str, PathLike), "gripper", valid, GripperError)
    if str(source) in gripper_names():
        text = (_HANDS / f"{source}.yaml").read_text(encoding="utf-8")
        return build(
            Gripper, parse_yaml(text, str(source), GripperError), str(source), GripperError
        )
    if not Path(source).suffix and not os.path.exists(source):
        names = ", ".join(gripper_names())
        raise GripperError(
            f"unknown gripper: {' '.join(fspath(source).split())}; valid: {names}, or a YAML file"
        )
    data = read_yaml(source, GripperError)
    if isinstance(data, dict):
        data.setdefault("name", Path(source).stem)
    return build(Gripper, data, fspath(source), GripperError)


def dump_config(config: Config) -> str:
    """Every setting with its value.

    Args:
        config: any.

    Returns:
        YAML that `load_config` reads back.
    """
    require(config, Config, "configuration", "a Config", ConfigError)
    return to_yaml(plain(config))


def config_hash(config: Config) -> str:
    """What tells two configurations apart.

    Args:
        config: any.

    Returns:
        16 hexadecimal digits of the SHA-256 of its canonical JSON.
    """
    return loaded_hash(load_config(config))


def loaded_hash(config: Config) -> str:
    """The same as `config_hash`, of a configuration that `load_config` gave.

    Args:
        config: not read again, so that numbers are taken for what they are.

    Returns:
        As `config_hash`.
    """
    values = plain(config)
    canonical = json.dumps(values, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(canonical.encode()).hexdigest()[:16]
