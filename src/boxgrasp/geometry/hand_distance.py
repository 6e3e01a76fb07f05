"""The only distances of the package: a hand's box to points, columns, cells and the plane.

The hand's box of a candidate is upright: its faces are vertical or level in the base frame, since
the target's box stands on the support plane and candidates turn by quarters. So a distance splits
into one in plan (a turned rectangle) and one in height, and stays exact.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Floats, Points, readonly
from boxgrasp.kernels._threads import run_chunks
from boxgrasp.kernels.uprights import cells_to_uprights, columns_to_uprights

CAP_M = 0.50  # m; what is farther is in no grasp's way


def uprights(T_base_gripper: Floats, half_m: Floats, swept_back_m: float = 0.0) -> Floats:
    """Boxes as the distances here take them.

    Args:
        T_base_gripper: (M, 4, 4) float64, poses of the boxes' centers.
        half_m: (3,) half sizes along the gripper's x, y, z, m.
        swept_back_m: stretches each box backwards along its approach, m: the space it passes.

    Returns:
        (M, 8) float64, base frame, m: center x, y, cosine and sine of its turn, half along, half
        across, lowest z, highest z.
    """
    T = np.asarray(T_base_gripper, dtype=np.float64)
    half = np.array(half_m, dtype=np.float64)
    half[0] += swept_back_m / 2
    center = T[:, :3, 3] - T[:, :3, 0] * (swept_back_m / 2)
    level = np.argmax(np.abs(T[:, 2, :3]), axis=1)  # the gripper axis that stands upright
    along_axis = np.where(level == 0, 1, 0)
    along = T[np.arange(len(T)), :3, along_axis]
    across_axis = 3 - level - along_axis
    columns = (
        *center[:, :2].T,
        *along[:, :2].T,
        half[along_axis],
        half[across_axis],
        center[:, 2] - half[level],
        center[:, 2] + half[level],
    )
    return np.ascontiguousarray(np.column_stack(columns))


def to_columns(boxes: Floats, columns: NDArray[np.float32]) -> tuple[Floats, NDArray[np.int64]]:
    """Distance of each upright box to the nearest column, and which column that is.

    Args:
        boxes: (M, 8) of `uprights`.
        columns: (N, 4) float32, base frame, m: x, y, lowest z, highest z. A point is a column of
            no height.

    Returns:
        (M,) float64, m, capped at 0.50, 0 inside; and (M,) int64 row, -1 where none is nearer.
    """
    distances = np.full(len(boxes), CAP_M)
    nearest = np.full(len(boxes), -1, dtype=np.int64)

    def work(first: int, last: int) -> None:
        columns_to_uprights(boxes, columns, distances, nearest, first, last)

    run_chunks(work, len(boxes), smallest=4)
    return distances, nearest


def to_points(boxes: Floats, points: Points) -> tuple[Floats, NDArray[np.int64]]:
    """Distance of each upright box to the nearest point, and which point that is.

    Args:
        boxes: (M, 8) of `uprights`.
        points: (N, 3) float32, base frame, m.

    Returns:
        (M,) float64, m, and (M,) int64 row, as `to_columns`.
    """
    return to_columns(boxes, np.ascontiguousarray(points[:, (0, 1, 2, 2)]))


def to_cells(
    boxes: Floats, centers_m: Floats, edges_m: Floats, yaw_rad: float
) -> tuple[Floats, NDArray[np.int64]]:
    """Distance of each upright box to the nearest cube cell, and which cell that is.

    Args:
        boxes: (M, 8) of `uprights`.
        centers_m: (K, 3) float64, base frame, m.
        edges_m: (K,) edges of the cells, m.
        yaw_rad: the cells' turn about the base's z, rad.

    Returns:
        (M,) float64, m, and (M,) int64 row, as `to_columns`.
    """
    # Views that are closed to writing, whatever they are of: the kernel is compiled for one kind.
    given = (np.ascontiguousarray(a, np.float64).view() for a in (boxes, centers_m, edges_m))
    rows, centers, edges = (readonly(array) for array in given)
    turn = float(np.cos(yaw_rad)), float(np.sin(yaw_rad))
    return cells_to_uprights(rows, centers, edges, *turn, CAP_M)


def to_plane(boxes: Floats, normal: Floats, offset_m: float) -> Floats:
    """Signed height of each upright box's lowest corner over a plane.

    Args:
        boxes: (M, 8) of `uprights`.
        normal: (3,) unit normal n of the plane n . p + offset_m = 0, base frame.
        offset_m: m.

    Returns:
        (M,) float64, m, within 0.50 of 0; below 0 where the corner is under the plane.
    """
    lowest = np.where(normal[2] >= 0, boxes[:, 6], boxes[:, 7])
    along = boxes[:, 2:4] @ normal[:2]
    across = boxes[:, 2] * normal[1] - boxes[:, 3] * normal[0]
    reach = np.abs(along) * boxes[:, 4] + np.abs(across) * boxes[:, 5]
    heights = boxes[:, :2] @ normal[:2] + lowest * normal[2] + offset_m - reach
    return np.asarray(np.clip(heights, -CAP_M, CAP_M))


def lowest_corners(boxes: Floats, normal: Floats) -> Floats:
    """The corner of each upright box that is lowest along a normal.

    Args:
        boxes: (M, 8) of `uprights`.
        normal: (3,) unit normal, base frame.

    Returns:
        (M, 3) float64, base frame, m.
    """
    c, s = boxes[:, 2], boxes[:, 3]
    along = np.where(c * normal[0] + s * normal[1] > 0, -1.0, 1.0) * boxes[:, 4]
    across = np.where(c * normal[1] - s * normal[0] > 0, -1.0, 1.0) * boxes[:, 5]
    return np.column_stack(
        (
            boxes[:, 0] + along * c - across * s,
            boxes[:, 1] + along * s + across * c,
            np.where(normal[2] >= 0, boxes[:, 6], boxes[:, 7]),
        )
    )
