"""Plain data into frozen dataclasses, strictly: nothing misspelt, mistyped or out of range passes.

The types and ranges are the annotations of the dataclasses (`Annotated[float, Meta(ge=0)]`). A
dataclass may say what its fields were called before, as a `RENAMED: ClassVar[dict[str, str]]` from
old to new.
"""

from __future__ import annotations

import dataclasses
import inspect
import json
import math
import re
import types
import typing
from collections.abc import Iterator, Mapping
from os import PathLike, fspath
from typing import Any, BinaryIO, TypeVar

import msgspec

from boxgrasp.errors import BoxgraspError, ConfigError, shown

D = TypeVar("D")
Source = str | PathLike[str]
Place = tuple[str | int, ...]

_DEEPEST = 10  # levels of settings that no annotation knows; YAML aliases could nest them forever


def build(kind: type[D], data: Any, origin: str, error: type[BoxgraspError]) -> D:
    """A frozen dataclass from plain data; `origin` names the data's source in messages.

    Raises:
        error: unknown keys at any depth, wrong types, values out of range.
    """
    try:
        data = _validated(kind, {} if data is None else data, ())
        return msgspec.convert(data, type=kind)
    except _FaultError as fault:
        raise error(f"{origin}: {fault}") from None
    except msgspec.ValidationError as fault:
        raise error(f"{origin}: {_explain(kind, data, str(fault))}") from None
    except BoxgraspError as fault:  # from the dataclass's own __post_init__
        raise error(f"{origin}: {fault}") from None


def validate_types(thing: Any, name: str, error: type[BoxgraspError]) -> None:
    """Refuse a dataclass whose fields were not given what their annotations say.

    Raises:
        error: names the first such field.
    """
    for item in dataclasses.fields(thing):
        value, kind = getattr(thing, item.name), _hints(type(thing))[item.name]
        if not _fits(kind, value):
            raise error(f"{name} {item.name} is {shown(value)}; valid: {describe(kind)}")


def _fits(kind: Any, value: Any) -> bool:
    section = _section(kind)
    if section is not None:
        return isinstance(value, section) or (value is None and _optional(kind))
    try:
        msgspec.convert(plain(value), type=_strip(kind))
    except (msgspec.ValidationError, OverflowError, BoxgraspError):
        return False
    return True


class _FaultError(Exception):
    """What is wrong with the data, without the name of the file it came from."""


def _validated(kind: Any, data: Any, place: Place) -> Any:
    """The data with unknown keys refused at every level, and empty sections made empty maps."""
    section = _section(kind)
    if section is not None and (data is None or isinstance(data, Mapping)):
        hints = _hints(section)
        names = [item.name for item in dataclasses.fields(section) if item.init]
        data = {} if data is None and not _optional(kind) else data
        if data is None:
            return None
        for key in data:
            if key not in names:
                raise _FaultError(_unknown(key, section, names, place))
        return {key: _validated(hints[key], value, (*place, key)) for key, value in data.items()}
    if isinstance(data, Mapping) and typing.get_origin(_strip(kind)) is dict:
        return _free(data, place)
    if isinstance(data, Mapping) and (of := _value_kind(kind)) is not None:
        return {key: _validated(of, value, (*place, key)) for key, value in data.items()}
    if isinstance(data, list | tuple) and kind is not Any:
        items = _item_kinds(kind)
        pairs = zip(items, data, strict=False)
        return [_validated(item, value, (*place, i)) for i, (item, value) in enumerate(pairs)]
    if isinstance(data, float) and not math.isfinite(data):
        raise _FaultError(f"{_spell(place)} is {data}; valid: a finite number")
    return data


