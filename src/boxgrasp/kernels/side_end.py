"""Where a side of a thing is, from how its points lie along one direction."""

from __future__ import annotations

import math

import numpy as np

from boxgrasp.arrays import Floats
from boxgrasp.kernels._jit import jit

BIN_M = 0.0005  # m, of the histogram; places are tried at half of it
_KINDS = 3
_NODES = 13  # over which an arc is smeared by noise
_LEAST = 0.02  # points a bin that are expected at least: strays are not impossible


@jit
def _shapes(step_m: float, first: int, count: int, noise_m: float) -> Floats:
    """(count, 3) density at offsets (first + k) step_m outward of a side, for each kind of side.

    A face that is seen crowds at its place; a surface that runs up to an edge ends there; an arc
    (a round thing's side) crowds there and thins out inward as 1 / sqrt(distance).
    """
    face_m = math.sqrt(noise_m**2 + BIN_M**2 / 12)
    shapes = np.empty((count, _KINDS))
    for k in range(count):
        off = (first + k) * step_m
        shapes[k, 0] = math.exp(-0.5 * (off / face_m) ** 2) / (face_m * math.sqrt(2 * math.pi))
        shapes[k, 1] = 0.5 * math.erfc(off / (noise_m * math.sqrt(2.0)))
        arc, total = 0.0, 0.0
        for node in range(_NODES):
            by = -3.0 + 6.0 * node / (_NODES - 1)
            weight = math.exp(-0.5 * by * by)
            inside = -off - by * noise_m
            total += weight
            if inside > 0:
                arc += weight / math.sqrt(max(inside, BIN_M / 2))
        shapes[k, 2] = arc / total
    return shapes


@jit
def _solved(A: Floats, b: Floats, size: int) -> bool:
    """Solve a small system in place, b becoming its solution; False where it has none or < 0."""
    for i in range(size):
        if abs(A[i, i]) < 1e-12:
            return False
        for j in range(i + 1, size):
            share = A[j, i] / A[i, i]
            for k in range(i, size):
                A[j, k] -= share * A[i, k]
            b[j] -= share * b[i]
    for i in range(size - 1, -1, -1):
        for k in range(i + 1, size):
            b[i] -= A[i, k] * b[k]
        b[i] /= A[i, i]
        if b[i] < 0:
            return False
    return True


@jit
def _explained(shapes: Floats, counts: Floats) -> float:
    """Log-likelihood of counts by the best mixture of shapes, none of them less than nothing.

    The mixture is that of least squares, each bin by its own variance; with more shapes it is
    never worse, so that fewer are tried only where one would be negative.
    """
    whole, right = np.zeros((_KINDS, _KINDS)), np.zeros(_KINDS)
    for k in range(counts.shape[0]):
        weight = 1.0 / (counts[k] + 1.0)
        for i in range(_KINDS):
            part = weight * shapes[k, i]
            right[i] += part * counts[k]
            for j in range(_KINDS):
                whole[i, j] += part * shapes[k, j]
    A, b = np.empty((_KINDS, _KINDS)), np.empty(_KINDS)
    kinds = np.empty(_KINDS, dtype=np.int64)
    best = -np.inf
    for wanted in range(_KINDS, 0, -1):
        for subset in range(1, 1 << _KINDS):
            size = 0
            for kind in range(_KINDS):
                if subset >> kind & 1:
                    kinds[size] = kind
                    size += 1
            if size != wanted:
                continue
            for i in range(size):
                b[i] = right[kinds[i]]
                for j in range(size):
                    A[i, j] = whole[kinds[i], kinds[j]]
            if not _solved(A, b, size):
                continue
            likely = 0.0
            for k in range(counts.shape[0]):
                expected = 0.0
                for i in range(size):
                    expected += b[i] * shapes[k, kinds[i]]
                expected = max(expected, _LEAST)
                likely += counts[k] * math.log(expected) - expected
            best = max(best, likely)
        if best > -np.inf:
            break
    return best


@jit
def side_end(
    values: Floats, about_m: float, inward_m: float, outward_m: float, deep_m: float, noise_m: float
) -> float:
    """The place of a side, by the mixture of face, edge and arc that explains the points best.

    Args:
        values: (N,) float64, places along the outward direction, m.
        about_m: where the side is about, m.
        inward_m: how far inward of that it is looked for, m.
        outward_m: how far outward, m.
        deep_m: how far inward points are looked at, m.
        noise_m: standard deviation of the points along the direction, m.

    Returns:
        The most likely place (Poisson counts in bins), m; NaN without points there.
    """
    half = BIN_M / 2
    low = about_m - deep_m
    bins = int(round((deep_m + 1.5 * outward_m) / BIN_M))
    counts = np.zeros(bins)
    total = 0
    for value in values:
        k = int(math.floor((value - low) / BIN_M))
        if 0 <= k < bins:
            counts[k] += 1
            total += 1
    if total == 0:
        return np.nan
    places = int(round((inward_m + outward_m) / half)) + 1
    start = int(round((deep_m - inward_m) / half))  # of the first place, half bins from low
    shapes = _shapes(half, -(start + places), 2 * bins + start + places + 1, noise_m)
    best, best_place, tried = -np.inf, 0, -1
    for step in (4, 1):  # coarse, then round the best
        first = 0 if step > 1 else max(best_place - 3, 0)
        last = places if step > 1 else min(best_place + 4, places)
        for place in range(first, last, step):
            likely = _explained(shapes[places - place + 1 :: 2][:bins], counts)
            if likely > best:
                best, tried = likely, place
        best_place = tried
    return about_m - inward_m + best_place * half
