"""Source archive and wheel: what they hold; the wheel in an empty environment and read-only."""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
import sys
import sysconfig
import venv
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
import pytest
from packaging.metadata import Metadata

from boxgrasp import __version__
from boxgrasp.simulate import demo_capture

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "tools"))

PIP = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check", "--no-input"]
CORE = ("numpy", "numba", "pillow", "pyyaml", "msgspec", "pypcd4", "onnxruntime")
PYTHONS = [10, 11, 12, 13]  # 3.N
OFFLINE = ("NewConnectionError", "name resolution", "ConnectTimeout", "ProxyError")


def pip(*words: str | Path) -> None:
    """Run pip; skip where there is no registry."""
    done = subprocess.run([*PIP, *map(str, words)], capture_output=True, text=True)
    if done.returncode and any(sign in done.stderr for sign in OFFLINE):
        pytest.skip("the package registry does not answer")
    assert done.returncode == 0, done.stderr


def built(source: Path, kind: str, folder: Path) -> Path:
    """What the build backend makes of a source folder."""
    command = [sys.executable, "-m", "hatchling", "build", "--target", kind, "--directory", folder]
    done = subprocess.run([*map(str, command)], cwd=source, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    (path,) = folder.iterdir()
    return path


@pytest.fixture(scope="module")
def unpacked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The source archive, unpacked."""
    archive = built(ROOT, "sdist", tmp_path_factory.mktemp("sdist"))
    assert archive.name == f"boxgrasp-{__version__}.tar.gz"
    folder = tmp_path_factory.mktemp("unpacked")
    shutil.unpack_archive(archive, folder)
    (path,) = folder.iterdir()
    return path


@pytest.fixture(scope="module")
def wheel(unpacked: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Made from the source archive alone, as an index's users without a wheel do."""
    return built(unpacked, "wheel", tmp_path_factory.mktemp("wheel"))


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


def test_source_archive_holds_all_that_tests_and_docs_need(unpacked: Path) -> None:
    trees = ("src", "benchmarks", "docs", "examples", "ros", "tests", "tools")
    singles = ("CHANGELOG.md", "LICENSE", "Makefile", "README.md", "pyproject.toml")
    made = ("__pycache__", "_build", ".hypothesis")
    wanted = {
        str(path.relative_to(ROOT))
        for tree in trees
        for path in (ROOT / tree).rglob("*")
        if path.is_file() and not set(made) & set(path.relative_to(ROOT).parts)
    } | set(singles)
    held = {str(path.relative_to(unpacked)) for path in unpacked.rglob("*") if path.is_file()}
    assert wanted <= held
    assert held - wanted <= {"PKG-INFO", ".gitignore"}


def test_metadata_is_what_an_index_takes(wheel: Path, unpacked: Path) -> None:
    """Every field as the packaging standards want it, the same in both."""
    inside = zipfile.Path(wheel) / f"boxgrasp-{__version__}.dist-info" / "METADATA"
    text = inside.read_text("utf-8")
    assert text == (unpacked / "PKG-INFO").read_text("utf-8")
    told = Metadata.from_email(text, validate=True)
    assert (told.name, str(told.version)) == ("boxgrasp", __version__)
    assert told.requires_python is not None
    allowed = [minor for minor in range(20) if f"3.{minor}" in told.requires_python]
    assert allowed == [*PYTHONS, 14], "3.14 by its wheels, see docs/platforms.md"
    named = {line.rsplit(" ", 1)[-1] for line in told.classifiers or [] if "Python ::" in line}
    assert named == {f"3.{minor}" for minor in PYTHONS}
    assert (told.license_expression, told.license_files) == ("Apache-2.0", ["LICENSE"])
    assert told.description_content_type == "text/markdown" and told.description
    asked = [item for item in told.requires_dist or [] if item.marker is None]
    assert {item.name for item in asked} == {*CORE}
    assert all(item.url is None for item in told.requires_dist or []), "an index refuses these"


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


def test_wheels_exist_for_a_robot() -> None:
    """For ROS 2 Humble on aarch64; the tool asks for every Python and system in some minutes."""
    import check_wheels

    if check_wheels.is_offline():
        pytest.skip("the package registry does not answer")
    found = check_wheels.resolve("3.10", "linux-aarch64", check_wheels.requirements())
    assert {*CORE, "llvmlite"} <= found.keys()
    assert all(name.endswith(".whl") and "x86_64" not in name for name in found.values())


def test_wheel_check_tells_what_is_missing(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import check_wheels

    def resolve(python: str, system: str, wanted: list[str]) -> dict[str, str]:
        if system == "linux-aarch64" and any(line.startswith("mujoco") for line in wanted):
            raise RuntimeError("no matching distribution")
        return {}

    monkeypatch.setattr(check_wheels, "resolve", resolve)
    assert check_wheels.main(["3.10", "linux-x86_64"]) == 0
    assert check_wheels.main(["3.10", "linux-aarch64"]) == check_wheels.MISSING
    assert "| 3.10 | linux-aarch64 |  | sim: mujoco" in capsys.readouterr().out
    assert check_wheels.main(["3.14", "linux-aarch64"]) == 0, "there the core alone is promised"
    assert check_wheels.main(["3.9", "linux-x86_64"]) == check_wheels.MISSING
    assert "valid: " in capsys.readouterr().out
