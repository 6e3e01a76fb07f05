"""What docs/api.md shows is documented in full, and the pages name what the code has.

Docstrings are Google style. A function says its `Args`, `Returns` and `Raises`, a dataclass its
`Attributes`; every array has a shape in parentheses, every length, angle and time a unit.
"""

from __future__ import annotations

import argparse
import ast
import builtins
import dataclasses
import functools
import importlib
import inspect
import json
import re
import subprocess
import sys
import textwrap
import typing
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FunctionType
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

import boxgrasp
from boxgrasp import GraspSelector, errors
from boxgrasp.arrays import Floats
from boxgrasp.cli import COMMANDS, command_parser
from boxgrasp.config import Config
from boxgrasp.errors import ConfigError, SceneError
from boxgrasp.perception.segmentation import SEGMENTATIONS
from boxgrasp.ranking.ranker import SHIPPED
from boxgrasp.result import JSON_SCHEMA_PATH
from boxgrasp.selector import default_checks
from boxgrasp.simulate import demo_capture

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
SOURCE = ROOT / "src" / "boxgrasp"

DIRECTIVE = re.compile(r"^\.\. auto(function|class|module):: (\S+)\n((?:   :.*\n)*)", re.M)
MEMBERS = re.compile(r"^   :members:(.*)$", re.M)
SECTIONS = ("Args", "Attributes", "Returns", "Yields", "Raises")
HEAD = re.compile(rf"^({'|'.join(SECTIONS)}):$")
ENTRY = re.compile(r"^    (\*{0,2}\w+): (.*)$")

SIZE = r"(?:\d+ l|[A-Za-z]\w{0,7}|\d+|\.\.\.)(?: ?[-+*/] ?\w{1,5})?"
SHAPE = re.compile(rf"\({SIZE},(?: {SIZE},?)*\)|\(\.\.\.\)")
UNITS = {
    "_m": r"\b(m|cm|mm|km|meters)\b",
    "_m2": r"\b(m2|m²|cm²)",
    "_rad": r"\b(rad|mrad|radians|degrees)\b",
    "_ms": r"\b(ms|milliseconds)\b",
    "_s": r"\b(s|seconds)\b",
    "_px": r"\b(px|pixels)\b",
}
COORDINATES = re.compile(r"(?:^|_)(?:points|centers|corners|position)$")


class Directive(NamedTuple):
    """An autodoc directive of docs/api.md; members is None where it shows none of them."""

    kind: str
    path: str
    members: list[str] | None


# What docs/api.md shows.


def directives() -> list[Directive]:
    """All of the page, in order."""
    found = []
    for kind, path, body in DIRECTIVE.findall((DOCS / "api.md").read_text("utf-8")):
        members = MEMBERS.search(body)
        names = [name for name in re.split(r"[,\s]+", members[1]) if name] if members else None
        found.append(Directive(kind, path, names))
    return found


def shown_faults(directive: Directive) -> list[str]:
    """What the docstrings that a directive shows lack."""
    kind, path, members = directive
    if kind == "module":
        module = importlib.import_module(path)
        own = members or [name for name in vars(module) if _is_own(module, name)]
        return [f"{name}: {said}" for name in own for said in faults_of(getattr(module, name))]
    module_name, _, name = path.rpartition(".")
    thing = getattr(importlib.import_module(module_name), name)
    found = faults_of(thing, members == [])
    for member in members or []:
        value = inspect.getattr_static(thing, member)
        found += [f"{member}: {said}" for said in member_faults(value)]
    return found


def _is_own(module: Any, name: str) -> bool:
    value = getattr(module, name)
    is_code = isinstance(inspect.unwrap(value) if callable(value) else value, FunctionType | type)
    return is_code and not name.startswith("_") and value.__module__ == module.__name__


# What a docstring says.


class Doc(NamedTuple):
    """A docstring in parts: its words before any section, and sections as entries or text."""

    text: str
    entries: dict[str, dict[str, str]]
    words: dict[str, str]


def parsed(thing: Any) -> Doc:
    """The parts of a docstring."""
    text = inspect.cleandoc(thing.__doc__ or "")
    section, name, head = "", "", []
    entries: dict[str, dict[str, str]] = {}
    words: dict[str, str] = {}
    for line in text.splitlines():
        if match := HEAD.match(line):
            section, name = match[1], ""
            entries[section], words[section] = {}, ""
        elif not section:
            head.append(line)
        elif line and not line.startswith(" "):
            section = ""
            head.append(line)
        elif (entry := ENTRY.match(line)) and section in ("Args", "Attributes", "Raises"):
            name = entry[1].lstrip("*")
            entries[section][name] = entry[2]
        elif name:
            entries[section][name] += " " + line.strip()
        else:
            words[section] += " " + line.strip()
    return Doc("\n".join(head).strip(), entries, {key: said.strip() for key, said in words.items()})


