"""Several captures, one after the other; one that fails does not stop the rest."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence

from boxgrasp.cli import FAILED, complain
from boxgrasp.errors import BoxgraspError

_log = logging.getLogger("boxgrasp.cli")


def each(
    items: Sequence[str], work: Callable[[int, str], None], names: Sequence[str] | None = None
) -> int:
    """Call `work(number, item)` for every item; the exit status is 2 if any failed."""
    failed = False
    for number, item in enumerate(items, start=1):
        path = names[number - 1] if names else item
        try:
            work(number, item)
        except BoxgraspError as error:
            failed = True
            text = str(error)
            complain(text if text.startswith(path) else f"{path}: {text}")
        except OSError as error:
            if isinstance(error, BrokenPipeError):
                raise
            failed = True
            complain(f"{error.filename or path}: {error.strerror or error}")
        except MemoryError:
            failed = True
            complain(f"{path}: too large for the memory there is")
        except Exception as error:  # a fault of ours must not cost the rest of the batch
            failed = True
            complain(f"{path}: internal error: {type(error).__name__}: {error}")
            _log.info("%s", path, exc_info=True)
    return FAILED if failed else 0
