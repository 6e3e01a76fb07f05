"""What is drawn over a backdrop: the target's box, the options, a hand, what stands in its way."""

from __future__ import annotations

import numpy as np

from boxgrasp.clearance import CAP_M, category, to_points, uprights
from boxgrasp.draw.backdrops import Cloud
from boxgrasp.draw.canvas import XY, Canvas, hull
from boxgrasp.draw.palette import BLACK, BLOCKED, CATEGORY, OBSTACLE, RGB, SHAPE, WHITE
from boxgrasp.draw.shapes import (
    EDGE_FACES,
    EDGES,
    contact_line,
    corners,
    face_point,
    fingers,
    inside,
    skeleton,
)
from boxgrasp.draw.views import View
from boxgrasp.frames import Floats, Points, invert, transform
from boxgrasp.gripper import Gripper
from boxgrasp.selection import BoxReport, OptionReport, Selection

_APPROACH_M = 0.15
_OVER_PLANE_M = 0.012
_ROUND_TARGET_M = 0.01
_NEAR_M = 0.02


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
    colour: RGB,
    dashed: bool,
) -> None:
    """The hand as the box that was checked, with fingers; its start faint, its way an arrow."""
    dash = (9.0, 6.0) if dashed else None
    size = 2 * gripper.half_m
    if T_base_pregrasp is not None:
        _edges(canvas, view, corners(T_base_pregrasp, size), colour, 1.4, None, 120, (4.0, 4.0))
        for a, b in skeleton(T_base_pregrasp, gripper):
            if (ends := view.segment(a, b)) is not None:
                canvas.line(*ends, colour, 3.0, alpha=110)
    for finger in fingers(T_base_gripper, gripper):
        flat = [view.point(corner) for corner in finger]
        if None not in flat:
            canvas.polygon(hull([at for at in flat if at is not None]), colour, 120)
    _edges(canvas, view, corners(T_base_gripper, size), colour, 2.0, WHITE, 255, dash)
    for a, b in skeleton(T_base_gripper, gripper):
        if (ends := view.segment(a, b)) is not None:
            canvas.line(*ends, colour, 5.0, halo=WHITE, dash=dash)
    back = gripper.length_m / 2 + _APPROACH_M
    start = T_base_gripper[:3, 3] - T_base_gripper[:3, 0] * back
    stop = T_base_gripper[:3, 3] - T_base_gripper[:3, 0] * (gripper.length_m / 2 + 0.01)
    ends = view.segment(start, stop)
    if ends is not None:
        canvas.arrow(*ends, colour, 4.0, halo=WHITE, head=18)


def _edges(
    canvas: Canvas,
    view: View,
    places: Floats,
    colour: RGB,
    width: float,
    halo: RGB | None,
    alpha: int,
    dash: tuple[float, float] | None,
) -> None:
    for a, b in EDGES:
        ends = view.segment(places[a], places[b])
        if ends is not None:
            canvas.line(*ends, colour, width, halo=halo, dash=dash, alpha=alpha)


def draw_options(canvas: Canvas, view: View, selection: Selection, chosen: int | None) -> None:
    """Each option's line on its face and a mark beside it, pushed apart where they would meet."""
    options, box = selection.options, selection.box
    crowded = len(options) > 30
    radius = 5.0 if crowded else 8.5
    order = sorted(options, key=lambda option: (option.label != chosen, option.label))
    for option in options:
        _contact(canvas, view, option, box)
    placed: list[XY] = []
    for option in order:
        spot = _spot(canvas, view, option, box)
        if spot is None:
            continue
        foot, direction = spot
        size = radius * (1.35 if option.label == chosen else 1.0)
        at = _free(foot, direction, size, placed, canvas)
        if at is None:
            continue
        placed.append(at)
        if np.hypot(at[0] - foot[0], at[1] - foot[1]) > size:
            canvas.line(foot, at, BLACK, 1.2, alpha=170)
        kind = category(option.seen_m)
        if option.label == chosen:
            canvas.ring(at, size + 4.5, WHITE, 2.5)
        canvas.mark(at, SHAPE[kind], CATEGORY[kind], size, style_of(option))
        canvas.take(at, size + 3)
    if crowded:
        return
    drawn = [option for option in order]
    for option, at in zip(drawn, placed, strict=False):
        canvas.label(at, str(option.label), 14, WHITE, halo=BLACK, away=radius + 3)


def _contact(canvas: Canvas, view: View, option: OptionReport, box: BoxReport) -> None:
    line = contact_line(option, box)
    if view.faces(line.mean(axis=0), -option.T_base_gripper[:3, 0]) < 0.08:
        return
    ends = view.segment(*line)
    if ends is not None:
        dash = None if option.rejected is None else (5.0, 4.0)
        canvas.line(*ends, CATEGORY[category(option.seen_m)], 2.2, halo=BLACK, dash=dash)


