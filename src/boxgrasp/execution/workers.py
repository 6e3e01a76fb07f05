"""What runs tasks: the calling process, processes of this machine, or a Dask cluster.

A function is one of a module, its tasks and results are picklable. Each call has one thread, for
BLAS as for the kernels, so that its floats do not depend on how many run side by side.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import AbstractContextManager, closing, contextmanager
from typing import Protocol, TypeVar

from boxgrasp.errors import WorkError
from boxgrasp.execution._dask import DaskWorkers
from boxgrasp.execution._limits import call_here, threadpool_limits
from boxgrasp.execution._processes import ProcessWorkers

T = TypeVar("T")
R = TypeVar("R")


class Workers(Protocol):
    """Runs the tasks, a bounded number at once."""

    def run(
        self, function: Callable[[T], R], tasks: Sequence[T]
    ) -> Generator[tuple[int, R], None, None]:
        """Run the tasks.

        Args:
            function: of a module.
            tasks: picklable, as their results must be.

        Yields:
            Index and result of each task, as they finish.

        Raises:
            WorkError: workers were lost, or a task ended its worker several times.
            Exception: whatever a task raises; then no more tasks are started.
        """
        ...


class _Here:
    """The calling process."""

    def run(
        self, function: Callable[[T], R], tasks: Sequence[T]
    ) -> Generator[tuple[int, R], None, None]:
        for index, task in enumerate(tasks):
            yield index, call_here(function, task)


def usable_cores() -> int:
    """How many cores this process may use.

    Returns:
        1 or more; those of the whole machine where a system (macOS, Windows) does not tell.
    """
    if sys.platform == "linux":
        return len(os.sched_getaffinity(0))
    else:
        return os.cpu_count() or 1


@contextmanager
def local_workers(processes: int | None = None) -> Iterator[Workers]:
    """Worker processes, one for each usable core by default; with one, the calling process itself.

    A process that is killed is replaced and its task run again, three times at most. Processes
    import the main script anew, which so needs its `if __name__ == "__main__"`.

    Args:
        processes: how many; None for one a usable core.

    Yields:
        The workers, ended with the block.

    Raises:
        WorkError: no process asked for.
        MissingExtraError: threadpoolctl is not installed.
    """
    count = usable_cores() if processes is None else processes
    if count < 1:
        raise WorkError(f"{count} processes; valid: 1 or more")
    threadpool_limits()  # complains here, not in a worker
    if count == 1:
        yield _Here()
        return
    with closing(ProcessWorkers(count)) as workers:
        yield workers


@contextmanager
def cluster_workers(address: str) -> Iterator[Workers]:
    """The workers of an existing Dask scheduler (`tcp://host:8786`), which run this boxgrasp too.

    The scheduler runs again what a lost worker held, finished or not; with no worker left, it
    waits for the next.

    Args:
        address: of the scheduler.

    Yields:
        The workers, left alone after the block.

    Raises:
        WorkError: not reached, no worker, or workers with other versions than here.
        MissingExtraError: distributed is not installed.
    """
    with closing(DaskWorkers(address)) as workers:
        yield workers


def workers_for(processes: int | None, cluster: str | None) -> AbstractContextManager[Workers]:
    """The workers of a cluster if there is one, else processes of this machine.

    Args:
        processes: how many; None for one a usable core.
        cluster: address of a Dask scheduler, or None.

    Returns:
        A context that gives the workers.

    Raises:
        WorkError: both are asked for; within the context, as `local_workers` and
            `cluster_workers`.
        MissingExtraError: within the context, as they.
    """
    if cluster is None:
        return local_workers(processes)
    if processes is not None:
        raise WorkError("both processes and a cluster; valid: one of them")
    return cluster_workers(cluster)
