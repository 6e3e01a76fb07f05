"""One thread a task, in every library, so that its floats do not depend on who else runs."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any, TypeVar

from boxgrasp.errors import MissingExtraError
from boxgrasp.kernels._threads import one_thread

T = TypeVar("T")
R = TypeVar("R")
_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS")


def threadpool_limits() -> Any:
    """The class of threadpoolctl.

    Returns:
        Called with a number, it limits every BLAS to that many threads.

    Raises:
        MissingExtraError: threadpoolctl is not installed.
    """
    try:
        import threadpoolctl
    except ImportError:
        raise MissingExtraError(
            "running tasks needs threadpoolctl; install it with: pip install 'boxgrasp[train]'"
        ) from None
    return threadpoolctl.threadpool_limits


def call_in_worker(function: Callable[[T], R], task: T) -> R:
    """Call on one thread in a process made for tasks, where BLAS stays at one for good.

    Given back between tasks, it would be given back under another task of the same process.

    Args:
        function: to call.
        task: its argument.

    Returns:
        What it gives.
    """
    # Libraries loaded so far are told, those that the task loads read the variables.
    os.environ.update(dict.fromkeys(_VARIABLES, "1"))
    threadpool_limits()(1)
    with one_thread():
        return function(task)


def call_here(function: Callable[[T], R], task: T) -> R:
    """Call on one thread, and give the threads back.

    Args:
        function: to call.
        task: its argument.

    Returns:
        What it gives.
    """
    before = {name: os.environ.get(name) for name in _VARIABLES}
    os.environ.update(dict.fromkeys(_VARIABLES, "1"))
    try:
        with threadpool_limits()(1), one_thread():
            return function(task)
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
