"""Make .venv-ros, where the ROS packages are tested with a real rclpy and no ROS installed.

`make setup-ros` runs this; it needs g++, cmake and make beside what the library needs. Whatever is
as the sources have it already is left alone, so that a second run takes no time.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
from collections.abc import Iterable
from pathlib import Path

if sys.version_info >= (3, 11):
    import tomllib
else:  # pip brings one
    from pip._vendor import tomli as tomllib

ROOT = Path(__file__).resolve().parents[2]
ENV = ROOT / ".venv-ros"
BUILD = ENV / "build"  # of the packages: none of it lies in the repository
REQUIREMENTS = ROOT / "ros" / "test" / "requirements.txt"
_TOOLS = ("hypothesis>=6.100", "jsonschema>=4.20")  # of the tests, beside the pinned pytest

# What is built together, one after the other: the nodes' Python anew in two seconds, without the
# interfaces, which take a minute.
_STUBS = ROOT / "ros" / "test" / "stub_msgs"
GROUPS = {
    "stubs": [_STUBS / name for name in ("tf2_msgs", "octomap_msgs", "moveit_msgs")],
    "interfaces": [ROOT / "ros" / "boxgrasp_msgs"],
    "nodes": [ROOT / "ros" / "boxgrasp_ros"],
}

# A ROS that the shell has sourced must not be mixed in.
_FOREIGN = re.compile(r"PYTHONPATH|LD_LIBRARY_PATH|_ROS_WHEELS_.*|(ROS|AMENT|COLCON|CMAKE)_.*")

# What the wheels' CMake files name of the container that they were built in.
_CONTAINER = r'/opt/python/[^/;"]+'
_CONTAINER_NUMPY = re.compile(_CONTAINER + r"/lib/python3\.\d+/site-packages/numpy/_core/include")
_CONTAINER_PYTHON = re.compile(_CONTAINER + r"/include/python3\.\d+")


class SetupError(Exception):
    """Why the environment cannot be made; the last line says it."""


def missing() -> str | None:
    """What the machine lacks to build interfaces, as one line, or None."""
    lacks = [name for name in ("g++", "cmake", "make") if shutil.which(name) is None]
    if not Path(sysconfig.get_paths()["include"], "Python.h").exists():
        lacks.append("python3-dev")
    if not lacks:
        return None
    return f"the ROS tests need {', '.join(lacks)}: apt-get install {' '.join(lacks)}"


def environment_key() -> str:
    """What the environment without the packages depends on."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    wanted = [project["dependencies"], project["optional-dependencies"]["io"], project["scripts"]]
    parts = [sys.version, sys.base_prefix, str(ENV), REQUIREMENTS.read_text("utf-8")]
    return _digest([*parts, json.dumps(wanted), *_TOOLS])


def group_key(group: str) -> str:
    """What the packages of a group depend on: every file of theirs, by name and content."""
    parts: list[str | bytes] = []
    for folder in GROUPS[group]:
        for path in sorted(folder.rglob("*")):
            if path.is_file() and "__pycache__" not in path.parts:
                mode = str(path.stat().st_mode & 0o111)
                parts += [str(path.relative_to(ROOT)), mode, path.read_bytes()]
    return _digest(parts)


def refresh_environment() -> None:
    """Make the environment anew if anything changed that it depends on."""
    key = environment_key()
    if _stamp("environment") == key:
        return
    print(f"installing ROS and the library into {ENV.name}", flush=True)
    shutil.rmtree(ENV, ignore_errors=True)
    # Debian splits ensurepip into python3-venv, so pip comes from outside.
    _run([sys.executable, "-m", "venv", "--without-pip", ENV])
    _run([sys.executable, "-m", "pip", "-qq", "--python", ENV / "bin/python", "install", "pip"])
    pip: list[str | Path] = [
        ENV / "bin/python",
        "-m",
        "pip",
        "-qq",
        "--disable-pip-version-check",
        "install",
    ]
    _run([*pip, "--requirement", REQUIREMENTS, "--editable", f"{ROOT}[io]", *_TOOLS])
    _point_cmake_here()
    _write_stamp("environment", key)


def refresh_packages() -> None:
    """Build and install the packages whose files changed; what they had installed goes first."""
    for group, folders in GROUPS.items():
        key = group_key(group)
        if _stamp(group) == key:
            continue
        (ENV / f".{group}").unlink(missing_ok=True)  # or a build that fails would count as done
        for folder in folders:
            _forget(folder.name)
        there = [folder for folder in folders if (folder / "package.xml").exists()]
        if there:
            print(f"building {', '.join(folder.name for folder in there)}", flush=True)
            _build(there)
        _write_stamp(group, key)