# What is wrong with one.


def function_faults(function: Callable[..., Any], *, prop: bool = False) -> Iterator[str]:
    """What the docstring of a function, a method or a property lacks."""
    function = inspect.unwrap(function)
    doc = parsed(function)
    if not doc.text:
        yield "has no docstring"
        return
    signature = inspect.signature(function)
    takes = {
        name: value.annotation
        for k, (name, value) in enumerate(signature.parameters.items())
        if not (k == 0 and name in ("self", "cls"))
    }
    yield from _entry_faults(doc, "Args", {} if prop else takes, function)
    gives = signature.return_annotation
    if prop:
        yield from _value_faults(function.__name__, function.__doc__ or "", gives, function)
    elif gives not in (None, "None", "NoReturn", inspect.Signature.empty):
        said = doc.words.get("Returns") or doc.words.get("Yields") or ""
        if not said:
            yield "says no Returns"
        else:
            yield from _value_faults(function.__name__, said, gives, function)
    yield from _raise_faults(doc, function, takes)


def class_faults(kind: type[Any], with_members: bool = True) -> Iterator[str]:
    """What the docstrings of a class and of its members lack."""
    doc = parsed(kind) if "__doc__" in vars(kind) else Doc("", {}, {})
    if not doc.text or doc.text.startswith(f"{kind.__name__}("):  # as dataclasses make one
        yield "has no docstring"
    if dataclasses.is_dataclass(kind):
        names = [item.name for item in dataclasses.fields(kind)]
    else:
        names = list(vars(kind).get("__annotations__", {}))
    holds = {
        name: _annotation(kind, name)
        for name in names
        if not name.startswith("_") and "ClassVar" not in str(_annotation(kind, name))
    }
    yield from _entry_faults(doc, "Attributes", holds, kind)
    own = [vars(kind).get(name) for name in ("__post_init__", "__init__")]
    by_hand = [
        f for f in own if isinstance(f, FunctionType) and f.__doc__ is None and _has_source(f)
    ]
    for function in by_hand:
        yield from _raise_faults(doc, function, {})
    if not with_members:
        return
    for name, value in vars(kind).items():
        written = isinstance(value, FunctionType) and value.__doc__ and _has_source(value)
        if not name.startswith("_") or (name == "__init__" and written):
            yield from (f"{name}: {fault}" for fault in member_faults(value))


def member_faults(value: Any) -> Iterator[str]:
    """What the docstring of a class's member lacks; nothing for a plain value."""
    if isinstance(value, property):
        yield from function_faults(typing.cast(Any, value.fget), prop=True)
    elif isinstance(value, functools.cached_property):  # noqa: TID251
        yield from function_faults(value.func, prop=True)
    elif isinstance(value, classmethod | staticmethod):
        yield from function_faults(value.__func__)
    elif isinstance(value, FunctionType):
        yield from function_faults(value)


def faults_of(thing: Any, with_members: bool = True) -> list[str]:
    """What the docstrings of a shown thing lack."""
    if isinstance(thing, type):
        return list(class_faults(thing, with_members))
    return list(function_faults(thing))


def _entry_faults(doc: Doc, section: str, wanted: dict[str, Any], thing: Any) -> Iterator[str]:
    said = doc.entries.get(section, {})
    if wanted and not said:
        yield f"has no {section}"
        return
    for name in wanted.keys() - said.keys():
        yield f"{section} do not name {name}"
    for name in said.keys() - wanted.keys():
        yield f"{section} name {name}, which is not there"
    for name in wanted.keys() & said.keys():
        yield from _value_faults(name, said[name], wanted[name], thing)


def _value_faults(name: str, said: str, annotation: Any, thing: Any) -> Iterator[str]:
    """A missing shape of an array, a missing unit of a length, an angle or a time."""
    arrays = _arrays_in(annotation, thing)
    if len(SHAPE.findall(said)) < arrays:
        yield f"{name} is {arrays} array(s), without a shape such as (N, 3): {said!r}"
    units = [words for suffix, words in UNITS.items() if name.endswith(suffix)]
    if arrays and COORDINATES.search(name):
        units.append(rf"{UNITS['_m']}|{UNITS['_px']}")
    if any(not re.search(words, said) for words in units):
        yield f"{name} has no unit: {said!r}"


