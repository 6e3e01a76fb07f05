"""Whether one version of the package is slower than another, call by call in turn.

    python tools/compare_speed.py BEFORE AFTER [--pairs 200] [--starts 20] [--scenes 8]

BEFORE and AFTER are folders that hold a checkout. Each answers in a process of its own; the two
take turns call by call, first one then the other first, on the same cast views, so that other work
on the machine weighs on both alike. Printed: the median time of each, and the median ratio of the
pairs with its 95 % interval (bootstrap). The same for the start of the command, `boxgrasp select
CAPTURE`, as whole processes, and for `boxgrasp --version`.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any, cast


class Worker:
    """A process that answers one view a line and says how long it took."""

    def __init__(self, checkout: str, scenes: int) -> None:
        self._environment = environment(checkout)
        self._process = subprocess.Popen(
            [sys.executable, __file__, "--answer", str(scenes)],
            env=self._environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self.call(0)

    def call(self, scene: int) -> float:
        """Milliseconds of one call."""
        put, get = cast(IO[str], self._process.stdin), cast(IO[str], self._process.stdout)
        put.write(f"{scene}\n")
        put.flush()
        return float(json.loads(get.readline()))

    def close(self) -> None:
        """End the process."""
        self._process.terminate()
        self._process.wait()


def environment(checkout: str) -> dict[str, str]:
    """Where the package of a checkout is found."""
    return {**os.environ, "PYTHONPATH": str(Path(checkout).resolve() / "src")}


def answer(scenes: int) -> None:
    """Read scene numbers, answer them, print milliseconds."""
    import numpy as np

    from boxgrasp import GraspSelector
    from boxgrasp.simulate import draw_scene, to_capture

    captures: list[Any] = []
    for number in range(scenes):
        rng = np.random.default_rng((424, number))
        captures.append(to_capture(draw_scene(rng), rng)[0])
    selector = GraspSelector()
    for capture in captures:
        selector.select(capture)
    for line in sys.stdin:
        start = time.perf_counter()
        selector.select(captures[int(line) % scenes])
        print(json.dumps((time.perf_counter() - start) * 1e3), flush=True)


def told(name: str, before: list[float], after: list[float]) -> str:
    """One line: the medians, the median ratio of the pairs, and its interval."""
    import numpy as np

    ratios = np.array(after) / np.array(before)
    rng = np.random.default_rng(0)
    draws = rng.integers(0, len(ratios), (5000, len(ratios)))
    low, high = np.percentile(np.median(ratios[draws], axis=1), (2.5, 97.5))
    return (
        f"{name:18} before {np.median(before):7.1f} ms, after {np.median(after):7.1f} ms, median "
        f"ratio {np.median(ratios):.3f} ({low:.3f} to {high:.3f}), {len(ratios)} pairs"
    )


def in_turn(
    calls: tuple[Callable[[int], float], Callable[[int], float]], pairs: int
) -> tuple[list[float], list[float]]:
    """Times of two calls made in turn, each first in every second pair."""
    times: tuple[list[float], list[float]] = ([], [])
    for k in range(pairs):
        for which in (0, 1) if k % 2 == 0 else (1, 0):
            times[which].append(calls[which](k // 2))
    return times


def started(checkout: str, words: list[str]) -> Callable[[int], float]:
    """A call that runs a command to its end and gives the milliseconds."""

    def run(_number: int) -> float:
        start = time.perf_counter()
        done = subprocess.run(
            [sys.executable, "-m", "boxgrasp", *words],
            env=environment(checkout),
            capture_output=True,
        )
        if done.returncode:
            raise SystemExit(f"{checkout}: {done.stderr.decode()}")
        return (time.perf_counter() - start) * 1e3

    return run


def write_capture(path: Path) -> None:
    """A cast view as the commands read it."""
    import numpy as np

    from boxgrasp.simulate import demo_capture

    view = demo_capture()
    np.savez(
        path,
        depth=np.asarray(view.depth),
        intrinsics=np.asarray(view.intrinsics),
        T_base_camera=np.asarray(view.T_base_camera),
        target_pixel=np.array(view.target_pixel),
    )


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("checkouts", nargs="*", metavar="BEFORE AFTER")
    parser.add_argument("--pairs", type=int, default=200)
    parser.add_argument("--starts", type=int, default=20)
    parser.add_argument("--scenes", type=int, default=8)
    parser.add_argument("--answer", type=int, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.answer:
        answer(args.answer)
        return 0
    if len(args.checkouts) != 2:
        parser.error("two checkouts are needed: BEFORE AFTER")
    before, after = args.checkouts
    workers = (Worker(before, args.scenes), Worker(after, args.scenes))
    print(told("select", *in_turn((workers[0].call, workers[1].call), args.pairs)), flush=True)
    for worker in workers:
        worker.close()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "table.npz"
        write_capture(path)
        for name, words in (
            ("start: select", ["select", str(path)]),
            ("start: --version", ["--version"]),
        ):
            calls = (started(before, words), started(after, words))
            for call in calls:
                call(0)
            print(told(name, *in_turn(calls, args.starts)), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
