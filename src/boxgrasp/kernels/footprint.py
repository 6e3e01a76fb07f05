"""Extent of a footprint over many yaws, by histogram: quantiles without sorting."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from boxgrasp.frames import Floats
from boxgrasp.kernels._jit import jit

_BIN_M = 0.0005


@jit
def _quantile_range(values: Floats, cut: int) -> tuple[float, float]:
    """Lowest and highest value after cutting that many values at each end, to 0.5 mm."""
    low = values.min()
    bins = int((values.max() - low) / _BIN_M) + 1
    counts = np.zeros(bins, dtype=np.int64)
    for v in values:
        counts[int((v - low) / _BIN_M)] += 1
    total = 0
    first = 0
    while first < bins - 1 and total + counts[first] <= cut:
        total += counts[first]
        first += 1
    total = 0
    last = bins - 1
    while last > 0 and total + counts[last] <= cut:
        total += counts[last]
        last -= 1
    return low + first * _BIN_M, low + (last + 1) * _BIN_M


@jit
def extents_over_yaws(footprint: Floats, yaws: Floats, cut: int) -> Floats:
    """(A, 4) low x, high x, low y, high y of (N, 2) points seen in axes turned by each yaw."""
    extents = np.empty((yaws.shape[0], 4))
    values = np.empty(footprint.shape[0])
    for k in range(yaws.shape[0]):
        c, s = np.cos(yaws[k]), np.sin(yaws[k])
        for i in range(footprint.shape[0]):
            values[i] = footprint[i, 0] * c + footprint[i, 1] * s
        extents[k, 0], extents[k, 1] = _quantile_range(values, cut)
        for i in range(footprint.shape[0]):
            values[i] = footprint[i, 1] * c - footprint[i, 0] * s
        extents[k, 2], extents[k, 3] = _quantile_range(values, cut)
    return extents


@jit
def within_full_slabs(
    footprint: Floats, yaws: Floats, slab_m: float, share: float
) -> NDArray[np.bool_]:
    """(N,) which of (N, 2) points stay when, along each yaw, both ends move in to where the
    outer slab holds its share of the points.
    """
    count = footprint.shape[0]
    stay = np.ones(count, dtype=np.bool_)
    need = share * count
    values = np.empty(count)
    width = int(slab_m / _BIN_M)
    for k in range(yaws.shape[0]):
        c, s = np.cos(yaws[k]), np.sin(yaws[k])
        for i in range(count):
            values[i] = footprint[i, 0] * c + footprint[i, 1] * s
        low = values.min()
        bins = int((values.max() - low) / _BIN_M) + 1
        counts = np.zeros(bins, dtype=np.int64)
        for v in values:
            counts[int((v - low) / _BIN_M)] += 1
        ends = (0, 0)
        for side in range(2):
            held = 0
            for b in range(min(width, bins)):
                held += counts[b if side == 0 else bins - 1 - b]
            edge = 0
            while held < need and edge + width < bins:
                held -= counts[edge if side == 0 else bins - 1 - edge]
                held += counts[edge + width if side == 0 else bins - 1 - edge - width]
                edge += 1
            ends = (edge, ends[1]) if side == 0 else (ends[0], edge)
        for i in range(count):
            b = int((values[i] - low) / _BIN_M)
            if b < ends[0] or b >= bins - ends[1]:
                stay[i] = False
    return stay
