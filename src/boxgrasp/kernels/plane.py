"""Support of plane hypotheses, and the sums for a refit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Floats, Points
from boxgrasp.kernels._jit import jit


@jit
def plane_votes(points: Points, planes: Floats, tolerance_m: float) -> NDArray[np.int64]:
    """How many points lie on each plane.

    Args:
        points: (N, 3) float32, m.
        planes: (H, 4) float64 unit normals n and d of n . p + d = 0, m.
        tolerance_m: from a plane, m.

    Returns:
        (H,) int64.
    """
    votes = np.zeros(planes.shape[0], dtype=np.int64)
    for k in range(planes.shape[0]):
        nx, ny, nz, d = planes[k, 0], planes[k, 1], planes[k, 2], planes[k, 3]
        on = 0
        for i in range(points.shape[0]):
            h = nx * points[i, 0] + ny * points[i, 1] + nz * points[i, 2] + d
            if abs(h) < tolerance_m:
                on += 1
        votes[k] = on
    return votes


@jit
def plane_sums(points: Points, plane: Floats, anchor: Floats, tolerance_m: float) -> Floats:
    """Sums over the points near a plane, for a least-squares fit.

    Args:
        points: (N, 3) float32, m.
        plane: (4,) float64 unit normal n and d, m.
        anchor: (3,) float64, what coordinates are taken relative to, m.
        tolerance_m: from the plane, m.

    Returns:
        (10,) float64: count, sums of x, y, z, and of xx, xy, xz, yy, yz, zz.
    """
    sums = np.zeros(10)
    for i in range(points.shape[0]):
        h = plane[0] * points[i, 0] + plane[1] * points[i, 1] + plane[2] * points[i, 2] + plane[3]
        if abs(h) < tolerance_m:
            x = points[i, 0] - anchor[0]
            y = points[i, 1] - anchor[1]
            z = points[i, 2] - anchor[2]
            sums[0] += 1.0
            sums[1] += x
            sums[2] += y
            sums[3] += z
            sums[4] += x * x
            sums[5] += x * y
            sums[6] += x * z
            sums[7] += y * y
            sums[8] += y * z
            sums[9] += z * z
    return sums
