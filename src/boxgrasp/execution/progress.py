"""How far a long run is: a bar on a terminal, a line now and then elsewhere, on standard error.

Nothing is shown where the package's log is at errors alone.
"""

from __future__ import annotations

import contextlib
import logging
import sys
import time
from collections.abc import Callable, Iterator
from importlib.util import find_spec

_EVERY_S = 10.0
_log = logging.getLogger("boxgrasp.execution")


@contextlib.contextmanager
def progress(title: str, total: int, done: int) -> Iterator[Callable[[], None]]:
    """Shows how many tasks are done; nothing where none is left, or without a title.

    Args:
        title: of the work.
        total: number of tasks.
        done: how many were done before.

    Yields:
        A function to call once a finished task.
    """
    quiet = not _log.isEnabledFor(logging.WARNING)
    if done >= total or not title or sys.stderr is None or quiet:
        yield lambda: None
    elif sys.stderr.isatty() and find_spec("rich"):
        with _bar(title, total, done) as step:
            yield step
    else:
        yield _Lines(title, total, done)


@contextlib.contextmanager
def _bar(title: str, total: int, done: int) -> Iterator[Callable[[], None]]:
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("{task.description:24}"), BarColumn(), MofNCompleteColumn(),
        TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn(),
    )  # fmt: skip
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task(title, total=total, completed=done)
        yield lambda: bar.advance(task)


class _Lines:
    def __init__(self, title: str, total: int, done: int) -> None:
        self.title, self.total, self.first, self.done = title, total, done, done
        self.start = self.last = time.monotonic()

    def __call__(self) -> None:
        self.done += 1
        now = time.monotonic()
        if now - self.last < _EVERY_S and self.done < self.total:
            return
        self.last = now
        spent = now - self.start
        left = spent / (self.done - self.first) * (self.total - self.done)
        text = f"{self.title}: {self.done} of {self.total}, {spent:.0f} s"
        rest = f", about {left:.0f} s left" if self.done < self.total else ""
        sys.stderr.write(f"{text}{rest}\n")
        sys.stderr.flush()
