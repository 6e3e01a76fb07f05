"""Show that every dependency has a wheel for each Python and system that boxgrasp is for.

`python tools/check_wheels.py` resolves the core's dependencies and each extra's, as pyproject.toml
has them, and theirs, for every Python and system with pip's own resolver, wheels only; nothing is
installed. `python tools/check_wheels.py 3.10 linux-aarch64` does so for one Python and system. pip
asks markers (`sys_platform == ...`) of the system that it runs on: what only another one needs is
not looked for. Exit status: 0 all that is promised is there, 1 something is missing, 3 the
registry does not answer.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

if sys.version_info >= (3, 11):
    import tomllib
else:  # pip brings one
    from pip._vendor import tomli as tomllib

ROOT = Path(__file__).resolve().parent.parent
PYTHONS = ("3.10", "3.11", "3.12", "3.13", "3.14")
GLIBC = (35, 34, 31, 28, 27, 24, 17)  # 2.N, as new as Ubuntu 22.04's, which ROS 2 Humble has
SYSTEMS = {
    **{
        f"linux-{cpu}": (
            *(f"manylinux_2_{minor}_{cpu}" for minor in GLIBC),
            *(f"manylinux2014_{cpu}", f"linux_{cpu}"),
        )
        for cpu in ("x86_64", "aarch64")
    },
    "macos-arm64": ("macosx_14_0_arm64",),  # pip adds the older ones
    "macos-x86_64": ("macosx_14_0_x86_64",),
    "windows-x86_64": ("win_amd64",),
}
# None for the core. Not `urdf`: trimesh leaves embreex out on aarch64, which pip judges by the
# machine it runs on.
EXTRAS = (None, "io", "lens", "sim", "train", "network", "cluster", "completion")
PROMISED = ("linux-x86_64", "linux-aarch64")
LAST_TESTED = "3.13"
MISSING, OFFLINE = 1, 3


def requirements(extra: str | None = None) -> list[str]:
    """The package's dependencies, or those of an extra, as pyproject.toml has them."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    found = project["optional-dependencies"][extra] if extra else project["dependencies"]
    return [str(line) for line in found if not str(line).startswith("boxgrasp")]


def resolve(python: str, system: str, wanted: list[str]) -> dict[str, str]:
    """Name to wheel file of all that pip would install there.

    Raises:
        RuntimeError: pip finds no set of wheels, or no registry.
    """
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.json"
        command = [sys.executable, "-m", "pip", "install", "--dry-run", "--ignore-installed"]
        command += ["--quiet", "--disable-pip-version-check", "--no-input", "--report", str(report)]
        command += ["--target", folder, "--only-binary", ":all:", "--python-version", python]
        command += ["--implementation", "cp"]
        command += [word for tag in SYSTEMS[system] for word in ("--platform", tag)]
        done = subprocess.run([*command, *wanted], capture_output=True, text=True)
        if done.returncode:
            raise RuntimeError(done.stderr.strip())
        installs = json.loads(report.read_text("utf-8"))["install"]
    return {
        item["metadata"]["name"].lower(): item["download_info"]["url"].rsplit("/", 1)[-1]
        for item in installs
    }


def lacking(python: str, system: str, wanted: list[str]) -> list[str]:
    """The requirements that have no wheels there, each asked for alone."""
    lacks = []
    for line in wanted:
        try:
            resolve(python, system, [line])
        except RuntimeError:
            lacks.append(line)
    return lacks or ["no set of them that fits"]


def look(python: str, system: str) -> dict[str, list[str]]:
    """What is missing there: requirements of the core and of the extras that lack some."""
    wanted = [line for extra in EXTRAS for line in requirements(extra)]
    try:
        resolve(python, system, wanted)
        return {}
    except RuntimeError:
        lacks = lacking(python, system, sorted(set(wanted)))
    missing = {
        extra or "core": [line for line in requirements(extra) if line in lacks] for extra in EXTRAS
    }
    return {name: lines for name, lines in missing.items() if lines} or {"all": lacks}


def is_offline() -> bool:
    """Whether pip finds not even a package that is known to be there."""
    try:
        resolve("3.11", "linux-x86_64", ["pip"])
    except RuntimeError:
        return True
    return False


def is_short(python: str, system: str, core: bool, extras: bool) -> bool:
    """Whether what lacks there was promised: the core on Linux or for a tested Python, or both."""
    tested = PYTHONS.index(python) <= PYTHONS.index(LAST_TESTED)
    return (core and (system in PROMISED or tested)) or (extras and system in PROMISED and tested)


def main(words: list[str]) -> int:
    """Print a row of a table for every Python and system, as it is known."""
    places = [(python, system) for python in PYTHONS for system in SYSTEMS]
    if words:
        if tuple(words) not in places:
            print(f"{' '.join(words)}; valid: one of {PYTHONS} and one of {(*SYSTEMS,)}")
            return MISSING
        places = [(words[0], words[1])]
    short = False
    print("| Python | system | core lacks | extras lack |\n| --- | --- | --- | --- |", flush=True)
    with ThreadPoolExecutor(2) as pool:
        answers = pool.map(lambda place: look(*place), places)
        for (python, system), lacks in zip(places, answers, strict=True):
            core = lacks.pop("core", []) + lacks.pop("all", [])
            extras = "; ".join(f"{name}: {', '.join(lines)}" for name, lines in lacks.items())
            print(f"| {python} | {system} | {', '.join(core)} | {extras} |", flush=True)
            short |= is_short(python, system, bool(core), bool(lacks))
    if not short:
        return 0
    return OFFLINE if is_offline() else MISSING


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
