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
    found: Points,
    index: NDArray[np.int32],
) -> int:
    """Take the points over the band that the table's own noise reaches.

    Args:
        points: (N, 3) float32, source frame, m.
        T_table_source: (4, 4).
        camera_position_m: (3,) table frame, m.
        band_m: height of the band, m, beside the noise.
        noise_gain: how many times the axial noise at a point's range is added to it; 0 for none.
        noise: floor, growth and range of the least noise: floor + growth (range - least)^2, m.
        max_height_m: points over it are left out, m.
        farthest_m: so are those farther from the camera, m.
        found: (N, 3) float32 to fill, table frame, m.
        index: (N,) int32 to fill, rows of the points found.

    Returns:
        How many were found.
    """
    T = T_table_source
    floor, growth, least_at = noise
    count = 0
    for i in range(points.shape[0]):
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        z = T[2, 0] * px + T[2, 1] * py + T[2, 2] * pz + T[2, 3]
        if z < band_m or z > max_height_m:
            continue
        x = T[0, 0] * px + T[0, 1] * py + T[0, 2] * pz + T[0, 3]
        y = T[1, 0] * px + T[1, 1] * py + T[1, 2] * pz + T[1, 3]
        dx = x - camera_position_m[0]
        dy = y - camera_position_m[1]
        dz = z - camera_position_m[2]
        square = dx * dx + dy * dy + dz * dz
        if square > farthest_m * farthest_m:
            continue
        if noise_gain > 0.0:
            away = square**0.5 - least_at
            if z < band_m + noise_gain * (floor + growth * away * away):
                continue
        found[count, 0] = x
        found[count, 1] = y
        found[count, 2] = z
        index[count] = i
        count += 1
    return count
