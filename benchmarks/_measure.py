"""What the timing scripts share: captures to time on, quartiles, and figures of a fresh process."""

from __future__ import annotations

import importlib
import os
import re
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from boxgrasp import Capture
from boxgrasp.simulate import draw_scene, to_capture


def cast_captures(count: int, seed: int) -> list[Capture]:
    """Cast 640 x 480 views with noise, each of a scene of its own."""
    captures = []
    for number in range(count):
        rng = np.random.default_rng((seed, number))
        captures.append(to_capture(draw_scene(rng), rng)[0])
    return captures


# Of which Debian package a system library is that the wheels of libraries want.
SYSTEM_PACKAGES = {
    "libEGL.so.1": "libegl1",
    "libGL.so.1": "libgl1",
    "libX11.so.6": "libx11-6",
    "libgomp.so.1": "libgomp1",
    "libstdc++.so.6": "libstdc++6",
    "libusb-1.0.so.0": "libusb-1.0-0",
}


def lacking(module: str, install: str) -> str | None:
    """Why a library that is compared against cannot be used, in one line; None where it can.

    Args:
        module: its name.
        install: how it is installed.
    """
    try:
        importlib.import_module(module)
    except ModuleNotFoundError as error:
        return f"no {error.name}: {install}"
    except (ImportError, OSError) as error:  # it is there, what it links to is not
        found = re.search(r"lib[\w.+-]*\.so[.\d]*", str(error))
        if found is None:
            return f"{module} cannot be loaded: {error}"
        package = SYSTEM_PACKAGES.get(found[0])
        remedy = f": apt-get install {package}" if package else ""
        return f"{module} cannot be loaded without the system library {found[0]}{remedy}"
    return None


def quartiles(milliseconds: Sequence[float]) -> str:
    """Median, lower and upper quartile, and the least."""
    low, middle, high = np.percentile(milliseconds, (25, 50, 75))
    return f"{middle:8.1f}  {low:8.1f} to {high:6.1f}  {min(milliseconds):8.1f}"


@dataclass(frozen=True)
class Finished:
    """A process that has ended."""

    seconds: float
    status: int
    out: str
    err: str


def run(words: Sequence[str], environment: Mapping[str, str] | None = None) -> Finished:
    """Run Python with these words to its end; wall time from start to exit."""
    start = time.perf_counter()
    done = subprocess.run(
        [sys.executable, *words],
        capture_output=True,
        text=True,
        env={**os.environ, **(environment or {})},
    )
    seconds = time.perf_counter() - start
    return Finished(seconds, done.returncode, done.stdout, done.stderr)
