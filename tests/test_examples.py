"""Every example runs as it stands, in a fresh interpreter and an empty folder."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

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
    """The Python of README and docs index, with the arrays of a cast view put in."""
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
