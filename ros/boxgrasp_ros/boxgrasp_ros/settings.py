"""Every setting of the node as a ROS parameter would hold it, made from the configuration's code.

Nothing here needs ROS: names, types, ranges and meanings are those of the dataclasses.
"""

from __future__ import annotations

import dataclasses
import difflib
import functools
import json
import math
import sys
import types
import typing
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Final, Literal, NamedTuple, Protocol, TypeVar

import msgspec
import yaml
from msgspec import Meta

from boxgrasp.config import Config, load_gripper
from boxgrasp.errors import ConfigError, GripperError
from boxgrasp.strict import attributes_of, build, describe, parse_yaml, plain

D = TypeVar("D")
Seconds = Annotated[float, Meta(gt=0.0, le=3600.0)]
Wait = Annotated[float, Meta(ge=0.0, le=60.0)]

HAND: Final = "the hand is fixed while the node runs: restart with the new one"
FRAMES: Final = "poses kept in the old frame would be mixed: restart with the new one"
THREADS: Final = "the threads that wait are made at the start: restart with the new number"
FIXED: Final = {
    "gripper": HAND,
    "hand": HAND,
    "base_frame": FRAMES,
    "camera_frame": FRAMES,
    "max_waiting": THREADS,
}

# Another name is taken for a slip where it is as near as this to one of ours (difflib's ratio).
_CLOSE = 0.85
_LEAST_INT, _MOST_INT = -(2**63), 2**63 - 1
_UNSET: Final[dict[str, Any]] = {"string": "", "integer": 0, "double": 0.0}
_NONE = (None, "", "null", "~")  # YAML's null reaches a node as text, an empty list as nothing


@dataclass(frozen=True)
class NodeConfig:
    """What the node needs beside the library's configuration.

    Attributes:
        base_frame: frame of every answer; its z points up.
        camera_frame: the camera's optical frame; empty for the frame_id of each view.
        hand: a hand that ships (`boxgrasp gripper list`) or a YAML file of one, from which
            `gripper` starts; empty for the default hand.
        max_view_age_s: a view older than this is stale and not used, s.
        wait_for_view_s: how long a request waits for a view that is not stale, s.
        wait_for_transform_s: how long it waits for the camera's pose in the base, s.
        views: how many earlier views are fused into the map, 0 for the newest alone.
        views_max_age_s: an earlier view older than this is left out, s.
        views_min_move_m: a view is kept where the camera moved this far from the last kept one, m.
        use_octomap: take the map of topic `octomap`, or of MoveIt's planning scene, in place of
            the node's own.
        max_octomap_age_s: such a map older than this is stale and not used, s.
        max_waiting: requests that may wait; more are refused as busy.
        publish_markers: show each answer to RViz.

    Raises:
        ConfigError: a frame's name that tf2 does not take.
    """

    base_frame: str = "base_link"
    camera_frame: str = ""
    hand: str = ""
    max_view_age_s: Seconds = 1.0
    wait_for_view_s: Wait = 1.0
    wait_for_transform_s: Wait = 0.2
    views: Annotated[int, Meta(ge=0, le=20)] = 0
    views_max_age_s: Seconds = 10.0
    views_min_move_m: Annotated[float, Meta(ge=0.0, le=10.0)] = 0.05
    use_octomap: bool = False
    max_octomap_age_s: Seconds = 5.0
    max_waiting: Annotated[int, Meta(ge=1, le=100)] = 4
    publish_markers: bool = True

    def __post_init__(self) -> None:
        for name in ("base_frame", "camera_frame"):
            frame = getattr(self, name)
            if frame.startswith("/") or frame != frame.strip():
                raise ConfigError(
                    f"{name} is {frame!r}; valid: a frame's name without a leading / or blanks"
                )
        if not self.base_frame:
            raise ConfigError("base_frame is empty; valid: the frame that answers are wanted in")


class Given(Protocol):
    """A parameter's name and value, as `rclpy.parameter.Parameter` has them."""

    @property
    def name(self) -> str:
        """With dots."""

    @property
    def value(self) -> Any:
        """None where it is not set."""


RosType = Literal[
    "bool", "integer", "double", "string", "bool array", "integer array", "double array",
    "string array",
]  # fmt: skip


