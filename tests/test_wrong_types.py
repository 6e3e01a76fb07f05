"""What is handed to public names is taken, or refused in one line of the library's errors."""

from __future__ import annotations

import inspect
import os
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import boxgrasp
from boxgrasp import BoxgraspError, Capture, Config, GraspSelector, Gripper, Selection, Target
from boxgrasp.config import dump_config, load_gripper
from boxgrasp.errors import ConfigError, GripperError, TargetError
from boxgrasp.selector import _two_blocks

OWN = ("warm_up", "advance_m")  # takes nothing; takes the package's own arrays
LONGEST = 500  # characters of a message; what is valid may be a list of names


class Thing:
    """No type of the package's."""


def fixed() -> list[Any]:
    """One of nearly every type, in shapes that something might take."""
    view, selector, answer = good()
    return [
        *(None, True, False, 0, 1, -1, 1.5, float("nan"), float("inf"), 2**70, 10**400, 1j, ...),
        *("", "a", "front", "é\0", "a\nb", "x" * 300, b"x", memoryview(b"abc"), Path("gone.npz")),
        *([], [1], [1, 2], [[1, 2], [3]], [None], [Thing()], [Thing], [view], ["1", "2"], [2**70]),
        *((), (1, 2), (1, 2, 3), ("a", "b"), (float("nan"),) * 2, {}, {"a": 1}, {1: 2}, {1, 2}),
        *(Thing, Thing(), len, iter([1]), range(3), slice(1), ValueError("x"), NotImplemented),
        *(np.zeros(0), np.zeros((3, 3)), np.eye(4), np.array("a"), np.array(["a", "b"])),
        *(np.zeros((3, 3), object), np.ones((4, 4), complex), np.zeros((2, 2), "M8[s]")),
        *(np.float64(2), np.int64(3), np.bool_(True), np.ma.masked, np.zeros((120, 160), bool)),
        *(view, selector, answer, selector.config, Target(object=1), Gripper(), Config()),
    ]


@cache
def good() -> tuple[Capture, GraspSelector, Selection]:
    """A small view, the selector that answers it, and its answer."""
    blocks = _two_blocks()
    view = Capture(blocks.depth, blocks.intrinsics, rgb=blocks.rgb, target_pixel=(80, 60))
    selector = GraspSelector()
    return view, selector, selector.select(view)


def callables() -> dict[str, tuple[Callable[..., Any], dict[str, Any]]]:
    """Every public name that can be called, its classes' methods too, with arguments that fit."""
    view, selector, answer = good()
    held = {Capture: view, GraspSelector: selector, Selection: answer, Gripper: Gripper()}
    scene = selector.scene(view)
    fitting: dict[str, Any] = {
        "depth": view.depth, "intrinsics": view.intrinsics, "points": view.valid_points()[0],
        "capture": view, "text": answer.to_json(), "label": 1, "analysis": selector.analyze(view),
        "path": "gone.npz", "code": "a", "message": "b", "scene": scene,
    }  # fmt: skip
    found: dict[str, Any] = {"load_gripper": load_gripper, "dump_config": dump_config}
    for name in boxgrasp.__all__:
        thing = getattr(boxgrasp, name)
        if name == "BoxgraspError" or not callable(thing):
            continue
        if thing is not Selection:  # an answer's own fields are not looked through anew
            found[name] = thing
        for method in dir(thing) if isinstance(thing, type) else ():
            owner = held.get(thing, thing)
            if (
                not method.startswith("_")
                and method not in OWN
                and callable(getattr(owner, method))
            ):
                found[f"{name}.{method}"] = getattr(owner, method)
    found |= {"default_checks": boxgrasp.default_checks, "load_config": boxgrasp.load_config}
    arguments = {name: _arguments(thing, fitting) for name, thing in found.items()}
    return {name: (thing, arguments[name]) for name, thing in found.items() if arguments[name]}


def _arguments(thing: Callable[..., Any], fitting: dict[str, Any]) -> dict[str, Any]:
    """A fitting value of every parameter; of *warnings none."""
    said = inspect.signature(thing).parameters.values()
    return {
        item.name: fitting.get(item.name, item.default)
        for item in said
        if item.kind is not item.VAR_POSITIONAL
    }


