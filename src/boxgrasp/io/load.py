"""From a path to a capture: picks the reader, and turns whatever goes wrong into one line."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np

from boxgrasp.errors import BoxgraspError, CaptureError, MissingExtraError
from boxgrasp.sensing.capture import Capture
from boxgrasp.sensing.validation import CLOUD_FRAMES, CloudFrame

_LONGEST: Final = 300  # characters of a message
_log = logging.getLogger("boxgrasp.io")
_VALID: Final = ".npz, .pcd, .ply, .bag, .db3, .mcap"


def load_capture(
    path: str | os.PathLike[str],
    *,
    cloud_frame: CloudFrame = "optical",
    topic: str | None = None,
    stamp: float | None = None,
) -> Capture:
    """Read a capture; the suffix, or what a folder holds, tells the format.

    Args:
        path: a folder, or a .npz, .pcd, .ply, .bag, .db3 or .mcap file (docs/file-formats.md).
        cloud_frame: 'optical' or 'base', of a cloud's points.
        topic: of a bag's message; None for the first that can be used.
        stamp: a bag's message nearest in time is taken, s; None for the first.

    Returns:
        The capture, validated.

    Raises:
        CaptureError: missing, unreadable, or no usable view; names the path.
        MissingExtraError: the format needs an extra that is not installed.
    """
    place = Path(path)
    try:
        with np.errstate(all="ignore"):  # a file's odd floats are judged, not warned about
            return _reader(place, cloud_frame, topic, stamp)()
    except ImportError as error:
        needed = (error.name or "a reader").partition(".")[0]
        raise MissingExtraError(
            f"{_line(str(place))}: reading it needs {needed}; "
            "install it with: pip install 'boxgrasp[io]'"
        ) from None
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


def _reader(
    path: Path, cloud_frame: CloudFrame, topic: str | None, stamp: float | None
) -> Callable[[], Capture]:
    """The call that reads this path. Readers are imported one at a time, so that none is paid."""
    if cloud_frame not in CLOUD_FRAMES:
        raise CaptureError(f"cloud_frame is {cloud_frame!r}; valid: {', '.join(CLOUD_FRAMES)}")
    if path.is_dir():
        return _folder_reader(path, cloud_frame, topic, stamp)
    if not path.is_file():
        what = "is no regular file" if os.path.lexists(path) else "no such file or folder"
        raise CaptureError(f"{what}; valid: a folder, or a file with suffix {_VALID}")
    match path.suffix.lower():
        case ".npz":
            from boxgrasp.io.npz import load_npz

            return lambda: load_npz(path)
        case ".pcd":
            from boxgrasp.io.pcd import load_pcd

            return lambda: load_pcd(path, cloud_frame)
        case ".ply":
            from boxgrasp.io.ply import load_ply

            return lambda: load_ply(path, cloud_frame)
        case ".bag" | ".db3" | ".mcap":
            return _bag_reader(path, cloud_frame, topic, stamp)
        case suffix:
            found = f"suffix {suffix!r}" if suffix else "no suffix"
            raise CaptureError(f"{found}; valid: {_VALID}, or a folder with depth.png")


def _bag_reader(
    path: Path, cloud_frame: CloudFrame, topic: str | None, stamp: float | None
) -> Callable[[], Capture]:
    from boxgrasp.io.bag import load_bag

    return lambda: load_bag(path, cloud_frame, topic, stamp)


def _folder_reader(
    path: Path, cloud_frame: CloudFrame, topic: str | None, stamp: float | None
) -> Callable[[], Capture]:
    names = set(os.listdir(path))
    if "metadata.yaml" in names:
        return _bag_reader(path, cloud_frame, topic, stamp)
    if "depth.png" in names:
        from boxgrasp.io.folder import load_folder

        return lambda: load_folder(path)
    for cloud in ("cloud.pcd", "cloud.ply"):
        if cloud in names:
            return _reader(path / cloud, cloud_frame, topic, stamp)
    raise CaptureError(
        "folder without depth.png; valid: depth.png and intrinsics.json, cloud.pcd, cloud.ply, "
        "or a ROS 2 bag's metadata.yaml"
    )