def _free(data: Any, place: Place) -> Any:
    """Settings that no annotation knows, as those of a plugin: plain data and nothing else."""
    if len(place) > _DEEPEST:
        raise _FaultError(f"{_spell(place)} is nested too deeply; valid: {_DEEPEST} levels")
    if isinstance(data, Mapping):
        for key in data:
            if not isinstance(key, str):
                raise _FaultError(f"key {_shown(key)} in {_spell(place)} is no text; valid: text")
        return {key: _free(value, (*place, key)) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [_free(value, (*place, i)) for i, value in enumerate(data)]
    finite = not isinstance(data, float) or math.isfinite(data)
    if not finite or not isinstance(data, bool | int | float | str | types.NoneType):
        raise _FaultError(
            f"{_spell(place)} is {data if not finite else type(data).__name__}; valid: a finite "
            "number, text, true, false, null, a list or a section"
        )
    return data


def _unknown(key: object, section: type[Any], names: list[str], place: Place) -> str:
    import difflib

    where = f" in {_spell(place)}" if place else ""
    renamed = getattr(section, "RENAMED", {}).get(key)
    if renamed:
        return f"{key!r}{where} is now {renamed!r}"
    close = difflib.get_close_matches(str(key), names, n=1)
    hint = f"; did you mean {close[0]}?" if close else ""
    return f"unknown key {key!r}{where}; valid: {', '.join(names)}{hint}"


def _spell(place: Place) -> str:
    parts = (f"[{step}]" if isinstance(step, int) else f".{step}" for step in place)
    return "".join(parts).lstrip(".") or "the whole"


_HINTS: dict[type[Any], dict[str, Any]] = {}


def _hints(section: type[Any]) -> dict[str, Any]:
    """The types of a dataclass's fields, kept: finding them takes longer than all else here."""
    if section not in _HINTS:
        _HINTS[section] = typing.get_type_hints(section, include_extras=True)
    return _HINTS[section]


def _strip(kind: Any) -> Any:
    """The type without its Annotated."""
    return typing.get_args(kind)[0] if typing.get_origin(kind) is typing.Annotated else kind


def _members(kind: Any) -> list[Any]:
    kind = _strip(kind)
    union = typing.get_origin(kind) in (typing.Union, types.UnionType)
    return [_strip(member) for member in typing.get_args(kind)] if union else [kind]


def _optional(kind: Any) -> bool:
    return types.NoneType in _members(kind)


def _section(kind: Any) -> type[Any] | None:
    for member in _members(kind):
        if isinstance(member, type) and dataclasses.is_dataclass(member):
            return member
    return None


def _value_kind(kind: Any) -> Any:
    """The type of a map's values, None for what is no map of dataclasses."""
    for member in _members(kind):
        args = typing.get_args(member)
        if typing.get_origin(member) in (dict, Mapping) and _section(args[1]) is not None:
            return args[1]
    return None


def _item_kinds(kind: Any) -> Iterator[Any]:
    """The types of a list's items, endless."""
    for member in _members(kind):
        args = typing.get_args(member)
        if typing.get_origin(member) in (tuple, list) and args:
            if len(args) == 2 and args[1] is Ellipsis:
                args = args[:1]
            yield from args
            while typing.get_origin(member) is list or typing.get_args(member)[-1] is Ellipsis:
                yield args[0]
    while True:
        yield Any


def _explain(kind: Any, data: Any, message: str) -> str:
    """msgspec's message as: place, what was found, what is valid."""
    text, _, path = message.partition(" - at `$")
    if "[...]." in path:  # within a value of a map, whose key the message does not tell
        return f"{path.strip('`').lstrip('.')}: {text[:1].lower()}{text[1:]}"
    place: list[str | int] = []
    for name, index in re.findall(r"\.(\w+)|\[(\d+)\]", path):
        place.append(name or int(index))
    found, wanted = data, kind
    for step in place:
        found = found[step]
        section = _section(wanted)
        if isinstance(step, int):
            items = _item_kinds(wanted)
            for _ in range(step):
                next(items)
            wanted = next(items)
        elif section is not None:
            wanted = _hints(section)[step]
    return f"{_spell(tuple(place))} is {_shown(found)}; valid: {describe(wanted)}"


def _shown(found: Any) -> str:
    if isinstance(found, Mapping):
        return "a section"
    if isinstance(found, list | tuple):
        return f"a list of {len(found)}"
    text = repr(found) if isinstance(found, str) else json.dumps(found, default=str)
    return text if len(text) <= 60 else text[:57] + "..."


_NAMES = {float: "a number", int: "a whole number", bool: "true or false", str: "text"}
_BOUNDS = (("gt", "above"), ("ge", "at least"), ("lt", "below"), ("le", "at most"))


def describe(kind: Any) -> str:
    """A setting's type and range in words, from its annotation."""
    notes = typing.get_args(kind)[1:] if typing.get_origin(kind) is typing.Annotated else ()
    said = " or ".join(_kind_name(member) for member in _raw_members(_strip(kind)))
    for note in notes:
        if isinstance(note, msgspec.Meta):
            bounds = [
                f"{word} {getattr(note, name):g}"
                for name, word in _BOUNDS
                if getattr(note, name) is not None
            ]
            said += f" {' and '.join(bounds)}" if bounds else ""
    return said


def _raw_members(kind: Any) -> list[Any]:
    union = typing.get_origin(kind) in (typing.Union, types.UnionType)
    return list(typing.get_args(kind)) if union else [kind]


def _kind_name(kind: Any) -> str:
    if typing.get_origin(kind) is typing.Annotated:
        return describe(kind)
    if typing.get_origin(kind) is typing.Literal:
        return ", ".join(str(value) for value in typing.get_args(kind))
    if typing.get_origin(kind) is dict:
        value = typing.get_args(kind)[1]
        return "a section" if value is Any else f"a section, each entry {describe(value)}"
    if typing.get_origin(kind) in (tuple, list):
        args = typing.get_args(kind)
        if typing.get_origin(kind) is list or args[-1] is Ellipsis:
            return f"a list, each {describe(args[0])}"
        return f"a list of {len(args)}, each {describe(args[0])}"
    if kind is types.NoneType:
        return "null"
    section = _section(kind)
    if section is not None:
        return f"a section with {', '.join(item.name for item in dataclasses.fields(section))}"
    return _NAMES.get(kind, str(kind))


def attributes_of(kind: type[Any]) -> tuple[str, dict[str, str]]:
    """What a dataclass's docstring says before its attributes, and of each; one line each."""
    text = inspect.cleandoc(kind.__doc__ or "")
    head, _, rest = text.partition("Attributes:\n")
    entries = re.split(r"^    (\w+): ", rest.split("\n\n")[0], flags=re.M)[1:]
    said = zip(entries[::2], entries[1::2], strict=True)
    return _line(head), {name: _line(words) for name, words in said}


def read_yaml(path: Source, error: type[BoxgraspError]) -> Any:
    """The plain data of a YAML file, read safely.

    Raises:
        error: the file cannot be read, is not YAML, or gives a key twice.
    """
    try:
        with open(path, "rb") as file:
            return parse_yaml(file, fspath(path), error)
    except (OSError, ValueError) as fault:  # a path with a zero byte is no value
        said = getattr(fault, "strerror", None) or fault
        raise error(f"{_line(fspath(path))}: {said}") from None


def parse_yaml(source: str | BinaryIO, origin: str, error: type[BoxgraspError]) -> Any:
    """The plain data of YAML text, read safely; `origin` names the text's source in messages.

    Raises:
        error: it is not YAML, or gives a key twice.
    """
    import yaml

    try:
        return yaml.load(source, Loader=_loader())
    except yaml.MarkedYAMLError as fault:
        mark = fault.problem_mark or fault.context_mark
        where = f"line {mark.line + 1}, column {mark.column + 1}: " if mark else ""
        raise error(f"{origin}: {where}{_line(fault.problem or fault)}") from None
    except (yaml.YAMLError, ValueError, RecursionError) as fault:
        raise error(f"{origin}: not YAML: {_line(fault)}") from None


def _line(text: object) -> str:
    return " ".join(str(text).split())


def _loader() -> Any:
    """PyYAML's safe loader, that refuses a key given twice and reads 1e-3 as a number."""
    import yaml

    class Loader(yaml.SafeLoader):
        def construct_mapping(self, node: Any, deep: bool = False) -> Any:
            seen = set()
            for key_node, _ in node.value:
                key = (key_node.tag, getattr(key_node, "value", None))
                if isinstance(key[1], str) and key in seen:
                    raise yaml.constructor.ConstructorError(
                        None, None, f"key {key[1]!r} is given twice", key_node.start_mark
                    )
                seen.add(key if isinstance(key[1], str) else id(key_node))
            return super().construct_mapping(node, deep)

    number = re.compile(r"[-+]?(\d[\d_]*\.?[\d_]*|\.\d[\d_]*)[eE][-+]?\d+")
    Loader.add_implicit_resolver("tag:yaml.org,2002:float", number, list("-+.0123456789"))
    return Loader


def plain(value: Any) -> Any:
    """A dataclass as maps, lists, numbers and strings, every field in it.

    msgspec.to_builtins will not do: it leaves out defaults and adds cached properties.
    """
    if dataclasses.is_dataclass(value):
        return {item.name: plain(getattr(value, item.name)) for item in dataclasses.fields(value)}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, Mapping):
        return {name: plain(item) for name, item in value.items()}
    return value


