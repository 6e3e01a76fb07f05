"""Depth as compressed_depth_image_transport sends it: PNG or RVL, in mm or as inverse depth."""

from __future__ import annotations

import io
import math
import struct
from collections.abc import Callable
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Points, readonly
from boxgrasp.errors import CaptureError
from boxgrasp.io.extent import MAX_PIXELS
from boxgrasp.io.images import png_size, read_depth_png
from boxgrasp.kernels import rvl
from boxgrasp.sensing.validation import Bytes

T = TypeVar("T")

_HEADER: Final = 12  # bytes before the image: a number that says nothing, and A and B
_RVL_HEADER: Final = 8  # bytes: width and height, before the stream


def unpack_depth(told: str, data: Bytes) -> Points:
    """The depth of a compressed image.

    Of 32FC1 the inverse depth is sent, as whole numbers v: depth is A / (v - B), and 0 is missing.
    Senders have A above 0 and B = 1 - A / (largest depth), so that none of their depths is below 0.

    Args:
        told: its `format`, which starts with 16UC1 or 32FC1.
        data: (n,) uint8.

    Returns:
        (H, W) float32, m, read-only; NaN where 32FC1 has none.

    Raises:
        CaptureError: another format, or damaged.
    """
    encoding, is_rvl, image = _parts(told, data)
    values = (_unpack_rvl if is_rvl else _unpack_png)(image)
    if encoding == "16UC1":
        return readonly((values * 0.001).astype(np.float32))
    a, b = struct.unpack_from("<ff", data.tobytes()[4:_HEADER])
    if not (math.isfinite(a) and a > 0 and math.isfinite(b) and b <= 1):
        raise CaptureError(
            f"compressed depth has A {a:g} and B {b:g}; valid: A above 0, B at most 1, finite"
        )
    above = values - np.float64(b)
    meters = np.full(values.shape, np.nan)
    np.divide(a, above, out=meters, where=(values > 0) & (above > 0))
    with np.errstate(over="ignore"):
        return readonly(meters.astype(np.float32))


def compressed_size(told: str, data: Bytes) -> tuple[int, int]:
    """The size of a compressed image, none of whose pixels is unpacked.

    Args:
        told: as `unpack_depth`.
        data: (n,) uint8.

    Returns:
        (width, height), pixels.

    Raises:
        CaptureError: another format, or damaged.
    """
    _, is_rvl, image = _parts(told, data)
    return _rvl_size(image) if is_rvl else _of_png(lambda: png_size(io.BytesIO(image.tobytes())))


def _parts(told: str, data: Bytes) -> tuple[str, bool, Bytes]:
    """Encoding, whether the image is an RVL, and the image."""
    encoding = told[:5]
    if encoding not in ("16UC1", "32FC1"):
        raise CaptureError(f"compressed depth is {told!r:.60}; valid: 16UC1, 32FC1 as PNG or RVL")
    if len(data) < _HEADER:
        raise CaptureError(f"compressed depth is truncated: it has {len(data)} bytes")
    return encoding, "rvl" in told.lower(), data[_HEADER:]


def _of_png(read: Callable[[], T]) -> T:
    try:
        return read()
    except (CaptureError, MemoryError):
        raise
    except Exception as error:  # a damaged PNG makes Pillow raise nearly anything
        raise CaptureError(f"compressed depth is damaged: {type(error).__name__}") from None


def _unpack_png(data: Bytes) -> NDArray[np.uint16]:
    return _of_png(lambda: read_depth_png(io.BytesIO(data.tobytes()), None))


def _rvl_size(data: Bytes) -> tuple[int, int]:
    if len(data) < _RVL_HEADER:
        raise CaptureError("compressed depth is truncated: its RVL has no size")
    width, height = struct.unpack_from("<II", data.data)
    if not 0 < width * height <= MAX_PIXELS:
        raise CaptureError(
            f"compressed depth claims {width} x {height} pixels; valid: 1 to {MAX_PIXELS}"
        )
    return width, height


def _unpack_rvl(data: Bytes) -> NDArray[np.uint16]:
    width, height = _rvl_size(data)
    words = data[_RVL_HEADER : len(data) - len(data) % 4].tobytes()  # aligned
    pixels = np.empty(width * height, np.uint16)
    filled = rvl.unpack(np.frombuffer(words, "<u4").astype(np.uint32), pixels)
    if filled < 0:
        what = "truncated" if filled == rvl.TRUNCATED else "damaged"
        raise CaptureError(f"compressed depth is {what}: no RVL of {width} x {height} pixels")
    return pixels.reshape(height, width)
