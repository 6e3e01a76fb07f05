"""Plane hypotheses, their support, and the sums for a refit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from boxgrasp.frames import Floats, Points
from boxgrasp.kernels._jit import jit


@jit
def plane_votes(
    points: Points, triples: NDArray[np.int64], tolerance_m: float
) -> tuple[Floats, NDArray[np.int64]]:
    """(H, 4) unit planes n, d through (H, 3) index triples and how many points lie on each."""
    count = triples.shape[0]
    planes = np.zeros((count, 4))
    votes = np.zeros(count, dtype=np.int64)
    for k in range(count):
        a, b, c = triples[k, 0], triples[k, 1], triples[k, 2]
        ux = float(points[b, 0]) - points[a, 0]
        uy = float(points[b, 1]) - points[a, 1]
        uz = float(points[b, 2]) - points[a, 2]
        vx = float(points[c, 0]) - points[a, 0]
        vy = float(points[c, 1]) - points[a, 1]
        vz = float(points[c, 2]) - points[a, 2]
        nx = uy * vz - uz * vy
        ny = uz * vx - ux * vz
        nz = ux * vy - uy * vx
        norm = np.sqrt(nx * nx + ny * ny + nz * nz)
        if norm < 1e-9:
            continue
        nx, ny, nz = nx / norm, ny / norm, nz / norm
        d = -(nx * points[a, 0] + ny * points[a, 1] + nz * points[a, 2])
        on = 0
        for i in range(points.shape[0]):
            h = nx * points[i, 0] + ny * points[i, 1] + nz * points[i, 2] + d
            if abs(h) < tolerance_m:
                on += 1
        planes[k, 0], planes[k, 1], planes[k, 2], planes[k, 3] = nx, ny, nz, d
        votes[k] = on
    return planes, votes


@jit
def plane_sums(points: Points, plane: Floats, anchor: Floats, tolerance_m: float) -> Floats:
    """Count, sums and products (10,) of the points within tolerance, relative to an anchor."""
    sums = np.zeros(10)
    for i in range(points.shape[0]):
        h = (
            plane[0] * points[i, 0]
            + plane[1] * points[i, 1]
            + plane[2] * points[i, 2]
            + plane[3]
        )
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
