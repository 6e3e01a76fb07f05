"""Pixels between two surfaces, which show neither: mixed pixels, veils, the ramps of edges."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from boxgrasp.kernels._jit import jit

_REACH_PX = 3  # over holes beside an edge, to the next pixel with depth


@jit
def mark_flying(
    depth: NDArray[np.float32],
    slope: float,
    spread: float,
    noise: tuple[float, float, float],
    longest_px: int,
    first: int,
    last: int,
    flying: NDArray[np.bool_],
) -> int:
    """Mark pixels of some rows that lie behind what is on one side and before what is on the other.

    Both by more than a surface seen aslant and noise explain. A slope that goes on is a surface.

    Args:
        depth: (H, W) float32, m, 0 for missing.
        slope: change of depth a pixel, as a share of the depth, of the steepest real surface.
        spread: how many standard deviations of depth are no jump.
        noise: floor, growth and range of the least noise: floor + growth (z - least)^2, m.
        longest_px: from so many pixels on a slope is a surface.
        first: row.
        last: row after the last one.
        flying: (H, W) bool, False, to fill.

    Returns:
        How many were marked.
    """
    height, width = depth.shape
    floor, growth, least_at = np.float32(noise[0]), np.float32(noise[1]), np.float32(noise[2])
    share, gain = np.float32(slope), np.float32(spread)
    count = 0
    for v in range(first, last):
        for u in range(width):
            z = depth[v, u]
            if z <= 0:
                continue
            rise = share * z
            for axis in range(2):
                place, size, dv, du = (v, height, 1, 0) if axis else (u, width, 0, 1)
                if 0 < place < size - 1:  # most pixels go here
                    before, after = depth[v - dv, u - du], depth[v + dv, u + du]
                    if before > 0 and after > 0:
                        whole = abs(after - before)
                        if whole <= 2 * rise or (z - before) * (after - z) <= 0:
                            continue
                away = z - least_at
                scatter = gain * (floor + growth * away * away)
                if not _between(depth, v, u, dv, du, place, size, rise, scatter):
                    continue
                if _steps(depth, v, u, dv, du, place, size, rise, longest_px) < longest_px:
                    flying[v, u] = True
                    count += 1
                    break
    return count


@jit
def _between(
    depth: NDArray[np.float32],
    v: int,
    u: int,
    dv: int,
    du: int,
    place: int,
    size: int,
    rise: float,
    scatter: float,
) -> bool:
    """Whether a pixel jumps from one side and on to the other, along one axis.

    rise: steepest real change of depth a pixel, m; scatter: what noise may add to it, m.
    """
    z = depth[v, u]
    low, high = np.float32(0.0), np.float32(0.0)
    low_gap, high_gap = 0, 0
    for by in range(1, _REACH_PX + 1):
        if low_gap == 0 and place >= by and depth[v - by * dv, u - by * du] > 0:
            low, low_gap = z - depth[v - by * dv, u - by * du], by
        if high_gap == 0 and place + by < size and depth[v + by * dv, u + by * du] > 0:
            high, high_gap = depth[v + by * dv, u + by * du] - z, by
    if low_gap == 0 or high_gap == 0 or low * high <= 0:
        return False
    if abs(low) > rise * low_gap + scatter and abs(high) > rise * high_gap + scatter:
        return True
    # A ramp shows over two pixels to each side, where noise counts for less.
    if abs(low) <= rise * low_gap or abs(high) <= rise * high_gap:
        return False
    if low_gap > 1 or high_gap > 1 or place < 2 or place + 2 >= size:
        return False
    before, after = depth[v - 2 * dv, u - 2 * du], depth[v + 2 * dv, u + 2 * du]
    if before <= 0 or after <= 0 or (z - before) * low <= 0 or (after - z) * high <= 0:
        return False
    least = 2 * rise + scatter
    return bool(abs(z - before) > least and abs(after - z) > least)


@jit
def _steps(
    depth: NDArray[np.float32],
    v: int,
    u: int,
    dv: int,
    du: int,
    place: int,
    size: int,
    rise: float,
    most: int,
) -> int:
    """Over how many pixels round one the depth goes the same way by half the rise and more."""
    count, sign = 0, 0
    for way in (-1, 1):
        z, at = depth[v, u], 0
        for by in range(1, most + 1):
            if not 0 <= place + way * by < size or by - at > _REACH_PX:
                break
            other = depth[v + way * by * dv, u + way * by * du]
            if other <= 0:
                continue
            step = (other - z) * way
            if sign == 0:
                sign = 1 if step > 0 else -1
            if step * sign <= 0.5 * rise * (by - at):
                break
            count += by - at
            z, at = other, by
    return count


def mark_flying_naive(
    depth: NDArray[np.float32],
    slope: float,
    spread: float,
    noise: tuple[float, float, float],
    longest_px: int,
) -> NDArray[np.bool_]:
    """The same pixels, from every row and column by itself.

    Args:
        depth: as `mark_flying`.
        slope: as `mark_flying`.
        spread: as `mark_flying`.
        noise: as `mark_flying`.
        longest_px: as `mark_flying`.

    Returns:
        (H, W) bool.
    """
    floor, growth, least_at = noise
    found = np.zeros(depth.shape, dtype=np.bool_)
    for lines, marked in ((depth, found), (depth.T, found.T)):
        for line, out in zip(lines.astype(np.float64), marked, strict=True):
            for i in np.flatnonzero(line > 0).tolist():
                rise = slope * line[i]
                scatter = spread * (floor + growth * (line[i] - least_at) ** 2)
                if _flies_naive(line, i, rise, scatter, longest_px):
                    out[i] = True
    return found


def _flies_naive(
    line: NDArray[np.float64], i: int, rise: float, scatter: float, longest_px: int
) -> bool:
    sides = []  # (gap, depth) of the nearest pixel with depth on each side
    for way in (-1, 1):
        near = [i + way * by for by in range(1, _REACH_PX + 1) if 0 <= i + way * by < len(line)]
        held = [j for j in near if line[j] > 0]
        if not held:
            return False
        sides.append((abs(held[0] - i), line[held[0]]))
    (low_gap, low), (high_gap, high) = sides
    for sign in (1, -1):  # rising, then falling
        down, up = sign * (line[i] - low), sign * (high - line[i])
        at_once = down > rise * low_gap + scatter and up > rise * high_gap + scatter
        wide = down > rise and up > rise and low_gap == high_gap == 1
        wide = wide and 2 <= i < len(line) - 2 and min(line[i - 2], line[i + 2]) > 0
        if wide:
            both = sign * (line[i] - line[i - 2]), sign * (line[i + 2] - line[i])
            wide = min(both) > 2 * rise + scatter
        if at_once or wide:
            lasts = [_last_naive(line, i, way, sign * 0.5 * rise, longest_px) for way in (-1, 1)]
            return lasts[1] - lasts[0] < longest_px
    return False


def _last_naive(line: NDArray[np.float64], i: int, way: int, least: float, most: int) -> int:
    """The last pixel one way up to which every step has at least a change a pixel."""
    at = i
    for j in range(i + way, i + way * (most + 1), way):
        if not 0 <= j < len(line) or abs(j - at) > _REACH_PX:
            break
        if line[j] <= 0:
            continue
        change = (line[j] - line[at]) / (j - at)
        if change * np.sign(least) <= abs(least):
            break
        at = j
    return at
