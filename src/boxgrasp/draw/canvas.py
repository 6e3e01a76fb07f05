"""A panel to draw on: smooth lines, dashes, marks, and texts that keep out of each other's way."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from boxgrasp.draw.palette import BLACK, RGB, WHITE
from boxgrasp.draw.planar import XY, Rect, clip_to, dashes, overlap
from boxgrasp.draw.text import Lettering, fit, font, text_size

if TYPE_CHECKING:
    from PIL.Image import Image

_FINE: Final = 2  # drawn at twice the size and averaged, so that lines are smooth
_DIRECTIONS: Final = ((1, 0), (-1, 0), (0, -1), (0, 1), (1, -1), (-1, -1), (1, 1), (-1, 1))
# Corners, angle of the first one, and reach of each shape: of about equal area.
_SHAPES: Final = {
    "circle": (28, 0.0, 1.0),
    "triangle": (3, -np.pi / 2, 1.28),
    "square": (4, np.pi / 4, 1.2),
    "diamond": (4, 0.0, 1.25),
}


@dataclass(frozen=True)
class Stroke:
    """How a line looks.

    Attributes:
        color: of the line.
        width_px: of the line.
        halo: color of an edge beside it, None for no edge.
        dash: lengths drawn and left out, px; None for a solid line.
        alpha: 0 for invisible to 255 for opaque.
    """

    color: RGB
    width_px: float = 2.0
    halo: RGB | None = None
    dash: tuple[float, float] | None = None
    alpha: int = 255


@dataclass(frozen=True)
class Look:
    """How a marker looks.

    Attributes:
        shape: `circle`, `triangle`, `square` or `diamond`.
        color: of its area, or of its edge where it is hollow.
        style: `kept` is filled, `dropped` hollow and crossed, `wide` hollow with a double arrow.
    """

    shape: str
    color: RGB
    style: str = "kept"


class Canvas:
    """One panel; coordinates are pixels of the panel with pixel centers at integers.

    Attributes:
        width: px.
        height: px.
        taken: left, upper, right, lower, px, of places that texts keep off.
    """

    def __init__(self, background: Image) -> None:
        """Start with a background.

        Args:
            background: an RGB image of the panel's size.
        """
        from PIL import Image as Images
        from PIL import ImageDraw

        self.width, self.height = background.size
        fine = (self.width * _FINE, self.height * _FINE)
        self._image = background.resize(fine, Images.Resampling.NEAREST)
        self._draw = ImageDraw.Draw(self._image, "RGBA")
        self._texts: list[tuple[XY, str, Lettering]] = []
        self.taken: list[Rect] = []

    def line(self, a: XY, b: XY, stroke: Stroke) -> None:
        """Draw a straight line.

        Args:
            a: x, y of one end, px.
            b: x, y of the other end, px.
            stroke: how it looks.
        """
        inside = clip_to(a, b, (-60.0, -60.0, self.width + 60.0, self.height + 60.0))
        if inside is None:
            return
        pieces = [
            [self._fine(start), self._fine(end)] for start, end in dashes(*inside, stroke.dash)
        ]
        if stroke.halo is not None:
            edge = round((stroke.width_px + 2.2) * _FINE)
            for ends in pieces:
                self._draw.line(ends, fill=(*stroke.halo, stroke.alpha), width=edge)
        width = max(1, round(stroke.width_px * _FINE))
        for ends in pieces:
            self._draw.line(ends, fill=(*stroke.color, stroke.alpha), width=width)

    def polygon(self, corners: Iterable[XY], color: RGB, alpha: int = 255) -> None:
        """Fill a polygon.

        Args:
            corners: x, y of each, px.
            color: of its area.
            alpha: 0 for invisible to 255 for opaque.
        """
        points = [self._fine(corner) for corner in corners]
        if len(points) > 2 and np.abs(np.array(points)).max() < 1e5:
            self._draw.polygon(points, fill=(*color, alpha))

    def dot(self, at: XY, radius: float, color: RGB, alpha: int = 255) -> None:
        """Fill a disc.

        Args:
            at: x, y of its center, px.
            radius: px.
            color: of its area.
            alpha: 0 for invisible to 255 for opaque.
        """
        self._draw.ellipse(self._round(at, radius), fill=(*color, alpha))

    def ring(self, at: XY, radius: float, color: RGB, width: float = 3.0) -> None:
        """Draw a circle with dark edges, to point at something.

        Args:
            at: x, y of its center, px.
            radius: px.
            color: of its line.
            width: of its line, px.
        """
        edge = round((width + 3) * _FINE)
        self._draw.ellipse(self._round(at, radius + 1.5), outline=(*BLACK, 255), width=edge)
        line = round(width * _FINE)
        self._draw.ellipse(self._round(at, radius), outline=(*color, 255), width=line)

    def arrow(self, a: XY, b: XY, stroke: Stroke, head: float = 14.0) -> None:
        """Draw a line from a to b with a head at b; nothing where they coincide.

        Args:
            a: x, y where it starts, px.
            b: x, y of its tip, px.
            stroke: how it looks.
            head: length of the head, px.
        """
        length = float(np.hypot(b[0] - a[0], b[1] - a[1]))
        if length < 3.0:
            return
        head = min(head, length)
        dx, dy = (b[0] - a[0]) / length, (b[1] - a[1]) / length
        neck = (b[0] - dx * head, b[1] - dy * head)
        self.line(a, neck, stroke)
        for grow, fill in ((2.5, stroke.halo), (0.0, stroke.color)):
            if fill is None:
                continue
            half = head * 0.45 + grow
            tip = (b[0] + dx * grow * 1.6, b[1] + dy * grow * 1.6)
            back = (neck[0] - dx * grow, neck[1] - dy * grow)
            left = (back[0] - dy * half, back[1] + dx * half)
            right = (back[0] + dy * half, back[1] - dx * half)
            self.polygon((tip, left, right), fill)

    def mark(self, at: XY, look: Look, radius: float) -> None:
        """Draw a marker.

        Args:
            at: x, y of its center, px.
            look: how it looks.
            radius: px.
        """
        outline = self._outline(at, look.shape, radius)
        hollow = look.style != "kept"
        edge = self._outline(at, look.shape, radius + 2.0)
        self._draw.polygon(edge, fill=(*BLACK, 255))
        self._draw.polygon(outline, fill=(*(WHITE if hollow else look.color), 255))
        if hollow:
            closed = [*outline, outline[0]]
            self._draw.line(closed, fill=(*look.color, 255), width=round(2.4 * _FINE))
            sign = _cross if look.style == "dropped" else _double_arrow
            for a, b in sign(at, radius * 0.52):
                self.line(a, b, Stroke(BLACK, 1.8))

    def text(self, at: XY, text: str, lettering: Lettering) -> None:
        """Write one line; moved and cut to stay inside the panel.

        Args:
            at: x, y of its upper left corner, px.
            text: one line.
            lettering: how it looks.
        """
        text = fit(text, lettering.size_px, self.width - 8.0)
        width, height = text_size(text, lettering.size_px)
        x = min(max(at[0], 3.0), max(3.0, self.width - width - 4.0))
        y = min(max(at[1], 3.0), max(3.0, self.height - height - 3.0))
        self._texts.append(((x, y), text, lettering))
        self.taken.append((x - 2, y - 1, x + width + 2, y + height + 1))

    def text_beside(
        self,
        near: XY,
        text: str,
        lettering: Lettering,
        *,
        away: float = 12.0,
        must: bool = False,
    ) -> bool:
        """Write beside a point where nothing else is; leave it out without room, unless it must.

        Args:
            near: x, y of the point, px.
            text: one line.
            lettering: how it looks.
            away: how far from the point, px.
            must: whether it is written even over something else.

        Returns:
            Whether it was written.
        """
        text = fit(text, lettering.size_px, self.width - 8.0)
        width, height = text_size(text, lettering.size_px)
        steps = (0, 12, 26, 44, 70) if must else (0, 7)
        places = [
            (
                near[0] + dx * (away + step) - (0.5 - dx / 2) * width,
                near[1] + dy * (away + step) - (0.5 - dy / 2) * height,
            )
            for step in steps
            for dx, dy in _DIRECTIONS
        ]
        free = next((at for at in places if self._is_free(at, width, height)), None)
        if free is not None or must:
            self.text(free or places[0], text, lettering)
        return free is not None or must

    def take(self, at: XY, radius: float) -> None:
        """Keep texts off a disc.

        Args:
            at: x, y of its center, px.
            radius: px.
        """
        self.taken.append((at[0] - radius, at[1] - radius, at[0] + radius, at[1] + radius))

    def finish(self) -> Image:
        """The panel at its own size, texts on top.

        Returns:
            An RGB image.
        """
        from PIL import ImageDraw

        image = self._image.reduce(_FINE)
        draw = ImageDraw.Draw(image)
        for at, text, how in self._texts:
            edge = 0 if how.halo is None else max(2, how.size_px // 7)
            letters = font(how.size_px)
            draw.text(at, text, how.color, letters, stroke_width=edge, stroke_fill=how.halo)
        return image

    def _is_free(self, at: XY, width: float, height: float) -> bool:
        rect = (at[0], at[1], at[0] + width, at[1] + height)
        inside = (
            at[0] >= 3 and at[1] >= 3 and rect[2] <= self.width - 4 and rect[3] <= self.height - 3
        )
        return inside and not any(overlap(rect, other) for other in self.taken)

    def _fine(self, at: XY) -> XY:
        return ((at[0] + 0.5) * _FINE - 0.5, (at[1] + 0.5) * _FINE - 0.5)

    def _round(self, at: XY, radius: float) -> Rect:
        x, y = self._fine(at)
        reach = radius * _FINE
        return (x - reach, y - reach, x + reach, y + reach)

    def _outline(self, at: XY, shape: str, radius: float) -> list[XY]:
        turns, start, reach = _SHAPES[shape]
        angles = start + 2 * np.pi * np.arange(turns) / turns
        lower = radius * 0.18 if shape == "triangle" else 0.0
        x, y = at[0], at[1] + lower
        reach *= radius
        return [
            self._fine((x + reach * float(np.cos(a)), y + reach * float(np.sin(a)))) for a in angles
        ]


def _cross(at: XY, reach: float) -> Iterator[tuple[XY, XY]]:
    x, y = at
    yield (x - reach, y - reach), (x + reach, y + reach)
    yield (x - reach, y + reach), (x + reach, y - reach)


def _double_arrow(at: XY, reach: float) -> Iterator[tuple[XY, XY]]:
    x, y = at
    yield (x - reach, y), (x + reach, y)
    for side in (-1, 1):
        end = x + side * reach * 1.15
        for turn in (-1, 1):
            yield (end, y), (end - side * reach * 0.5, y + turn * reach * 0.5)
