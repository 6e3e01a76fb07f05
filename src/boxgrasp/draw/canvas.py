"""A panel to draw on: smooth lines, dashes, marks, and labels that keep out of each other's way."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from boxgrasp.draw.palette import BLACK, RGB, WHITE

if TYPE_CHECKING:
    from PIL.Image import Image

XY = tuple[float, float]
Rect = tuple[float, float, float, float]

_FINE = 2  # drawn at twice the size and averaged, so that lines are smooth
_DIRECTIONS = ((1, 0), (-1, 0), (0, -1), (0, 1), (1, -1), (-1, -1), (1, 1), (-1, 1))


@lru_cache(maxsize=32)
def font(size: int) -> Any:
    """Pillow's own font at a size in pixels, so that no font file is needed."""
    from PIL import ImageFont

    return ImageFont.load_default(size)


def text_size(text: str, size: int) -> tuple[int, int]:
    """Width and line height in pixels."""
    return int(np.ceil(font(size).getlength(text))), int(np.ceil(size * 1.25))


def fit(text: str, size: int, width: float) -> str:
    """The text, cut with an ellipsis where it is wider than `width` pixels."""
    if text_size(text, size)[0] <= width:
        return text
    most = _longest(text, size, width - text_size("...", size)[0])
    return text[:most].rstrip() + "..."


def _longest(text: str, size: int, width: float) -> int:
    """How many first letters fit, by halving: a text may be very long."""
    low, high = 0, len(text)
    while low < high:
        middle = (low + high + 1) // 2
        low, high = (
            (middle, high) if text_size(text[:middle], size)[0] <= width else (low, middle - 1)
        )
    return low


def wrap(text: str, size: int, width: float, most: int = 99) -> list[str]:
    """The text in lines of at most `width` pixels; words that are too long are broken."""
    lines: list[str] = []
    line = ""
    for word in text.split():
        trial = f"{line} {word}" if line else word
        if text_size(trial, size)[0] <= width:
            line = trial
            continue
        if line:
            lines.append(line)
        while text_size(word, size)[0] > width and len(word) > 1:
            part = max(1, _longest(word, size, width))
            lines.append(word[:part])
            word = word[part:]
        line = word
    if line:
        lines.append(line)
    if len(lines) > most:
        lines = [*lines[: most - 1], fit(" ".join(lines[most - 1 :]), size, width)]
    return lines


