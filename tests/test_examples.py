"""Every example runs as it stands, in a fresh interpreter and an empty folder."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from boxgrasp.cli import main
from boxgrasp.simulate import demo_capture, to_capture
from boxgrasp.simulate.demo import DEMO_SPEC
from boxgrasp.simulate.scenes import build_scene

DOCS = Path(__file__).resolve().parent.parent / "docs"
EXAMPLES = sorted((Path(__file__).resolve().parent.parent / "examples").glob("*.py"))


def test_examples_are_numbered_without_gaps() -> None:
    numbers = [int(path.name[:2]) for path in EXAMPLES]
    assert numbers == list(range(1, len(EXAMPLES) + 1))


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_example_runs(path: Path, tmp_path: Path) -> None:
    done = subprocess.run([sys.executable, path], capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout
    notice = "compiling kernels"  # the first process after installing says so
    assert all(line.startswith(notice) for line in done.stderr.splitlines()), done.stderr


def test_readme_code_runs(tmp_path: Path) -> None:
    """The Python of the README, with the arrays of a cast view put in."""
    root = EXAMPLES[0].parent.parent
    (block,) = re.findall(r"```python\n(.*?)```", (root / "README.md").read_text("utf-8"), re.S)
    given = (
        "from boxgrasp.simulate import demo_capture\n"
        "view = demo_capture()\n"
        "depth, intrinsics, T_base_camera = view.depth, view.intrinsics, view.T_base_camera\n"
    )
    code = re.sub(r"pixel=\(\d+, \d+\)", "pixel=view.target_pixel", given + block)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def saved(path: Path, view: object) -> None:
    names = ("depth", "intrinsics", "T_base_camera", "rgb", "target_pixel")
    arrays = {name: getattr(view, name) for name in names if getattr(view, name) is not None}
    np.savez(path, **arrays)


def documented() -> list[tuple[str, str]]:
    """Each command of the command line page, and what the page says that it prints."""
    text = (DOCS / "command-line.md").read_text("utf-8")
    blocks = re.findall(r"^```\n(\$ boxgrasp.*?)^```", text, re.S | re.M)
    parts = [part for block in blocks for part in re.split(r"^\$ ", block, flags=re.M)[1:]]
    pairs = [part.partition("\n") for part in parts if part.startswith("boxgrasp")]
    return [(words.removeprefix("boxgrasp "), shown) for words, _, shown in pairs]


def test_commands_print_what_the_docs_say(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Word for word but for the numbers; a line `...` stands for any lines."""
    monkeypatch.chdir(tmp_path)
    saved(tmp_path / "table.npz", demo_capture())
    camera = {"position": [1.1, -0.75, 1.4], "gaze": [0.86, 0.0, 0.87]}
    other, _ = to_capture(build_scene(DEMO_SPEC | {"camera": camera}), np.random.default_rng(1))
    saved(tmp_path / "other.npz", other)
    commands = documented()
    assert len(commands) >= 9
    for command, shown in commands:
        words, _, into = command.partition(" > ")
        status = main(words.split())
        out, err = capsys.readouterr()
        err = "".join(line for line in err.splitlines(True) if "compiling" not in line)
        if into:
            (tmp_path / into).write_text(out, "utf-8")
        printed = "" if into else out + err
        assert status == (2 if "gone.npz" in words else 0), command
        for numeric in (r"[0-9a-f]{16}", r"-?\d+\.\d+", r"\b\d{3,}\b", r" +"):
            printed, shown = (re.sub(numeric, " ", text) for text in (printed, shown))
        pattern = re.escape(shown.strip()).replace(re.escape("..."), ".*")
        assert re.fullmatch(pattern, printed.strip(), re.S), f"{command}\n{printed}"


def test_ros_page_code_runs() -> None:
    (block,) = re.findall(r"```python\n(.*?)```", (DOCS / "ros.md").read_text("utf-8"), re.S)
    room: dict[str, object] = {}
    exec(block, room)
    view = demo_capture()
    assert view.depth is not None and view.intrinsics is not None
    height, width = view.depth.shape
    data = np.round(view.depth * 1000).astype(np.uint16).tobytes()
    depth = SimpleNamespace(height=height, width=width, step=2 * width, data=data)
    info = SimpleNamespace(k=view.intrinsics.reshape(-1).tolist())
    on_request: object = room["on_request"]
    answer = on_request(depth, info, view.T_base_camera, view.target_pixel)  # type: ignore[operator]
    assert isinstance(answer, str) or answer.status in ("grasp", "ask")
    assert not isinstance(answer, str), answer
