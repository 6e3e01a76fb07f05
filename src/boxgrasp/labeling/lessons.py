"""What labeled scenes teach: rows as scenario sets have them, of scenarios and captures alike.

A row is made again from its capture or seed, and kept under a hash of the scene, the settings and
the package's version. What was labeled stands in the columns `given_...`; of a capture nothing is
known to be true, so its columns of truth are empty.
"""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final, Protocol

import numpy as np

from boxgrasp.config import Config
from boxgrasp.errors import BoxgraspError, ConfigError, StoreError, WorkError
from boxgrasp.execution import Store, Workers, finish
from boxgrasp.grasps.candidates import CandidatesConfig
from boxgrasp.grasps.gripper import Gripper
from boxgrasp.labeling.captures import CaptureStore
from boxgrasp.labeling.sources import load_scene, scenario_scenes
from boxgrasp.labeling.words import LabelScene, OperatorLabel
from boxgrasp.mapping.local_map import MappingConfig
from boxgrasp.perception.box_fit import BoxConfig
from boxgrasp.ranking.model_set import help_label
from boxgrasp.selector import GraspSelector
from boxgrasp.strict import build, plain
from boxgrasp.teaching.operators import Label, Shown
from boxgrasp.teaching.rows import (
    MAP_RESOLUTIONS_M,
    RowConfig,
    analysis_columns,
    obstacle_points,
    scenario_row,
)
from boxgrasp.teaching.sets import Rows, SetConfig, from_parquet, joined, to_parquet
from boxgrasp.teaching.train import SCENE_KEY, Provenance, Taught, object_set_of
from boxgrasp.version import __version__

_GIVEN: Final = ("given",)
_APART: Final = ("name", "T_gripper_tcp", "T_flange_gripper")  # say nothing of where a hand fits
_CAPTURES: Final = "captures"  # in place of an object set


class Labels(Protocol):
    """Where labels are kept: a `Record`."""

    def standing(
        self, source: str | None = None, operator: str | None = None
    ) -> list[OperatorLabel]:
        """Labels that nothing supersedes.

        Args:
            source: of their scenes; None for all.
            operator: who said them; None for all.

        Returns:
            Oldest first.
        """

    def scenes(self, source: str | None = None) -> list[LabelScene]:
        """The scenes that labels are of.

        Args:
            source: of the scenes; None for all.

        Returns:
            At least those with a label.
        """


@dataclass(frozen=True)
class LessonShape:
    """Columns of labeled scenes.

    Attributes:
        lines: l, lines a face.
        target_sources: `given` alone.
    """

    lines: int
    target_sources: tuple[str, ...] = _GIVEN


@dataclass(frozen=True)
class LessonConfig:
    """How labels are made into rows.

    Attributes:
        config: of the package, for captures.
        lines: l, lines a face; None for those of the labels, if all have as many.
    """

    config: Config = Config()
    lines: int | None = None


@dataclass(frozen=True, eq=False)
class Lessons:
    """What labels teach.

    Attributes:
        taught: labeled rows, as training takes them, by scenario, capture and operator.
        labels: how many of the rows are people's; the others are a set's.
        scenes: how many scenes these are of.
        operators: rows by who labeled.
        box_kinds: rows by how the box was fitted.
        notes: what the user should know of it, a sentence each.
    """

    taught: Taught
    labels: int
    scenes: int
    operators: Mapping[str, int]
    box_kinds: Mapping[str, int]
    notes: tuple[str, ...] = ()


def scene_config(scene: LabelScene, config: Config) -> Config:
    """The settings by which a scene is shown, labeled and made into a row.

    Args:
        scene: any.
        config: the user's own.

    Returns:
        Of a scenario those of its set: the thesis's aligned box and poses and the default hand. Of
        a capture the user's own, with the box and lines of the scene.

    Raises:
        ConfigError: a scene with settings that cannot be.
    """
    candidates = CandidatesConfig(lines=scene.lines, refine="none")
    if scene.kind == "scenario":
        rows = row_config(scene)
        mapping = MappingConfig(stride=rows.stride)
        return Config(box=_box(scene, BoxConfig()), mapping=mapping, candidates=candidates)
    own = replace(config.candidates, lines=scene.lines)
    return replace(config, box=_box(scene, config.box), candidates=own)


def _box(scene: LabelScene, config: BoxConfig) -> BoxConfig:
    said = {**plain(config), "fit": scene.box_kind}
    return build(BoxConfig, said, f"scene {scene.key}, box", ConfigError)


def row_config(scene: LabelScene) -> RowConfig:
    """How a scenario's row is made: what its set is made with, the target's points given alone.

    Args:
        scene: a scenario.

    Returns:
        The settings.

    Raises:
        ConfigError: it has none, or some that cannot be.
    """
    if scene.row_config is None:
        raise ConfigError(f"scene {scene.key} has no settings; valid: those of its set")
    found = build(RowConfig, dict(scene.row_config), f"scene {scene.key}", ConfigError)
    return replace(found, target_sources=_GIVEN)


