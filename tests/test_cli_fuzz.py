"""Every command with options and values of every kind: an answer or one line, and never a fault.

The words are made from the parsers themselves, so that a new option is tried as it comes.
"""

from __future__ import annotations

import argparse
import io
import json
import os
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image

from boxgrasp.cli import COMMANDS, command_parser, main
from boxgrasp.errors import WorkError
from boxgrasp.selector import _two_blocks

NUMBERS = ("-1", "0", "1", "2", "80", "-0.0", "0.5", "nan", "inf", "-inf", "1e308", "1e-308")
NUMBERS += tuple(str(n) for n in (2**31, 2**32, 2**63 - 1, 2**63, 2**64, 10**30, -(2**63)))
NUMBERS += ("0x10", "1_0", "٣", "9" * 5000)
TEXTS = ("", " ", "-", "=", "é", "日本", "\u202e", "a\nb", "\udcff", "x" * 300, "front,right", ",")
TEXTS += ("clearance", "random", "cascade-grid", "oracle", "front", "None", "null", "{}", "..", ".")
TEXTS += ("memory://fuzz", "file://", "file:///proc/x", "nowhere://x", "://", "http:", "tcp://")
# Files by name; what they hold is below.
FILES = ("table.npz", "empty", "binary", "text.txt", "list.yaml", "deep.yaml", "mask.png")
FILES += (
    "rgb.png",
    "answers.jsonl",
    "folder",
    "folder/x",
    "text.txt/x",
    "loop",
    "gone.npz",
    "gone.png",
)
FILES += ("hand.yaml", "broken.npz", "targets.txt", "objects.yaml", "cut.png", "/dev/null", "x.jpg")
FILES += ("empty.npz", "empty.ply", "empty.pcd", "empty.bag", "empty.mcap", "empty.db3", "empty.bt")
FILES += ("out.png", "out/deep/out.png", "empty.jsonl", "empty.yaml", "set", "models")


LINK = (
    '<link name="{0}"><collision><geometry><box size="0.02 0.02 0.06"/></geometry></collision>'
    "</link>"
)
JOINT = (
    '<joint name="j{0}" type="prismatic"><parent link="palm"/><child link="{0}"/>'
    '<origin xyz="0 {1} 0.06"/><axis xyz="0 {2} 0"/><limit lower="0" upper="0.04" effort="1" '
    'velocity="1"/></joint>'
)
URDF = '<robot name="hand">' + "".join(LINK.format(name) for name in ("palm", "a", "b"))
URDF += JOINT.format("a", 0.01, 1) + JOINT.format("b", -0.01, -1) + "</robot>"
# Values that an option can use, by its name.
FITTING: dict[str, tuple[str, ...]] = {
    "captures": ("table.npz",),
    "scan": ("table.npz",),
    "pixel": ("60", "80"),
    "box": ("60", "90"),
    "object": ("1",),
    "point": ("0", "0.05"),
    "mask": ("mask.png",),
    "robot_mask": ("mask.png",),
    "targets": ("targets.txt",),
    "config": ("empty.yaml", "faces.yaml"),
    "gripper": ("hand.yaml", "thesis", "franka-hand"),
    "hand": ("hand.yaml", "thesis", "hand.urdf"),
    "palm": ("palm",),
    "flange": ("palm",),
    "fingers": ("a,b", "a,palm"),
    "faces": ("front,left", "top-parallel"),
    "ranker": ("random", "single-grid"),
    "picture": ("out.png", "out/deep/out.png"),
    "masks": ("masks.png",),
    "out": ("new", "set"),
    "count": ("1", "50"),
    "lines": ("3", "5"),
    "seed": ("0", "7"),
}


def fill(folder: Path) -> None:
    """Write the files that `FILES` names, a small view among them."""
    view = _two_blocks()
    arrays = {"depth": view.depth, "intrinsics": view.intrinsics, "rgb": view.rgb}
    np.savez(folder / "table.npz", **arrays, target_pixel=(80, 60))
    (folder / "broken.npz").write_bytes((folder / "table.npz").read_bytes()[:2000])
    for suffix in ("", ".npz", ".ply", ".pcd", ".bag", ".mcap", ".db3", ".bt", ".jsonl", ".yaml"):
        (folder / f"empty{suffix}").touch()
    (folder / "binary").write_bytes(bytes(range(256)) * 9)
    (folder / "text.txt").write_text("some: text\n- that is\nnothing: [\n")
    (folder / "list.yaml").write_text("[1, 2, 3]\n")
    (folder / "deep.yaml").write_text("[" * 1200)
    (folder / "hand.yaml").write_text("max_opening_m: 0.1\n")
    (folder / "faces.yaml").write_text("candidates: {faces: [front]}\n")
    (folder / "hand.urdf").write_text(URDF)
    (folder / "objects.yaml").write_text("objects: {a: {set: known, color: [1, 2, 3]}}")
    (folder / "targets.txt").write_text("table.npz --object 1\ngone.npz\n# nothing\n\n")
    (folder / "answers.jsonl").write_text('{"schema": 2}\n[]\n{"capture": "a", "error": "b"}\n')
    mask = np.zeros((120, 160), np.uint8)
    mask[50:70, 70:85] = 255
    Image.fromarray(mask).save(folder / "mask.png")
    Image.fromarray(np.zeros((9, 9, 3), np.uint8)).save(folder / "rgb.png")
    (folder / "cut.png").write_bytes((folder / "mask.png").read_bytes()[:90])
    (folder / "folder").mkdir()
    (folder / "set").mkdir()
    (folder / "set" / "set.json").write_text('{"count": 3}')
    (folder / "models").mkdir()
    (folder / "models" / "single-grid.onnx").write_bytes(b"no model")
    (folder / "loop").symlink_to("loop")


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    folder = tmp_path_factory.mktemp("fuzz") / "in" / "here"
    folder.mkdir(parents=True)
    fill(folder)
    before = os.getcwd()
    os.chdir(folder)
    yield folder
    os.chdir(before)


