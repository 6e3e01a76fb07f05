"""The shape of the source: small functions, packages in one order, compiled loops in one place."""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import grimp
import pytest

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).resolve().parent.parent
SOURCE = ROOT / "src" / "boxgrasp"
MOST_LINES, MOST_PARAMETERS, MOST_MODULES = 50, 6, 10
Function = ast.FunctionDef | ast.AsyncFunctionDef


def functions(tree: ast.AST) -> Iterator[Function]:
    return (node for node in ast.walk(tree) if isinstance(node, Function))


def lines_of(function: Function) -> int:
    """Lines of a function from its `def` on, without its docstring."""
    first = function.body[0]
    held = ast.get_docstring(function, clean=False) is not None
    docstring = (first.end_lineno or 0) - first.lineno + 1 if held else 0
    return (function.end_lineno or 0) - function.lineno + 1 - docstring


def parameters_of(function: Function) -> int:
    """Parameters of a function but self; 0 for a public constructor."""
    if function.name == "__init__" or function.name.startswith("from_"):
        return 0
    given = function.args
    names = [item.arg for item in (*given.posonlyargs, *given.args, *given.kwonlyargs)]
    names += [item.arg for item in (given.vararg, given.kwarg) if item]
    return len([name for name in names if name not in ("self", "cls")])


def too_much(text: str) -> list[str]:
    """The functions of a file that are too long or take too many parameters."""
    found = []
    for function in functions(ast.parse(text)):
        lines, parameters = lines_of(function), parameters_of(function)
        if lines > MOST_LINES or parameters > MOST_PARAMETERS:
            found.append(f"{function.name}: {lines} lines, {parameters} parameters")
    return found


def test_functions_outside_the_kernels_are_short_and_take_few_parameters() -> None:
    found = {
        str(path.relative_to(SOURCE)): too_much(path.read_text("utf-8"))
        for path in SOURCE.rglob("*.py")
        if "kernels" not in path.parts
    }
    assert not {path: names for path, names in found.items() if names}


def test_the_measure_of_functions_can_fail() -> None:
    assert too_much("def f(a, b, c, d, e, f, g): pass") == ["f: 1 lines, 7 parameters"]
    assert too_much("class C:\n def f(self, a, b, c, d, e, f): pass") == []
    assert too_much("def __init__(self, a, b, c, d, e, f, g): pass") == []
    body = "\n".join(" x = 1" for _ in range(50))
    assert too_much(f"def f():\n{body}") == ["f: 51 lines, 0 parameters"]
    doc = '\n """A\n' + "\n" * 80 + ' """\n'
    assert too_much(f"def f():{doc} return 1") == []


def test_few_modules_stand_beside_the_packages() -> None:
    assert len(list(SOURCE.glob("*.py"))) <= MOST_MODULES


def test_compiled_loops_stand_in_kernels_alone() -> None:
    for path in SOURCE.rglob("*.py"):
        if "kernels" not in path.parts:
            text = path.read_text("utf-8")
            assert not re.search(r"\bnumba\b.*import|import numba|@jit|import jit", text), path


def test_one_contract_orders_every_package_and_ignores_nothing() -> None:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["importlinter"]
    (layers,) = (item for item in settings["contracts"] if item["type"] == "layers")
    assert layers["exhaustive"] and "ignore_imports" not in layers
    named = {name.strip().strip("()") for layer in layers["layers"] for name in layer.split("|")}
    there = {path.name for path in SOURCE.iterdir() if (path / "__init__.py").exists()}
    there |= {path.stem for path in SOURCE.glob("*.py") if path.stem != "__init__"}
    assert named == there
    assert all(" : " not in layer and "(" not in layer for layer in layers["layers"])


def circle_in(arrows: dict[str, set[str]]) -> list[str]:
    """A walk along arrows that comes back to where it began, if there is one."""
    done: set[str] = set()

    def walk(place: str, way: list[str]) -> list[str]:
        if place in way:
            return [*way[way.index(place) :], place]
        if place in done:
            return []
        for following in sorted(arrows.get(place, ())):
            if found := walk(following, [*way, place]):
                return found
        done.add(place)
        return []

    return next((found for start in sorted(arrows) if (found := walk(start, []))), [])


def test_no_module_imports_itself_by_a_detour() -> None:
    graph = grimp.build_graph("boxgrasp", exclude_type_checking_imports=True, cache_dir=None)
    arrows = {name: set(graph.find_modules_directly_imported_by(name)) for name in graph.modules}
    assert len(arrows) > 100
    assert circle_in(arrows) == []


def test_the_search_for_circles_can_fail() -> None:
    assert circle_in({"a": {"b"}, "b": {"c"}, "c": {"b"}}) == ["b", "c", "b"]
    assert circle_in({"a": {"b", "c"}, "b": {"c"}, "c": set()}) == []


# Words that were given up; docs/names.md says for what.
GIVEN_UP = (
    *("chooser", "choosers", "sureness", "situation", "brain", "board", "sight"),
    *("reach_past_face_m", "seen_m", "body_m", "unseen_share", "near_m", "far_m", "colour"),
    *("neighbour", "centre_m", "option_truth", "options_of", "eye_m"),
)


@pytest.fixture(scope="module")
def names() -> dict[Path, set[str]]:
    """What each file of the source names."""
    found: dict[Path, set[str]] = {}
    for path in SOURCE.rglob("*.py"):
        names = found[path] = set()
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.Name):
                names.add(node.id)
            elif isinstance(node, ast.Attribute):
                names.add(node.attr)
            elif isinstance(node, ast.arg):
                names.add(node.arg)
            elif isinstance(node, ast.keyword):
                names.add(node.arg or "")
            elif isinstance(node, Function | ast.ClassDef):
                names.add(node.name)
    return found


@pytest.mark.parametrize("word", GIVEN_UP)
def test_words_that_were_given_up_name_nothing(word: str, names: dict[Path, set[str]]) -> None:
    assert len(names) > 100
    assert [path for path, found in names.items() if word in found] == []
