"""What is drawn over a backdrop: the target's box, the candidates, a hand."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from boxgrasp.arrays import Floats, Points
from boxgrasp.draw.canvas import Canvas, Look, Stroke
from boxgrasp.draw.palette import BLACK, RGB, WHITE
from boxgrasp.draw.planar import XY, hull
from boxgrasp.draw.shapes import (
    EDGE_FACES,
    EDGES,
    Hand,
    contact_line,
    corners,
    face_point,
    fingers,
    skeleton,
)
from boxgrasp.draw.text import Lettering
from boxgrasp.draw.views import View
from boxgrasp.draw.words import look_of
from boxgrasp.grasps.candidates import TOP_PERPENDICULAR
from boxgrasp.result import Candidate, Selection, TargetBox

_CROWD: Final = 30  # candidates, from which on marks are small and go without their numbers
_CELL_PX: Final = 5.0  # of the places that stand for what is held
_RING_PX: Final = 4.5  # from the shown candidate's mark to the ring round it
_LARGER: Final = 1.35  # the shown candidate's mark beside the others
_LETTERING: Final = Lettering(13, WHITE, halo=BLACK)
_SEEN_EDGE: Final = Stroke(WHITE, 3.0, halo=BLACK)
_HIDDEN_EDGE: Final = Stroke(WHITE, 1.2, halo=BLACK)


def draw_box(canvas: Canvas, view: View, box: TargetBox) -> None:
    """Draw the target's box in white; edges behind it thin.

    Args:
        canvas: the panel.
        view: of the panel.
        box: the target's.
    """
    places = corners(box.T_base_box, box.dimensions_m)
    R = box.T_base_box[:3, :3]
    for front in (False, True):
        for (a, b), faces in zip(EDGES, EDGE_FACES, strict=True):
            middle = (places[a] + places[b]) / 2
            seen = any(view.faces(middle, sign * R[:, axis]) > 0 for axis, sign in faces)
            ends = view.segment(places[a], places[b])
            if seen == front and ends is not None:
                canvas.line(*ends, _SEEN_EDGE if seen else _HIDDEN_EDGE)


def draw_hand(canvas: Canvas, view: View, hand: Hand, color: RGB, *, dashed: bool) -> None:
    """Draw the hand as its checked boxes, with fingers; its start faint, its way an arrow.

    Args:
        canvas: the panel.
        view: of the panel.
        hand: what to draw.
        color: of its lines.
        dashed: whether it is a hand that will not go there.
    """
    dash = (9.0, 6.0) if dashed else None
    if hand.T_base_pregrasp is not None:
        faint = Stroke(color, 1.4, alpha=120, dash=(4.0, 4.0))
        for solid in hand.solids(hand.T_base_pregrasp):
            draw_edges(canvas, view, solid, faint)
        _strokes(canvas, view, hand.T_base_pregrasp, hand, Stroke(color, 3.0, alpha=110))
    for finger in fingers(hand.T_base_gripper, hand.gripper):
        flat = [view.point(corner) for corner in finger]
        if None not in flat:
            canvas.polygon(hull([at for at in flat if at is not None]), color, 120)
    edge = Stroke(color, 2.0, halo=WHITE, dash=dash)
    for solid in hand.solids(hand.T_base_gripper):
        draw_edges(canvas, view, solid, edge)
    _strokes(canvas, view, hand.T_base_gripper, hand, Stroke(color, 5.0, halo=WHITE, dash=dash))
    _way(canvas, view, hand, Stroke(color, 4.0, halo=WHITE))


def _way(canvas: Canvas, view: View, hand: Hand, stroke: Stroke) -> None:
    """The last part of the approach, to the back of the hand."""
    back, way = hand.gripper.length_m / 2, hand.approach_m
    place, approach = hand.T_base_gripper[:3, 3], hand.T_base_gripper[:3, 0]
    start = place - approach * (back + way)
    ends = view.segment(start, place - approach * (back + min(0.01, way)))
    if ends is not None:
        canvas.arrow(*ends, stroke, head=18)


def _strokes(canvas: Canvas, view: View, T: Floats, hand: Hand, stroke: Stroke) -> None:
    for a, b in skeleton(T, hand.gripper):
        if (ends := view.segment(a, b)) is not None:
            canvas.line(*ends, stroke)


def draw_edges(canvas: Canvas, view: View, places: Floats, stroke: Stroke) -> None:
    """Draw the edges of a box.

    Args:
        canvas: the panel.
        view: of the panel.
        places: (8, 3) float64 corners as `corners` gives them, base frame, m.
        stroke: how they look.
    """
    for a, b in EDGES:
        if (ends := view.segment(places[a], places[b])) is not None:
            canvas.line(*ends, stroke)


@dataclass(frozen=True)
class _Placed:
    """A candidate's mark: where it belongs and where it found room, px."""

    candidate: Candidate
    look: Look
    radius: float
    foot: XY
    at: XY


def draw_contacts(
    canvas: Canvas, view: View, candidates: Iterable[Candidate], box: TargetBox
) -> None:
    """Draw the candidates' lines on the faces that are seen, where the fingers close.

    Args:
        canvas: the panel.
        view: of the panel.
        candidates: which.
        box: the target's.
    """
    for candidate in candidates:
        line = contact_line(candidate, box)
        if view.faces(line.mean(axis=0), -candidate.T_base_gripper[:3, 0]) < 0.08:
            continue
        ends = view.segment(*line)
        if ends is not None:
            dash = None if candidate.passed else (5.0, 4.0)
            canvas.line(*ends, Stroke(look_of(candidate).color, 2.2, halo=BLACK, dash=dash))


