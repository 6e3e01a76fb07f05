"""Source archive and wheel: what they hold; the wheel where nothing can be written."""

from __future__ import annotations

import ctypes
import email
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest
import yaml
from packaging.metadata import Metadata

from boxgrasp import __version__
from boxgrasp.cli import COMMANDS
from boxgrasp.io.npz import save_npz
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
    path = tmp_path_factory.mktemp("capture") / "table.npz"
    save_npz(demo_capture(), path)
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
    trees = ("src", "benchmarks", "container", "docs", "examples", "ros", "tests", "tools")
    singles = (
        *("CHANGELOG.md", "CITATION.cff", "CONTRIBUTING.md", "LICENSE", "Makefile", "README.md"),
        *("SECURITY.md", "pyproject.toml", ".dockerignore"),
    )
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


def test_metadata_names_authors_and_addresses(wheel: Path) -> None:
    """As a registry shows them; what is under the project's address is there."""
    with zipfile.ZipFile(wheel) as archive:
        (name,) = (name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
        said = email.message_from_bytes(archive.read(name))
    assert said["Author"] == "boxgrasp contributors"
    urls = dict(line.split(", ") for line in said.get_all("Project-URL", []))
    assert set(urls) == {"Homepage", "Documentation", "Source", "Issues", "Changelog"}
    assert said["Description-Content-Type"] == "text/markdown"
    listed = (ROOT / "docs" / "install.md").read_text("utf-8")
    for extra in {*said.get_all("Provides-Extra", [])} - {"dev"}:
        assert f"| `{extra}` |" in listed
    assert said.get_payload() == (ROOT / "README.md").read_text("utf-8")


def texts_with_addresses() -> dict[str, str]:
    names = ["pyproject.toml", "CITATION.cff", "README.md", "CONTRIBUTING.md", "SECURITY.md"]
    names += [f"docs/{path.name}" for path in (ROOT / "docs").glob("*.md")]
    return {name: (ROOT / name).read_text("utf-8") for name in names}


def test_one_address_stands_everywhere_and_what_it_names_is_there() -> None:
    found = set()
    for name, text in texts_with_addresses().items():
        for home, path in re.findall(
            r"https://(?:raw\.githubusercontent|github)\.com/([^/\s]+/[^/\s\")`]+)([^\s\")`]*)",
            text,
        ):
            found.add(home)
            place = re.sub(r"^/(blob/|tree/|raw/)?main/|#.*$", "", path)
            if place and not re.match(r"/(issues|security)", place):
                assert (ROOT / place).exists(), f"{name}: {path}"
    assert found == {"boxgrasp/boxgrasp"}


def test_pictures_and_links_of_the_readme_are_absolute() -> None:
    """A registry shows the README without the files beside it."""
    text = (ROOT / "README.md").read_text("utf-8")
    links = re.findall(r"\]\(([^)\s]+)\)", text)
    assert len(links) > 10 and all(link.startswith("https://") for link in links)
    assert re.search(r"!\[[^\]]+\]\(https://raw\.githubusercontent\.com/", text)


def test_citation_has_the_version_and_the_form_that_is_asked() -> None:
    said = yaml.safe_load((ROOT / "CITATION.cff").read_text("utf-8"))
    assert said["version"] == __version__
    assert {"cff-version", "message", "title", "authors"} <= set(said)
    assert said["cff-version"] == "1.2.0" and said["type"] == "software"
    assert said["authors"] == [{"name": "boxgrasp contributors"}]


def test_container_recipe_uses_files_and_commands_that_are_there() -> None:
    recipe = (ROOT / "container" / "Dockerfile").read_text("utf-8")
    copied = [line.split()[1:-1] for line in recipe.splitlines() if line.startswith("COPY p")]
    copied += [line.split()[1:-1] for line in recipe.splitlines() if line.startswith("COPY s")]
    let_in = (ROOT / ".dockerignore").read_text("utf-8").splitlines()
    for name in sum(copied, []):
        assert (ROOT / name).exists() and f"!{name}" in let_in
    assert all(command in COMMANDS for command in re.findall(r"boxgrasp ([\w-]+)", recipe)[1:])


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
    done = run_sealed(env, "-m", "boxgrasp", "warm-up")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("boxgrasp: compiled kernels can be kept nowhere")
    assert done.stderr.count("\n") == 1 and "valid: NUMBA_CACHE_DIR" in done.stderr


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