def is_complete() -> bool:
    """Whether the environment is there and all but the packages is as it should be."""
    return _stamp("environment") == environment_key()


def lock() -> int:
    """Hold off another run of this, until this process ends."""
    held = os.open(__file__, os.O_RDONLY)
    fcntl.flock(held, fcntl.LOCK_EX)
    return held


def _build(folders: list[Path]) -> None:
    env = {key: value for key, value in os.environ.items() if not _FOREIGN.fullmatch(key)}
    env |= {"AMENT_PREFIX_PATH": str(ENV), "CMAKE_PREFIX_PATH": str(ENV)}
    env["PATH"] = f"{ENV / 'bin'}{os.pathsep}{env['PATH']}"
    BUILD.mkdir(exist_ok=True)
    command: list[str | Path] = [ENV / "bin/colcon", "--log-base", BUILD / "log", "build"]
    # Merged into the environment, they are found by a bare bin/python, without any setup.bash.
    command += ["--merge-install", "--install-base", ENV, "--build-base", BUILD]
    command += ["--event-handlers", "console_direct-", "--paths", *folders]
    command += ["--cmake-args", "-DBUILD_TESTING=OFF", f"-DPython3_EXECUTABLE={ENV}/bin/python"]
    done = subprocess.run(
        [*map(str, command)], cwd=BUILD, env=env, text=True, stdout=-1, stderr=subprocess.STDOUT
    )
    if done.returncode:
        raise SetupError(f"{done.stdout}\ncolcon failed; its logs are in {BUILD / 'log'}")


def _forget(package: str) -> None:
    """Remove what a package installed, or a module deleted since would still be imported."""
    site = sysconfig.get_path("purelib", "venv", {"base": str(ENV), "platbase": str(ENV)})
    patterns = [f"{site}/{package}", f"{site}/{package}-*", f"build/{package}", f"lib/{package}"]
    patterns += [f"lib/lib{package}__*", f"include/{package}", f"share/{package}"]
    patterns += [f"share/ament_index/resource_index/*/{package}"]
    patterns += [f"share/colcon-core/packages/{package}"]
    for pattern in patterns:
        for path in ENV.glob(pattern.removeprefix(f"{ENV}/")):
            shutil.rmtree(path) if path.is_dir() and not path.is_symlink() else path.unlink()


def _point_cmake_here() -> None:
    """Replace the container's include paths, which are nowhere else, in the wheels' CMake files."""
    ask = [str(ENV / "bin/python"), "-c", "import numpy; print(numpy.get_include())"]
    numpy = subprocess.run(ask, check=True, text=True, capture_output=True).stdout.strip()
    python = sysconfig.get_paths()["include"]
    for path in (ENV / "share").glob("*/cmake/*.cmake"):
        before = path.read_text("utf-8")
        after = _CONTAINER_NUMPY.sub(lambda _: numpy, before)
        after = _CONTAINER_PYTHON.sub(lambda _: python, after)
        if "/opt/python/" in after:
            raise SetupError(f"{path} names a path of the wheel's build that nothing replaces")
        if after != before:
            path.write_text(after, "utf-8")


def _run(command: list[str | Path]) -> None:
    env = {key: value for key, value in os.environ.items() if not _FOREIGN.fullmatch(key)}
    done = subprocess.run([*map(str, command)], env=env)
    if done.returncode:
        raise SetupError(f"making {ENV.name} failed with: {' '.join(map(str, command))}")


def _digest(parts: Iterable[str | bytes]) -> str:
    total = hashlib.sha256()
    for part in parts:
        raw = part.encode() if isinstance(part, str) else part
        total.update(len(raw).to_bytes(8, "big") + raw)
    return total.hexdigest()


def _stamp(name: str) -> str | None:
    path = ENV / f".{name}"
    return path.read_text("utf-8") if path.exists() else None


def _write_stamp(name: str, key: str) -> None:
    (ENV / f".{name}").write_text(key, "utf-8")


def main() -> None:
    """Bring the environment up to date."""
    if problem := missing():
        raise SetupError(problem)
    lock()
    refresh_environment()
    refresh_packages()


if __name__ == "__main__":
    try:
        main()
    except SetupError as error:
        *before, last = str(error).splitlines()
        sys.exit("\n".join([*before, f"boxgrasp: {last}"]))