class Canvas:
    """One panel; coordinates are pixels of the panel with pixel centers at integers."""

    def __init__(self, background: Image) -> None:
        from PIL import Image as Images
        from PIL import ImageDraw

        self.width, self.height = background.size
        fine = (self.width * _FINE, self.height * _FINE)
        self._image = background.resize(fine, Images.Resampling.NEAREST)
        self._draw = ImageDraw.Draw(self._image, "RGBA")
        self._texts: list[tuple[XY, str, int, RGB, RGB | None]] = []
        self.taken: list[Rect] = []

    def line(
        self,
        a: XY,
        b: XY,
        color: RGB,
        width: float = 2.0,
        *,
        halo: RGB | None = None,
        dash: tuple[float, float] | None = None,
        alpha: int = 255,
    ) -> None:
        """A straight line, with an edge of `halo` and dashes of (on, off) pixels if asked."""
        inside = clip_to(a, b, (-60.0, -60.0, self.width + 60.0, self.height + 60.0))
        if inside is None:
            return
        for start, end in dashes(*inside, dash):
            ends = [self._fine(start), self._fine(end)]
            if halo is not None:
                edge = round((width + 2.2) * _FINE)
                self._draw.line(ends, fill=(*halo, alpha), width=edge)
        for start, end in dashes(*inside, dash):
            ends = [self._fine(start), self._fine(end)]
            self._draw.line(ends, fill=(*color, alpha), width=max(1, round(width * _FINE)))

    def polygon(self, corners: Iterable[XY], color: RGB, alpha: int) -> None:
        """A filled polygon."""
        points = [self._fine(corner) for corner in corners]
        if len(points) > 2 and np.abs(np.array(points)).max() < 1e5:
            self._draw.polygon(points, fill=(*color, alpha))

    def dot(self, at: XY, radius: float, color: RGB, alpha: int = 255) -> None:
        """A filled disc."""
        self._draw.ellipse(self._round(at, radius), fill=(*color, alpha))

    def ring(self, at: XY, radius: float, color: RGB, width: float = 3.0) -> None:
        """A circle with dark edges, to point at something."""
        self._draw.ellipse(
            self._round(at, radius + 1.5), outline=(*BLACK, 255), width=round((width + 3) * _FINE)
        )
        self._draw.ellipse(
            self._round(at, radius), outline=(*color, 255), width=round(width * _FINE)
        )

    def arrow(
        self, a: XY, b: XY, color: RGB, width: float, *, halo: RGB | None, head: float = 14.0
    ) -> None:
        """A line from a to b with a head at b; only the head where they nearly coincide."""
        length = float(np.hypot(b[0] - a[0], b[1] - a[1]))
        if length < 3.0:
            return
        head = min(head, length)
        dx, dy = (b[0] - a[0]) / length, (b[1] - a[1]) / length
        neck = (b[0] - dx * head, b[1] - dy * head)
        self.line(a, neck, color, width, halo=halo)
        for grow, fill in ((2.5, halo), (0.0, color)):
            if fill is None:
                continue
            half = head * 0.45 + grow
            tip = (b[0] + dx * grow * 1.6, b[1] + dy * grow * 1.6)
            back = (neck[0] - dx * grow, neck[1] - dy * grow)
            left = (back[0] - dy * half, back[1] + dx * half)
            right = (back[0] + dy * half, back[1] - dx * half)
            self.polygon((tip, left, right), fill, 255)

    def mark(self, at: XY, shape: str, color: RGB, radius: float, style: str = "kept") -> None:
        """A marker. style: `kept` filled, `dropped` hollow, crossed, `wide` hollow with <->."""
        outline = self._outline(at, shape, radius)
        hollow = style != "kept"
        self._draw.polygon(self._outline(at, shape, radius + 2.0), fill=(*BLACK, 255))
        self._draw.polygon(outline, fill=(*(WHITE if hollow else color), 255))
        if hollow:
            self._draw.line([*outline, outline[0]], fill=(*color, 255), width=round(2.4 * _FINE))
        reach = radius * 0.52
        x, y = at
        if style == "dropped":
            self.line((x - reach, y - reach), (x + reach, y + reach), BLACK, 1.8)
            self.line((x - reach, y + reach), (x + reach, y - reach), BLACK, 1.8)
        elif style == "wide":
            self.line((x - reach, y), (x + reach, y), BLACK, 1.8)
            for side in (-1, 1):
                end = x + side * reach * 1.15
                for turn in (-1, 1):
                    self.line(
                        (end, y), (end - side * reach * 0.5, y + turn * reach * 0.5), BLACK, 1.8
                    )

    def text(self, at: XY, text: str, size: int, color: RGB, *, halo: RGB | None = None) -> None:
        """Text with its upper left corner at a place; moved and cut to stay inside the panel."""
        text = fit(text, size, self.width - 8.0)
        width, height = text_size(text, size)
        x = min(max(at[0], 3.0), max(3.0, self.width - width - 4.0))
        y = min(max(at[1], 3.0), max(3.0, self.height - height - 3.0))
        self._texts.append(((x, y), text, size, color, halo))
        self.taken.append((x - 2, y - 1, x + width + 2, y + height + 1))

    def label(
        self,
        near: XY,
        text: str,
        size: int,
        color: RGB,
        *,
        halo: RGB | None = None,
        away: float = 12.0,
        must: bool = False,
    ) -> bool:
        """Text beside a point where nothing else is; left out without room, unless it must."""
        text = fit(text, size, self.width - 8.0)
        width, height = text_size(text, size)
        rings = (away, away + 12, away + 26, away + 44, away + 70) if must else (away, away + 7)
        places = []
        for distance in rings:
            for dx, dy in _DIRECTIONS:
                x = near[0] + dx * distance - (0.5 - dx / 2) * width
                y = near[1] + dy * distance - (0.5 - dy / 2) * height
                places.append((x, y))
        for x, y in places:
            rect = (x, y, x + width, y + height)
            inside = x >= 3 and y >= 3 and rect[2] <= self.width - 4 and rect[3] <= self.height - 3
            if inside and not any(_overlap(rect, other) for other in self.taken):
                self.text((x, y), text, size, color, halo=halo)
                return True
        if must:
            self.text(places[0], text, size, color, halo=halo)
        return must

    def take(self, at: XY, radius: float) -> None:
        """Keep labels off a disc."""
        self.taken.append((at[0] - radius, at[1] - radius, at[0] + radius, at[1] + radius))

    def finish(self) -> Image:
        """The panel at its own size, labels on top."""
        from PIL import ImageDraw

        image = self._image.reduce(_FINE)
        draw = ImageDraw.Draw(image)
        for at, text, size, color, halo in self._texts:
            edge = 0 if halo is None else max(2, size // 7)
            draw.text(at, text, fill=color, font=font(size), stroke_width=edge, stroke_fill=halo)
        return image

    def _fine(self, at: XY) -> XY:
        return ((at[0] + 0.5) * _FINE - 0.5, (at[1] + 0.5) * _FINE - 0.5)

    def _round(self, at: XY, radius: float) -> Rect:
        x, y = self._fine(at)
        reach = radius * _FINE
        return (x - reach, y - reach, x + reach, y + reach)

    def _outline(self, at: XY, shape: str, radius: float) -> list[XY]:
        turns, start, reach = {
            "circle": (28, 0.0, 1.0),
            "triangle": (3, -np.pi / 2, 1.28),
            "square": (4, np.pi / 4, 1.2),
        }[shape]
        angles = start + 2 * np.pi * np.arange(turns) / turns
        lower = radius * 0.18 if shape == "triangle" else 0.0
        x, y = at[0], at[1] + lower
        reach *= radius
        return [
            self._fine((x + reach * float(np.cos(a)), y + reach * float(np.sin(a)))) for a in angles
        ]


def clip_to(a: XY, b: XY, rect: Rect) -> tuple[XY, XY] | None:
    """The part of a segment inside a rectangle (Liang and Barsky)."""
    low, high = 0.0, 1.0
    for axis in (0, 1):
        step = b[axis] - a[axis]
        for edge, sign in ((rect[axis], 1.0), (rect[axis + 2], -1.0)):
            along, gap = -sign * step, sign * (a[axis] - edge)
            if along == 0.0:
                if gap < 0.0:
                    return None
                continue
            share = gap / along
            if along < 0.0:
                low = max(low, share)
            else:
                high = min(high, share)
    if low > high:
        return None
    dx, dy = b[0] - a[0], b[1] - a[1]
    return (a[0] + low * dx, a[1] + low * dy), (a[0] + high * dx, a[1] + high * dy)


def dashes(a: XY, b: XY, dash: tuple[float, float] | None) -> Iterable[tuple[XY, XY]]:
    """The pieces of a dashed line; the line itself without dashes."""
    length = float(np.hypot(b[0] - a[0], b[1] - a[1]))
    if dash is None or length == 0.0:
        yield a, b
        return
    at = 0.0
    while at < length:
        end = min(at + dash[0], length)
        yield _between(a, b, at / length), _between(a, b, end / length)
        at += dash[0] + dash[1]


def _between(a: XY, b: XY, share: float) -> XY:
    return (a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1]))


def _overlap(a: Rect, b: Rect) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]


def hull(points: Sequence[XY]) -> list[XY]:
    """The convex outline of a few points (Andrew's chain)."""
    ordered = sorted(set(points))
    if len(ordered) < 3:
        return ordered

    def half(run: Iterable[XY]) -> list[XY]:
        chain: list[XY] = []
        for p in run:
            while len(chain) > 1 and _turn(chain[-2], chain[-1], p) <= 0:
                chain.pop()
            chain.append(p)
        return chain[:-1]

    return half(ordered) + half(reversed(ordered))


def _turn(o: XY, a: XY, b: XY) -> float:
    return (a[0] - o[0]) * (b[1] - o[1]) - (a[1] - o[1]) * (b[0] - o[0])
