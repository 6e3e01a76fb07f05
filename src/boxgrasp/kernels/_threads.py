"""Own thread pool: numba's parallel loops abort when two Python threads enter them at once."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache

from boxgrasp.forks import drop_in_child

MOST_THREADS = max(1, min(4, os.cpu_count() or 1))  # one frame is too small for more
# Of the calling thread, so that tasks side by side in one process do not undo each other's.
_limit: ContextVar[int] = ContextVar("boxgrasp_threads", default=MOST_THREADS)


@cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(MOST_THREADS, thread_name_prefix="boxgrasp")


drop_in_child(_pool.cache_clear)  # its threads are not there, and it would wait for them


@contextmanager
def one_thread() -> Iterator[None]:
    """Within, `run_chunks` called from this thread stays on it: the caller fills the cores.

    Yields:
        Nothing.
    """
    before = _limit.set(1)
    try:
        yield
    finally:
        _limit.reset(before)


def run_chunks(work: Callable[[int, int], object], count: int, smallest: int = 20_000) -> None:
    """Call a function over [0, count) in contiguous chunks, on all cores.

    Chunks must write apart, or write the same value, so that their number changes no result.

    Args:
        work: called as work(start, stop).
        count: where the last chunk stops.
        smallest: least size of a chunk, below which a thread costs more than it brings.
    """
    chunks = max(1, min(_limit.get(), count // smallest))
    if chunks == 1:
        work(0, count)
        return
    edges = [count * i // chunks for i in range(chunks + 1)]
    futures = [_pool().submit(work, a, b) for a, b in zip(edges[1:-1], edges[2:], strict=True)]
    work(edges[0], edges[1])
    for future in futures:
        future.result()
