"""Task functions that worker processes import."""

from __future__ import annotations

import os
import signal
import threading
import time
import uuid
from pathlib import Path

import numpy as np

from boxgrasp.geometry.hand_distance import to_columns
from boxgrasp.kernels._threads import run_chunks


def numeric(seed: int) -> bytes:
    """Floats whose last bits may hang on the number of threads: BLAS, and a kernel in chunks."""
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(2, 400, 400))
    boxes = np.concatenate([rng.normal(size=(40, 3)), rng.uniform(0.01, 0.1, (40, 5))], axis=1)
    columns = rng.normal(size=(300, 4)).astype(np.float32)
    columns[:, 3] = columns[:, 2] + 0.1
    distances, nearest = to_columns(boxes, columns)
    return b"".join(array.tobytes() for array in (a @ b, distances, nearest))


def threads(_: int) -> tuple[int, int]:
    """The threads that BLAS and the kernels may use."""
    from threadpoolctl import threadpool_info

    seen: set[int] = set()
    run_chunks(lambda *_: seen.add(threading.get_ident()) or time.sleep(0.01), 10**6)
    return max(one["num_threads"] for one in threadpool_info()), len(seen)


def slow(task: tuple[str, str]) -> bytes:
    """Leave a mark `name-pid-...` in the folder, take 0.2 s."""
    folder, name = task
    mark(folder, name)
    time.sleep(0.2)
    return numeric(len(name) + int(name[-1]))


def mark(folder: str, name: str) -> None:
    (Path(folder) / f"{name}-{os.getpid()}-{uuid.uuid4().hex}").touch()


def marks(folder: Path) -> list[tuple[str, int]]:
    """The name and the process of each start of a task."""
    found = [path.name.split("-") for path in folder.iterdir()]
    return [(name, int(pid)) for name, pid, _ in found]


def die_once(task: tuple[str, str]) -> bytes:
    """Kill the own process the first time."""
    folder, name = task
    first = not any(other == name for other, _ in marks(Path(folder)))
    mark(folder, name)
    if first:
        os.kill(os.getpid(), signal.SIGKILL)
    return name.encode()


def die(_: int) -> bytes:
    os.kill(os.getpid(), signal.SIGKILL)
    return b""


class OddError(Exception):
    """Cannot be unpickled, as many that take more than a message."""

    def __init__(self, one: int, two: int) -> None:
        super().__init__(f"odd {one} {two}")


def fail_at_three(number: int) -> bytes:
    if number == 3:
        raise ValueError("three")
    return bytes([number])


def fail_oddly(number: int) -> bytes:
    raise OddError(number, 2)