class NoWorkers:
    """All that comes before the first task is done, and no task."""

    def run(self, function: Any, tasks: Any) -> Iterator[Any]:
        raise WorkError("no worker here")
        yield


@contextmanager
def no_workers(*_: object) -> Iterator[NoWorkers]:
    yield NoWorkers()


def actions_of(command: str) -> list[argparse.Action]:
    kept = command_parser(command).all_actions
    return [action for action in kept if action.dest not in ("help", "cluster", "processes")]


ANY = st.one_of(st.sampled_from(NUMBERS), st.sampled_from(TEXTS), st.sampled_from(FILES))


def value_of(action: argparse.Action) -> st.SearchStrategy[str]:
    """Words for an option: often of its own kind, sometimes of any."""
    if action.choices is not None:
        own: st.SearchStrategy[str] = st.sampled_from([str(choice) for choice in action.choices])
    elif action.type in (int, float):
        own = st.sampled_from(NUMBERS)
    else:
        own = st.sampled_from((*FILES, *TEXTS))
    fitting = st.sampled_from(FITTING[action.dest]) if action.dest in FITTING else own
    return st.one_of(fitting, fitting, own, ANY)


def words_of(action: argparse.Action) -> st.SearchStrategy[list[str]]:
    """An option with its values, or the values of what has no option."""
    least, most = {None: (1, 1), "?": (0, 1), "*": (0, 3), "+": (1, 3)}.get(
        action.nargs, (action.nargs, action.nargs)
    )
    values = st.lists(value_of(action), min_size=least, max_size=most)
    if not action.option_strings:
        return values
    flag = st.sampled_from(action.option_strings)
    return st.tuples(flag, values).map(lambda pair: [pair[0], *pair[1]])


@st.composite
def lines(draw: st.DrawFn, command: str) -> list[str]:
    """The words of a line that names the command."""
    actions = actions_of(command)
    required = [action for action in actions if not action.option_strings]
    options = [action for action in actions if action.option_strings]
    words = [draw(words_of(action)) for action in required]
    if command in ("select", "explain", "objects") and draw(st.booleans()):
        words = [["table.npz"]]  # so that options meet a view that can be answered
    chosen = draw(st.lists(st.sampled_from(options), max_size=4)) if options else []
    words += [draw(words_of(action)) for action in chosen]
    stray = draw(st.lists(ANY, max_size=1)) if draw(st.integers(0, 9)) == 0 else []
    return [command, *(word for part in words for word in part), *stray]


SAID = re.compile(r"boxgrasp(\.\w+)?: .+")  # or a line of the log


def check(line: list[str]) -> None:
    """A line is answered, or costs lines that each say what is wrong; a fault is never met."""
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        status = main(line)
    said = err.getvalue()
    assert status in (0, 2), (line, status)
    assert "internal error" not in said, (line, said)
    logged = any(re.fullmatch("-v+|--verbose", word) for word in line)
    if not logged:
        told = said.splitlines()
        assert all(SAID.fullmatch(one) for one in told), (line, said)
        assert "Traceback" not in said, (line, said)
        assert bool(told) == (status == 2), (line, status, said)
        answered = max(len(line), 4)  # a file of answers has three lines
        assert len(told) <= answered, (line, said)
    if "--json" in line and line[0] in ("select", "objects", "explain") and status == 0:
        for answer in out.getvalue().splitlines():
            json.loads(answer)


@contextmanager
def quiet(*_: object) -> Iterator[Callable[[], None]]:
    """A progress that tells nothing."""
    yield lambda: None


@pytest.mark.parametrize("command", COMMANDS)
def test_any_line_is_answered_or_refused(
    command: str, place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("boxgrasp.execution.workers_for", no_workers)
    monkeypatch.setattr("boxgrasp.cli.warm_up.STEPS", ())  # seconds each time, whatever the words

    if command in ("label", "assist"):  # a page would be served until somebody stops it
        monkeypatch.setattr("boxgrasp.labeling.sources.progress", quiet)
        monkeypatch.setattr("boxgrasp.cli._labeling._serve", lambda *_: None)

    @settings(
        max_examples=8 if command == "demo" else 40, deadline=None, derandomize=True,
        suppress_health_check=list(HealthCheck), database=None,
    )  # fmt: skip
    @given(line=lines(command))
    def fuzz(line: list[str]) -> None:
        check(line)

    fuzz()