def only_refuses(call: Callable[[], Any], what: str) -> None:
    try:
        call()
    except BoxgraspError as error:
        said = str(error)
        assert said.strip() and "\n" not in said and len(said) <= LONGEST, (what, said)


CALLED = callables()


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("name", CALLED)
@pytest.mark.filterwarnings("ignore")
def test_one_wrong_argument(name: str) -> None:
    """Each parameter in turn gets a thing of every type, beside others that fit."""
    thing, arguments = CALLED[name]
    for slot in arguments:
        if slot == "on_stage":
            continue  # what it raises is the caller's
        for junk in fixed():
            given_ = {**arguments, slot: junk}
            only_refuses(lambda given_=given_: thing(**given_), f"{name}({slot}={junk!r:.80})")


JUNK = st.recursive(
    st.one_of(st.sampled_from(range(len(fixed()))).map(lambda k: fixed()[k]), st.text(max_size=5)),
    lambda inner: st.one_of(
        st.lists(inner, max_size=4), st.dictionaries(st.text(max_size=5), inner, max_size=3)
    ),
    max_leaves=6,
)


@settings(
    max_examples=150, deadline=None, derandomize=True, database=None,
    suppress_health_check=list(HealthCheck),
)  # fmt: skip
@given(data=st.data())
@pytest.mark.filterwarnings("ignore")
def test_several_wrong_arguments(data: st.DataObject) -> None:
    name = data.draw(st.sampled_from(sorted(CALLED)))
    thing, arguments = CALLED[name]
    slots = [slot for slot in arguments if slot != "on_stage"]
    wrong = {slot: data.draw(JUNK) for slot in data.draw(st.sets(st.sampled_from(slots)))}
    only_refuses(lambda: thing(**{**arguments, **wrong}), f"{name}({wrong!r:.300})")


def test_a_number_is_no_file(tmp_path: Path) -> None:
    """Python takes a number for an open file: a configuration of 1 would close standard output."""
    with open(tmp_path / "x", "w+") as file:
        for read in (GraspSelector, boxgrasp.load_config, load_gripper, boxgrasp.load_capture):
            with pytest.raises(BoxgraspError):
                read(file.fileno())  # type: ignore[operator]
        os.fstat(file.fileno())


@pytest.mark.parametrize(
    ("call", "error", "said"),
    [
        (
            lambda: GraspSelector(123),
            ConfigError,
            "configuration is 123; valid: a YAML file's path",
        ),
        (
            lambda: GraspSelector([1]),
            ConfigError,
            "configuration is [1]; valid: a YAML file's path",
        ),
        (lambda: GraspSelector(checks="width"), ConfigError, "checks is 'width'; valid: a list"),
        (lambda: GraspSelector(checks=[1]), ConfigError, "int is no check; valid: an object"),
        (lambda: GraspSelector(ranker="random"), ConfigError, "str is no ranker; valid: "),
        (lambda: Gripper(width_m="wide"), GripperError, "gripper width_m is 'wide'; valid: a num"),
        (lambda: Config(gripper=Target()), ConfigError, "configuration gripper is of type Target;"),
        (
            lambda: good()[1].select(good()[0], "mug"),
            TargetError,
            "target is 'mug'; valid: a Target",
        ),
        (lambda: select(pixel="a"), TargetError, "target pixel is 'a'; valid: u v, whole numbers"),
        (lambda: select(pixel=("1", 2)), TargetError, "pixel is ('1', 2); valid: u v, whole"),
        (lambda: select(object=1.5), TargetError, "object is 1.5; valid: a number from 1 to"),
        (lambda: boxgrasp.load_capture(123), BoxgraspError, "capture's path is 123; valid: a path"),
    ],
)
def test_what_is_said(call: Callable[[], Any], error: type[BoxgraspError], said: str) -> None:
    with pytest.raises(error) as caught:
        call()
    assert said in str(caught.value)


def select(**target: Any) -> Selection:
    view, selector, _ = good()
    return selector.select(view, Target(**target))
