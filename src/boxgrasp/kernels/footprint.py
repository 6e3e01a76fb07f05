"""Extent of a footprint over many yaws, by histogram: quantiles without sorting."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from boxgrasp.frames import Floats
from boxgrasp.kernels._jit import jit

_BIN_M = 0.0005


@jit
def _solid_range(values: Floats, cut: int, slab_m: float, share: float) -> tuple[float, float]:
    """Lowest and highest value, to 0.5 mm, with `cut` values left out at each end, and moved in
    to where the outer slab holds its share of the values.
    """
    low = values.min()
    bins = int((values.max() - low) / _BIN_M) + 1
    counts = np.zeros(bins, dtype=np.int64)
    for v in values:
        counts[int((v - low) / _BIN_M)] += 1
    width = int(slab_m / _BIN_M)
    need = share * values.shape[0]
    first = _solid_from(counts, cut, width, need)
    last = bins - _solid_from(counts[::-1], cut, width, need)
    return low + first * _BIN_M, low + max(last, first + 1) * _BIN_M


@jit
def _solid_from(counts: NDArray[np.int64], cut: int, width: int, need: float) -> int:
    """First bin that counts, from the left."""
    bins = counts.shape[0]
    total = 0
    first = 0
    while first < bins - 1 and total + counts[first] <= cut:
        total += counts[first]
        first += 1
    held = counts[first : first + width].sum()
    while held < need and first + width < bins:
        held += counts[first + width] - counts[first]
        first += 1
    return first


@jit
def extents_over_yaws(
    footprint: Floats, yaws: Floats, cut: int, slab_m: float, share: float
) -> Floats:
    """(A, 4) low x, high x, low y, high y of (N, 2) points seen in axes turned by each yaw."""
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