@dataclass(frozen=True)
class Setting:
    """One setting and the parameter that holds it.

    Attributes:
        name: nested with dots, as in the YAML.
        of: `Config` or `NodeConfig`.
        kind: the annotation, without what ROS cannot hold: null.
        default: as the parameter holds it.
        ros_type: the parameter's.
        optional: whether it may be null.
        shape: of nested lists of numbers, which the parameter holds row by row; empty for others.
        text: whether it is a section that the parameter holds as YAML text.
        low: least number, None where there is no range.
        high: greatest, likewise.
        valid: in words.
        fixed: why it cannot change while the node runs, empty where it can.
        description: what it means, one line.
    """

    name: str
    of: type[Config] | type[NodeConfig]
    kind: Any
    default: Any
    ros_type: RosType
    optional: bool
    shape: tuple[int, ...]
    text: bool
    low: float | int | None
    high: float | int | None
    valid: str
    fixed: str
    description: str

    @property
    def path(self) -> tuple[str, ...]:
        """The names from the top to the setting."""
        return tuple(self.name.split("."))

    def read(self, value: Any) -> Any:
        """What the library is given for a parameter's value.

        Args:
            value: any; what has the wrong type is left to the library, which says so.

        Returns:
            Plain data.

        Raises:
            ConfigError: what the library would take, or refuse in words that are not ROS's.
        """
        value = _listed(value)
        if self.optional and (value in _NONE or _same(value, self.write(None))):
            return None
        if self.text:
            return self._read_text(value)
        if value is None:
            raise self._fault(value)
        if self.shape:
            if not isinstance(value, list) or len(value) != math.prod(self.shape):
                raise self._fault(value)
            value = _rows(value, self.shape)
        if self.optional:
            try:
                msgspec.convert(value, type=self.kind)
            except msgspec.ValidationError:
                raise self._fault(value) from None
        return value

    def _read_text(self, value: Any) -> Any:
        names_too = self.kind_has(str)
        if value is None and not names_too:  # ROS reads {} as nothing
            return {}
        if value is None or not isinstance(value, str):
            raise self._fault(value)
        data = parse_yaml(value, f"parameters: {self.name}", ConfigError)
        if isinstance(data, Mapping):
            return data
        if names_too:
            return value
        if data is None:
            return {}
        raise self._fault(value)

    def kind_has(self, kind: type[Any]) -> bool:
        """Whether values of a plain type are among those that are valid.

        Args:
            kind: such as str.

        Returns:
            True where they are.
        """
        literals = [k for k in _members(self.kind) if typing.get_origin(k) is Literal]
        return kind in _members(self.kind) or any(
            isinstance(value, kind) for k in literals for value in typing.get_args(k)
        )

    def write(self, value: Any) -> Any:
        """What a parameter holds for the library's value.

        Args:
            value: plain data.

        Returns:
            A bool, number, text, or list of them.
        """
        if value is None:
            return _UNSET.get(self.ros_type, [])
        if self.text:
            return value if isinstance(value, str) else _flow(value)
        if self.ros_type == "double":
            return float(value)
        if self.ros_type == "double array":
            return [float(number) for number in _flat(value)]
        return list(value) if isinstance(value, list | tuple) else value

    def held(self, value: Any) -> Any:
        """A value in the parameter's own type, where it means one: 1.0 for 1, nothing for null.

        Args:
            value: as someone set it.

        Returns:
            The value that the parameter holds, None for what has another type.
        """
        value = _listed(value)
        if self.optional and (value in _NONE or _same(value, self.write(None))):
            return self.write(None)
        items = value if isinstance(value, list) else [value]
        kind = {"double": float, "integer": int, "bool": bool, "string": str}[
            self.ros_type.split()[0]
        ]
        fits = all(type(item) is kind or (kind is float and _whole(item)) for item in items)
        if not fits or isinstance(value, list) != self.ros_type.endswith("array"):
            return None
        if kind is float:
            return [float(item) for item in items] if isinstance(value, list) else float(value)
        return value

    def _fault(self, value: Any) -> ConfigError:
        return ConfigError(f"parameters: {self.name} is {_shown(value)}; valid: {self.valid}")


@functools.cache
def settings() -> tuple[Setting, ...]:
    """Every setting, the node's own first, in the order of their dataclasses.

    Returns:
        One a parameter.
    """
    return (*_settings_of(NodeConfig, NodeConfig, ()), *_settings_of(Config, Config, ()))


def setting_named(name: str) -> Setting | None:
    """The setting that a parameter holds.

    Args:
        name: the parameter's.

    Returns:
        The setting, None for a name that is none's.
    """
    return _by_name().get(name)