def lessons_of(
    labels: Labels,
    captures: CaptureStore,
    workers: Workers,
    lesson: LessonConfig,
    *,
    mix: tuple[SetConfig, Rows] | None = None,
    title: str = "rows",
) -> Lessons:
    """The rows of all labels that stand, a row a label.

    Two operators' labels of one scene are two examples. `box_wrong` teaches nothing, nor does a
    scene whose target is not found any more.

    Args:
        labels: where they are kept.
        captures: where captures are kept, and rows beside them.
        workers: who makes the rows that are not kept yet.
        lesson: how.
        mix: a set whose labels are added; None for none.
        title: what progress is shown under; nothing is shown where it is empty.

    Returns:
        The rows.

    Raises:
        ConfigError: nothing to learn from, or labels of several hands or numbers of lines.
        StoreError: a capture is missing, or rows cannot be kept.
        WorkError: workers were lost.
        MissingExtraError: pyarrow is not installed.
    """
    standing = [item for item in labels.standing() if item.verdict in ("candidate", "none")]
    lines = _lines(standing, mix, lesson)
    notes, told = [], [item for item in standing if item.lines == lines]
    if len(told) < len(standing):
        left = len(standing) - len(told)
        notes.append(f"{left} labels of another number of lines than {lines} are left out")
    of_labels = {item.scene_key for item in told}
    scenes = {scene.key: scene for scene in labels.scenes() if scene.key in of_labels}
    told.sort(key=lambda item: (_place(scenes[item.scene_key]), item.operator, item.labeled_at))
    _refuse_several_hands(told)
    rows = kept_rows(list(scenes.values()), captures, workers, lesson.config, title)
    lost = {key for key, row in rows.items() if row["given_error"][0]}
    if lost:
        notes.append(f"{len(lost)} scenes are left out: their targets are not found any more")
    told = [item for item in told if item.scene_key not in lost]
    parts = [_labeled(rows[item.scene_key], item) for item in told]
    kinds = Counter(scenes[item.scene_key].box_kind for item in told)
    if mix is not None:
        parts.append(_mixed(mix, lines))
        kinds["aligned"] += parts[-1].count
    if not parts:
        raise ConfigError("no labels to learn from; valid: labels of candidates, or `none`")
    taught = _taught(joined(parts), told, [scenes[item.scene_key] for item in told], mix)
    if len(kinds) > 1:
        each = " and ".join(f"{count} {kind}" for kind, count in sorted(kinds.items()))
        notes.append(f"boxes of both kinds are learned from together: {each}")
    return Lessons(
        taught=taught,
        labels=len(told),
        scenes=len({item.scene_key for item in told}),
        operators=dict(Counter(taught.rows["label_source"].tolist())),
        box_kinds=dict(kinds),
        notes=tuple(notes),
    )


def kept_rows(
    scenes: Sequence[LabelScene],
    captures: CaptureStore,
    workers: Workers,
    config: Config,
    title: str = "rows",
) -> dict[str, Rows]:
    """The row of each scene, without a label; made where it is not kept yet.

    Args:
        scenes: whose.
        captures: where captures are kept, and rows beside them.
        workers: who makes rows.
        config: of the package, for captures.
        title: as `lessons_of`.

    Returns:
        One row by each scene's key.

    Raises:
        StoreError: a capture is missing, or rows cannot be kept.
        WorkError: workers were lost.
        MissingExtraError: pyarrow is not installed.
    """
    store, names = captures.store, {scene.key: _row_name(scene, config) for scene in scenes}
    tasks = {names[scene.key]: (scene, store.place, config) for scene in scenes}
    finish(store, tasks, row_bytes, workers, title)
    return {key: from_parquet(store.read(name)) for key, name in names.items()}


def row_bytes(task: tuple[LabelScene, str, Config]) -> bytes:
    """The row of one scene; a task of its own.

    Args:
        task: the scene, the place of captures, and the package's settings.

    Returns:
        Parquet of one row without a label.
    """
    scene, place, config = task
    loaded = load_scene(scene, CaptureStore(Store(place)))
    if loaded.scenario is not None and loaded.view is not None:
        rows = row_config(scene)
        row = scenario_row(loaded.scenario, loaded.view, rows, _Nobody())
        return to_parquet([{**row, "label": None, "label_source": None}], rows)
    row = {"target": scene.name}
    try:
        chosen = _selector(json.dumps(plain(scene_config(scene, config)), sort_keys=True))
        analysis = chosen.analyze(loaded.capture, loaded.target)
    except (StoreError, WorkError):
        raise
    except BoxgraspError as error:
        row["given_error"] = str(error)
    else:
        columns = analysis_columns(analysis, chosen.config.gripper, obstacle_points(analysis))
        row |= {f"given_{name}": value for name, value in columns.items()}
    return to_parquet([row], LessonShape(scene.lines))


