"""Support of plane hypotheses, and the sums for a refit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Floats, Points
from boxgrasp.kernels._jit import jit


@jit
def plane_votes(points: Points, planes: Floats, tolerance_m: float) -> NDArray[np.int64]:
    """(H,) number of points on each of (H, 4) unit planes n, d."""
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
    """Count, sums and products (10,) of the points within tolerance, relative to an anchor."""
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
