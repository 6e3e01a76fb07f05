"""Labels of some pixels of a depth image spread to the others along the surface."""

from __future__ import annotations

import numpy as np

from boxgrasp.arrays import Array
from boxgrasp.kernels._jit import jit

_STEEPEST = 4.0  # times a limit, that depth may change by where a line goes on
_STEPS = ((0, -1), (0, 1), (-1, 0), (1, 0))  # rows, columns


@jit
def flood(depth: Array, labels: Array, open_mask: Array, limits_m: Array) -> None:
    """Give each open pixel the label of a neighbor whose surface goes on there, smoothest first.

    A step from a pixel to its neighbor costs the change in depth, or how far the neighbor lies off
    the straight line through the pixel and the one behind it, whichever is less: slanted surfaces
    go on, outlines stop. No step is steeper than four limits.

    Args:
        depth: (H, W) float32, m, 0 where it is missing.
        labels: (H, W) int64, -1 for none yet; changed in place.
        open_mask: (H, W) bool, pixels that may be given a label.
        limits_m: (L,) rising: first all steps up to the least are taken, from near to far, then
            those up to the next, times the square of the depth where that is over 1 m.
    """
    height, width = depth.shape
    queue = np.empty(height * width, dtype=np.int64)
    for limit in limits_m:
        count = 0
        for v in range(height):
            for u in range(width):
                if labels[v, u] >= 0:
                    queue[count] = v * width + u
                    count += 1
        at = 0
        while at < count:
            v, u = queue[at] // width, queue[at] % width
            at += 1
            here = depth[v, u]
            for dv, du in _STEPS:
                nv, nu = v + dv, u + du
                if not (0 <= nv < height and 0 <= nu < width):
                    continue
                if labels[nv, nu] >= 0 or not open_mask[nv, nu]:
                    continue
                there = depth[nv, nu]
                cost = abs(there - here)
                bv, bu = v - dv, u - du
                if cost > _STEEPEST * limit * max(1.0, here * here):
                    continue
                if 0 <= bv < height and 0 <= bu < width and labels[bv, bu] == labels[v, u]:
                    cost = min(cost, abs(there - 2.0 * here + depth[bv, bu]))
                if cost <= limit * max(1.0, here * here):
                    labels[nv, nu] = labels[v, u]
                    queue[count] = nv * width + nu
                    count += 1
