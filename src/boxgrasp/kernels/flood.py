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


@jit
def nearest_labels(
    pixels: Array, width: int, full_depth: Array, first: Array, step: int, depth: Array,
    labels: Array, most_m: float, out: Array,
) -> None:  # fmt: skip
    """The label of each pixel: of the four thinned pixels round it the one nearest in depth.

    Args:
        pixels: (S,) int32, flat pixels v * W + u of the image.
        width: W.
        full_depth: (H * W,) float32, m.
        first: (2,) int64 v, u of the thinned image's first pixel in the image.
        step: every so many-th pixel is in the thinned image.
        depth: (h, w) float32 of the thinned image, m, 0 where it is missing.
        labels: (h, w) int64.
        most_m: a pixel farther off has no label, times the square of the depth over 1 m.
        out: (S,) int64 to fill, -1 for no label.
    """
    rows, columns = depth.shape
    for k in range(pixels.shape[0]):
        v, u = pixels[k] // width - first[0], pixels[k] % width - first[1]
        here = full_depth[pixels[k]]
        least = most_m * max(1.0, here * here)
        out[k] = -1
        for down in range(2 if v % step else 1):
            for right in range(2 if u % step else 1):
                y, x = v // step + down, u // step + right
                if 0 <= y < rows and 0 <= x < columns and depth[y, x] > 0.0:
                    off = abs(depth[y, x] - here)
                    if off < least:
                        least = off
                        out[k] = labels[y, x]
