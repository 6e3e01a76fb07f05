"""What is drawn over a backdrop: the target's box, the candidates, a hand."""

from __future__ import annotations

from typing import Final

import numpy as np

from boxgrasp.arrays import Floats
from boxgrasp.draw.canvas import XY, Canvas, hull
from boxgrasp.draw.palette import BLACK, CATEGORY, RGB, SHAPE, WHITE
from boxgrasp.draw.shapes import (
    EDGE_FACES,
    EDGES,
    contact_line,
    corners,
    face_point,
    fingers,
    skeleton,
)
from boxgrasp.draw.views import View
from boxgrasp.draw.words import style_of
from boxgrasp.grasps.candidates import TOP_PERPENDICULAR
from boxgrasp.grasps.gripper import Gripper
from boxgrasp.grasps.scoring import category
from boxgrasp.result import BoxReport, Candidate, Selection

_APPROACH_M: Final = 0.15
_CROWD: Final = 30


def draw_box(canvas: Canvas, view: View, box: BoxReport) -> None:
    """The target's box in white; edges behind it thin."""
    places = corners(box.T_base_box, box.dimensions_m)
    R = box.T_base_box[:3, :3]
    for front in (False, True):
        for (a, b), faces in zip(EDGES, EDGE_FACES, strict=True):
            middle = (places[a] + places[b]) / 2
            seen = any(view.faces(middle, sign * R[:, axis]) > 0 for axis, sign in faces)
            ends = view.segment(places[a], places[b])
            if seen != front or ends is None:
                continue
            canvas.line(*ends, WHITE, 3.0 if seen else 1.2, halo=BLACK)


def draw_gripper(
    canvas: Canvas,
    view: View,
    T_base_gripper: Floats,
    T_base_pregrasp: Floats | None,
    gripper: Gripper,
    color: RGB,
    dashed: bool,
) -> None:
    """The hand as the box that was checked, with fingers; its start faint, its way an arrow."""
    dash = (9.0, 6.0) if dashed else None
    size = 2 * gripper.half_m
    if T_base_pregrasp is not None:
        _edges(canvas, view, corners(T_base_pregrasp, size), color, 1.4, None, 120, (4.0, 4.0))
        for a, b in skeleton(T_base_pregrasp, gripper):
            if (ends := view.segment(a, b)) is not None:
                canvas.line(*ends, color, 3.0, alpha=110)
    for finger in fingers(T_base_gripper, gripper):
        flat = [view.point(corner) for corner in finger]
        if None not in flat:
            canvas.polygon(hull([at for at in flat if at is not None]), color, 120)
    _edges(canvas, view, corners(T_base_gripper, size), color, 2.0, WHITE, 255, dash)
    for a, b in skeleton(T_base_gripper, gripper):
        if (ends := view.segment(a, b)) is not None:
            canvas.line(*ends, color, 5.0, halo=WHITE, dash=dash)
    back = gripper.length_m / 2 + _APPROACH_M
    start = T_base_gripper[:3, 3] - T_base_gripper[:3, 0] * back
    stop = T_base_gripper[:3, 3] - T_base_gripper[:3, 0] * (gripper.length_m / 2 + 0.01)
    ends = view.segment(start, stop)
    if ends is not None:
        canvas.arrow(*ends, color, 4.0, halo=WHITE, head=18)


def _edges(
    canvas: Canvas,
    view: View,
    places: Floats,
    color: RGB,
    width: float,
    halo: RGB | None,
    alpha: int,
    dash: tuple[float, float] | None,
) -> None:
    for a, b in EDGES:
        ends = view.segment(places[a], places[b])
        if ends is not None:
            canvas.line(*ends, color, width, halo=halo, dash=dash, alpha=alpha)


def draw_candidates(
    canvas: Canvas, view: View, selection: Selection, chosen: int | None, kind: str
) -> None:
    """Each candidate's line on its face and a mark beside it, pushed apart where they would meet.

    kind: `camera`, `above` or `side`; from the side only the marks that say something there.
    """
    candidates, box = selection.candidates, selection.box
    for candidate in candidates:
        _contact(canvas, view, candidate, box)
    radius = _radius(view, box, len(candidates))
    order = sorted(candidates, key=lambda candidate: (candidate.label != chosen, candidate.label))
    placed: list[tuple[Candidate, XY]] = []
    for candidate in order:
        if kind == "side" and candidate.label != chosen and _behind(view, candidate):
            continue
        size = radius * (1.35 if candidate.label == chosen else 1.0)
        foot, direction = _spot(view, candidate, box)
        if foot is None:
            continue
        at = _free(foot, direction, size, [place for _, place in placed], canvas)
        if at is None:
            continue
        placed.append((candidate, at))
        if np.hypot(at[0] - foot[0], at[1] - foot[1]) > size:
            canvas.line(foot, at, BLACK, 1.2, alpha=170)
    for candidate, at in placed:
        size = radius * (1.35 if candidate.label == chosen else 1.0)
        if candidate.label == chosen:
            canvas.ring(at, size + 4.5, WHITE, 2.5)
        name = category(candidate.visible_clearance_m)
        canvas.mark(at, SHAPE[name], CATEGORY[name], size, style_of(candidate))
        canvas.take(at, size + 3)
    if len(candidates) > _CROWD:
        return
    for candidate, at in placed:
        canvas.label(at, str(candidate.label), 13, WHITE, halo=BLACK, away=radius + 3)


def _radius(view: View, box: BoxReport, count: int) -> float:
    """Marks small enough for the box and their number."""
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


def _contact(canvas: Canvas, view: View, candidate: Candidate, box: BoxReport) -> None:
    line = contact_line(candidate, box)
    if view.faces(line.mean(axis=0), -candidate.T_base_gripper[:3, 0]) < 0.08:
        return
    ends = view.segment(*line)
    if ends is not None:
        dash = None if candidate.rejected is None else (5.0, 4.0)
        canvas.line(
            *ends, CATEGORY[category(candidate.visible_clearance_m)], 2.2, halo=BLACK, dash=dash
        )


def _spot(
    view: View, candidate: Candidate, box: BoxReport
) -> tuple[XY | None, tuple[float, float]]:
    """Where a candidate's mark belongs, in pixels, and the way to push it when that is taken."""
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


def _free(
    foot: XY, direction: tuple[float, float], radius: float, placed: list[XY], canvas: Canvas
) -> XY | None:
    """The first place from the foot outwards that is inside and touches no other mark."""
    apart = 2 * radius + 5
    for turn in (0.0, 0.5, -0.5, 1.0, -1.0, 1.6, -1.6):
        c, s = float(np.cos(turn)), float(np.sin(turn))
        dx, dy = direction[0] * c - direction[1] * s, direction[0] * s + direction[1] * c
        for step in range(7):
            away = radius * (1.4 + step)
            at = (foot[0] + dx * away, foot[1] + dy * away)
            within = (
                radius + 4 < at[0] < canvas.width - radius - 4
                and radius + 4 < at[1] < canvas.height - radius - 4
            )
            if within and all(np.hypot(at[0] - x, at[1] - y) >= apart for x, y in placed):
                return at
    return None
