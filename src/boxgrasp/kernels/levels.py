"""Level surfaces: points near them in plan, the heights that cells share, their small patches."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Floats, Points
from boxgrasp.kernels._jit import jit

_MOST_CELLS = 4_000_000  # of a grid


@jit
def points_near(
    points: Points,
    step: int,
    T_table_source: Floats,
    camera_position_m: Floats,
    farthest_m: float,
    height_m: float,
    found: Points,
) -> int:
    """Take every few points that lie near a table's plane and in reach of the camera.

    Args:
        points: (N, 3) float32, source frame, m.
        step: 1 for all.
        T_table_source: (4, 4).
        camera_position_m: (3,) source frame, m.
        farthest_m: from the camera, m.
        height_m: over or under the plane, m.
        found: (N / step + 1, 3) float32 to fill, table frame, m.

    Returns:
        How many were found.
    """
    T, camera, count = T_table_source, camera_position_m, 0
    for i in range(0, points.shape[0], step):
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        z = T[2, 0] * px + T[2, 1] * py + T[2, 2] * pz + T[2, 3]
        if abs(z) >= height_m:
            continue
        dx, dy, dz = px - camera[0], py - camera[1], pz - camera[2]
        if dx * dx + dy * dy + dz * dz > farthest_m * farthest_m:
            continue
        found[count, 0] = T[0, 0] * px + T[0, 1] * py + T[0, 2] * pz + T[0, 3]
        found[count, 1] = T[1, 0] * px + T[1, 1] * py + T[1, 2] * pz + T[1, 3]
        found[count, 2] = z
        count += 1
    return count


@jit
def cells_at_heights(
    points: Points,
    corner_m: Floats,
    shape: tuple[int, int],
    cell_m: float,
    bin_m: float,
    bins: int,
) -> NDArray[np.int64]:
    """How many cells of the plan hold points at each height.

    Args:
        points: (N, 3) float32, table frame, m, all within the plan.
        corner_m: (2,) lowest x and y of the plan, m.
        shape: rows and columns of the plan.
        cell_m: edge of a cell, m.
        bin_m: of height, m.
        bins: over and under 0, each.

    Returns:
        (2 bins,) int64, from the lowest; higher and lower points count nowhere.
    """
    held = np.zeros((shape[0] * shape[1], 2 * bins), dtype=np.bool_)
    counts = np.zeros(2 * bins, dtype=np.int64)
    for i in range(points.shape[0]):
        at = int(np.floor(points[i, 2] / bin_m)) + bins
        if at < 0 or at >= 2 * bins:
            continue
        row = int(np.floor((points[i, 0] - corner_m[0]) / cell_m))
        column = int(np.floor((points[i, 1] - corner_m[1]) / cell_m))
        cell = row * shape[1] + column
        if not held[cell, at]:
            held[cell, at] = True
            counts[at] += 1
    return counts


@jit
def patch_moments(points: Points, T_plane_source: Floats, height_m: float, cell_m: float) -> Floats:
    """Sums over the points near a plane in each cell of its plan.

    Args:
        points: (N, 3) float32, source frame, m.
        T_plane_source: (4, 4), z = 0 on the plane.
        height_m: over or under it, m.
        cell_m: edge of a cell, m.

    Returns:
        (C, 10) float64: count, means of x, y, z, and of the products xx, xy, xz, yy, yz, zz of
        what they differ from these by, plane's frame, m; cells without points are left out.
    """
    T = T_plane_source
    local = np.empty((points.shape[0], 3))
    count = 0
    for i in range(points.shape[0]):
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        z = T[2, 0] * px + T[2, 1] * py + T[2, 2] * pz + T[2, 3]
        if abs(z) < height_m:
            local[count, 0] = T[0, 0] * px + T[0, 1] * py + T[0, 2] * pz + T[0, 3]
            local[count, 1] = T[1, 0] * px + T[1, 1] * py + T[1, 2] * pz + T[1, 3]
            local[count, 2] = z
            count += 1
    if count == 0:
        return np.zeros((0, 10))
    low_x, low_y = local[:count, 0].min(), local[:count, 1].min()
    rows = int((local[:count, 0].max() - low_x) / cell_m) + 1
    columns = int((local[:count, 1].max() - low_y) / cell_m) + 1
    if rows * columns > _MOST_CELLS:
        return np.zeros((0, 10))
    number = np.full(rows * columns, -1, dtype=np.int64)
    sums = np.zeros((min(count, rows * columns), 10))
    own = np.empty(count, dtype=np.int64)
    cells = 0
    for i in range(count):
        at = int((local[i, 0] - low_x) / cell_m) * columns + int((local[i, 1] - low_y) / cell_m)
        if number[at] < 0:
            number[at] = cells
            cells += 1
        own[i] = number[at]
        sums[own[i], 0] += 1.0
        for k in range(3):
            sums[own[i], 1 + k] += local[i, k]
    for c in range(cells):
        for k in range(3):
            sums[c, 1 + k] /= sums[c, 0]
    for i in range(count):
        c = own[i]
        x, y, z = (local[i, 0] - sums[c, 1], local[i, 1] - sums[c, 2], local[i, 2] - sums[c, 3])
        sums[c, 4] += x * x
        sums[c, 5] += x * y
        sums[c, 6] += x * z
        sums[c, 7] += y * y
        sums[c, 8] += y * z
        sums[c, 9] += z * z
    for c in range(cells):
        for k in range(4, 10):
            sums[c, k] /= sums[c, 0]
    return sums[:cells]


@jit
def on_and_under(
    points: Points, plane: Floats, on_m: float, under_m: float, cell_m: float
) -> tuple[int, int]:
    """Points on a plane, and those just under it in cells of the plan that hold any on it.

    Args:
        points: (N, 3) float32, source frame, m.
        plane: (4,) float64 unit normal n and d of n . p + d = 0, m.
        on_m: how far from the plane points are on it, m.
        under_m: how far under it they count, m.
        cell_m: edge of a cell, m.

    Returns:
        The two counts.
    """
    nx, ny, nz, d = plane[0], plane[1], plane[2], plane[3]
    # Two axes on the plane, of which the first lies across the axis farthest from the normal.
    first = np.array([0.0, nz, -ny]) if abs(nx) < 0.6 else np.array([-nz, 0.0, nx])
    first /= np.sqrt(np.sum(first * first))
    second = np.cross(plane[:3], first)
    cells = np.empty((points.shape[0], 2), dtype=np.int64)
    on = np.zeros(points.shape[0], dtype=np.bool_)
    count = 0
    for i in range(points.shape[0]):
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        z = nx * px + ny * py + nz * pz + d
        if -under_m < z < on_m:
            x = first[0] * px + first[1] * py + first[2] * pz
            y = second[0] * px + second[1] * py + second[2] * pz
            cells[count, 0], cells[count, 1] = int(np.floor(x / cell_m)), int(np.floor(y / cell_m))
            on[count] = z > -on_m
            count += 1
    if count == 0:
        return 0, 0
    low_x, low_y = cells[:count, 0].min(), cells[:count, 1].min()
    rows = cells[:count, 0].max() - low_x + 1
    columns = cells[:count, 1].max() - low_y + 1
    if rows * columns > _MOST_CELLS:
        return 0, 0
    held = np.zeros((rows, columns), dtype=np.bool_)
    for i in range(count):
        if on[i]:
            held[cells[i, 0] - low_x, cells[i, 1] - low_y] = True
    upper, lower = 0, 0
    for i in range(count):
        if on[i]:
            upper += 1
        elif held[cells[i, 0] - low_x, cells[i, 1] - low_y]:
            lower += 1
    return upper, lower
