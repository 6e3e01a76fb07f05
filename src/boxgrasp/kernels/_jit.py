"""One way to compile: cached, without the GIL, and told apart from a cold start."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

import numba
from numba.core import event
from numba.core.compiler_lock import global_compiler_lock

from boxgrasp.forks import held_at_fork

P = ParamSpec("P")
R = TypeVar("R")
_log = logging.getLogger("boxgrasp.kernels")


class _CompileNotice(event.Listener):
    """Says once a process that kernels are being compiled; a cached kernel raises no event."""

    def __init__(self) -> None:
        self.said = False

    def on_start(self, _event: Any) -> None:
        if not self.said:
            self.said = True
            _log.warning("compiling kernels, once after installing; this takes some seconds")

    def on_end(self, _event: Any) -> None:
        return


event.register("numba:compile", _CompileNotice())
held_at_fork(global_compiler_lock)
_cache_warned = False
_made: list[Any] = []


def jit(function: Callable[P, R]) -> Callable[P, R]:
    """Compile on first call, with a cache on disk; where none can be written, warn once.

    Args:
        function: of arrays and numbers.

    Returns:
        The compiled function; it lets go of the GIL.
    """
    global _cache_warned
    try:
        compiled: Callable[P, R] = numba.njit(nogil=True, cache=True)(function)
    except RuntimeError as error:  # numba: no locator available
        if not _cache_warned:
            _cache_warned = True
            _log.warning("kernels cannot be cached and compile in every process: %s", error)
        compiled = numba.njit(nogil=True)(function)
    _made.append(compiled)
    return compiled


def signatures() -> dict[str, tuple[str, ...]]:
    """What each kernel was called with in this process, so far as its module is imported.

    Returns:
        By `module.name`, the types of every call that was compiled or loaded.
    """
    return {
        f"{one.py_func.__module__}.{one.py_func.__name__}": tuple(map(str, one.signatures))
        for one in _made
    }


def compiled_count() -> int:
    """How many kernels this process compiled, since it found them in no cache.

    Returns:
        The number, a kernel for other types counted again.
    """
    return sum(sum(one.stats.cache_misses.values()) for one in _made)


def cache_folder() -> str | None:
    """Where compiled kernels are kept.

    Returns:
        The folder, or None where none can be written.
    """
    return next((one.stats.cache_path for one in _made if one.stats.cache_path), None)
