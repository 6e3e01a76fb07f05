"""Extent of a footprint over many yaws, by histogram: quantiles without sorting."""

from __future__ import annotations

import numpy as np

from boxgrasp.arrays import Floats
from boxgrasp.kernels._jit import jit

_BIN_M = 0.0005  # m, finer than any depth


@jit
def _solid_range(values: Floats, cut: int, slab_m: float, share: float) -> tuple[float, float]:
    """Lowest and highest value, to a bin, strays left out.

    `cut` values are left out at each end, and the end moves in to where the outer slab holds its
    share of the values.
    """
    low, high = values[0], values[0]
    for v in values:
        low, high = min(low, v), max(high, v)
    bins = int((high - low) / _BIN_M) + 1
    counts = np.zeros(bins, dtype=np.int64)
    for v in values:
        counts[int((v - low) / _BIN_M)] += 1
    width = int(slab_m / _BIN_M)
    ends = np.empty(2, dtype=np.int64)
    for side in range(2):
        step = 1 if side == 0 else -1
        first = 0 if side == 0 else bins - 1
        total = 0
        moved = 0
        while moved < bins - 1 and total + counts[first] <= cut:
            total += counts[first]
            first += step
            moved += 1
        held = 0
        for k in range(min(width, bins - moved)):
            held += counts[first + step * k]
        while held < share * values.shape[0] and moved + width < bins:
            held += counts[first + step * width] - counts[first]
            first += step
            moved += 1
        ends[side] = first
    return low + ends[0] * _BIN_M, low + max(ends[1] + 1, ends[0] + 1) * _BIN_M


@jit
def extents_over_yaws(
    footprint: Floats, yaws: Floats, cut: int, slab_m: float, share: float
) -> Floats:
    """Extents of a footprint in axes turned by each yaw, strays left out.

    Args:
        footprint: (N, 2) float64, m.
        yaws: (A,) float64, rad.
        cut: points to leave out at each end.
        slab_m: thickness of the outer slab, m.
        share: of the points that the slab must hold.

    Returns:
        (A, 4) float64 low x, high x, low y, high y, m.
    """
    extents = np.empty((yaws.shape[0], 4))
    values = np.empty(footprint.shape[0])
    for k in range(yaws.shape[0]):
        c, s = np.cos(yaws[k]), np.sin(yaws[k])
        for i in range(footprint.shape[0]):
            values[i] = footprint[i, 0] * c + footprint[i, 1] * s
        extents[k, 0], extents[k, 1] = _solid_range(values, cut, slab_m, share)
        for i in range(footprint.shape[0]):
            values[i] = footprint[i, 1] * c - footprint[i, 0] * s
        extents[k, 2], extents[k, 3] = _solid_range(values, cut, slab_m, share)
    return extents
