"""What decides an answer, marked where its checks say it is."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np

from boxgrasp.arrays import Floats, Points
from boxgrasp.draw.canvas import Canvas, Stroke
from boxgrasp.draw.palette import BLACK, HELD, OBSTACLE, RGB, WHITE
from boxgrasp.draw.planar import XY
from boxgrasp.draw.shapes import Hand, contact_line
from boxgrasp.draw.text import Lettering
from boxgrasp.draw.views import View
from boxgrasp.draw.words import visible_clearance
from boxgrasp.geometry.transforms import invert, transform
from boxgrasp.grasps.checks.approach_clearance import ApproachClearance
from boxgrasp.grasps.checks.check import Rejection, measured
from boxgrasp.grasps.checks.holds import Holds
from boxgrasp.grasps.checks.width import Width
from boxgrasp.grasps.checks.width_known import WidthKnown
from boxgrasp.grasps.held import points_in_hand
from boxgrasp.result import Candidate, Selection

_PATCH_M: Final = 0.02  # round an obstacle's nearest point, so that one sees which thing it is
_NEAR_M: Final = 0.20
_DOTS: Final = 150
_SLACK_M: Final = 0.006  # of a box, whose sides are where faces are: noise reaches out of them
_TOUCHES_M: Final = 0.002
_SAME_PLACE_PX: Final = 14.0
_WIDTHS: Final = (Width.name, WidthKnown.name)
_LETTERING: Final = Lettering(16, WHITE, halo=BLACK)


@dataclass(frozen=True, eq=False)
class Mark:
    """One thing to point at.

    Attributes:
        words: what is written beside it.
        point_m: (3,) float64, base frame, where a check says it is; None for nowhere.
        on_hand_m: (3,) float64, base frame, the place of the hand nearest to it; None likewise.
        across_m: (2, 3) float64, base frame, ends of a width; None where it is none.
        is_obstacle: whether the point is an object's.
    """

    words: str
    point_m: Floats | None = None
    on_hand_m: Floats | None = None
    across_m: Floats | None = None
    is_obstacle: bool = False

    @property
    def is_near(self) -> bool:
        """Whether its point is so near to the hand that panels should show both."""
        if self.point_m is None or self.on_hand_m is None:
            return False
        return float(np.linalg.norm(self.on_hand_m - self.point_m)) < _NEAR_M


def marks_of(selection: Selection) -> tuple[Mark, ...]:
    """What to mark: why the shown candidate was rejected, else the obstacle nearest to it.

    Args:
        selection: the answer.

    Returns:
        One mark a rejection, in their order; for a candidate that passed the visible obstacle
        nearest to it, where there is one.
    """
    shown = selection.shown
    if shown is None:
        return ()
    if shown.rejections:
        return tuple(_rejected(selection, shown, rejection) for rejection in shown.rejections)
    near = visible_clearance(shown)
    if near is None or near.nearest_point_m is None:
        return ()
    what = f"object {near.object}" if near.object else "obstacle"
    point = np.array(near.nearest_point_m)
    hand = Hand(selection.gripper, shown.T_base_gripper)
    words = f"{what} at {measured(near.value, near.unit)}"
    return (Mark(words, point, hand.nearest(point), is_obstacle=True),)


def _rejected(selection: Selection, shown: Candidate, rejection: Rejection) -> Mark:
    if rejection.check in _WIDTHS:
        return Mark(rejection.sentence, across_m=contact_line(shown, selection.box))
    if rejection.nearest_point_m is None:
        return Mark(rejection.sentence)
    point = np.array(rejection.nearest_point_m)
    hand = Hand(selection.gripper, shown.T_base_gripper)
    on_hand = hand.nearest(point, on_the_way=rejection.check == ApproachClearance.name)
    is_obstacle = rejection.object is not None
    return Mark(rejection.sentence, point, on_hand, is_obstacle=is_obstacle)


def held_points(selection: Selection, points: Points) -> Points:
    """The target's seen points that the check `holds` counts for the shown candidate.

    An answer names no points: those in the target's box are taken for its own. On casts and real
    captures, of candidates that pass, this gave all that were counted, and 1 of 1000 besides.

    Args:
        selection: the answer.
        points: (N, 3) float32 of the capture, base frame, m.

    Returns:
        (M, 3) float32, base frame, m; none where that check was not made.
    """
    shown, box = selection.shown, selection.box
    if shown is None or Holds.name not in shown.checks:
        return points[:0]
    local = np.abs(transform(invert(box.T_base_box), points))
    own = points[(local <= box.dimensions_m / 2 + _SLACK_M).all(axis=1)]
    return own[points_in_hand(shown.T_base_gripper, own, selection.gripper)[0]]


def dot_held(canvas: Canvas, view: View, points: Points) -> None:
    """Dot what is held.

    Args:
        canvas: the panel.
        view: of the panel.
        points: of `held_points`.
    """
    _dots(canvas, view, points, HELD)


def dot_obstacles(canvas: Canvas, view: View, points: Points, marks: Iterable[Mark]) -> None:
    """Dot the seen points round each obstacle's nearest one; drawn under all else.

    Args:
        canvas: the panel.
        view: of the panel.
        points: (N, 3) float32 of the capture, base frame, m.
        marks: of `marks_of`.
    """
    for mark in marks:
        if mark.point_m is None or not mark.is_obstacle:
            continue
        off = points - mark.point_m.astype(np.float32)
        patch = points[np.einsum("ij,ij->i", off, off) < _PATCH_M**2]
        _dots(canvas, view, patch[:: -(-len(patch) // _DOTS) or 1], OBSTACLE)


def _dots(canvas: Canvas, view: View, points: Points, color: RGB) -> None:
    """Dots with dark edges; where they are dense, an area with a dark edge."""
    places = [(x, y) for x, y in view.project(points)[0].tolist() if not np.isnan(x)]
    for radius, fill in ((2.9, BLACK), (1.8, color)):
        for at in places:
            canvas.dot(at, radius, fill)


def draw_marks(canvas: Canvas, view: View, selection: Selection, marks: Iterable[Mark]) -> None:
    """Draw each mark, then the words; reasons that name one place share its ring.

    Args:
        canvas: the panel.
        view: of the panel.
        selection: the answer.
        marks: of `marks_of`.
    """
    shown = selection.shown
    if shown is None:
        return
    radius = 7.0 if selection.refusal is None else 12.0
    rings: list[XY] = []
    placed: list[tuple[XY | None, str]] = []
    for mark in marks:
        if mark.across_m is not None:
            at = dimension_line(canvas, view, mark.across_m)
        elif mark.point_m is not None and mark.on_hand_m is not None:
            at = _draw_gap(canvas, view, mark.on_hand_m, mark.point_m)
            if at is not None and all(_apart_px(at, ring) >= _SAME_PLACE_PX for ring in rings):
                canvas.ring(at, radius, OBSTACLE)
                canvas.take(at, radius + 3)
                rings.append(at)
        else:
            at = view.point(shown.T_base_gripper[:3, 3])
        placed.append((at, mark.words))
    for at, words in placed:
        if at is not None:
            canvas.text_beside(at, words, _LETTERING, must=True, away=18)


def _draw_gap(canvas: Canvas, view: View, on_hand_m: Floats, point_m: Floats) -> XY | None:
    """A line from the hand to a point, unless they touch; the point's place, px."""
    ends = view.segment(on_hand_m, point_m)
    if ends is None:
        return None
    if float(np.linalg.norm(on_hand_m - point_m)) > _TOUCHES_M:
        canvas.line(*ends, Stroke(OBSTACLE, 2.5, halo=BLACK))
    return ends[1]


def _apart_px(a: XY, b: XY) -> float:
    return float(np.hypot(a[0] - b[0], a[1] - b[1]))


def dimension_line(canvas: Canvas, view: View, across_m: Floats) -> XY | None:
    """Draw a dimension line across the target, with its ticks.

    Args:
        canvas: the panel.
        view: of the panel.
        across_m: (2, 3) float64 ends, base frame, m.

    Returns:
        Its middle, px; None behind the camera.
    """
    ends = view.segment(across_m[0], across_m[1])
    if ends is None:
        return None
    a, b = ends
    dx, dy = b[0] - a[0], b[1] - a[1]
    length = float(np.hypot(dx, dy))
    if length >= 6.0:  # else it is seen end on
        nx, ny = -dy / length * 10, dx / length * 10
        stroke = Stroke(OBSTACLE, 3.5, halo=BLACK)
        canvas.line(a, b, stroke)
        for x, y in (a, b):
            canvas.line((x - nx, y - ny), (x + nx, y + ny), stroke)
    return (a[0] + b[0]) / 2, (a[1] + b[1]) / 2