def to_yaml(data: Any) -> str:
    """Plain data as YAML; lists of plain values on one line."""
    import yaml

    return str(yaml.dump(data, Dumper=_dumper(), sort_keys=False))


def _dumper() -> Any:
    import yaml

    class Dumper(yaml.SafeDumper):
        def ignore_aliases(self, data: Any) -> bool:
            return True

        def represent_short(self, data: Any) -> Any:
            flat = not any(isinstance(item, list | tuple | dict) for item in data)
            return self.represent_sequence("tag:yaml.org,2002:seq", data, flow_style=flat)

    Dumper.add_representer(list, Dumper.represent_short)
    Dumper.add_representer(tuple, Dumper.represent_short)
    return Dumper


def plugin(group: str, name: str, settings: Mapping[str, Any] | None = None) -> Any:
    """An object of a class that an installed package brings under a name.

    Args:
        group: of entry points.
        name: of the entry point.
        settings: what the class is called with, by name.

    Returns:
        The object, or None where no package has the name.

    Raises:
        ConfigError: it cannot be imported, does not take the settings, or two packages have it.
    """
    from importlib.metadata import entry_points

    found = tuple(entry_points(group=group, name=name))
    if len({entry.value for entry in found}) > 1:
        both = ", ".join(sorted(entry.value for entry in found))
        raise ConfigError(f"entry point {name!r} of {group} is taken twice: {both}; valid: once")
    if not found:
        return None
    try:
        return found[0].load()(**(settings or {}))
    except Exception as fault:  # the package's own code may raise anything
        kind = "" if isinstance(fault, BoxgraspError) else f"{type(fault).__name__}: "
        raise ConfigError(
            f"entry point {name!r} of {group}, {found[0].value}: {kind}{_line(fault)}"
        ) from None


def plugin_names(group: str) -> tuple[str, ...]:
    """Names of all entry points that installed packages bring.

    Args:
        group: of entry points.

    Returns:
        Sorted names.
    """
    from importlib.metadata import entry_points

    return tuple(sorted(entry_points(group=group).names))
