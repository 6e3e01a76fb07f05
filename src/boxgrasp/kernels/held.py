"""What of a target lies between the fingers of a hand, and what of it in their way."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Floats, Points
from boxgrasp.kernels._jit import jit


@jit
def _in_hand(T: Floats, points: Points, n: int) -> tuple[float, float, float]:
    x, y, z = points[n, 0] - T[0, 3], points[n, 1] - T[1, 3], points[n, 2] - T[2, 3]
    return (
        x * T[0, 0] + y * T[1, 0] + z * T[2, 0],
        x * T[0, 1] + y * T[1, 1] + z * T[2, 1],
        x * T[0, 2] + y * T[1, 2] + z * T[2, 2],
    )


@jit
def mark_in_hand(
    T_base_gripper: Floats,
    points: Points,
    boxes_m: Floats,
    pads_m: Floats,
    held: NDArray[np.bool_],
    in_fingers: NDArray[np.bool_],
) -> None:
    """Mark the points between a hand's fingertips, and those where its fingers are.

    Args:
        T_base_gripper: (4, 4) float64.
        points: (N, 3) float32, base frame, m.
        boxes_m: (B, 2, 3) float64 lowest and highest corners of the hand's solid boxes, in its own
            frame, m.
        pads_m: (2, 3) float64, likewise of the space between the fingers' last stretches.
        held: (N,) to fill: between the fingers' last stretches, in the middle.
        in_fingers: (N,) to fill: in the hand's boxes.
    """
    for n in range(points.shape[0]):
        place = _in_hand(T_base_gripper, points, n)
        held[n] = _inside(pads_m, place)
        in_fingers[n] = False
        if not held[n]:
            for b in range(boxes_m.shape[0]):
                in_fingers[n] |= _inside(boxes_m[b], place)


@jit
def _inside(box: Floats, place: tuple[float, float, float]) -> bool:
    for axis in range(3):
        if not box[0, axis] <= place[axis] <= box[1, axis]:
            return False
    return True


@jit
def surfaces_ahead(
    T_base_gripper: Floats,
    points: Points,
    ways_m: Floats,
    slab_m: Floats,
    counts: tuple[int, int, int],
    ahead_m: Floats,
) -> None:
    """How far along each hand's approach a target's surface lies, from the hand's center.

    Args:
        T_base_gripper: (M, 4, 4) float64.
        points: (N, 3) float32, base frame, m.
        ways_m: (W, 6) float64, what each part of the hand meets as it moves: from and to across,
            from and to off the mid-plane, how far its front is behind the fingertips, all m; and
            0 for a finger, 1 for the palm.
        slab_m: (2,) half of the opening, and half the thickness of the slab round the mid-plane in
            which the surface is looked for, m.
        counts: of the slab's points between the fingers at least; of these that may lie nearer than
            the surface; of points that may lie nearer than what is in the hand's way.
        ahead_m: (M, 3) to fill, m: the surface between the fingers, the fingertips where a finger
            meets the target, and where the palm does; NaN where there is none.
    """
    count, (least, rim, stray) = points.shape[0], counts
    middle, finger, palm = np.empty(count), np.empty(count), np.empty(count)
    for m in range(T_base_gripper.shape[0]):
        a = b = c = 0
        for n in range(count):
            along, across, off = _in_hand(T_base_gripper[m], points, n)
            if abs(across) <= slab_m[0] and abs(off) <= slab_m[1]:
                middle[a] = along
                a += 1
            for_finger = for_palm = np.inf
            for w in range(ways_m.shape[0]):
                way = ways_m[w]
                if way[0] <= across <= way[1] and way[2] <= off <= way[3]:
                    if way[5] == 0.0:
                        for_finger = min(for_finger, along + way[4])
                    else:
                        for_palm = min(for_palm, along + way[4])
            if for_finger < np.inf:
                finger[b] = for_finger
                b += 1
            if for_palm < np.inf:
                palm[c] = for_palm
                c += 1
        ahead_m[m] = np.nan
        if a >= least:
            ahead_m[m, 0] = np.sort(middle[:a])[rim]
        if b > stray:
            ahead_m[m, 1] = np.sort(finger[:b])[stray]
        if c > stray:
            ahead_m[m, 2] = np.sort(palm[:c])[stray]


@jit
def steady_depths(
    T_base_gripper: Floats,
    points: Points,
    slab_m: Floats,
    surface_m: Floats,
    step_m: float,
    least: int,
    growth_m: float,
    steps: int,
    depth_m: Floats,
) -> None:
    """How deep behind a target's surface its two sides stop running apart.

    Fingers that close on sides that run apart touch them aslant, and slip off.

    Args:
        T_base_gripper: (M, 4, 4) float64.
        points: (N, 3) float32, base frame, m.
        slab_m: (2,) half of the opening, and half the thickness of the slab round the mid-plane
            that is looked at, m.
        surface_m: (M,) float64 where the surface is along each approach, from the hand's center,
            m; NaN for nowhere.
        step_m: of depth, m.
        least: steps that are gone in any case.
        growth_m: of the width over two steps, up to which sides do not run apart, m.
        steps: down to the deepest.
        depth_m: (M,) to fill, m, whole steps; `least` of them where the sides never stop.
    """
    low, high, width_m = np.empty(steps), np.empty(steps), np.empty(steps)
    for m in range(T_base_gripper.shape[0]):
        depth_m[m] = least * step_m
        if np.isnan(surface_m[m]):
            continue
        low[:], high[:] = np.inf, -np.inf
        for n in range(points.shape[0]):
            along, across, off = _in_hand(T_base_gripper[m], points, n)
            if abs(across) > slab_m[0] or abs(off) > slab_m[1]:
                continue
            k = max(int(np.floor((along - surface_m[m]) / step_m)), 0)
            if k < steps:
                low[k], high[k] = min(low[k], across), max(high[k], across)
        for k in range(steps):
            if k > 0:
                low[k], high[k] = min(low[k], low[k - 1]), max(high[k], high[k - 1])
            width_m[k] = high[k] - low[k]
        for k in range(max(least, 3), steps + 1):
            if width_m[k - 1] - width_m[k - 3] <= growth_m:
                depth_m[m] = k * step_m
                break
