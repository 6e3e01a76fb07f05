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
    half_m: Floats,
    opening_m: float,
    tip_m: float,
    middle_m: float,
    held: NDArray[np.bool_],
    in_fingers: NDArray[np.bool_],
) -> None:
    """Mark the points between a hand's fingertips, and those where its fingers are.

    Args:
        T_base_gripper: (4, 4) float64.
        points: (N, 3) float32, base frame, m.
        half_m: (3,) float64 half sizes of the hand's box, m.
        opening_m: between the fingers, m.
        tip_m: length of the fingers' last stretch, which must hold something, m.
        middle_m: how far from the hand's mid-plane a point is held in the middle, m.
        held: (N,) to fill: between the fingers' last stretches, in the middle.
        in_fingers: (N,) to fill: in the hand's box beyond the opening.
    """
    for n in range(points.shape[0]):
        along, across, off = _in_hand(T_base_gripper, points, n)
        held[n] = in_fingers[n] = False
        if abs(along) > half_m[0] or abs(across) > half_m[1] or abs(off) > half_m[2]:
            continue
        if abs(across) > opening_m / 2:
            in_fingers[n] = True
        elif abs(off) <= middle_m and along >= half_m[0] - tip_m:
            held[n] = True


@jit
def surfaces_ahead(
    T_base_gripper: Floats,
    points: Points,
    half_m: Floats,
    opening_m: float,
    middle_m: float,
    least: int,
    rim: int,
    stray: int,
    ahead_m: Floats,
) -> None:
    """How far along each hand's approach a target's surface lies, from the hand's center.

    Args:
        T_base_gripper: (M, 4, 4) float64.
        points: (N, 3) float32, base frame, m.
        half_m: (3,) float64 half sizes of the hand's box, m.
        opening_m: between the fingers, m.
        middle_m: half the thickness of the slab round the mid-plane in which it is looked for, m.
        least: of the slab's points between the fingers; fewer are no surface.
        rim: of these points that may lie nearer than the surface.
        stray: points that may lie nearer than what is in a finger's or the palm's way.
        ahead_m: (M, 3) to fill, m: the surface between the fingers, the nearest thing in a finger's
            way, the nearest in the palm's; NaN where there is none.
    """
    count = points.shape[0]
    middle, finger, palm = np.empty(count), np.empty(count), np.empty(count)
    for m in range(T_base_gripper.shape[0]):
        a = b = c = 0
        for n in range(count):
            along, across, off = _in_hand(T_base_gripper[m], points, n)
            if abs(across) > half_m[1] or abs(off) > half_m[2]:
                continue
            if abs(across) > opening_m / 2:
                finger[b] = along
                b += 1
                continue
            palm[c] = along
            c += 1
            if abs(off) <= middle_m:
                middle[a] = along
                a += 1
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
    half_m: Floats,
    opening_m: float,
    middle_m: float,
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
        half_m: (3,) float64 half sizes of the hand's box, m.
        opening_m: between the fingers, m.
        middle_m: half the thickness of the slab round the mid-plane that is looked at, m.
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
            if abs(across) > opening_m / 2 or abs(off) > middle_m:
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
