"""The only distances of the package: a hand's boxes to points, columns, cells and the plane.

The boxes of a candidate's hand are upright: their faces are vertical or level in the base frame,
since the target's box stands on the support plane and candidates turn by quarters. So a distance
splits into one in plan (a turned rectangle) and one in height, and stays exact.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Floats, Points, readonly
from boxgrasp.kernels._threads import run_chunks
from boxgrasp.kernels.uprights import cells_to_uprights, columns_to_uprights, filled_shares

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


def hand_uprights(T_base_gripper: Floats, boxes_m: Floats, swept_back_m: float = 0.0) -> Floats:
    """Hands of several boxes as the distances here take them.

    Args:
        T_base_gripper: (M, 4, 4) float64, poses of the hands.
        boxes_m: (B, 2, 3) lowest and highest corners in the gripper's frame, m.
        swept_back_m: as `uprights`.

    Returns:
        (M, B, 8) float64, each as `uprights`; all boxes of a hand have one turn.
    """
    T = np.asarray(T_base_gripper, dtype=np.float64)
    parts = []
    for low, high in boxes_m:
        moved, middle = T.copy(), (low + high) / 2
        moved[:, :3, 3] += T[:, :3, :3] @ middle
        parts.append(uprights(moved, (high - low) / 2, swept_back_m))
    return np.ascontiguousarray(np.stack(parts, axis=1))


def to_columns(
    hands: Floats, columns: NDArray[np.float32], cap_m: float = CAP_M
) -> tuple[Floats, NDArray[np.int64]]:
    """Distance of each hand to the nearest column, and which column that is.

    Args:
        hands: (M, 8) of `uprights`, or (M, B, 8) of `hand_uprights`.
        columns: (N, 4) float32, base frame, m: x, y, lowest z, highest z. A point is a column of
            no height.
        cap_m: what is farther counts as so far, m.

    Returns:
        (M,) float64, m, capped, 0 inside; and (M,) int64 row, -1 where none is nearer.
    """
    boxes, outer = _grouped(hands)
    distances = np.full(len(boxes), cap_m)
    nearest = np.full(len(boxes), -1, dtype=np.int64)

    def work(first: int, last: int) -> None:
        columns_to_uprights(boxes, outer, columns, distances, nearest, first, last)

    run_chunks(work, len(boxes), smallest=4)
    return distances, nearest


def to_points(
    hands: Floats, points: Points, cap_m: float = CAP_M
) -> tuple[Floats, NDArray[np.int64]]:
    """Distance of each hand to the nearest point, and which point that is.

    Args:
        hands: as `to_columns`.
        points: (N, 3) float32, base frame, m.
        cap_m: as `to_columns`.

    Returns:
        (M,) float64, m, and (M,) int64 row, as `to_columns`.
    """
    return to_columns(hands, np.ascontiguousarray(points[:, (0, 1, 2, 2)]), cap_m)


def to_cells(
    hands: Floats, centers_m: Floats, edges_m: Floats, yaw_rad: float, cap_m: float = CAP_M
) -> tuple[Floats, NDArray[np.int64]]:
    """Distance of each hand to the nearest cube cell, and which cell that is.

    Args:
        hands: as `to_columns`.
        centers_m: (K, 3) float64, base frame, m.
        edges_m: (K,) edges of the cells, m.
        yaw_rad: the cells' turn about the base's z, rad.
        cap_m: as `to_columns`.

    Returns:
        (M,) float64, m, and (M,) int64 row, as `to_columns`.
    """
    boxes, outer = _grouped(hands)
    return cells_to_uprights(
        boxes,
        outer,
        _closed(centers_m),
        _closed(edges_m),
        float(np.cos(yaw_rad)),
        float(np.sin(yaw_rad)),
        cap_m,
    )


def filled_fraction(hands: Floats, centers_m: Floats, edge_m: float, grow_m: float) -> Floats:
    """How much of each hand's boxes, every box grown to every side, cube cells fill.

    Args:
        hands: as `to_columns`.
        centers_m: (K, 3) float64, base frame, m, of cells turned as the hands are.
        edge_m: of the cells, m.
        grow_m: m.

    Returns:
        (M,) float64, 0 to 1.
    """
    boxes, outer = _grouped(hands)
    return filled_shares(boxes, outer, _closed(centers_m), edge_m, grow_m)


def to_plane(hands: Floats, normal: Floats, offset_m: float) -> Floats:
    """Signed height of each hand's lowest corner over a plane.

    Args:
        hands: as `to_columns`.
        normal: (3,) unit normal n of the plane n . p + offset_m = 0, base frame.
        offset_m: m.

    Returns:
        (M,) float64, m, within 0.50 of 0; below 0 where the corner is under the plane.
    """
    heights = lowest_corners(hands, normal) @ normal + offset_m
    return np.asarray(np.clip(heights, -CAP_M, CAP_M))


def lowest_corners(hands: Floats, normal: Floats) -> Floats:
    """The corner of each hand that is lowest along a normal.

    Args:
        hands: as `to_columns`.
        normal: (3,) unit normal, base frame.

    Returns:
        (M, 3) float64, base frame, m.
    """
    boxes = _grouped(hands)[0]
    c, s = boxes[..., 2], boxes[..., 3]
    along = np.where(c * normal[0] + s * normal[1] > 0, -1.0, 1.0) * boxes[..., 4]
    across = np.where(c * normal[1] - s * normal[0] > 0, -1.0, 1.0) * boxes[..., 5]
    corners = np.stack(
        (
            boxes[..., 0] + along * c - across * s,
            boxes[..., 1] + along * s + across * c,
            boxes[..., 6] if normal[2] >= 0 else boxes[..., 7],
        ),
        axis=-1,
    )
    lowest = np.argmin(corners @ normal, axis=1)
    return np.asarray(corners[np.arange(len(corners)), lowest])


def _closed(array: Floats) -> Floats:
    """A view in one piece and closed to writing, so that kernels are compiled for one kind."""
    return readonly(np.ascontiguousarray(array, dtype=np.float64).view())


def _grouped(hands: Floats) -> tuple[Floats, Floats]:
    """(M, B, 8) boxes of each hand, and (M, 8) a box round them."""
    if hands.ndim == 2:
        return _closed(hands[:, None]), _closed(hands)
    if hands.shape[1] == 1:
        return _closed(hands), _closed(hands[:, 0])
    c, s = hands[:, :1, 2], hands[:, :1, 3]
    u, v = hands[..., 0] * c + hands[..., 1] * s, hands[..., 1] * c - hands[..., 0] * s
    low_u, high_u = (u - hands[..., 4]).min(axis=1), (u + hands[..., 4]).max(axis=1)
    low_v, high_v = (v - hands[..., 5]).min(axis=1), (v + hands[..., 5]).max(axis=1)
    middle_u, middle_v, c, s = (low_u + high_u) / 2, (low_v + high_v) / 2, c[:, 0], s[:, 0]
    columns = (
        middle_u * c - middle_v * s,
        middle_u * s + middle_v * c,
        c,
        s,
        (high_u - low_u) / 2,
        (high_v - low_v) / 2,
        hands[..., 6].min(axis=1),
        hands[..., 7].max(axis=1),
    )
    return _closed(hands), _closed(np.column_stack(columns))