def _spot(
    canvas: Canvas, view: View, option: OptionReport, box: BoxReport
) -> tuple[XY, tuple[float, float]] | None:
    """Where an option's mark belongs, in pixels, and the way to push it when that is taken."""
    approach, opening = option.T_base_gripper[:3, 0], option.T_base_gripper[:3, 1]
    middle = face_point(option, box)
    outward = -approach
    foot = middle
    if abs(approach[2]) > 0.7:  # both top faces share their middle: step aside along the line
        outward = -opening
        foot = middle + outward * option.width_m / 2
    a, b = view.point(foot), view.point(foot + outward * 0.02)
    if a is None or b is None:
        return None
    dx, dy = b[0] - a[0], b[1] - a[1]
    length = float(np.hypot(dx, dy))
    if length < 3.0:
        return a, (0.0, -1.0)
    return a, (dx / length, dy / length)


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


def draw_evidence(
    canvas: Canvas,
    view: View,
    cloud: Cloud,
    selection: Selection,
    best: OptionReport,
    gripper: Gripper,
    floor_m: float,
) -> None:
    """What decides: the obstacle nearest to the hand, a width too wide, the table in the way."""
    ask = selection.status != "grasp"
    if ask and not best.fits:
        line = contact_line(best, selection.box)
        ends = view.segment(*line)
        if ends is not None:
            _measure(
                canvas,
                *ends,
                f"{100 * best.width_m:.1f} cm wide, opens {100 * gripper.opening_m:.1f}",
            )
    if ask and best.support_m < 0.0:
        low = corners(best.T_base_gripper, 2 * gripper.half_m)
        at = view.point(low[int(np.argmin(low[:, 2]))])
        if at is not None:
            canvas.ring(at, 11, BLOCKED)
            canvas.take(at, 14)
            canvas.label(
                at,
                f"{-100 * best.support_m:.1f} cm into the support",
                16,
                WHITE,
                halo=BLACK,
                must=True,
                away=18,
            )
    near = nearest_obstacle(cloud.points, selection.box, best, gripper, floor_m, swept=ask)
    if near is None:
        return
    distance_m, obstacle, on_hand, around = near
    stated_m = min(best.seen_m, best.approach_m) if ask else best.seen_m
    if distance_m >= CAP_M or abs(distance_m - stated_m) > 0.01:
        return
    if ask:
        for at in view.project(around[:: max(1, len(around) // 400)])[0]:
            if not np.isnan(at).any():
                canvas.dot((float(at[0]), float(at[1])), 1.8, OBSTACLE, 150)
    ends = view.segment(on_hand, obstacle)
    if ends is None:
        return
    canvas.line(*ends, OBSTACLE, 2.5, halo=BLACK)
    canvas.ring(ends[1], 11 if ask else 7, OBSTACLE)
    canvas.take(ends[1], 14)
    word = f"obstacle {100 * stated_m:.1f} cm" if stated_m > 0 else "obstacle in the way"
    canvas.label(ends[1], word, 16, WHITE, halo=BLACK, must=True, away=18)


def _measure(canvas: Canvas, a: XY, b: XY, word: str) -> None:
    """A dimension line with ticks and its word."""
    dx, dy = b[0] - a[0], b[1] - a[1]
    length = max(float(np.hypot(dx, dy)), 1.0)
    nx, ny = -dy / length * 10, dx / length * 10
    canvas.line(a, b, OBSTACLE, 3.5, halo=BLACK)
    for x, y in (a, b):
        canvas.line((x - nx, y - ny), (x + nx, y + ny), OBSTACLE, 3.5, halo=BLACK)
    canvas.label(
        ((a[0] + b[0]) / 2, (a[1] + b[1]) / 2), word, 16, WHITE, halo=BLACK, must=True, away=16
    )


def nearest_obstacle(
    points: Points,
    box: BoxReport,
    option: OptionReport,
    gripper: Gripper,
    floor_m: float,
    *,
    swept: bool,
) -> tuple[float, Floats, Floats, Points] | None:
    """Distance (m), obstacle point, nearest point on the hand, and all obstacle points near it.

    Obstacles are the points over the support that are not in the target's box; swept: on the
    hand's way in, too.
    """
    close = np.abs(points - option.T_base_gripper[:3, 3].astype(np.float32)).max(axis=1) < 0.75
    points = points[close]
    points = points[points[:, 2] > floor_m + _OVER_PLANE_M]
    points = np.ascontiguousarray(points[~inside(points, box, _ROUND_TARGET_M)])
    if len(points) == 0:
        return None
    T, back = option.T_base_gripper, _APPROACH_M if swept else 0.0
    distances, index = to_points(uprights(T[None], gripper.half_m, back), points)
    if index[0] < 0:
        return None
    obstacle = points[int(index[0])].astype(np.float64)
    low, high = -gripper.half_m.copy(), gripper.half_m.copy()
    low[0] -= back
    local = np.asarray(transform(invert(T), points.astype(np.float64)))
    outside = np.linalg.norm(local - np.clip(local, low, high), axis=1)
    on_hand = transform(T, np.clip(local[int(index[0])], low, high)[None])[0]
    return (
        float(distances[0]),
        obstacle,
        np.asarray(on_hand),
        points[outside <= distances[0] + _NEAR_M],
    )