def draw_candidates(
    canvas: Canvas, view: View, selection: Selection, held: Points, kind: str
) -> None:
    """Draw a mark beside each candidate's line.

    It covers no other one; where there is room, it and its number cover nothing that is held.

    Args:
        canvas: the panel.
        view: of the panel.
        selection: the answer.
        held: (M, 3) float32, base frame, m, what the shown hand holds.
        kind: `camera`, `above` or `side`; from the side only the marks that say something there.
    """
    candidates, shown = selection.candidates, selection.shown
    radius = _radius(view, selection.box, len(candidates))
    placed: list[_Placed] = []
    held_px = _thinned(view.project(held)[0])
    for x, y in held_px.tolist():
        canvas.take((x, y), _CELL_PX / 2)
    for candidate in sorted(candidates, key=lambda item: (item is not shown, item.label)):
        if kind == "side" and candidate is not shown and _behind(view, candidate):
            continue
        size = radius * (_LARGER if candidate is shown else 1.0)
        foot, direction = _spot(view, candidate, selection.box)
        if foot is None:
            continue
        at = _free(canvas, foot, direction, size, [other.at for other in placed], held_px)
        if at is not None:
            placed.append(_Placed(candidate, look_of(candidate), size, foot, at))
    _draw_placed(canvas, placed, shown)
    for mark in placed if len(candidates) <= _CROWD else ():
        number = str(mark.candidate.label)
        canvas.text_beside(mark.at, number, _LETTERING, away=radius + 3)


def _draw_placed(canvas: Canvas, placed: Sequence[_Placed], shown: Candidate | None) -> None:
    for mark in placed:
        if np.hypot(mark.at[0] - mark.foot[0], mark.at[1] - mark.foot[1]) > mark.radius:
            canvas.line(mark.foot, mark.at, Stroke(BLACK, 1.2, alpha=170))
    for mark in placed:
        if mark.candidate is shown:
            canvas.ring(mark.at, mark.radius + _RING_PX, WHITE, 2.5)
        canvas.mark(mark.at, mark.look, mark.radius)
        canvas.take(mark.at, mark.radius + 3)


def _radius(view: View, box: TargetBox, count: int) -> float:
    """Marks small enough for the box and their number, px."""
    if count > _CROWD:
        return 5.0
    xy, _ = view.project(corners(box.T_base_box, box.dimensions_m))
    extent = float(np.nanmax(np.ptp(xy, axis=0))) if not np.isnan(xy).any() else 200.0
    return float(np.clip(0.055 * extent, 6.5, 9.0))


def _behind(view: View, candidate: Candidate) -> bool:
    """Whether a plan shows a candidate from behind, or end on."""
    if candidate.face == TOP_PERPENDICULAR:
        return True
    return view.faces(candidate.T_base_gripper[:3, 3], -candidate.T_base_gripper[:3, 0]) < -0.5


def _spot(view: View, candidate: Candidate, box: TargetBox) -> tuple[XY | None, XY]:
    """Where a candidate's mark belongs, px, and the way to push it when that is taken."""
    approach, opening = candidate.T_base_gripper[:3, 0], candidate.T_base_gripper[:3, 1]
    foot = face_point(candidate, box)
    outward = -approach
    if abs(approach[2]) > 0.7:  # both top faces share their middle: step aside along the line
        outward = -opening
        foot = foot + outward * candidate.width_m / 2
    a, b = view.point(foot), view.point(foot + outward * 0.02)
    if a is None or b is None:
        return None, (0.0, -1.0)
    dx, dy = b[0] - a[0], b[1] - a[1]
    length = float(np.hypot(dx, dy))
    return a, (0.0, -1.0) if length < 3.0 else (dx / length, dy / length)


def _thinned(xy: Floats) -> Floats:
    """(M, 2) px, one place a cell of some pixels: enough to keep marks off them."""
    seen = xy[~np.isnan(xy).any(axis=1)]
    return np.asarray(np.unique(np.rint(seen / _CELL_PX), axis=0) * _CELL_PX)


def _free(
    canvas: Canvas, foot: XY, direction: XY, radius: float, placed: Sequence[XY], held_px: Floats
) -> XY | None:
    """The first place from the foot outwards that is inside and touches no other mark.

    One that covers what is held only where there is no other.
    """
    apart, edge = 2 * radius + 5, radius + 4
    covering = None
    for turn in (0.0, 0.5, -0.5, 1.0, -1.0, 1.6, -1.6):
        c, s = float(np.cos(turn)), float(np.sin(turn))
        dx, dy = direction[0] * c - direction[1] * s, direction[0] * s + direction[1] * c
        for step in range(7):
            away = radius * (1.4 + step)
            x, y = foot[0] + dx * away, foot[1] + dy * away
            if not (edge < x < canvas.width - edge and edge < y < canvas.height - edge):
                continue
            if any(np.hypot(x - other[0], y - other[1]) < apart for other in placed):
                continue
            if (np.hypot(*(held_px - (x, y)).T) > radius + _RING_PX + _CELL_PX).all():
                return x, y
            covering = covering or (x, y)
    return covering