def _arrays_in(annotation: Any, thing: Any) -> int:
    """How many arrays an annotation names; aliases are looked up where it stands."""
    space = vars(importlib.import_module(thing.__module__)) if thing.__module__ else {}
    names = re.findall(r"\w+", annotation if isinstance(annotation, str) else str(annotation))
    return sum(_is_array(name, space) for name in names)


def _is_array(name: str, space: dict[str, Any]) -> bool:
    value = space.get(name, vars(boxgrasp.arrays).get(name))
    return name in ("NDArray", "ArrayLike") or _holds_array(value)


def _holds_array(value: Any) -> bool:
    if typing.get_origin(value) in (np.ndarray, NDArray):  # the latter from numpy 2.5 on
        return True
    return any(_holds_array(part) for part in typing.get_args(value))


def _raise_faults(doc: Doc, function: Callable[..., Any], takes: dict[str, Any]) -> Iterator[str]:
    said = doc.entries.get("Raises", {})
    space = vars(importlib.import_module(function.__module__))
    for name in sorted(_raised(function)):
        kind = space.get(name, getattr(errors, name, getattr(builtins, name, None)))
        bases = {base.__name__ for base in kind.__mro__} if isinstance(kind, type) else {name}
        if not bases & said.keys():
            yield f"Raises do not name {name}"
    for name in said:
        if name not in takes and not hasattr(errors, name) and not hasattr(builtins, name):
            yield f"Raises name {name}, which is no error"


def _raised(function: Callable[..., Any]) -> set[str]:
    """Public exceptions that a function raises, itself or in a private helper of its module."""
    found: set[str] = set()
    waiting, met = [function], set()
    while waiting:
        one = inspect.unwrap(waiting.pop())
        if one in met:
            continue
        met.add(one)
        tree = ast.parse(textwrap.dedent(inspect.getsource(one)))
        names, called = _raised_in(tree, frozenset())
        found |= names
        space = vars(importlib.import_module(one.__module__))
        helpers = (space.get(name) for name in called if name.startswith("_"))
        waiting += [
            helper
            for helper in helpers
            if isinstance(helper, FunctionType) and helper.__module__ == one.__module__
        ]
    return found


def _raised_in(node: ast.AST, caught: frozenset[str]) -> tuple[set[str], set[str]]:
    """Names of the public exceptions that leave a node, and of the functions called in it.

    A function that is called where something is caught may raise what is turned into another
    error there, so it does not count.
    """
    raised: set[str] = set()
    called: set[str] = set()
    if isinstance(node, ast.Raise) and node.exc is not None:
        name = _last_name(node.exc.func if isinstance(node.exc, ast.Call) else node.exc)
        raised |= {name} - caught if name[:1].isupper() else set()
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and not caught:
        called.add(node.func.id)
    for field, value in ast.iter_fields(node):
        within = caught
        if isinstance(node, ast.Try) and field == "body":
            kinds = [handler.type for handler in node.handlers if handler.type is not None]
            parts = [part for kind in kinds for part in getattr(kind, "elts", [kind])]
            within = caught | {_last_name(part) for part in parts}
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST):
                names, functions = _raised_in(child, within)
                raised |= names
                called |= functions
    return raised, called


def _last_name(node: ast.AST) -> str:
    return node.id if isinstance(node, ast.Name) else getattr(node, "attr", "")


def _has_source(function: FunctionType) -> bool:
    """Whether it is written by hand: dataclasses make some, protocols take one of typing."""
    return function.__code__.co_filename != "<string>" and function.__module__ != "typing"


def _annotation(kind: type[Any], name: str) -> Any:
    for base in kind.__mro__:
        if name in vars(base).get("__annotations__", {}):
            return vars(base)["__annotations__"][name]
    return "Any"


# The tests.


@pytest.mark.parametrize("directive", directives(), ids=lambda directive: directive.path)
def test_what_the_api_page_shows_is_documented_in_full(directive: Directive) -> None:
    found = shown_faults(directive)
    assert not found, "\n".join(found)


def test_the_api_page_shows_every_public_name() -> None:
    shown = {name for _, path, members in directives() for name in (path, *(members or []))}
    config = {name for name in dir(boxgrasp.config) if name in boxgrasp.__all__}  # all of it
    shown = {name.rpartition(".")[2] for name in shown} | config
    assert set(boxgrasp.__all__) - {"__version__", "BoxgraspError"} <= shown


