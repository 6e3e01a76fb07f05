"""Text by its size in pixels: measured, cut, and broken into lines."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from boxgrasp.draw.palette import INK, RGB


@dataclass(frozen=True)
class Lettering:
    """How text looks.

    Attributes:
        size_px: height of the font.
        color: of the letters.
        halo: color of an edge round them, None for no edge.
    """

    size_px: int
    color: RGB = INK
    halo: RGB | None = None


@lru_cache(maxsize=32)
def font(size_px: int) -> Any:
    """Pillow's own font, so that no font file is needed.

    Args:
        size_px: height.

    Returns:
        A Pillow font.
    """
    from PIL import ImageFont

    return ImageFont.load_default(size_px)


def text_size(text: str, size_px: int) -> tuple[int, int]:
    """The room that one line of text takes.

    Args:
        text: one line.
        size_px: height of the font.

    Returns:
        Width and line height, px.
    """
    return int(np.ceil(font(size_px).getlength(text))), int(np.ceil(size_px * 1.25))


def fit(text: str, size_px: int, width_px: float) -> str:
    """The text, cut with an ellipsis where it is too wide.

    Args:
        text: one line.
        size_px: height of the font.
        width_px: what it may take.

    Returns:
        The text, or its beginning and three dots.
    """
    if text_size(text, size_px)[0] <= width_px:
        return text
    most = _longest(text, size_px, width_px - text_size("...", size_px)[0])
    return text[:most].rstrip() + "..."


def wrap(text: str, size_px: int, width_px: float, most: int = 99) -> list[str]:
    """The text in lines; words that are too long are broken.

    Args:
        text: any length.
        size_px: height of the font.
        width_px: what a line may take.
        most: lines at most; the last one is cut with an ellipsis.

    Returns:
        The lines.
    """
    lines: list[str] = []
    line = ""
    for word in text.split():
        trial = f"{line} {word}" if line else word
        if text_size(trial, size_px)[0] <= width_px:
            line = trial
            continue
        if line:
            lines.append(line)
        while text_size(word, size_px)[0] > width_px and len(word) > 1:
            part = max(1, _longest(word, size_px, width_px))
            lines.append(word[:part])
            word = word[part:]
        line = word
    if line:
        lines.append(line)
    if len(lines) > most:
        lines = [*lines[: most - 1], fit(" ".join(lines[most - 1 :]), size_px, width_px)]
    return lines


def _longest(text: str, size_px: int, width_px: float) -> int:
    """How many first letters fit, by halving: a text may be very long."""
    low, high = 0, len(text)
    while low < high:
        middle = (low + high + 1) // 2
        if text_size(text[:middle], size_px)[0] <= width_px:
            low = middle
        else:
            high = middle - 1
    return low
