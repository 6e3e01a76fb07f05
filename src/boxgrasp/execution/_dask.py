"""Workers of an existing Dask scheduler."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Sequence
from contextlib import suppress
from typing import Any, TypeVar

from boxgrasp.errors import MissingExtraError, WorkError
from boxgrasp.execution._limits import call_in_worker

T = TypeVar("T")
R = TypeVar("R")
_FAILED = ("error", "cancelled")  # as distributed spells them
_REACH_S = 10  # for the scheduler
_WAIT_S = 30  # for its first worker
_AHEAD = 4  # tasks in flight for each thread of the cluster
_COUNT_EVERY_S = 5.0  # its threads, as workers come and go
_SAME = ("boxgrasp", "numpy", "numba", "scikit-learn", "mujoco")  # of the same version everywhere


class DaskWorkers:
    """The workers of the scheduler at `address`; see `cluster_workers`.

    Raises:
        WorkError: not reached, no worker, or workers with other versions than here.
        MissingExtraError: distributed is not installed.
    """

    def __init__(self, address: str) -> None:
        try:
            import distributed
        except ImportError:
            raise MissingExtraError(
                "a Dask cluster needs distributed; install it with: pip install 'boxgrasp[cluster]'"
            ) from None
        self._dask: Any = distributed
        self._address = address
        self._threads, self._counted = 1, -_COUNT_EVERY_S
        try:
            self._dask.comm.get_address_host_port(address)  # a client fails, then will not close
            self._client: Any = distributed.Client(address, timeout=_REACH_S, set_as_default=False)
        except (OSError, ValueError) as error:
            raise WorkError(
                f"no Dask scheduler at {address}: {' '.join(str(error).split())}"
            ) from error
        try:
            self._validate()
        except BaseException:
            self.close()
            raise

    def run(
        self, function: Callable[[T], R], tasks: Sequence[T]
    ) -> Generator[tuple[int, R], None, None]:
        """See `Workers.run`.

        Args:
            function: of a module.
            tasks: picklable.

        Yields:
            Index and result of each task, as they finish.

        Raises:
            WorkError: the scheduler was lost, or a task ended its worker several times.
            Exception: whatever a task raises.
        """
        flying: dict[Any, int] = {}  # futures and their indices
        finished = self._dask.as_completed(loop=self._client.loop)
        following = 0
        self._counted = -_COUNT_EVERY_S  # and so notice first whether the scheduler is there
        try:
            while following < len(tasks) or flying:
                for index in range(
                    following, min(len(tasks), following + self._free_slots(flying))
                ):
                    future = self._client.submit(call_in_worker, function, tasks[index], pure=False)
                    flying[future] = index
                    finished.add(future)
                    following = index + 1
                batch = finished.next_batch()
                good = [future for future in batch if future.status not in _FAILED]
                for future, result in zip(good, self._gather(good), strict=True):
                    yield flying.pop(future), result
                for future in batch:
                    if future in flying:
                        self._fail(future)
        finally:
            if flying:
                with suppress(Exception):  # the scheduler may be gone
                    self._client.cancel(list(flying), force=True)

    def close(self) -> None:
        """Leave the cluster, which goes on."""
        self._client.close(timeout=2)

    def _validate(self) -> None:
        try:
            self._client.wait_for_workers(1, timeout=_WAIT_S)
        except self._dask.TimeoutError:
            raise WorkError(
                f"no worker at the Dask scheduler {self._address} within {_WAIT_S} s"
            ) from None
        told: Any = self._client.get_versions(packages=list(_SAME))
        for name in _SAME:
            ours = told["client"]["packages"][name]
            for worker, about in told["workers"].items():
                theirs = about["packages"].get(name)
                if ours is not None and theirs != ours:
                    raise WorkError(
                        f"Dask worker {worker} has {name} {theirs or 'not at all'}, "
                        f"needed is {ours} as here, or results would differ"
                    )

    def _free_slots(self, flying: dict[Any, int]) -> int:
        """How many tasks more may be in flight."""
        now = time.monotonic()
        if now - self._counted > _COUNT_EVERY_S:
            try:
                self._threads = max(1, sum(self._client.nthreads().values()))
            except OSError as error:
                raise self._gone() from error
            self._counted = now
        return max(0, _AHEAD * self._threads - len(flying))

    def _gather(self, futures: list[Any]) -> list[Any]:
        try:
            return list(self._client.gather(futures))
        except (OSError, self._dask.CancelledError) as error:
            raise self._gone() from error

    def _fail(self, future: Any) -> None:
        """Raise what a task raised, or that the cluster failed."""
        try:
            future.result()
        except self._dask.scheduler.KilledWorker as error:
            raise WorkError(
                f"a task was under way on {error.allowed_failures + 1} Dask workers that died; "
                "is there enough memory?"
            ) from error
        except self._dask.CancelledError as error:
            raise self._gone() from error

    def _gone(self) -> WorkError:
        return WorkError(f"lost the Dask scheduler at {self._address}")