def good(points: Floats, back_m: float, *, steps: int = 1) -> Floats:
    """The points, moved back.

    Args:
        points: (N, 3) float64, base frame, m.
        back_m: how far, m.
        steps: in how many.

    Returns:
        (N, 3) float64, base frame, m.

    Raises:
        ConfigError: no step.
    """
    if steps < 1:
        raise ConfigError("no step")
    return points - back_m


def no_sections(points: Floats) -> Floats:
    """The points."""
    return points


def no_shape(points: Floats) -> Floats:
    """The points.

    Args:
        points: of the view, m.

    Returns:
        The same.
    """
    return points


def no_unit(back_m: float, points: Floats) -> None:
    """Move.

    Args:
        back_m: how far.
        points: (N, 3) of the view.
    """


def misnamed(back_m: float) -> None:
    """Move.

    Args:
        by_m: how far, m.
    """


def silent_raise() -> None:
    """Refuse."""
    _refuse()


def _refuse() -> None:
    raise SceneError("nothing there")


def turned_raise() -> None:
    """Refuse.

    Raises:
        ConfigError: always.
    """
    try:
        raise ValueError("inner")
    except ValueError:
        raise ConfigError("outer") from None


@dataclasses.dataclass(frozen=True)
class Half:
    """Half a docstring.

    Attributes:
        center_m: (3,) base frame.
    """

    center_m: Floats
    yaw_rad: float

    @property
    def place(self) -> Floats:
        """Where it is."""
        return self.center_m


def test_a_full_docstring_has_no_fault() -> None:
    assert faults_of(good) == []
    assert faults_of(turned_raise) == []


@pytest.mark.parametrize(
    ("thing", "faults"),
    [
        (no_sections, ["has no Args", "says no Returns"]),
        (no_shape, ["points is 1 array(s)", "no_shape is 1 array(s)"]),
        (no_unit, ["back_m has no unit", "points has no unit"]),
        (misnamed, ["Args do not name back_m", "Args name by_m"]),
        (silent_raise, ["Raises do not name SceneError"]),
        (Half, ["Attributes do not name yaw_rad", "center_m has no unit", "place: place is"]),
    ],
)  # fmt: skip
def test_a_poor_docstring_is_found(thing: Any, faults: list[str]) -> None:
    found = sorted(faults_of(thing))
    assert len(found) == len(faults), found
    assert all(any(said.startswith(fault) for said in found) for fault in faults), found


# The pages name what the code has.


def page(name: str) -> str:
    """The text of a page."""
    return (DOCS / name).read_text("utf-8")


def sections_of(kind: type[Any], place: str = "") -> Iterator[tuple[str, type[Any]]]:
    """Every section of the configuration, with its dotted name."""
    yield place, kind
    for name, hint in typing.get_type_hints(kind).items():
        if dataclasses.is_dataclass(hint):
            yield from sections_of(typing.cast(type[Any], hint), f"{place}{name}.")


def test_names_page_has_every_setting_that_was_renamed() -> None:
    said = page("names.md")
    for place, kind in sections_of(Config):
        for old, new in getattr(kind, "RENAMED", {}).items():
            row = rf"^\|[^|]*`[\w.]*{old}`[^|]*\|[^|]*`{re.escape(place)}{new}`"
            assert re.search(row, said, re.M), f"{old} -> {place}{new}"


def test_pages_list_every_warning_code() -> None:
    codes = set()
    for path in SOURCE.rglob("*.py"):
        codes |= {code for code in _warning_codes(ast.parse(path.read_text("utf-8")))}
    assert len(codes) >= 10
    assert all(f"`{code}`" in page("how-it-works.md") for code in codes), codes


def _warning_codes(tree: ast.AST) -> Iterator[str]:
    for node in ast.walk(tree):
        called = isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
        if called and node.func.id == "CodedWarning" and node.args:  # type: ignore[attr-defined]
            code = node.args[0]  # type: ignore[attr-defined]
            if isinstance(code, ast.Constant):
                yield code.value
            elif isinstance(code, ast.JoinedStr):  # width_{axis}_lower_bound
                parts = [p.value if isinstance(p, ast.Constant) else "?" for p in code.values]
                yield from ("".join(parts).replace("?", axis) for axis in "xy")


def test_pages_list_every_check_and_ranker() -> None:
    said = page("how-it-works.md")
    assert all(f"`{check.name}`" in said for check in default_checks())
    assert all(f"`{name}`" in said for name in SHIPPED)


def test_pages_list_every_field_of_an_answer() -> None:
    schema = json.loads(JSON_SCHEMA_PATH.read_text("utf-8"))
    said = page("file-formats.md")
    missing = [name for name in _property_names(schema) if name not in said]
    assert not missing


