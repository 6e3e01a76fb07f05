"""One long task in a process of its own, while the caller goes on with other things."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from boxgrasp.errors import WorkError
from boxgrasp.execution._limits import threadpool_limits
from boxgrasp.execution._processes import ProcessWorkers

T = TypeVar("T")
R = TypeVar("R")


class Background:
    """A task that runs beside the caller, on one thread, and ends with it at the latest.

    Args:
        function: of a module.
        task: picklable, as the result must be.

    Raises:
        MissingExtraError: threadpoolctl is not installed.
    """

    def __init__(self, function: Callable[[T], R], task: T) -> None:
        threadpool_limits()  # complains here, not in the process
        self._workers = ProcessWorkers(1)
        self._worker = self._workers.started(function, task)

    def finished(self) -> bool:
        """Whether `result` has something to say; never waits.

        Returns:
            Whether the task ended, well or not.
        """
        return self._worker.pipe.closed or bool(self._worker.pipe.poll())

    def result(self) -> Any:
        """What the task gave; waits for it.

        Returns:
            The result.

        Raises:
            WorkError: the process was ended from outside.
            Exception: whatever the task raises.
        """
        answer = None if self._worker.pipe.closed else self._worker.take()
        self.end()
        if answer is None:
            raise WorkError(f"the process of the task was ended by {self._worker.end_by}")
        good, value = answer
        if good:
            return value
        raise value[0]

    def end(self) -> None:
        """End the process at once."""
        self._workers.close()