def started(given: Iterable[Given]) -> tuple[Config, NodeConfig]:
    """The configuration that a node starts with.

    Args:
        given: parameters of the command line, launch file or parameter files, all others at their
            defaults; ROS's own and other nodes' pass through.

    Returns:
        The library's and the node's.

    Raises:
        ConfigError: an unknown name in one of our sections, a wrong type, a value out of its
            range, values that contradict each other; one line.
    """
    return _with(Config(), NodeConfig(), given)


def updated(
    config: Config, node_config: NodeConfig, parameters: Iterable[Given]
) -> tuple[Config, NodeConfig]:
    """The configuration of a running node after parameters are set, all together.

    Args:
        config: the library's before.
        node_config: the node's before.
        parameters: as a set-parameters callback is given them; ROS's own pass through.

    Returns:
        The new ones; the very same object where nothing of it changed.

    Raises:
        ConfigError: as `started`, and a setting that is fixed while the node runs; one line.
    """
    after = _with(config, node_config, parameters)
    for setting in settings():
        if not setting.fixed:
            continue
        before, now = (_leaf(half, setting) for half in ((config, node_config), after))
        if before != now:
            kept = _shown(setting.write(before))
            raise ConfigError(f"parameters: {setting.name} stays {kept}: {setting.fixed}")
    return after


def values(config: Config, node_config: NodeConfig) -> dict[str, Any]:
    """What each parameter holds.

    Args:
        config: the library's.
        node_config: the node's.

    Returns:
        Values by name, of every setting.
    """
    return {s.name: s.write(_leaf((config, node_config), s)) for s in settings()}


def near_misses(names: Iterable[str]) -> list[str]:
    """What to tell of parameters that are not this node's but look like a slip.

    Names in none of our sections cannot be refused: a file's `/**` speaks to every node.

    Args:
        names: of parameters given at the start.

    Returns:
        A line a name.
    """
    ours = list(_by_name())
    lines = []
    for name in names:
        top = name.split(".")[0]
        if name in ours or top in _sections() or _ros(name):
            continue
        if "." in name and top in Config.RENAMED:
            lines.append(f"parameter {name!r} is not used: {top} is now {Config.RENAMED[top]}")
        elif close := difflib.get_close_matches(name, ours, n=1, cutoff=_CLOSE):
            lines.append(f"parameter {name!r} is not used; did you mean {close[0]}?")
    return lines


class Row(NamedTuple):
    """One parameter as documentation shows it.

    Attributes:
        name: with dots.
        type: ROS's name of its type.
        default: as YAML.
        valid: in words.
        changeable: whether it can be set while the node runs.
        description: one line.
    """

    name: str
    type: str
    default: str
    valid: str
    changeable: bool
    description: str


def rows() -> list[Row]:
    """Every parameter, for documentation.

    Returns:
        A row a parameter, the node's own first.
    """
    return [
        Row(s.name, s.ros_type, _flow(s.default), s.valid, not s.fixed, s.description)
        for s in settings()
    ]


def markdown_table() -> str:
    """Every parameter as a table.

    Returns:
        Markdown.
    """
    lines = [
        "| parameter | type | default | valid | while running | meaning |",
        "|---|---|---|---|---|---|",
    ]
    for row in rows():
        default = f"`{row.default}`"
        change = "yes" if row.changeable else "fixed"
        cells = (f"`{row.name}`", row.type, default, row.valid, change, row.description)
        lines.append("| " + " | ".join(cell.replace("|", r"\|") for cell in cells) + " |")
    return "\n".join(lines) + "\n"


def _with(
    config: Config, node_config: NodeConfig, given: Iterable[Given]
) -> tuple[Config, NodeConfig]:
    """Both configurations with what is given in place of what was."""
    data: dict[Any, dict[str, Any]] = {Config: plain(config), NodeConfig: plain(node_config)}
    touched: set[Any] = set()
    given = tuple(given)
    for parameter in given:
        if parameter.name == "hand" and parameter.value not in (node_config.hand, *_NONE):
            data[Config]["gripper"] = _hand(parameter.value)
            touched.add(Config)
    for parameter in given:
        setting = setting_named(parameter.name)
        if setting is not None:
            value = setting.read(parameter.value)
            _put(data[setting.of], setting.path, value)
            touched.add(setting.of)
        elif parameter.name.split(".")[0] in _sections() and not _ros(parameter.name):
            _put_unknown(data[Config], parameter.name, parameter.value)
            touched.add(Config)
    if Config in touched:
        new = build(Config, data[Config], "parameters", ConfigError)
        new.mapping.lattice()  # so many cells as memory holds
        config = config if plain(new) == plain(config) else new
    if NodeConfig in touched:
        new_node = build(NodeConfig, data[NodeConfig], "parameters", ConfigError)
        node_config = node_config if new_node == node_config else new_node
    return config, node_config


