"""The README and the docs, line by line, in an environment that was made as the README says."""

from __future__ import annotations

import contextlib
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageChops

from boxgrasp.simulate import demo_capture

ROOT = Path(__file__).resolve().parent.parent
for name in ("tools", "docs"):
    sys.path.insert(0, str(ROOT / name))

import pictures  # noqa: E402
import run_docs  # noqa: E402

README, INSTALL = run_docs.FIRST


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[str], Path]:
    """What fails of the README, done in an empty folder, and its environment's programs."""
    return run_docs.install(tmp_path_factory.mktemp("clone"))


@pytest.fixture(scope="module")
def programs(installed: tuple[list[str], Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of that environment, compiled as the page on installing says; our own where there is none."""
    faults, found = installed
    found = Path(sys.executable).parent if lacking(faults) else found
    assert not list(run_docs.run_page(INSTALL, tmp_path_factory.mktemp("install"), found))
    return found


def lacking(faults: list[str]) -> str | None:
    """Why this machine cannot install as the README says, where that is not the README's fault."""
    signs = (sign for fault in faults for sign in run_docs.LACKING if sign in fault)
    return next(signs, None)


@pytest.mark.slow
def test_the_readme_does_what_it_says(installed: tuple[list[str], Path]) -> None:
    faults, _ = installed
    if reason := lacking(faults):
        pytest.skip(f"no environment can be made here: {reason}")
    assert not faults, "\n".join(faults)


@pytest.mark.slow
@pytest.mark.parametrize(
    "page", [page for page in run_docs.PAGES if page not in run_docs.FIRST], ids=lambda p: p.name
)
def test_a_page_does_what_it_says(page: Path, programs: Path, tmp_path: Path) -> None:
    faults = list(run_docs.run_page(page, tmp_path, programs))
    assert not faults, "\n".join(faults)


@pytest.mark.slow
@pytest.mark.parametrize("words", ["objects cloud.pcd", "select cloud.pcd --object 1"])
def test_a_cloud_compiles_nothing_more(words: str, programs: Path, tmp_path: Path) -> None:
    """In a process of its own, as every command of the pages; they have no clouds."""
    write_pcd(tmp_path / "cloud.pcd")
    step = run_docs.Step("", f"python -m boxgrasp {words}")
    with contextlib.closing(run_docs.Shell(tmp_path, programs)) as shell:
        assert run_docs.done(step, shell) is None


def write_pcd(path: Path) -> None:
    """The demo's view as a cloud in the PCD format, as text."""
    points, _ = demo_capture().valid_points()
    points = points[::4]
    head = ["VERSION 0.7", "FIELDS x y z", "SIZE 4 4 4", "TYPE F F F", "COUNT 1 1 1"]
    head += [f"WIDTH {len(points)}", "HEIGHT 1", "VIEWPOINT 0 0 0 1 0 0 0"]
    head += [f"POINTS {len(points)}", "DATA ascii"]
    rows = (f"{x:.4f} {y:.4f} {z:.4f}" for x, y, z in points.tolist())
    path.write_text("\n".join([*head, *rows, ""]))


@pytest.mark.parametrize("page", run_docs.PAGES, ids=lambda page: page.name)
def test_what_a_page_does_not_run_is_sound_too(page: Path) -> None:
    """Languages are known, data can be read, Python is some, and options are there."""
    assert run_docs.faults_of(page) == []


def test_every_reason_not_to_run_a_line_is_used() -> None:
    reasons = {step.reason for page in run_docs.PAGES for step in run_docs.steps_of(page)}
    assert reasons - {""} == {*run_docs.NOT_RUN.values(), *run_docs.PYTHON_NOT_RUN.values()}


def test_make_demo_says_what_works() -> None:
    """The commands that it prints are those of the README, on the file that it wrote."""
    done = subprocess.run(
        ["make", "--dry-run", "--assume-old", ".venv/.installed", "demo"],
        cwd=ROOT, capture_output=True, text=True, check=True,
    )  # fmt: skip
    said = [line for line in done.stdout.splitlines() if line.startswith("echo")]
    told = "\n".join(line.removeprefix("echo ").strip("\"'") for line in said)
    block = run_docs.Block("make demo", "bash", told)
    commands = [command for command, _ in run_docs.commands_of(block)]
    for command in ("boxgrasp objects out/table.npz", "boxgrasp select out/table.npz --object 5"):
        assert any(command in line for line in commands), told


@pytest.mark.parametrize(
    ("shown", "printed", "fault"),
    [
        ("a: 1.25 m", "a: 1.26 m", None),
        ("a: 1.25 m", "a: 1.29 m", "1.25 is 1.29"),
        ("a: 1.25 m", "b: 1.25 m", "other words"),
        ("8 objects", "9 objects", "8 is 9"),
        ("points 3525", "points 3530", None),
        ("points 3525", "points 3600", "3525 is 3600"),
        ("took 5 s, 12.5 ms", "took 61 s, 1.0 ms", None),
        ("# hash: 66559c04d97792b0", "# hash: 66559c04d97792b0", None),
        ("# hash: 66559c04d97792b0", "# hash: 66559c04d97792b1", "other words"),
        ("head\n...\ntail 3", "head\nmany\nlines\ntail 3", None),
        ("head\n...\ntail 3", "head\nmany\nlines\ntail 4", "3 is 4"),
        ("one", "one\ntwo", "other words"),
        ("a   b", "a b", None),
    ],
)
def test_outputs_are_compared(shown: str, printed: str, fault: str | None) -> None:
    said = run_docs.difference(shown, printed)
    assert said is None if fault is None else said is not None and said.startswith(fault)


def test_a_page_that_is_wrong_is_found(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(
        "```bash\ncd /tmp\nfalse\nboxgrasp reproduce OUT --nothing\n```\n"
        "```console\n$ echo 1 2\n1 3\n$ pwd\n/tmp\n```\n"
        "```yaml\nscene: {voxel: 1}\n```\n```python\nif\n```\n```\nnothing\n```\n"
    )
    told = "\n".join(run_docs.faults_of(page))
    for part in ("--nothing: refused", "unknown key 'voxel'", "invalid syntax", "no language"):
        assert part in told
    faults = list(run_docs.run_page(page, tmp_path, Path(sys.executable).parent))
    assert [fault.splitlines()[0] for fault in faults[:2]] == [
        "page.md:1: false: exit status 1:",
        "page.md:6: echo 1 2: 3 is 2:",
    ]
    assert len(faults) == 3 and "SyntaxError" in faults[2]  # and no fault of `pwd`


def test_a_command_that_compiles_is_found(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("```console\n$ echo one; echo compiling kernels\none\n```\n")
    (fault,) = run_docs.run_page(page, tmp_path, Path(sys.executable).parent)
    assert "compiles kernels" in fault


def test_pictures_of_the_docs_are_those_that_are_drawn() -> None:
    """Made by docs/pictures.py; a few pixels may differ where another processor draws them."""
    for name, drawn in pictures.drawn().items():
        with Image.open(pictures.IMAGES / f"{name}.png") as kept:
            assert kept.size == drawn.size
            off = np.asarray(ImageChops.difference(kept.convert("RGB"), drawn.convert("RGB")))
        assert np.mean(off.max(axis=2) > 24) < 0.002, f"python docs/pictures.py: {name}.png"
