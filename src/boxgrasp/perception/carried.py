"""Which clusters the table may carry.

Chairs, screens and what stands on other furniture reach over the plane of the table too. Under a
thing on a table the camera sees nothing: the table hides it, or something nearer. Where the camera
looks past the table under a cluster, or sees no depth there, the cluster must stand over table
that was seen.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Floats, Points
from boxgrasp.geometry.transforms import invert, transform
from boxgrasp.kernels.table_cells import regions
from boxgrasp.perception.lines_of_sight import depth_towards
from boxgrasp.perception.segmentation.clusters import Clusters
from boxgrasp.perception.support_plane import spans
from boxgrasp.sensing.capture import Capture

_CELL_M = 0.05  # m, cells in which the table was seen
_ON_M = 0.015  # m, what points on it may be off
_FAR_M = 10.0  # m, farther cells are damaged data's
_SAMPLE = 20_000  # points of the view tell where it was seen
_FULL_SHARE = 0.3  # of the pixels that a level cell would fill: a wall at its height fills few
_LEAST_CELLS = 12  # 3 dm2 of neighboring cells: less is another thing's top
_OVER_SHARE = 0.5  # of a cluster's points that lie over the seen table at least, if in doubt
_FEET = 300  # points of a cluster, put under the table, tell what hides them there
# Of them, hidden. In 59 captures 0.47 and more of each thing's, 0.12 and less of what stood behind.
_FEET_SHARE = 0.4
_DEEP_M = 0.03  # m under the table: there the camera would see what stands lower
_TABLE_M = 0.015  # m under the plane, to which the table itself may be seen


def are_carried(
    capture: Capture, T_source_table: Floats, view: Points, points: Points, clusters: Clusters
) -> NDArray[np.bool_]:
    """Which clusters the table may carry.

    Args:
        capture: the view; without a depth image nothing is looked for.
        T_source_table: (4, 4), z = 0 on the table.
        view: (N, 3) float32 all points of it, source frame, m.
        points: (K, 3) float32, table frame, m.
        clusters: (K,) int64 ids from 0, -1 for none.

    Returns:
        (C,) bool.
    """
    carried = np.ones(int(clusters.max(initial=-1)) + 1, dtype=np.bool_)
    if capture.depth is None or capture.intrinsics is None:
        return carried
    depth, intrinsics = capture.depth, capture.intrinsics
    doubtful = [
        cluster
        for cluster in range(len(carried))
        if _feet(depth, intrinsics, T_source_table, points[clusters == cluster]) < _FEET_SHARE
    ]
    if doubtful:
        seen = _SeenTable.of(intrinsics, T_source_table, view)
        for cluster in doubtful:
            own = points[clusters == cluster]
            carried[cluster] = len(own) == 0 or seen.under(own).mean() > _OVER_SHARE
    return carried


def _feet(depth: Points, intrinsics: Floats, T_source_table: Floats, points: Points) -> float:
    """The share of places under a cluster, a little deep in the table, that something hides."""
    if len(points) == 0:
        return 0.0
    under = points[:: max(1, len(points) // _FEET)].copy()
    under[:, 2] = -_DEEP_M
    places = transform(T_source_table, under)
    found, inside = depth_towards(depth, intrinsics, places)
    # Along one ray heights go from the camera's down to the place's as the depths do.
    camera_m = invert(T_source_table)[2, 3]
    shown_m = camera_m - (camera_m + _DEEP_M) * found / np.maximum(places[:, 2], np.float32(1e-3))
    hidden = ~inside | ((found > 0) & (shown_m > -_TABLE_M))  # past the border nothing is known
    return float(hidden.mean())


@dataclass(frozen=True, eq=False)
class _SeenTable:
    """The cells of the table that were seen, or lie between such, and the place of the first."""

    cells: NDArray[np.bool_]
    lowest: NDArray[np.int64]

    @staticmethod
    def of(intrinsics: Floats, T_source_table: Floats, view: Points) -> _SeenTable:
        """Those that a view shows."""
        step = max(1, len(view) // _SAMPLE)
        T_table_source = invert(T_source_table)
        local, camera_m = transform(T_table_source, view[::step]), T_table_source[:3, 3]
        on = (np.abs(local[:, 2]) < _ON_M) & (np.abs(local[:, :2]).max(axis=1) < _FAR_M)
        at = np.floor(local[on, :2] / _CELL_M).astype(np.int64)
        lowest, shape = at.min(axis=0) - 1, np.ptp(at, axis=0) + 3
        count = np.bincount(
            (at[:, 0] - lowest[0]) * shape[1] + at[:, 1] - lowest[1], minlength=int(shape.prod())
        )
        middles = (np.moveaxis(np.indices(tuple(shape.tolist())), 0, -1) + lowest + 0.5) * _CELL_M
        away = np.sqrt(((middles - camera_m[:2]) ** 2).sum(axis=-1) + camera_m[2] ** 2)
        full = (intrinsics[0, 0] * _CELL_M) ** 2 * abs(camera_m[2]) / away**3 / step
        part, parts = regions(count.reshape(shape) >= np.maximum(_FULL_SHARE * full, 1), False)
        large = np.append(np.bincount(part[part >= 0], minlength=parts) >= _LEAST_CELLS, False)
        return _SeenTable(spans(large[part]), lowest)

    def under(self, points: Points) -> NDArray[np.bool_]:
        """(N,) which points, table frame, lie over them."""
        at = np.floor(points[:, :2] / _CELL_M).astype(np.int64) - self.lowest
        inside = np.all((at >= 0) & (at < self.cells.shape), axis=1)
        inside[inside] = self.cells[tuple(at[inside].T)]
        return np.asarray(inside)
