"""What a forked child must not inherit: locks that other threads held, and pools without threads.

A fork copies the memory of all threads but goes on with one of them. Windows has no fork, and no
`os.register_at_fork`; there nothing of this is needed.
"""

from __future__ import annotations

import functools
import os
import threading
from collections.abc import Callable
from contextlib import nullcontext
from typing import TYPE_CHECKING, Any, Protocol, TypeVar
from weakref import WeakSet


class Lock(Protocol):
    """What can be held."""

    def acquire(self) -> Any:
        """Wait for it."""
        ...

    def release(self) -> Any:
        """Give it back."""
        ...


__all__ = ["cached_property", "drop_in_child", "held_at_fork"]

L = TypeVar("L", bound=Lock)
_locks: WeakSet[Any] = WeakSet()
_forking = threading.Lock()  # by one thread at a time
_held: list[Any] = []  # by the fork under way


def held_at_fork(lock: L) -> L:
    """Have every fork wait for a lock, so that the child finds what it guards whole, and it free.

    Args:
        lock: held for a short while only, and never while waiting for another one given here.

    Returns:
        The lock.
    """
    _locks.add(lock)
    return lock


def drop_in_child(drop: Callable[[], object]) -> None:
    """Call a function in every child, before anything else of it runs.

    Args:
        drop: forgets what is of no use there.
    """
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(after_in_child=drop)


def _hold() -> None:
    _forking.acquire()
    for lock in list(_locks):
        lock.acquire()
        _held.append(lock)


def _let_go() -> None:
    while _held:
        _held.pop().release()
    _forking.release()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(before=_hold, after_in_child=_let_go, after_in_parent=_let_go)


if TYPE_CHECKING:
    from functools import cached_property  # noqa: TID251
else:

    class cached_property(functools.cached_property):  # noqa: N801, TID251
        """The one of functools without its lock, which it has up to Python 3.11 for each class.

        A child forked while another thread is inside would wait for it for ever.
        """

        def __init__(self, func: Callable[[Any], Any]) -> None:
            super().__init__(func)
            self.lock = nullcontext()
