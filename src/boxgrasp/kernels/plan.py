"""A cluster seen from above: top heights, patches of even height or color, their borders."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Points
from boxgrasp.kernels._jit import jit

_TOP_BAND_M = 0.012  # m under the top, where its color is taken
_ALL_RINGS = 1 << 40  # more than any grid has


@jit
def plan_grid(
    points: Points, tints: Points, cell_m: float
) -> tuple[Points, Points, NDArray[np.int64]]:
    """A cluster in plan.

    Args:
        points: (N, 3) float32, table frame, m.
        tints: (N, 3) float32 shares of color, NaN where unknown.
        cell_m: edge of a cell, m.

    Returns:
        (nx, ny) float32 top heights, m, NaN for empty cells; (nx, ny, 3) float32 mean tints near
        the top, NaN where none is known there; and (N, 2) int64 cell of each point.
    """
    count = points.shape[0]
    cells = np.empty((count, 2), dtype=np.int64)
    low_x, low_y = 1 << 40, 1 << 40
    high_x, high_y = -(1 << 40), -(1 << 40)
    for i in range(count):
        cells[i, 0] = int(np.floor(points[i, 0] / cell_m))
        cells[i, 1] = int(np.floor(points[i, 1] / cell_m))
        low_x, high_x = min(low_x, cells[i, 0]), max(high_x, cells[i, 0])
        low_y, high_y = min(low_y, cells[i, 1]), max(high_y, cells[i, 1])
    top = np.full((high_x - low_x + 3, high_y - low_y + 3), np.float32(np.nan))
    tint = np.zeros((top.shape[0], top.shape[1], 3), dtype=np.float32)
    hits = np.zeros(top.shape, dtype=np.int64)
    for i in range(count):
        cells[i, 0] -= low_x - 1
        cells[i, 1] -= low_y - 1
        x, y = cells[i, 0], cells[i, 1]
        if not top[x, y] >= points[i, 2]:
            top[x, y] = points[i, 2]
    for i in range(count):
        x, y = cells[i, 0], cells[i, 1]
        if points[i, 2] > top[x, y] - _TOP_BAND_M and tints[i, 0] == tints[i, 0]:
            hits[x, y] += 1
            for k in range(3):
                tint[x, y, k] += tints[i, k]
    for x in range(top.shape[0]):
        for y in range(top.shape[1]):
            for k in range(3):
                tint[x, y, k] = tint[x, y, k] / hits[x, y] if hits[x, y] else np.nan
    return top, tint, cells


@jit
def smooth_cells(
    top: Points, tint: Points, step_m: float, tint_step: float, most: int
) -> NDArray[np.bool_]:
    """Cells of which nearly all neighbors are there and no step away.

    Args:
        top: (nx, ny) float32 heights, m, NaN for empty cells.
        tint: (nx, ny, 3) float32.
        step_m: from which a top steps, m.
        tint_step: from which a color does, sum over the three shares.
        most: neighbors that may be missing or a step away.

    Returns:
        (nx, ny) bool.
    """
    nx, ny = top.shape
    smooth = np.zeros((nx, ny), dtype=np.bool_)
    for x in range(1, nx - 1):
        for y in range(1, ny - 1):
            apart = 0
            for dx in range(-1, 2):
                for dy in range(-1, 2):
                    a, b = x + dx, y + dy
                    away = 0.0
                    for k in range(3):
                        away += abs(tint[a, b, k] - tint[x, y, k])
                    if not abs(top[a, b] - top[x, y]) <= step_m or away > tint_step:
                        apart += 1
            smooth[x, y] = apart <= most and top[x, y] == top[x, y]
    return smooth


@jit
def patches(
    inside: NDArray[np.bool_], top: Points, tint: Points, step_m: float, tint_step: float
) -> NDArray[np.int64]:
    """Patches of cells: neighbors join unless height or tint steps.

    Args:
        inside: (nx, ny) bool, the cells that count.
        top: (nx, ny) float32 heights, m.
        tint: (nx, ny, 3) float32; NaN, an unknown tint, joins.
        step_m: from which a top steps, m.
        tint_step: from which a color does.

    Returns:
        (nx, ny) int64 patch of each cell, from 0; -1 outside.
    """
    nx, ny = inside.shape
    patch = np.full((nx, ny), -1, dtype=np.int64)
    stack = np.empty((nx * ny, 2), dtype=np.int64)
    found = 0
    for x0 in range(nx):
        for y0 in range(ny):
            if patch[x0, y0] != -1 or not inside[x0, y0]:
                continue
            patch[x0, y0] = found
            stack[0, 0], stack[0, 1] = x0, y0
            depth = 1
            while depth > 0:
                depth -= 1
                x, y = stack[depth, 0], stack[depth, 1]
                for dx in range(-1, 2):
                    for dy in range(-1, 2):
                        a, b = x + dx, y + dy
                        if a < 0 or b < 0 or a >= nx or b >= ny:
                            continue
                        if not inside[a, b] or patch[a, b] != -1:
                            continue
                        if abs(top[a, b] - top[x, y]) > step_m:
                            continue
                        away = 0.0
                        for k in range(3):
                            away += abs(tint[a, b, k] - tint[x, y, k])
                        if away > tint_step:  # NaN, an unknown tint, joins
                            continue
                        patch[a, b] = found
                        stack[depth, 0], stack[depth, 1] = a, b
                        depth += 1
            found += 1
    return patch


@jit
def borders(patch: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """How long the borders between patches are.

    Args:
        patch: (nx, ny) int64 patch of each cell, -1 for none.
        count: number of patches.

    Returns:
        (count + 1, count + 1) int64 cell sides, the last row and column for outside; the diagonal
        holds each patch's area in cells.
    """
    table = np.zeros((count + 1, count + 1), dtype=np.int64)
    nx, ny = patch.shape
    for x in range(nx):
        for y in range(ny):
            a = patch[x, y]
            if a >= 0:
                table[a, a] += 1
            for k in range(2):
                u, v = (x + 1, y) if k == 0 else (x, y + 1)
                if u >= nx or v >= ny:
                    continue
                b = patch[u, v]
                if a != b:
                    i = a if a >= 0 else count
                    j = b if b >= 0 else count
                    table[i, j] += 1
                    table[j, i] += 1
    return table


@jit
def filled(patch: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """A patch with the holes that drop-outs leave in it: cells most of whose ring is patch.

    Args:
        patch: (nx, ny) bool.

    Returns:
        (nx, ny) bool.
    """
    nx, ny = patch.shape
    whole = patch.copy()
    for x in range(1, nx - 1):
        for y in range(1, ny - 1):
            ring = 0
            for dx in range(-1, 2):
                for dy in range(-1, 2):
                    if patch[x + dx, y + dy]:
                        ring += 1
            if ring >= 5:
                whole[x, y] = True
    return whole


@jit
def inward(inside: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Steps from each cell to the outside, over 8 neighbors.

    Args:
        inside: (nx, ny) bool.

    Returns:
        (nx, ny) int64, 0 outside.
    """
    nx, ny = inside.shape
    far = nx + ny
    steps = np.zeros((nx, ny), dtype=np.int64)
    for x in range(nx):
        for y in range(ny):
            if inside[x, y]:
                least = far
                if x == 0 or y == 0 or x == nx - 1 or y == ny - 1:
                    least = 0
                else:
                    least = min(
                        steps[x - 1, y], steps[x, y - 1], steps[x - 1, y - 1], steps[x - 1, y + 1]
                    )
                steps[x, y] = least + 1
    for x in range(nx - 1, -1, -1):
        for y in range(ny - 1, -1, -1):
            if inside[x, y]:
                least = 0
                if 0 < x < nx - 1 and 0 < y < ny - 1:
                    least = min(
                        steps[x + 1, y], steps[x, y + 1], steps[x + 1, y + 1], steps[x + 1, y - 1]
                    )
                steps[x, y] = min(steps[x, y], least + 1)
    return steps


