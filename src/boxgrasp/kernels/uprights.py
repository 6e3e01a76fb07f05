"""Distances of upright boxes (a turned rectangle in plan, an interval in height), exact.

A hand is one such box or several of one turn; its distance is that of the nearest.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Floats
from boxgrasp.kernels._jit import jit


@jit
def columns_to_uprights(
    hands: Floats,
    outer: Floats,
    columns: NDArray[np.float32],
    distances: Floats,
    nearest: NDArray[np.int64],
    first: int,
    last: int,
) -> None:
    """Lower distances[first:last] to the nearest column, and note which it is.

    Args:
        hands: (M, B, 8) upright boxes of each hand, of `hand_distance.hand_uprights`, m.
        outer: (M, 8) a box round all of a hand's, m: a column farther from it is not looked at.
        columns: (N, 4) float32 x, y, lowest z, highest z, base frame, m.
        distances: (M,) float64 to lower, m.
        nearest: (M,) int64 to fill.
        first: row of the hands.
        last: row of the hands.
    """
    count = hands.shape[1]
    for m in range(first, last):
        least = distances[m] * distances[m]
        for i in range(columns.shape[0]):
            d = _to_column(outer[m], columns[i], least)
            if d >= least:
                continue
            if count == 1:
                least = d
                nearest[m] = i
                continue
            for b in range(count):
                d = _to_column(hands[m, b], columns[i], least)
                if d < least:
                    least = d
                    nearest[m] = i
        distances[m] = np.sqrt(least)


@jit
def _to_column(box: Floats, column: NDArray[np.float32], least: float) -> float:
    """Squared distance of an upright box to a column, or `least` where it is at least that."""
    w = max(column[2] - box[7], box[6] - column[3], 0.0)
    if w * w >= least:
        return least
    x = column[0] - box[0]
    y = column[1] - box[1]
    u = max(abs(x * box[2] + y * box[3]) - box[4], 0.0)
    v = max(abs(y * box[2] - x * box[3]) - box[5], 0.0)
    return float(u * u + v * v + w * w)


@jit
def _corner_gap(
    x: float, y: float, c: float, s: float, along: float, across: float, other: Floats
) -> float:
    """Least squared distance of four corners to a rectangle at the origin; -1 if one is inside.

    `other` (4, 2): corners in the rectangle's own axes are found here; x, y shift them.
    """
    least = np.inf
    for k in range(4):
        px = other[k, 0] - x
        py = other[k, 1] - y
        u = max(abs(px * c + py * s) - along, 0.0)
        v = max(abs(py * c - px * s) - across, 0.0)
        least = min(least, u * u + v * v)
    return least


@jit
def _apart(
    dx: float,
    dy: float,
    c: float,
    s: float,
    along: float,
    across: float,
    c2: float,
    s2: float,
    along2: float,
    across2: float,
) -> bool:
    """Whether an axis of the first rectangle separates the two (separating axis theorem)."""
    cosine = abs(c * c2 + s * s2)
    sine = abs(c * s2 - s * c2)
    if abs(dx * c + dy * s) > along + along2 * cosine + across2 * sine:
        return True
    return abs(dy * c - dx * s) > across + along2 * sine + across2 * cosine


@jit
def cells_to_uprights(
    hands: Floats, outer: Floats, centers: Floats, sizes: Floats, c2: float, s2: float, cap_m: float
) -> tuple[Floats, NDArray[np.int64]]:
    """Distances to the nearest of K cube cells.

    Args:
        hands: (M, B, 8) upright boxes of each hand, of `hand_distance.hand_uprights`, m.
        outer: (M, 8) a box round all of a hand's, m.
        centers: (K, 3) float64, base frame, m.
        sizes: (K,) float64 edges, m.
        c2: cosine of the cells' turn about z.
        s2: its sine.
        cap_m: what is farther counts as so far, m.

    Returns:
        (M,) float64, m, and (M,) int64 rows, -1 where none is nearer.
    """
    count, parts = hands.shape[0], hands.shape[1]
    best = np.full(count, cap_m)
    nearest = np.full(count, -1, dtype=np.int64)
    corners = np.empty((parts, 4, 2))
    own = np.empty((4, 2))
    for m in range(count):
        c, s = outer[m, 2], outer[m, 3]
        for b in range(parts):
            box = hands[m, b]
            _corners(box[0], box[1], c, s, box[4], box[5], corners[b])
        for i in range(centers.shape[0]):
            half = sizes[i] / 2
            w = max(centers[i, 2] - half - outer[m, 7], outer[m, 6] - centers[i, 2] - half, 0.0)
            if w >= best[m]:
                continue
            x, y = centers[i, 0], centers[i, 1]
            reach = outer[m, 4] + outer[m, 5] + 2 * half + best[m]
            if abs(x - outer[m, 0]) > reach or abs(y - outer[m, 1]) > reach:
                continue
            for b in range(parts):
                box = hands[m, b]
                w = max(centers[i, 2] - half - box[7], box[6] - centers[i, 2] - half, 0.0)
                if w >= best[m]:
                    continue
                gap = _plan_gap(box, corners[b], x, y, half, c2, s2, own)
                distance = np.sqrt(gap + w * w)
                if distance < best[m]:
                    best[m] = distance
                    nearest[m] = i
    return best, nearest


@jit
def _plan_gap(
    box: Floats, corners: Floats, x: float, y: float, half: float, c2: float, s2: float, own: Floats
) -> float:
    """Squared distance in plan of an upright box to a square cell; `own` is scratch, (4, 2)."""
    cx, cy, c, s, along, across = box[0], box[1], box[2], box[3], box[4], box[5]
    dx, dy = x - cx, y - cy
    if not (
        _apart(dx, dy, c, s, along, across, c2, s2, half, half)
        or _apart(dx, dy, c2, s2, half, half, c, s, along, across)
    ):
        return 0.0
    _corners(x, y, c2, s2, half, half, own)
    return min(
        _corner_gap(cx, cy, c, s, along, across, own),
        _corner_gap(x, y, c2, s2, half, half, corners),
    )


@jit
def _corners(
    cx: float, cy: float, c: float, s: float, along: float, across: float, out: Floats
) -> None:
    """The corners of a turned rectangle, into out (4, 2)."""
    for k in range(4):
        a = along if k < 2 else -along
        b = across if k % 2 == 0 else -across
        out[k, 0] = cx + a * c - b * s
        out[k, 1] = cy + a * s + b * c


@jit
def filled_shares(
    hands: Floats, outer: Floats, centers: Floats, edge_m: float, grow_m: float
) -> Floats:
    """Share of each hand's boxes, every box grown on every side, that cubes fill.

    Args:
        hands: (M, B, 8) upright boxes of each hand, of `hand_distance.hand_uprights`, m.
        outer: (M, 8) a box round all of a hand's, m.
        centers: (K, 3) float64, base frame, m, of cubes whose sides are along the boxes' own, as
            those of the local map are.
        edge_m: of the cubes, m.
        grow_m: on every side, m.

    Returns:
        (M,) float64, 0 to 1.
    """
    count, parts = hands.shape[0], hands.shape[1]
    shares = np.zeros(count)
    half = edge_m / 2
    for m in range(count):
        held, volume = 0.0, 0.0
        for b in range(parts):
            box = hands[m, b]
            tall = (box[7] + grow_m) - (box[6] - grow_m)
            volume += 4.0 * (box[4] + grow_m) * (box[5] + grow_m) * tall
        for i in range(centers.shape[0]):
            shared = _common(outer[m], centers[i], half, grow_m)
            if parts == 1:
                held += shared
            elif shared > 0.0:
                for b in range(parts):
                    held += _common(hands[m, b], centers[i], half, grow_m)
        shares[m] = min(1.0, held / volume)
    return shares


@jit
def _common(box: Floats, center: Floats, half: float, grow_m: float) -> float:
    """Volume that a grown upright box and a cube turned alike have in common, m3."""
    c, s = box[2], box[3]
    along, across = box[4] + grow_m, box[5] + grow_m
    low, high = box[6] - grow_m, box[7] + grow_m
    dx, dy = center[0] - box[0], center[1] - box[1]
    u, v, z = dx * c + dy * s, dy * c - dx * s, center[2]
    a = min(along, u + half) - max(-along, u - half)
    b = min(across, v + half) - max(-across, v - half)
    h = min(high, z + half) - max(low, z - half)
    return a * b * h if a > 0.0 and b > 0.0 and h > 0.0 else 0.0
