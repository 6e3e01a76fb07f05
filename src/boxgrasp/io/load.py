"""From a path to a capture: picks the reader, and turns whatever goes wrong into one line."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from boxgrasp.errors import CaptureError, require
from boxgrasp.io.refusals import refusals_of
from boxgrasp.sensing.capture import Capture
from boxgrasp.sensing.validation import CloudFrame, validate_cloud_frame

_VALID: Final = ".npz, .pcd, .ply, .bag, .db3, .mcap"
_NO_BAG: Final = "base_frame is given, but this is no bag; valid: a bag, whose /tf is read"


@dataclass(frozen=True)
class _How:
    """How to read, as `load_capture` is told."""

    cloud_frame: CloudFrame
    topic: str | None
    stamp: float | None
    base_frame: str | None


def load_capture(
    path: str | os.PathLike[str],
    *,
    cloud_frame: CloudFrame = "optical",
    topic: str | None = None,
    stamp: float | None = None,
    base_frame: str | None = None,
) -> Capture:
    """Read a capture; the suffix, or what a folder holds, tells the format.

    Args:
        path: a folder, or a .npz, .pcd, .ply, .bag, .db3 or .mcap file (docs/file-formats.md).
        cloud_frame: 'optical' or 'base', of a cloud's points.
        topic: of a bag's message; None for the first that can be used.
        stamp: a bag's message nearest in time is taken, s; None for the first.
        base_frame: name of the base frame in a bag's /tf and /tf_static, out of which
            `T_base_camera` then comes; None leaves it unknown. A cloud in that very frame has
            cloud frame 'base'.

    Returns:
        The capture, validated.

    Raises:
        CaptureError: missing, unreadable, no usable view, or the base frame's place is unknown;
            names the path.
        MissingExtraError: the format needs an extra that is not installed.
    """
    require(path, (str, os.PathLike), "capture's path", "a path", CaptureError)
    for name, value in (("topic", topic), ("base_frame", base_frame)):
        require(value, (str, type(None)), name, "a name, or None", CaptureError)
    if stamp is not None:
        require(stamp, (int, float), "stamp", "seconds, or None", CaptureError)
    place = Path(path)
    how = _How(cloud_frame, topic, stamp, base_frame)
    # A file's odd floats are judged, not warned about.
    with refusals_of(place), np.errstate(all="ignore"):
        validate_cloud_frame(cloud_frame)
        return _reader(place, how)()


def _reader(path: Path, how: _How) -> Callable[[], Capture]:
    """The call that reads this path. Readers are imported one at a time, so that none is paid."""
    if path.is_dir():
        return _folder_reader(path, how)
    if not path.is_file():
        what = "is no regular file" if os.path.lexists(path) else "no such file or folder"
        raise CaptureError(f"{what}; valid: a folder, or a file with suffix {_VALID}")
    suffix = path.suffix.lower()
    if suffix in (".bag", ".db3", ".mcap"):
        return _bag_reader(path, how)
    if how.base_frame is not None:
        raise CaptureError(_NO_BAG)
    match suffix:
        case ".npz":
            from boxgrasp.io.npz import load_npz

            return lambda: load_npz(path)
        case ".pcd":
            from boxgrasp.io.pcd import load_pcd

            return lambda: load_pcd(path, how.cloud_frame)
        case ".ply":
            from boxgrasp.io.ply import load_ply

            return lambda: load_ply(path, how.cloud_frame)
        case _:
            found = f"suffix {suffix!r}" if suffix else "no suffix"
            raise CaptureError(f"{found}; valid: {_VALID}, or a folder with depth.png")


def _bag_reader(path: Path, how: _How) -> Callable[[], Capture]:
    from boxgrasp.io.bag import load_bag

    return lambda: load_bag(path, how.cloud_frame, how.topic, how.stamp, how.base_frame)


def _folder_reader(path: Path, how: _How) -> Callable[[], Capture]:
    names = set(os.listdir(path))
    if "metadata.yaml" in names:
        return _bag_reader(path, how)
    if how.base_frame is not None:
        raise CaptureError(_NO_BAG)
    if "depth.png" in names:
        from boxgrasp.io.folder import load_folder

        return lambda: load_folder(path)
    for cloud in ("cloud.pcd", "cloud.ply"):
        if cloud in names:
            return _reader(path / cloud, how)
    raise CaptureError(
        "folder without depth.png; valid: depth.png and intrinsics.json, cloud.pcd, cloud.ply, "
        "or a ROS 2 bag's metadata.yaml"
    )
