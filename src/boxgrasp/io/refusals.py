"""Whatever goes wrong in reading a path becomes one kind of error, of one line."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from boxgrasp.errors import BoxgraspError, CaptureError, MissingExtraError

_LONGEST: Final = 300  # characters of a message
_log = logging.getLogger("boxgrasp.io")


@contextmanager
def refusals_of(place: Path | str) -> Iterator[None]:
    """Turn what is raised within into an error that names the path.

    Args:
        place: what is read: a path, or a name for what came without one.

    Yields:
        Nothing.

    Raises:
        CaptureError: anything was raised.
        MissingExtraError: an optional package is not installed.
    """
    try:
        yield
        return
    except ImportError as error:
        needed = (error.name or "a reader").partition(".")[0]
        raise MissingExtraError(
            f"{_line(str(place))}: reading it needs {needed}; "
            "install it with: pip install 'boxgrasp[io]'"
        ) from None
    except MissingExtraError as error:
        raise MissingExtraError(f"{_line(str(place))}: {error}") from None
    except BoxgraspError as error:
        what = str(error)
    except MemoryError:
        what = "too large for the memory there is"
    except OSError as error:
        what = f"cannot be read: {error.strerror or str(error) or type(error).__name__}"
    # A damaged file makes its decoder raise nearly anything; the caller gets one kind of error.
    except Exception as error:
        _log.debug("%s: no capture", place, exc_info=True)
        what = f"damaged, or another format than its name says: {type(error).__name__}: {error}"
    raise CaptureError(f"{_line(str(place))}: {_line(what)[:_LONGEST]}")


def _line(text: str) -> str:
    """The text on one line, without what a terminal would obey."""
    return " ".join("".join(c if c.isprintable() else " " for c in text).split())
