"""A scene as a picture: panels under each other, each under its words, legible on a telephone."""

from __future__ import annotations

import io
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from boxgrasp.arrays import Array, Floats
from boxgrasp.draw.backdrops import camera_panel
from boxgrasp.draw.canvas import Canvas, Look, Stroke
from boxgrasp.draw.clouds import painted
from boxgrasp.draw.evidence import dimension_line
from boxgrasp.draw.marks import draw_box, draw_edges, draw_hand
from boxgrasp.draw.page import blank
from boxgrasp.draw.palette import (
    BLACK,
    BLOCKED,
    CATEGORY,
    GRIPPER,
    INK,
    OBSTACLE,
    PAPER,
    RGB,
    SHAPE,
    WHITE,
)
from boxgrasp.draw.planar import hull
from boxgrasp.draw.shapes import Hand, contact_line, corners
from boxgrasp.draw.text import Lettering, wrap
from boxgrasp.draw.views import View, plan_view
from boxgrasp.geometry.transforms import transform
from boxgrasp.grasps.gripper import Gripper
from boxgrasp.mapping.local_map import FREE, OCCUPIED, LocalMap
from boxgrasp.ranking.sampling import RADIUS_M
from boxgrasp.result import Candidate
from boxgrasp.study.seen import Seen

if TYPE_CHECKING:
    from PIL.Image import Image

# On a screen of 390 px a panel is 345 px wide: letters of 24 px are then 15 px high.
WIDTH_PX: Final = 540
HEIGHT_PX: Final = 400
_LETTERS_PX: Final = 24
_LINE_PX: Final = 30
_MARK_PX: Final = 11
_EDGE_PX: Final = 10
_GAP_PX: Final = 12
_SHADES: Final = 128  # of a picture; a third of the bytes of all colors
_KEPT: Final = (*CATEGORY.values(), GRIPPER, BLOCKED, OBSTACLE, WHITE, BLACK, INK)
_TALL_M: Final = 0.40  # over the half sphere's center, where cells are palest
_LOW_RGB, _HIGH_RGB = np.array((0, 70, 140.0)), np.array((250, 225, 90.0))
_CELL_EDGE: Final = Stroke(BLACK, 0.8, alpha=150)
_LINE: Final = Stroke(CATEGORY["yellow"], 4.0, halo=BLACK)
_OTHER_LINE: Final = Stroke(WHITE, 2.0, halo=BLACK)
_GAP: Final = Stroke(OBSTACLE, 4.0, halo=BLACK)
_SPHERE: Final = Stroke(GRIPPER, 2.5, halo=WHITE)
_SOLID: Final = Stroke(INK, 3.0, halo=WHITE)
_HIDDEN_LEAST: Final = 0.05  # cosine under which a face is seen end on
_SQUARE: Final = ((-1, -1), (-1, 1), (1, 1), (1, -1))
_SIGNS: Final = np.repeat((-1.0, 1.0), 3)[:, None] * np.tile(np.eye(3), (2, 1))


@dataclass(frozen=True)
class Heading:
    """The words over a panel.

    Attributes:
        words: lines, broken again where they are too long.
        category: `green`, `yellow` or `red`, shown by color and shape; empty for none.
    """

    words: str
    category: str = ""


