"""Pictures as bytes and files."""

from __future__ import annotations

import os
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from boxgrasp.errors import BoxgraspError

if TYPE_CHECKING:
    from PIL.Image import Image

SUFFIXES: Final = {".png": "PNG", ".jpg": "JPEG", ".jpeg": "JPEG", ".webp": "WEBP"}


def validate_place(path: str | os.PathLike[str] | None) -> Path | None:
    """Refuse a place where no picture can be written, before one is drawn.

    Args:
        path: of the picture; None where none is to be written.

    Returns:
        The same path.

    Raises:
        BoxgraspError: its suffix is no image's, or its folder is not there.
    """
    if path is None:
        return None
    place = Path(path)
    if place.suffix.lower() not in SUFFIXES:
        valid = ", ".join(SUFFIXES)
        raise BoxgraspError(f"picture {place} has suffix {place.suffix!r}; valid: {valid}")
    if not place.parent.is_dir():
        raise BoxgraspError(
            f"picture {place}: no folder {place.parent}; valid: a folder that exists"
        )
    return place


def encoded(image: Image, suffix: str = ".png") -> bytes:
    """A picture as a file holds it; the same picture gives the same bytes.

    Args:
        image: the picture.
        suffix: one of `SUFFIXES`.

    Returns:
        The file's content.
    """
    held = BytesIO()
    options: dict[str, Any] = {"compress_level": 3} if suffix == ".png" else {"quality": 92}
    image.save(held, SUFFIXES[suffix], **options)
    return held.getvalue()


def save(image: Image, place: Path | None) -> None:
    """Write a picture.

    Args:
        image: the picture.
        place: what `validate_place` gave; None writes nothing.

    Raises:
        BoxgraspError: it cannot be written.
    """
    if place is None:
        return
    try:
        place.write_bytes(encoded(image, place.suffix.lower()))
    except OSError as error:
        what = error.strerror or str(error)
        raise BoxgraspError(f"picture {place} cannot be written: {what}") from None
