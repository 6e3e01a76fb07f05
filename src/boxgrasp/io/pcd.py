"""PCD clouds through pypcd4, behind a check of the header that it believes."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any, Final, cast

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Floats
from boxgrasp.errors import CaptureError
from boxgrasp.geometry.transforms import make_transform, rotation_of
from boxgrasp.io.colors import unpack_rgb
from boxgrasp.io.extent import header_lines, remaining_bytes, validate_cloud_size
from boxgrasp.sensing.capture import Capture
from boxgrasp.sensing.validation import CloudFrame

_ENCODINGS: Final = ("ascii", "binary", "binary_compressed")
_LZF_RATIO: Final = 100  # one LZF token of 3 bytes unpacks to at most 264
_MAX_POINT_BYTES: Final = 4096  # more is damage
_SNIFF: Final = 4096  # bytes that show how values are parted


def load_pcd(path: Path, cloud_frame: CloudFrame) -> Capture:
    """A capture of a PCD file; a viewpoint other than the identity is the camera's pose.

    With such a viewpoint the points are in the frame it is given in, taken as the base frame.

    Args:
        path: of a .pcd.
        cloud_frame: 'optical' or 'base', of the points where there is no such viewpoint.

    Returns:
        The capture.

    Raises:
        CaptureError: damaged, truncated, no x y z, or no usable cloud.
    """
    with path.open("rb") as stream:
        header = _validate_header(stream)
        count = int(header["POINTS"][0])
        T_base_camera = _viewpoint(header.get("VIEWPOINT", []))
        messy = header["DATA"][0] == "ascii" and _is_messy(stream)
        stream.seek(0)
        cells = _read(cast("IO[bytes]", _Tidy(stream)) if messy else stream)
    if len(cells) != count:
        raise CaptureError(f"cloud has {len(cells)} of the {count} points its header says")
    xyz = np.stack([cells[axis] for axis in "xyz"], axis=1, dtype=np.float32, casting="same_kind")
    packed = next(
        (cells[name] for name in ("rgb", "rgba") if name in (cells.dtype.names or ())), None
    )
    colors = unpack_rgb(packed) if packed is not None else None
    width, height = int(header["WIDTH"][0]), int(header["HEIGHT"][0])
    organized = (height, width, 3) if height > 1 else (count, 3)
    return Capture.from_cloud(
        xyz.reshape(organized),
        cloud_frame=cloud_frame if T_base_camera is None else "base",
        colors=colors,
        T_base_camera=T_base_camera,
    )


def _read(stream: IO[bytes]) -> NDArray[np.void]:
    """(N,) structured, one record a point."""
    from pypcd4.pypcd4 import (
        PointCloud,
    )  # brings pydantic: imported where a PCD is read, not before

    cloud = PointCloud.from_fileobj(cast("Any", stream))
    return np.atleast_1d(cloud.pc_data)


def _validate_header(stream: IO[bytes]) -> dict[str, list[str]]:
    """The header's words by key, once its sizes agree with each other and with the file."""
    lines = header_lines(stream, "DATA")
    words = [line.split() for line in lines if line and not line.startswith("#")]
    header = {word[0]: word[1:] for word in words}
    for key in ("VERSION", "FIELDS", "SIZE", "TYPE", "COUNT", "WIDTH", "HEIGHT", "POINTS", "DATA"):
        if not header.get(key):
            raise CaptureError(f"PCD header lacks {key}; valid: PCD 0.7")
    if len(words) > 10:
        raise CaptureError(f"PCD header has {len(words)} entries; valid: the 10 of PCD 0.7")
    encoding = header["DATA"][0]
    if encoding not in _ENCODINGS:
        raise CaptureError(f"PCD data are {encoding!r:.40}; valid: {', '.join(_ENCODINGS)}")
    fields = header["FIELDS"]
    sizes, counts = _integers(header, "SIZE"), _integers(header, "COUNT")
    if not len(fields) == len(sizes) == len(counts) == len(header["TYPE"]):
        raise CaptureError("PCD header's FIELDS, SIZE, TYPE and COUNT differ in length")
    for axis in "xyz":
        if fields.count(axis) != 1:
            raise CaptureError(f"PCD has fields {' '.join(fields):.80}; valid: x y z once each")
        if header["TYPE"][fields.index(axis)] != "F" or counts[fields.index(axis)] != 1:
            raise CaptureError(f"PCD field {axis} is no single float; valid: TYPE F, COUNT 1")
    record = sum(size * count for size, count in zip(sizes, counts, strict=True))
    if min(*sizes, *counts) < 1 or record > _MAX_POINT_BYTES:
        raise CaptureError(f"PCD has {record} bytes a point; valid: up to {_MAX_POINT_BYTES}")
    (width, *_), (height, *_) = _integers(header, "WIDTH"), _integers(header, "HEIGHT")
    (points, *_) = _integers(header, "POINTS")
    if width * height != points or min(width, height) < 0:
        raise CaptureError(f"PCD has {points} points for {width} x {height}; valid: their product")
    _validate_size(stream, encoding, points, record, sum(counts))
    return header


def _validate_size(stream: IO[bytes], encoding: str, points: int, record: int, values: int) -> None:
    there, start = remaining_bytes(stream), stream.tell()
    if encoding == "ascii":
        validate_cloud_size(points, 2 * values * points - 1, there)
    elif encoding == "binary":
        validate_cloud_size(points, record * points, there)
    else:
        validate_cloud_size(points, 8, there)
        packed, unpacked = struct.unpack("<II", stream.read(8))
        validate_cloud_size(points, packed, there - 8)
        if unpacked != record * points or unpacked > _LZF_RATIO * packed + 64:
            raise CaptureError(
                f"PCD unpacks to {unpacked} bytes for {points} points of {record}; damaged"
            )
    stream.seek(start)


def _integers(header: dict[str, list[str]], key: str) -> list[int]:
    try:
        return [int(word) for word in header[key]]
    except ValueError:
        found = " ".join(header[key])
        raise CaptureError(f"PCD header's {key} is {found!r:.60}; valid: whole numbers") from None


def _viewpoint(words: list[str]) -> Floats | None:
    """T_base_camera of `tx ty tz qw qx qy qz`; None for the identity, or where there is none."""
    if not words:
        return None
    try:
        numbers = np.array([float(word) for word in words])
    except ValueError:
        numbers = np.array([np.nan])
    if numbers.shape != (7,) or not np.isfinite(numbers).all():
        raise CaptureError(f"PCD viewpoint is {' '.join(words)!r:.60}; valid: seven numbers")
    if not 0.99 < np.linalg.norm(numbers[3:]) < 1.01:
        raise CaptureError("PCD viewpoint's quaternion is not of unit length; valid: qw qx qy qz")
    w, x, y, z = numbers[3:] / np.linalg.norm(numbers[3:])
    if not numbers[:3].any() and abs(w) == 1:
        return None
    return make_transform(rotation_of((x, y, z, w)), numbers[:3])


def _is_messy(stream: IO[bytes]) -> bool:
    """Whether values are not parted by single blanks, which is all that pypcd4 takes."""
    start = stream.read(_SNIFF)
    return any(mark in start for mark in (b"  ", b"\t", b" \n", b"\r", b"\n ", b"\n\n"))


class _Tidy:
    """A stream's lines with single blanks; as much of a file as pypcd4 asks for."""

    def __init__(self, stream: IO[bytes]) -> None:
        self._stream = stream

    def __iter__(self) -> Iterator[bytes]:
        return (b" ".join(words) + b"\n" for line in self._stream if (words := line.split()))

    def seek(self, offset: int) -> int:
        return self._stream.seek(offset)
