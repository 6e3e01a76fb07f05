"""How far a long run is: a bar on a terminal, a line now and then elsewhere, on standard error."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable, Iterator
from importlib.util import find_spec

_EVERY_S = 10.0


@contextlib.contextmanager
def progress(label: str, total: int, done: int) -> Iterator[Callable[[], None]]:
    """Gives a function to call once a finished task; shows nothing if none is left, or no label."""
    if done >= total or not label or sys.stderr is None:
        yield lambda: None
    elif sys.stderr.isatty() and find_spec("rich"):
        with _bar(label, total, done) as step:
            yield step
    else:
        yield _Lines(label, total, done)


@contextlib.contextmanager
def _bar(label: str, total: int, done: int) -> Iterator[Callable[[], None]]:
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
        task = bar.add_task(label, total=total, completed=done)
        yield lambda: bar.advance(task)


class _Lines:
    def __init__(self, label: str, total: int, done: int) -> None:
        self.label, self.total, self.first, self.done = label, total, done, done
        self.start = self.last = time.monotonic()

    def __call__(self) -> None:
        self.done += 1
        now = time.monotonic()
        if now - self.last < _EVERY_S and self.done < self.total:
            return
        self.last = now
        spent = now - self.start
        left = spent / (self.done - self.first) * (self.total - self.done)
        text = f"{self.label}: {self.done} of {self.total}, {spent:.0f} s"
        rest = f", about {left:.0f} s left" if self.done < self.total else ""
        sys.stderr.write(f"{text}{rest}\n")
        sys.stderr.flush()
