"""A hand's surface as a few boxes along its approach."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from boxgrasp.arrays import Floats
from boxgrasp.grasps.gripper import HandBox

SLICE_M: Final = 0.004  # boxes begin and end at multiples of it; sloped parts widen them by less
MOST_BOXES: Final = 4  # of a palm or a finger: each costs the checks time
_LOOSENESS: Final = 1.12  # of the boxes' volume to that of all slices; more boxes would win little
_EDGES: Final = ((0, 1), (1, 2), (2, 0))


def slice_extents(triangles_m: Floats) -> Floats:
    """The extents of a surface between planes of constant x.

    Args:
        triangles_m: (N, 3, 3) float64 corners of its triangles, hand's axes, m.

    Returns:
        (S, 6) float64, m: low and high x, y and z of each slice that holds some of it.
    """
    if not len(triangles_m):
        return np.zeros((0, 6))
    low, high = triangles_m[..., 0].min(), triangles_m[..., 0].max()
    first, last = math.floor(low / SLICE_M + 1e-6), math.ceil(high / SLICE_M - 1e-6)
    planes = SLICE_M * np.arange(first, max(last, first + 1) + 1)
    points: Floats = triangles_m.reshape(-1, 3)
    order = np.argsort(points[:, 0], kind="stable")
    points = points[order]
    cuts = [_crossings(triangles_m, x) for x in planes]
    rows = []
    for k, (near, far) in enumerate(zip(planes[:-1], planes[1:], strict=True)):
        ends = np.searchsorted(points[:, 0], (near - 1e-9, far + 1e-9))
        held = np.concatenate((points[ends[0] : ends[1]], cuts[k], cuts[k + 1]))
        if len(held):
            rows.append(np.stack((held.min(axis=0), held.max(axis=0)), axis=1).reshape(-1))
    return np.array(rows).reshape(-1, 6)


def _crossings(triangles_m: Floats, x: float) -> Floats:
    """(K, 3) points where the triangles' edges meet a plane of constant x."""
    found = []
    for a, b in _EDGES:
        start, end = triangles_m[:, a], triangles_m[:, b]
        across = (start[:, 0] < x) != (end[:, 0] < x)
        start, way = start[across], (end - start)[across]
        point = start + way * ((x - start[:, 0]) / way[:, 0])[:, None]
        point[:, 0] = x
        found.append(point)
    return np.concatenate(found)


def fit_boxes(extents_m: Floats, most: int = MOST_BOXES) -> tuple[HandBox, ...]:
    """The few boxes of least volume that hold all slices, each a run of slices.

    Args:
        extents_m: (S, 6) of `slice_extents`, of one surface or of several.
        most: boxes at most; fewer where they are hardly larger.

    Returns:
        Boxes in order along x.
    """
    if not len(extents_m):
        return ()
    runs = _merged(extents_m)
    fine = sum(_volume(run) for run in runs)
    best: list[tuple[float, tuple[int, ...]]] = [(0.0, ()), *((math.inf, ()) for _ in runs)]
    for _ in range(min(most, len(runs))):
        best = [(math.inf, ()), *(_cheapest(best, runs, end) for end in range(1, len(runs) + 1))]
        if best[-1][0] <= _LOOSENESS * fine:
            break
    starts = best[-1][1]
    hulls = [_hull(runs[a:b]) for a, b in zip(starts, (*starts[1:], len(runs)), strict=True)]
    return tuple(_box(hull) for hull in hulls)


def _cheapest(
    best: Sequence[tuple[float, tuple[int, ...]]], runs: Sequence[Floats], end: int
) -> tuple[float, tuple[int, ...]]:
    """With one more box, which ends there: the least volume, and where the boxes start."""
    costs = ((best[a][0] + _volume(_hull(runs[a:end])), (*best[a][1], a)) for a in range(end))
    return min(costs, key=lambda cost: cost[0])


def _merged(extents_m: Floats) -> list[Floats]:
    """One row a place along x, of all rows whose slice lies there."""
    places = np.floor((extents_m[:, 0] + extents_m[:, 1]) / 2 / SLICE_M + 1e-9).astype(int)
    return [_hull(extents_m[places == place]) for place in np.unique(places)]


def _hull(rows: Sequence[Floats] | Floats) -> Floats:
    held = np.asarray(rows)
    hull = np.empty(6)
    hull[::2], hull[1::2] = held[:, ::2].min(axis=0), held[:, 1::2].max(axis=0)
    return hull


def _volume(row: Floats) -> float:
    return float(np.prod(row[1::2] - row[::2]))


def _box(row: Floats) -> HandBox:
    x0, x1, y0, y1, z0, z1 = (round(float(value), 5) for value in row)
    return HandBox((x0, x1), (y0, y1), (z0, z1))
