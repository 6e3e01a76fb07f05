"""PNG and JPEG images as arrays, their size known before a pixel is unpacked; object images."""

from __future__ import annotations

import os
import warnings
from io import BytesIO
from pathlib import Path
from typing import IO, Any, Final

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from boxgrasp.errors import BoxgraspError, CaptureError
from boxgrasp.io.extent import MAX_PIXELS

_MOST_OBJECTS: Final = 65535  # that 16 bits number
_DEPTH_MODES: Final = ("I;16", "I;16B", "I;16L", "I")  # by Pillow's version and the file's order


def read_depth_png(source: Path | IO[bytes], size: tuple[int, int] | None) -> NDArray[np.uint16]:
    """A 16-bit gray PNG.

    Args:
        source: a path or an open file.
        size: (width, height) that it must have, or None for any.

    Returns:
        (H, W) uint16.

    Raises:
        CaptureError: another format or depth of bits, or another size.
    """
    with _open(source, ("PNG",), size, "depth.png") as image:
        if image.mode not in _DEPTH_MODES:
            raise CaptureError(
                f"depth.png has pixels of mode {image.mode}; valid: 16 bit, one channel"
            )
        return np.asarray(image).astype(np.uint16)


def png_size(source: IO[bytes]) -> tuple[int, int]:
    """The size of a PNG, none of whose pixels is unpacked.

    Args:
        source: an open file.

    Returns:
        (width, height), pixels.

    Raises:
        CaptureError: another format, or too large.
    """
    with _open(source, ("PNG",), None, "depth.png") as image:
        width, height = image.size
    return int(width), int(height)


def read_color(source: Path | IO[bytes], size: tuple[int, int]) -> NDArray[np.uint8]:
    """A color image.

    Args:
        source: path of a PNG or JPEG, or an open file.
        size: (width, height) that it must have.

    Returns:
        (H, W, 3) uint8 red, green, blue.

    Raises:
        CaptureError: another format or size.
    """
    with _open(source, ("PNG", "JPEG"), size, _name_of(source, "color")) as image:
        return np.asarray(image.convert("RGB"))


def read_mask(source: Path | IO[bytes], size: tuple[int, int] | None = None) -> NDArray[np.bool_]:
    """A mask.

    Args:
        source: path of a PNG, or an open file.
        size: (width, height) that it must have, or None for any.

    Returns:
        (H, W) bool, True where any color is above 0.

    Raises:
        CaptureError: another format or size.
    """
    with _open(source, ("PNG",), size, _name_of(source, "mask")) as image:
        if "A" in image.mode:
            image = image.convert("LA" if image.mode == "LA" else "RGBA")
        pixels = np.asarray(image)
    if pixels.ndim == 3:
        opaque = pixels.shape[2] - (1 if pixels.shape[2] in (2, 4) else 0)
        pixels = pixels[..., :opaque].max(axis=2)
    return np.asarray(pixels != 0)


def write_object_image(path: str | os.PathLike[str], image: NDArray[np.int32]) -> None:
    """Write the object that each pixel shows as a gray PNG whose values are the objects' numbers.

    8 bit up to 255 objects, which every reader gives back as it is; 16 bit beyond, for which
    OpenCV wants `IMREAD_UNCHANGED`.

    Args:
        path: of the file; .png.
        image: (H, W) integer of `GraspSelector.segment`, 0 for no object.

    Raises:
        BoxgraspError: another suffix, a number below 0 or over 65535, or a path that cannot be
            written.
    """
    file = Path(path)
    if file.suffix.lower() != ".png":
        raise BoxgraspError(f"object image {file} has suffix {file.suffix!r}; valid: .png")
    low, high = int(np.min(image, initial=0)), int(np.max(image, initial=0))
    if low < 0 or high > _MOST_OBJECTS:
        found = low if low < 0 else high
        raise BoxgraspError(f"object image has number {found}; valid: 0 to {_MOST_OBJECTS}")
    held = BytesIO()
    pixels = image.astype(np.uint8 if high <= 255 else np.uint16)
    Image.fromarray(pixels).save(held, "PNG")
    try:
        file.write_bytes(held.getvalue())
    except OSError as error:
        what = error.strerror or str(error)
        raise BoxgraspError(f"object image {file} cannot be written: {what}") from None


def _name_of(source: Path | IO[bytes], what: str) -> str:
    return source.name if isinstance(source, Path) else what


def _open(
    source: Path | IO[bytes], formats: tuple[str, ...], size: tuple[int, int] | None, name: str
) -> Any:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            image = Image.open(source, formats=formats)
    except UnidentifiedImageError:
        raise CaptureError(f"{name} is damaged or no {' or '.join(formats)}") from None
    except (Image.DecompressionBombError, Image.DecompressionBombWarning):
        raise CaptureError(f"{name} is too large; valid: at most {MAX_PIXELS} pixels") from None
    width, height = image.size
    if size is not None and (width, height) != size:
        image.close()
        raise CaptureError(
            f"{name} is {width} x {height} pixels; valid: {size[0]} x {size[1]}, as the depth"
        )
    if width * height > MAX_PIXELS:
        image.close()
        raise CaptureError(f"{name} has {width} x {height} pixels; valid: at most {MAX_PIXELS}")
    return image