class _Nobody:
    """Labels nothing: the label is another's, and is put in later."""

    def label(self, shown: Shown, rng: np.random.Generator) -> Label:
        return Label(None, "")


@lru_cache(maxsize=4)
def _selector(settings: str) -> GraspSelector:
    """The selector of some settings; rows need no ranker of the user's."""
    config = build(Config, json.loads(settings), "configuration", ConfigError)
    plain_ranker = replace(config, ranker="clearance", models=None, unchecked=False)
    return GraspSelector(plain_ranker, map_resolutions_m=MAP_RESOLUTIONS_M)


def _row_name(scene: LabelScene, config: Config) -> str:
    settings = plain(replace(scene_config(scene, config), ranker="clearance", models=None))
    said = {"scene": scene.key, "config": settings, "version": __version__}
    sha256 = hashlib.sha256(json.dumps(said, sort_keys=True).encode()).hexdigest()
    return f"rows/{sha256[:2]}/{sha256}.parquet"


def _place(scene: LabelScene) -> tuple[bool, str, int]:
    """Scenarios by set and number, then captures."""
    number = 0 if scene.number is None else scene.number
    is_capture = scene.kind == "capture"
    return is_capture, scene.key if is_capture else scene.key.rpartition("-")[0], number


def _lines(
    labels: Sequence[OperatorLabel], mix: tuple[SetConfig, Rows] | None, lesson: LessonConfig
) -> int:
    found = {item.lines for item in labels} | (set() if mix is None else {mix[0].rows.lines})
    if lesson.lines is not None:
        return lesson.lines
    if len(found) > 1:
        raise ConfigError(
            f"labels of {' and '.join(map(str, sorted(found)))} lines a face; valid: one number "
            "(--lines)"
        )
    if not found:
        raise ConfigError("no labels to learn from; valid: labels of candidates, or `none`")
    return found.pop()


def _refuse_several_hands(labels: Sequence[OperatorLabel]) -> None:
    hands = {
        json.dumps({k: v for k, v in item.gripper.items() if k not in _APART}, sort_keys=True)
        for item in labels
    }
    if len(hands) > 1:
        names = sorted({str(item.gripper.get("name", "")) for item in labels})
        raise ConfigError(
            f"labels of {len(hands)} hands ({', '.join(names)}); valid: a database of one hand's"
        )


def _labeled(row: Rows, label: OperatorLabel) -> Rows:
    """A scene's row with what was said of it."""
    said = help_label(label.lines) if label.verdict == "none" else label.label
    columns = {
        **row.columns,
        "label": np.array([said], dtype=np.int64),
        "label_source": np.array([label.operator], dtype=np.str_),
        SCENE_KEY: np.array([label.scene_key], dtype=np.str_),
    }
    return Rows(columns)


def _mixed(mix: tuple[SetConfig, Rows], lines: int) -> Rows:
    """A set's rows with the columns of labeled scenes."""
    made, rows = mix
    if made.rows.lines != lines:
        raise ConfigError(f"the set has {made.rows.lines} lines a face, labels {lines}; valid: one")
    numbers = np.flatnonzero(rows["given_error"] == "")
    keys = [scene.key for scene in scenario_scenes(made, numbers.tolist())]
    others = {
        name: column
        for name, column in rows.take(numbers).columns.items()
        if not name.startswith("found_")
    }
    return Rows({**others, SCENE_KEY: np.array(keys, dtype=np.str_)})


def _taught(
    rows: Rows,
    labels: Sequence[OperatorLabel],
    scenes: Sequence[LabelScene],
    mix: tuple[SetConfig, Rows] | None,
) -> Taught:
    """The rows with where they come from."""
    configs = [row_config(scene) for scene in scenes if scene.kind == "scenario"]
    configs += [] if mix is None else [mix[0].rows]
    places = sorted({object_set_of(config.recipe) for config in configs})
    if any(scene.kind == "capture" for scene in scenes):
        places.append(_CAPTURES)
    hand = (
        build(Gripper, dict(labels[0].gripper), "label's gripper", ConfigError)
        if labels
        else Gripper()
    )
    provenance = Provenance(
        object_set="; ".join(places),
        seeds=tuple(sorted({config.seed for config in configs})),
        label_source=", ".join(sorted(set(rows["label_source"].tolist()))),
        gripper=hand,
        lines=labels[0].lines if labels else configs[0].lines,
    )
    said = [[item.scene_key, item.operator, item.verdict, item.label] for item in labels]
    made = {
        "labels": len(labels),
        "labels_sha256": hashlib.sha256(json.dumps(said).encode()).hexdigest(),
        "mix": None if mix is None else plain(mix[0]),
        "version": __version__,
    }
    return Taught(rows, provenance, made)
