"""Distances of upright boxes (a turned rectangle in plan, an interval in height), exact."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Floats
from boxgrasp.kernels._jit import jit


@jit
def columns_to_uprights(
    boxes: Floats,
    columns: NDArray[np.float32],
    distances: Floats,
    nearest: NDArray[np.int64],
    first: int,
    last: int,
) -> None:
    """Lower distances[first:last] to the nearest column, and note which it is.

    Args:
        boxes: (M, 8) of `hand_distance.uprights`, m.
        columns: (N, 4) float32 x, y, lowest z, highest z, base frame, m.
        distances: (M,) float64 to lower, m.
        nearest: (M,) int64 to fill.
        first: row of the boxes.
        last: row of the boxes.
    """
    for m in range(first, last):
        cx, cy, c, s = boxes[m, 0], boxes[m, 1], boxes[m, 2], boxes[m, 3]
        along, across, low, high = boxes[m, 4], boxes[m, 5], boxes[m, 6], boxes[m, 7]
        least = distances[m] * distances[m]
        for i in range(columns.shape[0]):
            w = max(columns[i, 2] - high, low - columns[i, 3], 0.0)
            if w * w >= least:
                continue
            x = columns[i, 0] - cx
            y = columns[i, 1] - cy
            u = max(abs(x * c + y * s) - along, 0.0)
            v = max(abs(y * c - x * s) - across, 0.0)
            d = u * u + v * v + w * w
            if d < least:
                least = d
                nearest[m] = i
        distances[m] = np.sqrt(least)


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
    boxes: Floats, centers: Floats, sizes: Floats, c2: float, s2: float, cap_m: float
) -> tuple[Floats, NDArray[np.int64]]:
    """Distances to the nearest of K cube cells.

    Args:
        boxes: (M, 8) of `hand_distance.uprights`, m.
        centers: (K, 3) float64, base frame, m.
        sizes: (K,) float64 edges, m.
        c2: cosine of the cells' turn about z.
        s2: its sine.
        cap_m: what is farther counts as so far, m.

    Returns:
        (M,) float64, m, and (M,) int64 rows, -1 where none is nearer.
    """
    count = boxes.shape[0]
    best = np.full(count, cap_m)
    nearest = np.full(count, -1, dtype=np.int64)
    first = np.empty((4, 2))
    second = np.empty((4, 2))
    for m in range(count):
        cx, cy, c, s = boxes[m, 0], boxes[m, 1], boxes[m, 2], boxes[m, 3]
        along, across, low, high = boxes[m, 4], boxes[m, 5], boxes[m, 6], boxes[m, 7]
        for k in range(4):
            a = along if k < 2 else -along
            b = across if k % 2 == 0 else -across
            first[k, 0] = cx + a * c - b * s
            first[k, 1] = cy + a * s + b * c
        for i in range(centers.shape[0]):
            half = sizes[i] / 2
            w = max(centers[i, 2] - half - high, low - centers[i, 2] - half, 0.0)
            if w >= best[m]:
                continue
            x, y = centers[i, 0], centers[i, 1]
            dx, dy = x - cx, y - cy
            reach = along + across + 2 * half + best[m]
            if abs(dx) > reach or abs(dy) > reach:
                continue
            gap = 0.0
            if _apart(dx, dy, c, s, along, across, c2, s2, half, half) or _apart(
                dx, dy, c2, s2, half, half, c, s, along, across
            ):
                for k in range(4):
                    a = half if k < 2 else -half
                    b = half if k % 2 == 0 else -half
                    second[k, 0] = x + a * c2 - b * s2
                    second[k, 1] = y + a * s2 + b * c2
                gap = min(
                    _corner_gap(cx, cy, c, s, along, across, second),
                    _corner_gap(x, y, c2, s2, half, half, first),
                )
            distance = np.sqrt(gap + w * w)
            if distance < best[m]:
                best[m] = distance
                nearest[m] = i
    return best, nearest


@jit
def filled_shares(boxes: Floats, centers: Floats, edge_m: float, grow_m: float) -> Floats:
    """Share of each upright box, grown on every side, that cubes fill.

    Args:
        boxes: (M, 8) of `hand_distance.uprights`, m.
        centers: (K, 3) float64, base frame, m, of cubes whose sides are along the boxes' own, as
            those of the local map are.
        edge_m: of the cubes, m.
        grow_m: on every side, m.

    Returns:
        (M,) float64, 0 to 1.
    """
    shares = np.zeros(boxes.shape[0])
    half = edge_m / 2
    for m in range(boxes.shape[0]):
        c, s = boxes[m, 2], boxes[m, 3]
        along, across = boxes[m, 4] + grow_m, boxes[m, 5] + grow_m
        low, high = boxes[m, 6] - grow_m, boxes[m, 7] + grow_m
        held = 0.0
        for i in range(centers.shape[0]):
            dx, dy = centers[i, 0] - boxes[m, 0], centers[i, 1] - boxes[m, 1]
            u, v, z = dx * c + dy * s, dy * c - dx * s, centers[i, 2]
            a = min(along, u + half) - max(-along, u - half)
            b = min(across, v + half) - max(-across, v - half)
            h = min(high, z + half) - max(low, z - half)
            if a > 0.0 and b > 0.0 and h > 0.0:
                held += a * b * h
        shares[m] = min(1.0, held / (4.0 * along * across * (high - low)))
    return shares
