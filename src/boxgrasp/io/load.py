"""From a path to a capture: picks the reader, and turns whatever goes wrong into one line."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Final

from boxgrasp.capture import Capture, CloudFrame
from boxgrasp.errors import BoxgraspError, CaptureError, MissingExtraError

_LONGEST: Final = 300


def load_capture(
    path: str | os.PathLike[str],
    *,
    cloud_frame: CloudFrame = "optical",
    topic: str | None = None,
    stamp: float | None = None,
) -> Capture:
    """The capture at `path`; the suffix, or what a folder holds, tells the format.

    Raises:
        CaptureError: missing, unreadable, or no usable view; names the path.
        MissingExtraError: the format needs an extra that is not installed.
    """
    place = Path(path)
    try:
        return _reader(place, cloud_frame, topic, stamp)()
    except MissingExtraError:
        raise
    except BoxgraspError as error:
        raise CaptureError(_one_line(f"{place}: {error}")) from None
    except MemoryError:
        raise CaptureError(_one_line(f"{place}: too large for the memory there is")) from None
    except OSError as error:
        what = error.strerror or str(error) or type(error).__name__
        raise CaptureError(_one_line(f"{place}: cannot be read: {what}")) from None
    # A damaged file makes its decoder raise nearly anything; the caller gets one kind of error.
    except Exception as error:
        what = f"{type(error).__name__}: {error}"
        raise CaptureError(_one_line(f"{place}: damaged or no such format: {what}")) from error


def _one_line(text: str) -> str:
    line = " ".join(text.split())
    return line if len(line) <= _LONGEST else line[: _LONGEST - 3] + "..."


def _reader(
    path: Path, cloud_frame: CloudFrame, topic: str | None, stamp: float | None
) -> Callable[[], Capture]:
    """The call that reads this path. Readers are imported one at a time, so that none is paid."""
    if not os.path.lexists(path):
        raise CaptureError("no such file or folder; valid: a capture's path")
    suffix = path.suffix.lower()
    if suffix == ".npz" and not path.is_dir():
        from boxgrasp.io.npz import load_npz

        return lambda: load_npz(path)
    raise CaptureError(f"has suffix {suffix!r}; valid: .npz")
