"""The wheel: what it holds, that it installs and works in an empty environment and read-only."""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
import sysconfig
import venv
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
import pytest

from boxgrasp import __version__
from boxgrasp.simulate import demo_capture

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "tools"))

PIP = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check", "--no-input"]
OFFLINE = ("NewConnectionError", "name resolution", "ConnectTimeout", "ProxyError")


def pip(*words: str | Path) -> None:
    """Run pip; skip where there is no registry."""
    done = subprocess.run([*PIP, *map(str, words)], capture_output=True, text=True)
    if done.returncode and any(sign in done.stderr for sign in OFFLINE):
        pytest.skip("the package registry does not answer")
    assert done.returncode == 0, done.stderr


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    pip("wheel", "--no-deps", "--wheel-dir", folder, ROOT)
    (path,) = folder.glob("*.whl")
    return path


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    view = demo_capture()
    path = tmp_path_factory.mktemp("capture") / "table.npz"
    np.savez(
        path,
        depth=view.depth,
        intrinsics=view.intrinsics,
        T_base_camera=view.T_base_camera,
        target_pixel=view.target_pixel,
    )
    return path


def test_wheel_holds_all_and_only_the_package(wheel: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    assert {name.split("/")[0] for name in names} == {
        "boxgrasp",
        f"boxgrasp-{__version__}.dist-info",
    }
    source = ROOT / "src"
    wanted = {
        str(path.relative_to(source))
        for path in (source / "boxgrasp").rglob("*")
        if path.is_file() and path.suffix != ".pyc" and "__pycache__" not in path.parts
    }
    assert wanted == {name for name in names if name.startswith("boxgrasp/")}
    assert "boxgrasp/py.typed" in names
    assert any(name.endswith("licenses/LICENSE") for name in names)


@pytest.mark.slow
def test_works_in_an_empty_environment(wheel: Path, capture: Path, tmp_path: Path) -> None:
    """From the registry, core dependencies alone, nothing shared with this environment."""
    env = tmp_path / "env"
    venv.create(env, with_pip=False)
    pip("--python", env / "bin" / "python", "install", wheel)
    clean = {"PATH": "/usr/bin:/bin", "HOME": str(tmp_path), "LC_ALL": "C.UTF-8"}
    clean |= {key: value for key, value in os.environ.items() if key.startswith("OPENBLAS")}

    def boxgrasp(*words: str | Path, python: bool = False) -> subprocess.CompletedProcess[str]:
        start = [env / "bin" / "python", "-m", "boxgrasp"] if python else [env / "bin" / "boxgrasp"]
        return subprocess.run(
            [*map(str, [*start, *words])], capture_output=True, text=True, cwd=tmp_path, env=clean
        )

    assert boxgrasp("--version").stdout == f"boxgrasp {__version__}\n"
    assert boxgrasp("--version", python=True).stdout == f"boxgrasp {__version__}\n"
    first = boxgrasp("select", "--json", capture)
    assert first.returncode == 0, first.stderr
    assert '"status": "' in first.stdout
    assert first.stderr.count("compiling kernels") == 1, "the first run says that it compiles"
    second = boxgrasp("select", "--json", capture)
    assert second.returncode == 0 and second.stderr == "", "the second finds the kernels cached"
    write_pcd(tmp_path / "cloud.pcd")
    cloud = boxgrasp("objects", "cloud.pcd")
    assert cloud.returncode == 0 and "objects; meters" in cloud.stdout, cloud.stderr
    demo = boxgrasp("demo", "--picture", "demo.png")
    assert demo.returncode == 0, demo.stderr
    assert (tmp_path / "demo.png").read_bytes().startswith(b"\x89PNG")


def write_pcd(path: Path) -> None:
    """The demo's view as a cloud in the PCD format, as text."""
    points, _ = demo_capture().valid_points()
    points = points[::4]
    head = ["VERSION 0.7", "FIELDS x y z", "SIZE 4 4 4", "TYPE F F F", "COUNT 1 1 1"]
    head += [f"WIDTH {len(points)}", "HEIGHT 1", "VIEWPOINT 0 0 0 1 0 0 0"]
    head += [f"POINTS {len(points)}", "DATA ascii"]
    rows = (f"{x:.4f} {y:.4f} {z:.4f}" for x, y, z in points.tolist())
    path.write_text("\n".join([*head, *rows, ""]))


def drop_override() -> None:
    """Give up root's right to write where it may not; a no-op for anyone else."""
    libc = ctypes.CDLL(None)
    for capability in (1, 2, 3):  # DAC_OVERRIDE, DAC_READ_SEARCH, FOWNER
        libc.prctl(24, capability, 0, 0, 0)  # PR_CAPBSET_DROP: exec gains no more than this


@pytest.fixture
def sealed(wheel: Path, tmp_path: Path) -> Iterator[tuple[Path, dict[str, str]]]:
    """A site folder and a home that cannot be written, and the environment to use them."""
    site, home = tmp_path / "site", tmp_path / "home"
    pip("install", "--no-deps", "--no-compile", "--target", site, wheel)
    home.mkdir()
    folders = [home, site, *(path for path in site.rglob("*") if path.is_dir())]
    for folder in folders:
        folder.chmod(0o555)
    keep = {key: value for key, value in os.environ.items() if key.startswith("OPENBLAS")}
    shared = sysconfig.get_paths()["purelib"]
    env = {"HOME": str(home), "PATH": os.environ["PATH"], "PYTHONPATH": f"{site}:{shared}", **keep}
    yield site, env
    for folder in folders:
        folder.chmod(0o755)


def run_sealed(env: Mapping[str, str], *words: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, *map(str, words)],
        capture_output=True,
        text=True,
        cwd="/",
        env=dict(env),
        preexec_fn=drop_override,
    )


@pytest.mark.slow
def test_works_from_a_folder_that_cannot_be_written(
    sealed: tuple[Path, dict[str, str]], capture: Path
) -> None:
    site, env = sealed
    for folder in (site / "boxgrasp" / "kernels", env["HOME"]):
        tried = run_sealed(env, "-c", f"open({str(folder)!r} + '/x', 'w')")
        if tried.returncode == 0:
            pytest.skip("this user writes into folders that cannot be written")
        assert "PermissionError" in tried.stderr
    where = run_sealed(env, "-c", "import boxgrasp; print(boxgrasp.__file__)")
    assert where.stdout.startswith(str(site)), where.stderr
    done = run_sealed(env, "-m", "boxgrasp", "select", "--json", capture)
    assert done.returncode == 0, done.stderr
    assert '"status": "' in done.stdout
    assert done.stderr.count("cannot be cached") == 1, done.stderr
    assert "Traceback" not in done.stderr


def test_wheels_exist_for_every_python_and_processor() -> None:
    done = subprocess.run(
        [sys.executable, str(ROOT / "tools" / "check_wheels.py")], capture_output=True, text=True
    )
    if done.returncode == 3:
        pytest.skip("the package registry does not answer")
    assert done.returncode == 0, done.stdout + done.stderr
    lines = done.stdout.splitlines()
    assert len(lines) == 6
    for line in lines:
        core = ("numpy", "numba", "llvmlite", "pillow", "pyyaml", "msgspec", "pypcd4")
        for name in (*core, "rosbags", "octomap_python"):
            assert f"{name}-" in line.lower(), line


def test_wheel_check_can_fail() -> None:
    import check_wheels

    if check_wheels.is_offline():
        pytest.skip("the package registry does not answer")
    with pytest.raises(RuntimeError, match="numpy==0.0.1"):
        check_wheels.resolve("3.12", "aarch64", ["numpy==0.0.1"])
