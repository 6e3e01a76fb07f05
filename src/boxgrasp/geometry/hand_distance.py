"""The only distances of the package: gripper boxes to points, columns, cells and the plane.

Every gripper box of a candidate is upright: its faces are vertical or level in the base frame,
since the box stands on the support plane and candidates turn by quarters. So a distance splits
into one in plan (a turned rectangle) and one in height, and stays exact.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Floats
from boxgrasp.kernels._threads import run_chunks
from boxgrasp.kernels.uprights import cells_to_uprights, columns_to_uprights

CAP_M = 0.50


def uprights(T_base_gripper: Floats, half_m: Floats, swept_back_m: float = 0.0) -> Floats:
    """(M, 8) upright boxes: center x, y, cosine, sine, half along, half across, z low, z high.

    `swept_back_m` stretches each box backwards along its approach: the space it passes.
    """
    boxes = np.empty((len(T_base_gripper), 8))
    for k, T in enumerate(T_base_gripper):
        half = np.array(half_m, dtype=np.float64)
        center = T[:3, 3] - T[:3, 0] * (swept_back_m / 2)
        half[0] += swept_back_m / 2
        level = int(np.argmax(np.abs(T[2, :3])))  # the gripper axis that stands upright
        along = T[:3, 1] if level == 0 else T[:3, 0]
        across = 3 - level - (1 if level == 0 else 0)
        boxes[k] = (
            center[0],
            center[1],
            along[0],
            along[1],
            half[1 if level == 0 else 0],
            half[across],
            center[2] - half[level],
            center[2] + half[level],
        )
    return boxes


def to_columns(boxes: Floats, columns: NDArray[np.float32]) -> tuple[Floats, NDArray[np.int64]]:
    """Distance of each upright box to the nearest column, and which column that is.

    columns: (N, 4) float32 base frame x, y, z low, z high; a point is a column of no height.
    Returns (M,) meters capped at 0.50, 0 inside, and (M,) index (-1 where none is near).
    """
    distances = np.full(len(boxes), CAP_M)
    nearest = np.full(len(boxes), -1, dtype=np.int64)

    def work(first: int, last: int) -> None:
        columns_to_uprights(boxes, columns, distances, nearest, first, last)

    run_chunks(work, len(boxes), smallest=4)
    return distances, nearest


def to_points(boxes: Floats, points: NDArray[np.float32]) -> tuple[Floats, NDArray[np.int64]]:
    """Distance of each upright box to the nearest of (N, 3) points, and its index."""
    return to_columns(boxes, np.ascontiguousarray(points[:, (0, 1, 2, 2)]))


def to_cells(boxes: Floats, centers: Floats, sizes_m: Floats, yaw_rad: float) -> Floats:
    """Distance of each upright box to the nearest cube cell; (M,) meters capped, 0 inside.

    centers: (K, 3) base frame; sizes_m: (K,) edges; yaw_rad: the cells' turn about base z.
    """
    return cells_to_uprights(
        boxes,
        np.ascontiguousarray(centers, dtype=np.float64),
        np.ascontiguousarray(sizes_m, dtype=np.float64),
        float(np.cos(yaw_rad)),
        float(np.sin(yaw_rad)),
        CAP_M,
    )


def to_plane(boxes: Floats, normal: Floats, offset_m: float) -> Floats:
    """Signed height of each upright box's lowest corner over the plane n.p + offset = 0."""
    lowest = np.where(normal[2] >= 0, boxes[:, 6], boxes[:, 7])
    along = boxes[:, 2:4] @ normal[:2]
    across = boxes[:, 2] * normal[1] - boxes[:, 3] * normal[0]
    reach = np.abs(along) * boxes[:, 4] + np.abs(across) * boxes[:, 5]
    heights = boxes[:, :2] @ normal[:2] + lowest * normal[2] + offset_m - reach
    return np.asarray(np.clip(heights, -CAP_M, CAP_M))