def test_the_example_answer_has_the_form_of_a_real_one() -> None:
    block = re.findall(r"```js\n(.*?)```", page("file-formats.md"), re.S)[0]
    shown = json.loads(re.sub(r"  // .*$", "", block, flags=re.M))
    real = GraspSelector().select(demo_capture()).to_dict()
    assert list(shown) == list(real)
    assert shown["config_hash"] == real["config_hash"]
    for name in ("grasp", "box", "gripper", "timings_ms"):
        assert list(shown[name]) == list(real[name])
    (candidate,) = shown["candidates"]
    first = real["candidates"][0]
    assert list(candidate) == list(first) and candidate["rejections"] == first["rejections"]
    for name, said in first["checks"].items():
        assert list(candidate["checks"][name]) == list(said)
        assert candidate["checks"][name]["value"] == pytest.approx(said["value"], abs=1e-4)
    assert shown["grasp"]["position_m"] == pytest.approx(real["grasp"]["position_m"], abs=1e-4)


def _property_names(schema: Any) -> Iterator[str]:
    if isinstance(schema, dict):
        yield from schema.get("properties", {})
        for value in schema.values():
            yield from _property_names(value)
    elif isinstance(schema, list):
        for value in schema:
            yield from _property_names(value)


@pytest.mark.parametrize("command", COMMANDS)
def test_pages_have_every_option(command: str) -> None:
    said = page("command-line.md") + page("teaching.md") + page("file-formats.md")
    assert f"`{command}`" in said
    for action in command_parser(command)._actions:
        gone = action.help == argparse.SUPPRESS  # refused with the name that it has now
        for flag in action.option_strings:
            assert flag in (page("names.md") if gone else said) or flag in ("-h", "--help"), flag


def new_files() -> dict[str, str]:
    """The files that docs/extending.md adds, by their names without folders."""
    found = {}
    for block in diffs():
        for head, lines in re.findall(r"^\+\+\+ b/(\S+)\n@@ -0,0 .*\n((?:\+.*\n)+)", block, re.M):
            found[Path(head).name] = re.sub(r"^\+", "", lines, flags=re.M)
    return found


def diffs() -> list[str]:
    """The diffs of docs/extending.md."""
    return re.findall(r"```diff\n(.*?)```", page("extending.md"), re.S)


@pytest.mark.parametrize(
    "diff", diffs(), ids=lambda diff: diff.splitlines()[1].removeprefix("+++ b/")
)
def test_extending_page_has_diffs_that_apply(diff: str) -> None:
    done = subprocess.run(
        ["git", "apply", "--check", "-"], input=diff, text=True, cwd=ROOT, capture_output=True
    )
    assert done.returncode == 0, done.stderr


def test_what_the_extending_page_adds_works(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, text in new_files().items():
        (tmp_path / name).write_text(text, "utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    for name in ("within_reach", "lowest", "plan"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    view = demo_capture()
    # A check, handed over as the page says.
    space: dict[str, Any] = {}
    exec(re.findall(r"```python\n(.*?)```", page("extending.md"), re.S)[0], space)
    refusal = space["selector"].select(view).refusal
    assert refusal is not None
    assert [item.sentence for item in refusal.violations] == [
        "within reach: 82.2 cm, at most 80.0 cm"
    ]
    assert refusal.violations[0].sentence in page("extending.md")
    # A ranker.
    ranked = GraspSelector(ranker=importlib.import_module("lowest").Lowest()).select(view)
    heights_m = [c.T_base_gripper[2, 3] for c in sorted(ranked.candidates, key=lambda c: c.rank)]
    assert np.all(np.diff(heights_m) > -0.001)
    # A segmentation: the lamp over the can becomes one object with it.
    monkeypatch.setitem(SEGMENTATIONS, "plan", "plan:plan_segments")
    found = GraspSelector({"scene": {"segmentation": "plan"}}).objects(view)
    split = GraspSelector({"scene": {"segmentation": "split"}})
    assert len(found) == len(split.objects(view)) - 1


OLD_WORDS = re.compile(
    r"\b(choosers?|sureness|sights?|situation|hall|house|blocking|best_rejected|seen_m|body_m|"
    r"far_m|near_m|unseen_share|unseen_m)\b"
)


@pytest.mark.parametrize(
    "path", sorted([*DOCS.glob("*.md"), ROOT / "README.md"]), ids=lambda p: p.name
)
def test_pages_use_the_new_words(path: Path) -> None:
    if path.name == "names.md":
        return
    assert not OLD_WORDS.findall(path.read_text("utf-8"))
