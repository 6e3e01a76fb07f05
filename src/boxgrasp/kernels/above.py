"""Points over the support plane, in the plane's own frame, in one pass."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Floats, Points
from boxgrasp.kernels._jit import jit


@jit
def above_plane(
    points: Points,
    T_table_source: Floats,
    camera_position_m: Floats,
    band_m: float,
    noise_gain: float,
    noise: tuple[float, float, float],
    max_height_m: float,
    farthest_m: float,
    planes: Floats,
    owner: NDArray[np.int8],
    plan: tuple[float, float, float],
    found: Points,
    index: NDArray[np.int32],
) -> int:
    """Take the points over the band that the noise of what they stand over reaches.

    Args:
        points: (N, 3) float32, source frame, m.
        T_table_source: (4, 4).
        camera_position_m: (3,) table frame, m.
        band_m: height of the band, m, beside the noise.
        noise_gain: how many times the axial noise at a point's range is added to it; 0 for none.
        noise: floor, growth and range of the least noise: floor + growth (range - least)^2, m.
        max_height_m: points over it are left out, m.
        farthest_m: so are those farther from the camera, m.
        planes: (S, 4) float64 unit normals n and d of the surfaces, table frame, m; the first is
            the table's own, z = 0.
        owner: (R, C) int8, which of them a cell of the plan belongs to; (0, 0) for the first alone.
        plan: lowest x and y of the cells and their edge, m.
        found: (N, 3) float32 to fill, table frame, m.
        index: (N,) int32 to fill, rows of the points found.

    Returns:
        How many were found.
    """
    T = T_table_source
    floor, growth, least_at = noise
    low_x, low_y, cell_m = plan
    count = 0
    for i in range(points.shape[0]):
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        z = T[2, 0] * px + T[2, 1] * py + T[2, 2] * pz + T[2, 3]
        if z > max_height_m or (z < band_m and owner.size == 0):
            continue
        x = T[0, 0] * px + T[0, 1] * py + T[0, 2] * pz + T[0, 3]
        y = T[1, 0] * px + T[1, 1] * py + T[1, 2] * pz + T[1, 3]
        over = z
        if owner.size > 0:
            row, column = int(np.floor((x - low_x) / cell_m)), int(np.floor((y - low_y) / cell_m))
            if 0 <= row < owner.shape[0] and 0 <= column < owner.shape[1]:
                own = planes[owner[row, column]]
                over = own[0] * x + own[1] * y + own[2] * z + own[3]
            if over < band_m:
                continue
        dx = x - camera_position_m[0]
        dy = y - camera_position_m[1]
        dz = z - camera_position_m[2]
        square = dx * dx + dy * dy + dz * dz
        if square > farthest_m * farthest_m:
            continue
        if noise_gain > 0.0:
            away = square**0.5 - least_at
            if over < band_m + noise_gain * (floor + growth * away * away):
                continue
        found[count, 0] = x
        found[count, 1] = y
        found[count, 2] = z
        index[count] = i
        count += 1
    return count
