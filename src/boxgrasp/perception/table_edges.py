"""Strips of a table's own edge and specks of noise: clusters that are no things."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Floats, Points
from boxgrasp.geometry.transforms import transform
from boxgrasp.perception.lines_of_sight import depth_towards
from boxgrasp.perception.segmentation.clusters import Clusters
from boxgrasp.sensing.capture import Capture

# Found on cast tables with edges and on the real captures whose tables end in view.
_LOW_M = 0.015  # over the plane, up to which a cluster may be the table's own edge, curled up
_TALL_SHARE = 0.05  # of its points may lie higher
_OFF_M = (0.03, 0.06, 0.09)  # beside a point at the edge there is no table, nor farther out
_DIRECTIONS = 16
_THROUGH_M = 0.03  # behind the plane, from which the camera is seen to look past the table
_EDGE_SHARE = 0.5  # of its points that lie at the edge at least
_SPECK = 64  # voxels, 6 cm2: fewer are a speck where they are also
_SPECK_WIDE_M = 0.020  # no wider than this: veils left over, noise at outlines


def are_no_things(
    capture: Capture, T_source_table: Floats, points: Points, clusters: Clusters
) -> NDArray[np.bool_]:
    """Which clusters are strips of the table's edge or specks.

    Args:
        capture: the view; without a depth image no edge is looked for.
        T_source_table: (4, 4), z = 0 on the table.
        points: (K, 3) float32, table frame, m.
        clusters: (K,) int64 ids from 0, -1 for none.

    Returns:
        (C,) bool.
    """
    held = clusters >= 0
    sizes = np.bincount(clusters[held])
    tall = np.bincount(clusters[held], points[held, 2] > _LOW_M)
    low = tall <= _TALL_SHARE * sizes
    found = np.zeros(len(sizes), dtype=np.bool_)
    for cluster in np.flatnonzero((sizes > 0) & (low | (sizes < _SPECK))).tolist():
        own = points[clusters == cluster]
        speck = len(own) < _SPECK and _width_m(own) < _SPECK_WIDE_M
        found[cluster] = speck or (low[cluster] and _at_edge(capture, T_source_table, own))
    return found


def _width_m(points: Points) -> float:
    """Extent along the second of a cluster's three axes: a line's and a veil's are narrow."""
    off = points - points.mean(axis=0)
    _, axes = np.linalg.eigh(off.T @ off)
    return float(np.sort(np.ptp(off @ axes, axis=0))[1])


def _at_edge(capture: Capture, T_source_table: Floats, points: Points) -> bool:
    """Whether the table ends beside half of the points: the camera looks past it there.

    Where depth is missing the table may go on, so that on the way out it must be looked past at
    least once, and never be seen.
    """
    if capture.depth is None or capture.intrinsics is None:
        return False
    turns = np.arange(_DIRECTIONS) * (2 * np.pi / _DIRECTIONS)
    ways = np.column_stack((np.cos(turns), np.sin(turns)))
    off = np.array(_OFF_M)[:, None, None] * ways
    on_table = np.zeros((len(points), *off.shape[:2], 3), dtype=np.float32)
    on_table[..., :2] = points[:, None, None, :2] + off  # points, distances, directions
    through, missing = _seen(capture.depth, capture.intrinsics, transform(T_source_table, on_table))
    ends = (through | missing).all(axis=1) & through.any(axis=1)
    return bool(np.count_nonzero(np.any(ends, axis=1)) >= _EDGE_SHARE * len(points))


def _seen(
    depth: Points, intrinsics: Floats, places: Points
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Whether the camera looks through each place (..., 3), optical frame, and has no depth."""
    found, inside = depth_towards(depth, intrinsics, places)
    return inside & (found > places[..., 2] + _THROUGH_M), inside & (found == 0)