class Panel:
    """One view of a scene, drawn over step by step.

    Attributes:
        heading: over it.
        canvas: what is drawn on.
        view: how base-frame points fall on it.
    """

    def __init__(
        self,
        seen: Seen,
        heading: Heading,
        focus: Sequence[Floats] = (),
        kind: str = "camera",
        height_px: int = HEIGHT_PX,
    ) -> None:
        """Start with what the camera saw.

        Args:
            seen: the scene.
            heading: over the panel.
            focus: (M, 3) base frame, m, each: what it must show beside the target's box.
            kind: `camera`, or `above` or `side`, the visible points in a plan.
            height_px: of the panel.
        """
        self.seen, self.heading = seen, heading
        size = (WIDTH_PX, height_px)
        around = np.vstack([_corners_of(seen), *focus])
        if kind == "camera":
            found = camera_panel(seen.capture, seen.cloud, around, size, seen.floor_m)
            self.view, image = found.view, found.image
        else:
            self.view = plan_view(kind, around, size, 0.3)
            image = painted(seen.cloud, self.view, size, seen.floor_m)
        self.canvas = Canvas(image)

    def box(self) -> Panel:
        """Draw the target's box.

        Returns:
            The panel.
        """
        draw_box(self.canvas, self.view, self.seen.target_box)
        return self

    def lines(self, candidates: Iterable[Candidate], chosen: Candidate | None = None) -> Panel:
        """Draw candidates' lines on the faces that are seen.

        Args:
            candidates: which.
            chosen: the one that is drawn thick, though its face is behind.

        Returns:
            The panel.
        """
        for candidate in candidates:
            line = contact_line(candidate, self.seen.target_box)
            outward = -candidate.T_base_gripper[:3, 0]
            if self.view.faces(line.mean(axis=0), outward) > _HIDDEN_LEAST:
                self._line(line, _OTHER_LINE)
        if chosen is not None:
            self._line(contact_line(chosen, self.seen.target_box), _LINE)
        return self

    def hand(self, candidate: Candidate, *, blocked: bool = False) -> Panel:
        """Draw the hand with its box at a candidate.

        Args:
            candidate: where.
            blocked: in the color of what cannot be.

        Returns:
            The panel.
        """
        hand = Hand(Gripper(), candidate.T_base_gripper)
        draw_hand(self.canvas, self.view, hand, BLOCKED if blocked else GRIPPER, dashed=False)
        return self

    def gap(self, candidate: Candidate) -> Panel:
        """Draw d, from the hand's box to the nearest visible obstacle (thesis figure 3-13).

        Args:
            candidate: where the hand is.

        Returns:
            The panel.
        """
        distance_m, point = self.seen.nearest_obstacle(candidate)
        if point is None:
            return self
        nearest = Hand(Gripper(), candidate.T_base_gripper).nearest(point)
        self._line(np.array((nearest, point)), _GAP)
        at = self.view.point(point)
        if at is not None:
            self.canvas.ring(at, 8.0, OBSTACLE)
            self.canvas.take(at, 12.0)
            self.say(at, f"d = {100 * distance_m:.1f} cm")
        return self

    def width(self, candidate: Candidate) -> Panel:
        """Draw how wide the target is between the fingers.

        Args:
            candidate: whose fingers.

        Returns:
            The panel.
        """
        at = dimension_line(self.canvas, self.view, contact_line(candidate, self.seen.target_box))
        if at is not None:
            self.say(at, f"{100 * candidate.width_m:.1f} cm wide")
        return self

    def cells(self, local_map: LocalMap, alpha: int = 255) -> Panel:
        """Draw the occupied cells of a map, paler with their height.

        Args:
            local_map: round the target.
            alpha: 0 for invisible to 255 for opaque.

        Returns:
            The panel.
        """
        centers = local_map.cells(OCCUPIED)
        share = np.clip(centers[:, 2:] / _TALL_M, 0.0, 1.0)
        tints = (1 - share) * _LOW_RGB + share * _HIGH_RGB
        cubes(self.canvas, self.view, local_map, (centers, tints), alpha)
        return self

    def samples(self, points: Floats, states: Array, radius_px: float = 5.0) -> Panel:
        """Draw samples: occupied full and red, free a small ring, unseen gray.

        Args:
            points: (P, 3) map frame, m.
            states: (P,) uint8, 0 free, 1 unseen, 2 occupied.
            radius_px: of an occupied one.

        Returns:
            The panel.
        """
        xy, depth = self.view.project(transform(self.seen.box.T_base_map(), points))
        for k in np.argsort(-depth, kind="stable").tolist():
            if np.isnan(xy[k]).any():
                continue
            at = float(xy[k, 0]), float(xy[k, 1])
            if states[k] == OCCUPIED:
                self.canvas.dot(at, radius_px + 1.2, BLACK)
                self.canvas.dot(at, radius_px, BLOCKED)
            else:
                self.canvas.dot(at, 0.6 * radius_px + 1.2, BLACK, 170)
                paint = WHITE if states[k] == FREE else (150, 155, 165)
                self.canvas.dot(at, 0.6 * radius_px, paint)
        return self

    def half_sphere(self) -> Panel:
        """Draw the half sphere's edges.

        Returns:
            The panel.
        """
        turn = np.linspace(0.0, 2 * np.pi, 73)
        cos, sin, none = RADIUS_M * np.cos(turn), RADIUS_M * np.sin(turn), 0 * turn
        whole, upper = slice(None), slice(0, 37)
        rings = ((cos, sin, none, whole), (cos, none, sin, upper), (none, cos, sin, upper))
        for x, y, z, kept in rings:
            ring = np.column_stack((x, y, z))[kept]
            places = transform(self.seen.box.T_base_map(), ring)
            for a, b in zip(places, places[1:], strict=False):
                self._line(np.array((a, b)), _SPHERE)
        return self

    def solid(self, places: Floats, color: RGB) -> Panel:
        """Draw a true solid's outline, filled.

        Args:
            places: (8, 3) its corners as `corners` gives them, base frame, m.
            color: of its area.

        Returns:
            The panel.
        """
        flat = [self.view.point(place) for place in places]
        self.canvas.polygon(hull([at for at in flat if at is not None]), color, 150)
        draw_edges(self.canvas, self.view, places, _SOLID)
        return self

    def outlines(self, local_map: LocalMap, color: RGB) -> Panel:
        """Draw the occupied cells as they lie from above.

        Args:
            local_map: round the target.
            color: of their edges.

        Returns:
            The panel.
        """
        s = local_map.resolution_m
        for x, y in np.unique(local_map.cells(OCCUPIED)[:, :2], axis=0).tolist():
            square = [(x + a * s / 2, y + b * s / 2, 0.0) for a, b in _SQUARE]
            places = transform(local_map.T_base_map, np.array(square))
            for a, b in zip(places, np.roll(places, -1, axis=0), strict=True):
                self._line(np.array((a, b)), Stroke(color, 2.5))
        return self

    def say(self, at: tuple[float, float], words: str) -> Panel:
        """Write beside a place.

        Args:
            at: x, y, px.
            words: one line.

        Returns:
            The panel.
        """
        lettering = Lettering(_LETTERS_PX, WHITE, halo=BLACK)
        self.canvas.text_beside(at, words, lettering, away=18, must=True)
        return self

    def _line(self, ends_m: Floats, stroke: Stroke) -> None:
        ends = self.view.segment(ends_m[0], ends_m[1])
        if ends is not None:
            self.canvas.line(*ends, stroke)


