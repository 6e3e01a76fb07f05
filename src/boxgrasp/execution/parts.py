"""Long work in parts: what is finished is kept and never done again."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import closing
from typing import TypeVar

from boxgrasp.execution.progress import progress
from boxgrasp.execution.store import Store
from boxgrasp.execution.workers import Workers

T = TypeVar("T")


def finish(
    store: Store,
    tasks: Mapping[str, T],
    function: Callable[[T], bytes],
    workers: Workers,
    title: str,
) -> None:
    """Do the tasks whose name the store does not have, and keep each result as soon as it is there.

    So a kill at any moment loses what was under way and no more.

    Args:
        store: where results are kept.
        tasks: by the names of their results.
        function: of a module; a result's bytes from a task.
        workers: who runs them.
        title: what progress is shown under; nothing is shown where it is empty.

    Raises:
        StoreError: a result cannot be written.
        WorkError: workers were lost.
    """
    missing = [name for name in tasks if not store.exists(name)]
    with progress(title, len(tasks), len(tasks) - len(missing)) as step:
        with closing(workers.run(function, [tasks[name] for name in missing])) as results:
            for index, result in results:
                store.write(missing[index], result)
                step()
