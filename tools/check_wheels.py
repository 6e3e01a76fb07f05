"""Show that every dependency has a wheel for each Python and processor that robots have.

`python tools/check_wheels.py` resolves the core's dependencies and those of the extras below, as
pyproject.toml has them, and theirs, for every combination with pip's own resolver, wheels only;
nothing is installed. Exit status: 0 all there, 1 one is missing, 3 the registry does not
answer.
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
PYTHONS = ("3.11", "3.12", "3.13")
PROCESSORS = ("x86_64", "aarch64")
GLIBC = (39, 35, 34, 31, 28, 27, 24, 17)  # what a wheel may ask for, manylinux_2_N
# Not `urdf`: trimesh leaves embreex out on aarch64, which pip judges by the machine it runs on.
EXTRAS = ("io", "lens", "sim", "train", "network", "cluster")
MISSING, OFFLINE = 1, 3


def requirements(extra: str | None = None) -> list[str]:
    """The package's dependencies, or those of an extra, as pyproject.toml has them."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    found = project["optional-dependencies"][extra] if extra else project["dependencies"]
    return [str(line) for line in found if not str(line).startswith("boxgrasp")]


def resolve(python: str, processor: str, wanted: list[str]) -> dict[str, str]:
    """Name to wheel file of all that pip would install there.

    Raises:
        RuntimeError: pip finds no set of wheels, or no registry.
    """
    platforms = [f"manylinux_2_{minor}_{processor}" for minor in GLIBC]
    platforms += [f"manylinux2014_{processor}", f"linux_{processor}"]
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.json"
        command = [sys.executable, "-m", "pip", "install", "--dry-run", "--ignore-installed"]
        command += ["--quiet", "--disable-pip-version-check", "--no-input", "--report", str(report)]
        command += ["--target", folder, "--only-binary", ":all:", "--python-version", python]
        command += ["--implementation", "cp"]
        command += [word for platform in platforms for word in ("--platform", platform)]
        done = subprocess.run([*command, *wanted], capture_output=True, text=True)
        if done.returncode:
            raise RuntimeError(done.stderr.strip())
        installs = json.loads(report.read_text("utf-8"))["install"]
    return {
        item["metadata"]["name"].lower(): item["download_info"]["url"].rsplit("/", 1)[-1]
        for item in installs
    }


def is_offline() -> bool:
    """Whether pip finds not even a package that is known to be there."""
    try:
        resolve("3.11", "x86_64", ["pip"])
    except RuntimeError:
        return True
    return False


def main() -> int:
    """Print a line for every combination."""
    wanted = [line for extra in (None, *EXTRAS) for line in requirements(extra)]
    places = [(python, processor) for python in PYTHONS for processor in PROCESSORS]

    def look(place: tuple[str, str]) -> dict[str, str] | str:
        try:
            return resolve(*place, wanted)
        except RuntimeError as error:
            return str(error)

    with ThreadPoolExecutor(2) as pool:
        answers = list(pool.map(look, places))
    for (python, processor), answer in zip(places, answers, strict=True):
        if isinstance(answer, str):
            print(f"{python} {processor}: MISSING\n{answer}")
        else:
            print(f"{python} {processor}: {', '.join(sorted(answer.values()))}")
    if not any(isinstance(answer, str) for answer in answers):
        return 0
    return OFFLINE if is_offline() else MISSING


if __name__ == "__main__":
    sys.exit(main())
