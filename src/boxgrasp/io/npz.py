"""Captures as numpy archives; nothing in them can run, since pickles are refused."""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any, Final

import numpy as np
from numpy.typing import NDArray

from boxgrasp.errors import CaptureError
from boxgrasp.io.lens import lens_of, undistorted
from boxgrasp.sensing.capture import Capture

KEYS: Final = (
    "depth",
    "intrinsics",
    "T_base_camera",
    "rgb",
    "target_pixel",
    "mask",
    "robot_mask",
    "distortion",
)
_REQUIRED: Final = KEYS[:2]
_MAX_BYTES: Final = 1 << 29  # unpacked, an array: as float64, the pixels that any reader takes


def load_npz(source: Path | IO[bytes], most_bytes: int | None = None) -> Capture:
    """A capture of a numpy archive.

    Args:
        source: path of an .npz, or an open file, with the arrays named in `KEYS`; others are
            passed over.
        most_bytes: of these arrays together, unpacked; None bounds each alone.

    Returns:
        The capture.

    Raises:
        CaptureError: no numpy archive, truncated, pickled objects, or no usable view.
    """
    arrays: dict[str, Any] = {}
    with zipfile.ZipFile(source) as archive:
        names = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
        for key in _REQUIRED:
            if key not in names:
                found = ", ".join(sorted(names)[:8]) or "nothing"
                raise CaptureError(f"archive holds {found}; valid: {', '.join(_REQUIRED)}")
        held = sum(names[key].file_size for key in KEYS if key in names)
        if most_bytes is not None and held > most_bytes:
            raise CaptureError(f"archive unpacks to {held} bytes; valid: at most {most_bytes}")
        for key in KEYS:
            if key in names:
                arrays[key] = _read_array(archive, names[key], key)
    distortion = arrays.pop("distortion", None)
    capture = Capture(**arrays)
    if distortion is None:
        return capture
    if distortion.dtype.kind not in "fiu":
        raise CaptureError(f"distortion holds {distortion.dtype}; valid: numbers")
    lens = lens_of("", distortion, "distortion")
    return capture if lens is None else undistorted(capture, lens, "distortion")


def save_npz(capture: Capture, out: str | Path | IO[bytes], **more: NDArray[Any]) -> None:
    """Write a capture as a numpy archive, compressed.

    Args:
        capture: of a depth image.
        out: the file's path, or a file that is open for bytes.
        more: (...) further arrays by their names; `load_capture` passes them over.

    Raises:
        CaptureError: the capture is a cloud, which such an archive does not hold.
    """
    if capture.depth is None:
        raise CaptureError("a cloud is not written as .npz; valid: a capture of a depth image")
    own = [key for key in KEYS if key != "distortion"]  # a capture's was undone
    arrays = {key: getattr(capture, key) for key in own}
    held = {key: np.asarray(value) for key, value in arrays.items() if value is not None}
    np.savez_compressed(out, **held, **more)  # type: ignore[arg-type]


def _read_array(archive: zipfile.ZipFile, info: zipfile.ZipInfo, key: str) -> NDArray[Any]:
    """One .npy member; its header is believed only as far as the member's own size."""
    if info.file_size > _MAX_BYTES:
        raise CaptureError(f"{key} has {info.file_size} bytes; valid: at most {_MAX_BYTES}")
    with archive.open(info) as stream:
        return read_npy(stream, info.file_size, key)


def read_npy(stream: IO[bytes], size: int, name: str) -> NDArray[Any]:
    """An array in numpy's own format, whose header is believed only as far as its bytes go.

    Args:
        stream: at its start.
        size: most bytes that are read.
        name: of the array, in messages.

    Returns:
        The array, of any shape and type but objects.

    Raises:
        CaptureError: another version, pickled objects, or truncated.
    """
    version = np.lib.format.read_magic(stream)
    if version not in ((1, 0), (2, 0)):
        raise CaptureError(f"{name} is .npy version {version}; valid: 1.0, 2.0")
    read_header: Callable[..., Any] = np.lib.format.read_array_header_1_0
    if version == (2, 0):
        read_header = np.lib.format.read_array_header_2_0
    shape, fortran, dtype = read_header(stream)
    if dtype.hasobject:
        raise CaptureError(f"{name} holds pickled objects; valid: numbers")
    data = stream.read(size)
    count = 1
    for length in shape:
        count *= int(length)
    if count * dtype.itemsize != len(data):
        raise CaptureError(f"{name} has {len(data)} bytes for shape {shape} of {dtype}; truncated?")
    array = np.frombuffer(data, dtype)
    return array.reshape(shape, order="F" if fortran else "C")
