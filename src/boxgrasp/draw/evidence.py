"""What decides an answer, marked where it is: an obstacle, a width, the support, unseen space."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from boxgrasp.arrays import Floats, Points
from boxgrasp.draw.canvas import XY, Canvas
from boxgrasp.draw.palette import BLACK, BLOCKED, OBSTACLE, WHITE
from boxgrasp.draw.shapes import contact_line, corners, inside
from boxgrasp.draw.views import View
from boxgrasp.geometry.hand_distance import to_points, uprights
from boxgrasp.geometry.transforms import invert, transform
from boxgrasp.grasps.gripper import Gripper
from boxgrasp.result import BoxReport, Candidate, Selection

_BACK_M: Final = 0.15
_OVER_PLANE_M: Final = 0.012
_ROUND_TARGET_M: Final = 0.01
_BESIDE_M: Final = 0.015
_AGREES_M: Final = 0.01
_FARTHEST_M: Final = 0.12
_DOTS: Final = 150


@dataclass(frozen=True, eq=False)
class Obstacle:
    """The obstacle's point (3,) nearest to the hand, the hand's to it, (K, 3) points as near.

    Base frame, meters.
    """

    distance_m: float
    point: Floats
    on_hand: Floats
    around: Points


@dataclass(frozen=True, eq=False)
class Mark:
    """One thing to point at. kind: `obstacle`, `width`, `support` or `space`."""

    kind: str
    word: str
    obstacle: Obstacle | None = None


def evidence_of(
    points: Points, selection: Selection, best: Candidate, gripper: Gripper, floor_m: float
) -> list[Mark]:
    """What to mark for the chosen candidate, or for each reason why the best one fell out."""
    if selection.status == "grasp":
        near = nearest_obstacle(points, selection.box, best, gripper, floor_m, 0.0)
        if near is None or abs(near.distance_m - best.visible_clearance_m) > _AGREES_M:
            return []
        return [Mark("obstacle", f"obstacle {100 * best.visible_clearance_m:.1f} cm", near)]
    marks = []
    for reason in (best.rejected or "").split("; "):
        kind = _kind(reason)
        if kind != "obstacle":
            marks += [Mark(kind, reason)] if kind else []
            continue
        back_m = _BACK_M if reason.startswith("approach") else 0.0
        near = nearest_obstacle(points, selection.box, best, gripper, floor_m, back_m)
        if near is not None and near.distance_m < _FARTHEST_M:
            marks.append(Mark("obstacle", reason, near))
    return marks


def _kind(reason: str) -> str | None:
    """What a reason of the check speaks of; an obstacle unless it says another thing."""
    words = {"support": "support", "width": "width", "opening": "width", "unseen": "space"}
    for word, kind in words.items():
        if word in reason:
            return kind
    return None if not reason or "not allowed" in reason else "obstacle"


def dot_obstacles(canvas: Canvas, view: View, marks: list[Mark]) -> None:
    """Dot the obstacles' points that are as near as the nearest; drawn under all else."""
    for mark in marks:
        if mark.obstacle is None:
            continue
        around = mark.obstacle.around
        for x, y in view.project(around[:: -(-len(around) // _DOTS)])[0].tolist():
            if not np.isnan(x):
                canvas.dot((x, y), 2.6, BLACK, 160)
                canvas.dot((x, y), 1.8, OBSTACLE)


def draw_evidence(
    canvas: Canvas,
    view: View,
    marks: list[Mark],
    selection: Selection,
    best: Candidate,
    gripper: Gripper,
) -> None:
    """Draw each mark with its words; obstacles that several reasons name are marked once."""
    ask = selection.status != "grasp"
    rings: list[XY] = []
    for mark in marks:
        if mark.obstacle is not None:
            _obstacle(canvas, view, mark.obstacle, mark.word, ask, rings)
        elif mark.kind == "width":
            _width(canvas, view, best, selection.box, mark.word)
        elif mark.kind == "support":
            low = corners(best.T_base_gripper, 2 * gripper.half_m)
            at = view.point(low[int(np.argmin(low[:, 2]))])
            if at is not None:
                canvas.ring(at, 10, BLOCKED)
                canvas.take(at, 13)
                _say(canvas, at, mark.word)
        else:
            at = view.point(best.T_base_gripper[:3, 3])
            if at is not None:
                _say(canvas, at, mark.word)


def _obstacle(
    canvas: Canvas, view: View, near: Obstacle, word: str, ask: bool, rings: list[XY]
) -> None:
    ends = view.segment(near.on_hand, near.point)
    if ends is None:
        return
    if near.distance_m > 0.002:
        canvas.line(*ends, OBSTACLE, 2.5, halo=BLACK)
    if any(np.hypot(ends[1][0] - x, ends[1][1] - y) < 14 for x, y in rings):
        return
    canvas.ring(ends[1], 12 if ask else 7, OBSTACLE)
    canvas.take(ends[1], 15 if ask else 10)
    rings.append(ends[1])
    _say(canvas, ends[1], word)


def _width(canvas: Canvas, view: View, best: Candidate, box: BoxReport, word: str) -> None:
    """A dimension line across the target, with its ticks and its word."""
    ends = view.segment(*contact_line(best, box))
    if ends is None:
        return
    a, b = ends
    dx, dy = b[0] - a[0], b[1] - a[1]
    length = float(np.hypot(dx, dy))
    if length >= 6.0:  # else it is seen end on
        nx, ny = -dy / length * 10, dx / length * 10
        canvas.line(a, b, OBSTACLE, 3.5, halo=BLACK)
        for x, y in (a, b):
            canvas.line((x - nx, y - ny), (x + nx, y + ny), OBSTACLE, 3.5, halo=BLACK)
    _say(canvas, ((a[0] + b[0]) / 2, (a[1] + b[1]) / 2), word)


def _say(canvas: Canvas, at: XY, word: str) -> None:
    canvas.label(at, word, 16, WHITE, halo=BLACK, must=True, away=18)


def nearest_obstacle(
    points: Points,
    box: BoxReport,
    candidate: Candidate,
    gripper: Gripper,
    floor_m: float,
    back_m: float,
) -> Obstacle | None:
    """The visible obstacle nearest to the hand, or to its last `back_m` on the way in.

    Obstacles are the points over the support that are not in the target's box.
    """
    T = candidate.T_base_gripper
    reach = np.float32(gripper.length_m + back_m + 0.5)
    points = points[np.abs(points - T[:3, 3].astype(np.float32)).max(axis=1) < reach]
    points = points[points[:, 2] > np.float32(floor_m + _OVER_PLANE_M)]
    points = np.ascontiguousarray(points[~inside(points, box, _ROUND_TARGET_M)])
    if len(points) == 0:
        return None
    distances, index = to_points(uprights(T[None], gripper.half_m, back_m), points)
    if index[0] < 0:
        return None
    low, high = -gripper.half_m, np.array(gripper.half_m)
    low[0] -= back_m
    local = np.asarray(transform(invert(T), points.astype(np.float64)))
    outside = np.linalg.norm(local - np.clip(local, low, high), axis=1)
    row = int(index[0])
    within = np.flatnonzero(outside == 0.0)
    if len(within):  # many touch: the one in their midst says most
        middle = np.median(local[within], axis=0)
        row = int(within[np.argmin(np.linalg.norm(local[within] - middle, axis=1))])
    on_hand = np.asarray(transform(T, np.clip(local[row], low, high)[None]))[0]
    around = points[outside <= distances[0] + _BESIDE_M]
    return Obstacle(float(distances[0]), points[row].astype(np.float64), on_hand, around)