def cubes(
    canvas: Canvas, view: View, local_map: LocalMap, cells: tuple[Floats, Floats], alpha: int
) -> None:
    """Draw cells as cubes, far before near, the faces that are seen.

    Args:
        canvas: the panel.
        view: of the panel.
        local_map: whose cells they are.
        cells: (K, 3) centers in the map frame, m, and (K, 3) their colors, 0 to 255.
        alpha: 0 for invisible to 255 for opaque.
    """
    centers = transform(local_map.T_base_map, cells[0])
    R, half_m = local_map.T_base_map[:3, :3], local_map.resolution_m / 2
    depth = _depths(view, centers)
    for k in np.argsort(-depth, kind="stable").tolist():
        for sign in _SIGNS:
            normal = R @ sign
            middle = centers[k] + half_m * normal
            if view.faces(middle, normal) <= 0:
                continue
            first, second = (R[:, axis] * half_m for axis in np.flatnonzero(sign == 0))
            square = [view.point(middle + a * first + b * second) for a, b in _SQUARE]
            outline = [at for at in square if at is not None]
            if len(outline) < 4:
                continue
            light = 1.0 if sign[2] else 0.8 if sign[0] else 0.62
            r, g, b = (int(value) for value in cells[1][k] * light)
            canvas.polygon(outline, (r, g, b), alpha)
            for a, end in zip(outline, [*outline[1:], outline[0]], strict=True):
                canvas.line(a, end, _CELL_EDGE)


def stacked(panels: Sequence[Panel]) -> bytes:
    """Panels under each other, each under its heading.

    Args:
        panels: drawn.

    Returns:
        A PNG file, `WIDTH_PX` wide.
    """
    from PIL import Image as Images

    parts: list[Image] = []
    for panel in panels:
        parts += [_heading(panel.heading), panel.canvas.finish()]
    height = sum(part.height for part in parts) + _GAP_PX * (len(panels) - 1)
    sheet = Images.new("RGB", (WIDTH_PX, height), WHITE)
    y = 0
    for k, part in enumerate(parts):
        sheet.paste(part, (0, y))
        y += part.height + (_GAP_PX if k % 2 else 0)
    held = io.BytesIO()
    _reduced(sheet).save(held, "PNG", optimize=True)
    return held.getvalue()


def _reduced(sheet: Image) -> Image:
    """The sheet in few colors, those that mean something among them as they are."""
    from PIL import Image as Images

    none = Images.Dither.NONE
    own = (sheet.quantize(_SHADES, dither=none).getpalette() or [])[: 3 * _SHADES]
    palette = Images.new("P", (1, 1))
    palette.putpalette([*own, *(value for color in _KEPT for value in color)])
    return sheet.quantize(palette=palette, dither=none)


def _heading(heading: Heading) -> Image:
    left = 2 * _MARK_PX + 2.0 * _EDGE_PX if heading.category else float(_EDGE_PX)
    room = WIDTH_PX - left - _EDGE_PX
    lines = [line for part in heading.words.split("\n") for line in wrap(part, _LETTERS_PX, room)]
    canvas = blank(WIDTH_PX, _LINE_PX * len(lines) + _EDGE_PX, PAPER)
    if heading.category:
        look = Look(SHAPE[heading.category], CATEGORY[heading.category])
        canvas.mark((_EDGE_PX + _MARK_PX, _EDGE_PX / 2 + _LINE_PX / 2), look, _MARK_PX)
    for k, line in enumerate(lines):
        canvas.text((left, _EDGE_PX / 2 + _LINE_PX * k), line, Lettering(_LETTERS_PX))
    return canvas.finish()


def _depths(view: View, points: Floats) -> Floats:
    return np.asarray(view.project(points)[1]) if len(points) else np.empty(0)


def _corners_of(seen: Seen) -> Floats:
    return corners(seen.box.T_base_box, seen.box.dimensions_m)