def _hand(name: Any) -> Any:
    """The sizes of a hand by its name or file."""
    if not isinstance(name, str):
        raise ConfigError(f"parameters: hand is {_shown(name)}; valid: a hand's name or YAML file")
    try:
        return plain(load_gripper(name))
    except GripperError as error:
        raise ConfigError(f"parameters: hand: {error}") from None


def _put(data: dict[str, Any], path: tuple[str, ...], value: Any) -> None:
    for step in path[:-1]:
        data = data[step]
    data[path[-1]] = value


def _put_unknown(data: dict[str, Any], name: str, value: Any) -> None:
    """A name that no setting has, put where the library meets it and says what is valid."""
    path = name.split(".")
    for k in range(1, len(path)):
        if holder := setting_named(".".join(path[:k])):
            raise ConfigError(
                f"parameters: unknown parameter {name!r}; valid: {holder.name} alone, "
                f"{holder.valid}"
            )
    for step in path:
        if step not in data:
            data[step] = {}
            return
        data = data[step]
    if value is not None:  # ROS reads an empty section as nothing
        raise ConfigError(f"parameters: {name} is {_shown(_listed(value))}; valid: a section")


def _leaf(halves: tuple[Config, NodeConfig], setting: Setting) -> Any:
    found: Any = halves[0] if setting.of is Config else halves[1]
    for step in setting.path:
        found = getattr(found, step)
    return plain(found)


@functools.cache
def _by_name() -> dict[str, Setting]:
    return {setting.name: setting for setting in settings()}


@functools.cache
def _sections() -> frozenset[str]:
    return frozenset(s.path[0] for s in settings() if len(s.path) > 1)


def _ros(name: str) -> bool:
    """Whether a parameter is one of those that every node has."""
    return name.split(".")[0] in ("use_sim_time", "qos_overrides", "start_type_description_service")


def _settings_of(
    top: type[Config] | type[NodeConfig], kind: type[Any], place: tuple[str, ...]
) -> Iterator[Setting]:
    hints = typing.get_type_hints(kind, include_extras=True)
    said = attributes_of(kind)[1]
    default = kind()
    for item in dataclasses.fields(kind):
        hint = hints[item.name]
        if dataclasses.is_dataclass(hint) and isinstance(hint, type):
            yield from _settings_of(top, hint, (*place, item.name))
        elif not _holds_sections(hint):  # a list of boxes comes by a hand's name or file
            value = plain(getattr(default, item.name))
            yield _setting(top, (*place, item.name), hint, value, said[item.name])


def _setting(
    top: type[Config] | type[NodeConfig],
    path: tuple[str, ...],
    hint: Any,
    default: Any,
    description: str,
) -> Setting:
    members = [member for member in _members(hint) if member is not types.NoneType]
    optional = len(members) < len(_members(hint))
    kind = hint if not optional else typing.Union[tuple(members)]  # noqa: UP007
    shape = _shape(_bare(kind))
    text = any(_is_section(member) for member in members)
    ros_type = "double array" if shape else "string" if text else _ros_type(_bare(kind))
    low, high = _range(kind, ros_type)
    if optional and low is not None:
        low = min(low, _UNSET[ros_type])
    setting = Setting(
        name=".".join(path),
        of=top,
        kind=kind,
        default=None,
        ros_type=ros_type,
        optional=optional,
        shape=shape,
        text=text,
        low=low,
        high=high,
        valid=_valid(kind, ros_type, shape, text, optional),
        fixed=FIXED.get(path[0], ""),
        description=description,
    )
    return dataclasses.replace(setting, default=setting.write(default))


def _valid(kind: Any, ros_type: str, shape: tuple[int, ...], text: bool, optional: bool) -> str:
    words = describe(kind)
    if shape:
        words = f"{math.prod(shape)} numbers, {shape[0]} rows of {shape[-1]} one after the other"
    elif text:
        words = words.replace("a section", "YAML text of a section", 1)
    if optional:
        words += f", or {json.dumps(_UNSET.get(ros_type, []))} for none"
    return words


