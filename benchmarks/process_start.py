"""Wall time of whole `boxgrasp select` processes. `python benchmarks/process_start.py`.

From start to exit on one capture `.npz`. The first process finds no compiled kernels (an empty
NUMBA_CACHE_DIR stands for a fresh installation) and must say that it compiles; those after it
find them and must say nothing.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from pathlib import Path

import numpy as np
from _measure import Finished, cast_captures, run
from select_speed import word

from boxgrasp.io.npz import save_npz

FIRST_S, NEXT_S = 20.0, 1.5  # the bars


def checked(done: Finished) -> Finished:
    """The process, which must have answered."""
    if done.status or not done.out.startswith("{"):
        raise RuntimeError(done.err or "no answer")
    return done


def main(argv: list[str] | None = None) -> None:
    """Print both times."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=9, help="processes after the first")
    parser.add_argument("--seed", type=int, default=31)
    parser.add_argument("--warm", action="store_true", help="leave out the first process")
    args = parser.parse_args(argv)
    with tempfile.TemporaryDirectory() as place:
        path = Path(place) / "capture.npz"
        save_npz(cast_captures(1, args.seed)[0], path)
        words = ["-m", "boxgrasp", "select", str(path), "--json"]
        cache = {} if args.warm else {"NUMBA_CACHE_DIR": str(Path(place) / "cache")}
        first = checked(run(words, cache))
        rest = [checked(run(words, cache)) for _ in range(args.rounds)]
    seconds = [done.seconds for done in rest]
    middle = float(np.median(seconds))
    print(f"{os.cpu_count()} cores, one 640 x 480 capture, from start to exit")
    if not args.warm:
        said = "compiling" in first.err
        print(
            f"first, nothing compiled: {first.seconds:.1f} s (bar {FIRST_S:.0f}), "
            f"{word(first.seconds <= FIRST_S)}; "
            f"{'says' if said else 'does NOT say'} that it compiles"
        )
    silent = not any(done.err for done in rest)
    print(
        f"after it: {middle:.2f} s, {min(seconds):.2f} to {max(seconds):.2f} (bar {NEXT_S}), "
        f"{word(middle <= NEXT_S)}; {'silent' if silent else 'NOT silent on stderr'}"
    )


if __name__ == "__main__":
    main()