@jit
def grow(
    seeds: NDArray[np.int64], inside: NDArray[np.bool_], most_rings: int = _ALL_RINGS
) -> NDArray[np.int64]:
    """Seeds grown over the inside cells, ring by ring; the lower number wins a tie.

    Args:
        seeds: (nx, ny) int64 patch of each cell, -1 for none.
        inside: (nx, ny) bool.
        most_rings: how often each seed grows by its eight neighbors at most.

    Returns:
        (nx, ny) int64.
    """
    grown = seeds.copy()
    nx, ny = grown.shape
    reached = np.full((nx, ny), -1, dtype=np.int64)  # by the ring that is being grown
    ring = np.empty((nx * ny, 2), dtype=np.int64)  # each cell once: seeds, then ring after ring
    start, stop, rings = 0, 0, 0
    for x in range(nx):
        for y in range(ny):
            if seeds[x, y] >= 0:
                ring[stop, 0], ring[stop, 1] = x, y
                stop += 1
    while start < stop and rings < most_rings:
        rings += 1
        end = stop
        for k in range(start, stop):
            x, y = ring[k, 0], ring[k, 1]
            for a in range(max(x - 1, 0), min(x + 2, nx)):
                for b in range(max(y - 1, 0), min(y + 2, ny)):
                    if grown[a, b] != -1 or not inside[a, b]:
                        continue
                    if reached[a, b] == -1:
                        ring[end, 0], ring[end, 1] = a, b
                        end += 1
                        reached[a, b] = grown[x, y]
                    else:
                        reached[a, b] = min(reached[a, b], grown[x, y])
        for k in range(stop, end):
            x, y = ring[k, 0], ring[k, 1]
            grown[x, y] = reached[x, y]
        start, stop = stop, end
    return grown


@jit
def hull_area(inside: NDArray[np.bool_]) -> float:
    """Area of the convex hull of cells (Andrew's monotone chain).

    Args:
        inside: (nx, ny) bool.

    Returns:
        The area, in cells.
    """
    nx, ny = inside.shape
    low = np.full(nx + 1, ny + 1)
    high = np.full(nx + 1, -1)
    for x in range(nx):
        for y in range(ny):
            if inside[x, y]:
                for line in range(x, x + 2):  # the two grid lines that bound the cell
                    low[line] = min(low[line], y)
                    high[line] = max(high[line], y + 1)
    hull = np.empty((2 * nx + 4, 2), dtype=np.int64)
    doubled = 0
    for side in range(2):  # the chain of the low ends, then that of the high ends
        size = 0
        for j in range(nx + 1):
            x = j if side == 0 else nx - j
            y = low[x] if side == 0 else high[x]
            if high[x] < 0:
                continue
            while size >= 2:
                ax, ay = hull[size - 2, 0], hull[size - 2, 1]
                bx, by = hull[size - 1, 0], hull[size - 1, 1]
                if (bx - ax) * (y - ay) - (by - ay) * (x - ax) > 0:
                    break
                size -= 1
            hull[size, 0] = x
            hull[size, 1] = y
            size += 1
        for j in range(size - 1):
            doubled += hull[j, 0] * hull[j + 1, 1] - hull[j, 1] * hull[j + 1, 0]
        if size > 0:  # across, from where one chain ends to where the other starts
            x = hull[size - 1, 0]
            before = hull[size - 1, 1]
            after = high[x] if side == 0 else low[x]
            doubled += x * after - before * x
    return abs(doubled) / 2.0