def _members(kind: Any) -> tuple[Any, ...]:
    union = typing.get_origin(kind) in (typing.Union, types.UnionType)
    return typing.get_args(kind) if union else (kind,)


def _bare(kind: Any) -> Any:
    return typing.get_args(kind)[0] if typing.get_origin(kind) is Annotated else kind


def _is_section(kind: Any) -> bool:
    return dataclasses.is_dataclass(kind) or typing.get_origin(kind) is dict


def _holds_sections(kind: Any) -> bool:
    """Whether it is a list of sections."""
    return typing.get_origin(kind) is tuple and dataclasses.is_dataclass(typing.get_args(kind)[0])


def _shape(kind: Any) -> tuple[int, ...]:
    """Rows and columns of nested tuples of numbers, empty for all else."""
    if typing.get_origin(kind) is not tuple:
        return ()
    items = typing.get_args(kind)
    first = _bare(items[0])
    if Ellipsis in items or len(set(items)) > 1:
        return ()
    if first is float:
        return (len(items),)
    inner = _shape(first)
    return (len(items), *inner) if inner else ()


def _ros_type(kind: Any) -> RosType:
    scalars: dict[Any, RosType] = {bool: "bool", int: "integer", float: "double", str: "string"}
    arrays: dict[Any, RosType] = {
        bool: "bool array", int: "integer array", float: "double array", str: "string array",
    }  # fmt: skip
    if kind in scalars:
        return scalars[kind]
    if typing.get_origin(kind) is Literal and all(
        isinstance(v, str) for v in typing.get_args(kind)
    ):
        return "string"
    if typing.get_origin(kind) in (tuple, list):
        return arrays[_bare(typing.get_args(kind)[0])]
    raise TypeError(f"no ROS parameter can hold {kind}")


def _range(kind: Any, ros_type: RosType) -> tuple[float | int | None, float | int | None]:
    """The least and the greatest number that are valid, both or none."""
    notes = typing.get_args(kind)[1:] if typing.get_origin(kind) is Annotated else ()
    bounds = [note for note in notes if isinstance(note, Meta)]
    if ros_type not in ("integer", "double") or not bounds:
        return None, None
    low: float | int
    high: float | int
    if ros_type == "integer":
        lows = [b.ge for b in bounds] + [b.gt + 1 for b in bounds if b.gt is not None]
        highs = [b.le for b in bounds] + [b.lt - 1 for b in bounds if b.lt is not None]
        low, high = _LEAST_INT, _MOST_INT
        return (
            max([low, *(int(b) for b in lows if b is not None)]),
            min([high, *(int(b) for b in highs if b is not None)]),
        )
    up = [math.nextafter(b.gt, math.inf) for b in bounds if b.gt is not None]
    down = [math.nextafter(b.lt, -math.inf) for b in bounds if b.lt is not None]
    low = max([-sys.float_info.max, *up, *(float(b.ge) for b in bounds if b.ge is not None)])
    high = min([sys.float_info.max, *down, *(float(b.le) for b in bounds if b.le is not None)])
    return low, high


def _listed(value: Any) -> Any:
    """A value with arrays made lists; texts and bytes stay what they are."""
    if value is None or isinstance(value, bool | int | float | str | bytes):
        return value
    return list(value) if isinstance(value, Iterable) else value


def _same(value: Any, other: Any) -> bool:
    return type(value) is type(other) and bool(value == other)


def _whole(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _rows(numbers: list[Any], shape: tuple[int, ...]) -> list[Any]:
    if len(shape) < 2:
        return numbers
    size = len(numbers) // shape[0]
    return [_rows(numbers[k : k + size], shape[1:]) for k in range(0, len(numbers), size)]


def _flat(value: Any) -> list[Any]:
    if not isinstance(value, list | tuple):
        return [value]
    return [number for item in value for number in _flat(item)]


def _shown(value: Any) -> str:
    if value is None:
        return "empty"
    if isinstance(value, list):
        return f"a list of {len(value)}"
    text = repr(value) if isinstance(value, str) else json.dumps(value, default=str)
    return text if len(text) <= 60 else text[:57] + "..."


def _flow(value: Any) -> str:
    """Plain data as YAML text on one line."""
    if not isinstance(value, Mapping | list | tuple):
        return json.dumps(value)
    text = yaml.safe_dump(
        value, default_flow_style=True, width=math.inf, allow_unicode=True, sort_keys=False
    )
    return str(text).strip()
