"""A thing's outline: between its last pixel and the first one that shows what is behind it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Floats, Points
from boxgrasp.kernels._jit import jit

_LEVEL = 1e-3  # a ray that falls less, as a share of its length, meets no level


@jit
def outline_points(
    target: NDArray[np.bool_],
    points: Points,
    camera_position_m: Floats,
    reach_px: int,
    same_m: float,
    nearer_m: float,
    found: Floats,
) -> int:
    """Points of a thing's outline, at the height of its pixels there.

    From each pixel at its end a row or column is followed to the first pixel beyond that shows
    something else. What lies next to the last one in space is the thing's own, left out by the
    segmentation. The ray beyond passes the thing at its height; the outline is half way there.

    Args:
        target: (h, w) the thing's pixels.
        points: (h, w, 3) float32, what each pixel shows, base frame, m; NaN for nothing.
        camera_position_m: (3,) base frame, m.
        reach_px: pixels without depth that are passed at most, and one.
        same_m: what is nearer than this to the thing's last pixel is the thing itself, m.
        nearer_m: what is nearer to the camera by more than this hides the outline, m.
        found: (N, 3) float64 to fill, base frame, m; N four times the thing's pixels suffices.

    Returns:
        How many were found.
    """
    rows, columns = target.shape
    count = 0
    for v in range(rows):
        for u in range(columns):
            if not target[v, u]:
                continue
            for side in range(4):
                dv = -1 if side == 0 else (1 if side == 1 else 0)
                du = -1 if side == 2 else (1 if side == 3 else 0)
                last_v, last_u = v, u
                for k in range(1, reach_px + 1):
                    at_v, at_u = v + k * dv, u + k * du
                    if not (0 <= at_v < rows and 0 <= at_u < columns) or target[at_v, at_u]:
                        break
                    if np.isnan(points[at_v, at_u, 2]):
                        continue
                    square = 0.0
                    ray_square = 0.0
                    own_square = 0.0
                    for axis in range(3):
                        own = float(points[last_v, last_u, axis])
                        other = float(points[at_v, at_u, axis])
                        square += (other - own) ** 2
                        ray_square += (other - camera_position_m[axis]) ** 2
                        own_square += (own - camera_position_m[axis]) ** 2
                    if square < same_m * same_m:
                        last_v, last_u = at_v, at_u
                        continue
                    own_z = float(points[last_v, last_u, 2])
                    fall = float(points[at_v, at_u, 2]) - camera_position_m[2]
                    if (
                        ray_square**0.5 > own_square**0.5 - nearer_m
                        and abs(fall) > _LEVEL * ray_square**0.5
                    ):
                        share = (own_z - camera_position_m[2]) / fall
                        for axis in range(3):
                            start = camera_position_m[axis]
                            passed = start + share * (float(points[at_v, at_u, axis]) - start)
                            found[count, axis] = (float(points[last_v, last_u, axis]) + passed) / 2
                        count += 1
                    break
    return count
