"""Worker processes of this machine, one task each at a time.

`concurrent.futures` gives up all results of a pool that loses one process, leaves its processes
behind when the caller is killed, and waits for them on Ctrl-C; so the processes are our own.
"""

from __future__ import annotations

import logging
import os
import pickle
import signal
import sys
import threading
import traceback
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager, suppress
from multiprocessing import connection, get_context, parent_process, process, resource_tracker
from typing import Any, TypeVar
from weakref import WeakSet

from boxgrasp.errors import WorkError
from boxgrasp.execution._limits import call_in_worker
from boxgrasp.forks import drop_in_child

T = TypeVar("T")
R = TypeVar("R")
_DEATHS = 3  # that one task may cause


class ProcessWorkers:
    """Processes that start with the first tasks and stay until `close`."""

    def __init__(self, processes: int) -> None:
        self._processes = processes
        self._workers: list[_Worker] = []
        _pools.add(self)

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
            WorkError: a task ended its worker several times.
            Exception: whatever a task raises.
        """
        left = deque(range(len(tasks)))
        deaths: Counter[int] = Counter()
        self._end(self._busy())  # of a run that was given up
        try:
            while left or self._busy():
                self._hand_out(left, function, tasks)
                finished: list[tuple[int, bool, Any]] = []
                for worker in self._ready():
                    index = worker.index
                    answer = worker.take()
                    if answer is not None:
                        finished.append((index, *answer))
                        continue
                    self._end([worker])
                    deaths[index] += 1
                    if deaths[index] == _DEATHS:
                        raise WorkError(
                            f"task {index} of {len(tasks)} ended its worker process {_DEATHS} "
                            f"times, the last time by {worker.end_by}"
                        )
                    left.appendleft(index)
                self._hand_out(left, function, tasks)  # before the caller takes its time
                yield from ((index, value) for index, good, value in finished if good)
                for _, good, value in finished:
                    if not good:
                        error, where = value
                        raise error from _InWorkerError(where)
        finally:
            self._end(self._busy())

    def started(self, function: Callable[[T], R], task: T) -> _Worker:
        """A process that has begun a task, whose answer the caller takes.

        Args:
            function: of a module.
            task: picklable.

        Returns:
            The process.
        """
        worker = _Worker()
        self._workers.append(worker)
        worker.give(0, function, task)
        return worker

    def close(self) -> None:
        """End the processes at once; an idle one holds nothing."""
        self._end(self._workers)

    def forget(self) -> None:
        """Leave the processes to the one that this was forked from; the next tasks start others."""
        for worker in self._workers:
            _siblings.discard(worker.process)
        self._workers = []

    def _busy(self) -> list[_Worker]:
        return [worker for worker in self._workers if worker.index >= 0]

    def _ready(self) -> list[_Worker]:
        """Busy workers that answered or died, by index of their tasks."""
        busy = {worker.pipe: worker for worker in self._busy()}
        ready = [busy[pipe] for pipe in connection.wait(list(busy)) if pipe in busy]
        return sorted(ready, key=lambda worker: worker.index)

    def _hand_out(self, left: deque[int], function: Callable[[T], R], tasks: Sequence[T]) -> None:
        while left and len(self._busy()) < self._processes:
            idle = next((worker for worker in self._workers if worker.index < 0), None)
            if idle is None:
                idle = _Worker()
                self._workers.append(idle)
            index = left.popleft()
            idle.give(index, function, tasks[index])

    def _end(self, workers: Sequence[_Worker]) -> None:
        for worker in workers:
            worker.process.kill()
        for worker in workers:
            worker.process.join()
            worker.pipe.close()
        self._workers = [worker for worker in self._workers if worker not in workers]


class _InWorkerError(Exception):
    """The traceback of a worker, as the cause of what is raised here; notes came with 3.11."""

    def __str__(self) -> str:
        return f"in a worker process:\n{self.args[0]}"


# What multiprocessing ends with the interpreter; in a bare fork too, whose children they are not.
_siblings: set[Any] = getattr(process, "_children", set())
_pools: WeakSet[ProcessWorkers] = WeakSet()


def _forget_pools() -> None:
    for pool in list(_pools):
        pool.forget()


drop_in_child(_forget_pools)


class _Worker:
    """One process and the task it runs, `index` -1 when idle."""

    def __init__(self) -> None:
        spawn = get_context("spawn")  # a fork copies locks that threads hold
        self.pipe, far = spawn.Pipe()
        self.index = -1
        level = logging.getLogger("boxgrasp").getEffectiveLevel()
        self.process = spawn.Process(target=_serve, args=(far, level), daemon=True)
        with _interrupt_later():
            self.process.start()
        far.close()  # so that the pipe ends with the process

    def give(self, index: int, function: Callable[[T], R], task: T) -> None:
        """Start a task; if the process is dead, `take` will tell.

        Args:
            index: of the task.
            function: of a module.
            task: picklable.
        """
        message = pickle.dumps((function, task), pickle.HIGHEST_PROTOCOL)
        self.index = index
        with suppress(OSError):
            self.pipe.send_bytes(message)

    def take(self) -> tuple[bool, Any] | None:
        """What came of the task.

        Returns:
            Whether it went well, with the result, or the exception and its traceback; None if the
            process died.
        """
        try:
            message = self.pipe.recv_bytes()
        except (EOFError, OSError):
            return None
        self.index = -1
        good, value = pickle.loads(message)
        return good, value

    @property
    def end_by(self) -> str:
        """How the process ended."""
        code = self.process.exitcode or 0
        if code < 0:
            return f"{signal.Signals(-code).name}; is there enough memory?"
        return f'exit status {code}; has the main script its `if __name__ == "__main__"`?'


@contextmanager
def _interrupt_later() -> Iterator[None]:
    """Put off Ctrl-C, which reaches all processes of a terminal, until a process has started.

    Ours is to end the others silently, even while they start. They inherit what is blocked here;
    this process may get the signal in another thread, and must not give up a half-started one.
    """
    if sys.platform == "win32":  # no signal can be blocked there; `_serve` ignores it
        yield
    else:
        resource_tracker.ensure_running()  # it would unblock
        came: list[int] = []
        is_main = threading.current_thread() is threading.main_thread()
        handler = signal.getsignal(signal.SIGINT)
        if is_main:
            signal.signal(signal.SIGINT, lambda number, _: came.append(number))
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
            if is_main:
                signal.signal(signal.SIGINT, signal.SIG_DFL if handler is None else handler)
            if came:
                signal.raise_signal(signal.SIGINT)


def _serve(pipe: connection.Connection, log_level: int) -> None:
    """Answer tasks until the parent ends; log no more than it does."""
    logging.getLogger("boxgrasp").setLevel(log_level)
    if sys.platform == "win32":
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    while True:
        try:
            message = pipe.recv_bytes()
        except (EOFError, OSError):
            return
        with suppress(OSError):
            pipe.send_bytes(_answer(message))


def _answer(message: bytes) -> bytes:
    try:
        function, task = pickle.loads(message)
        return pickle.dumps((True, call_in_worker(function, task)), pickle.HIGHEST_PROTOCOL)
    except Exception as error:
        where, said = traceback.format_exc(), traceback.format_exception_only(error)[-1].strip()
        try:
            answer = pickle.dumps((False, (error, where)), pickle.HIGHEST_PROTOCOL)
            pickle.loads(answer)  # fails for those with arguments of their own
        except Exception:
            answer = pickle.dumps((False, (RuntimeError(said), where)))
        return answer


def _end_with_parent() -> None:
    """A parent that is killed cannot end its workers."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
