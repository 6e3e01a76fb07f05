"""The image in square cells of pixels: heights at the table's level, regions and their rims."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Array, Floats, Points
from boxgrasp.kernels._jit import jit


@jit
def _height(points: Points, i: int, plane: Floats) -> float:
    total = plane[3]
    for k in range(3):
        total += plane[k] * points[i, k]
    return float(total)


@jit
def cell_heights(
    points: Points,
    pixels: NDArray[np.int32],
    taken: NDArray[np.int32],
    plane: Floats,
    limits_m: tuple[float, float],
    cell_px: int,
    width: int,
    total_m: Floats,
    count: NDArray[np.int32],
    first: NDArray[np.int32],
) -> None:
    """Sum up the heights of the points at the table's level, cell by cell.

    Args:
        points: (N, 3) float32, source frame, m.
        pixels: (N,) int32, rising, flat pixels v * width + u.
        taken: (P,) int32, rising, rows of points that are left out.
        plane: (4,) normal and offset of the plane, source frame, m.
        limits_m: from which to which height a point counts, m.
        cell_px: edge of a cell, px.
        width: of the image, px.
        total_m: (rows, columns) float64 to add to, m.
        count: (rows, columns) int32 to add to.
        first: (rows, columns) int32, -1, to fill with the row of a cell's first point.
    """
    at, row = 0, 0
    column_of = np.arange(width) // cell_px
    for i in range(points.shape[0]):
        if at < taken.shape[0] and taken[at] == i:
            at += 1
            continue
        height = _height(points, i, plane)
        if not limits_m[0] < height < limits_m[1]:
            continue
        while pixels[i] >= (row + 1) * width:
            row += 1
        v, u = row // cell_px, column_of[pixels[i] - row * width]
        if count[v, u] == 0:
            first[v, u] = i
        total_m[v, u] += height
        count[v, u] += 1


@jit
def rows_in_cells(
    points: Points,
    pixels: NDArray[np.int32],
    taken: NDArray[np.int32],
    plane: Floats,
    limits_m: tuple[float, float],
    cell_px: int,
    width: int,
    wanted: NDArray[np.int64],
) -> tuple[NDArray[np.int32], NDArray[np.int64], Points]:
    """The points at the table's level in wanted cells.

    Args:
        points: as `cell_heights`.
        pixels: likewise.
        taken: likewise.
        plane: likewise.
        limits_m: likewise.
        cell_px: likewise.
        width: likewise.
        wanted: (rows, columns) int64, a name of each cell, -1 for none.

    Returns:
        (n,) int32 rows, rising; (n,) int64 names of their cells; (n,) float32 heights, m.
    """
    most, top, bottom = 0, wanted.shape[0], 0
    for v in range(wanted.shape[0]):
        for u in range(wanted.shape[1]):
            if wanted[v, u] >= 0:
                most += cell_px * cell_px
                top, bottom = min(top, v), v + 1
    start = np.searchsorted(pixels, top * cell_px * width)
    stop = np.searchsorted(pixels, bottom * cell_px * width)
    most = min(most, points.shape[0])
    rows = np.empty(most, dtype=np.int32)
    names = np.empty(most, dtype=np.int64)
    heights = np.empty(most, dtype=np.float32)
    found, row = 0, 0
    at = np.searchsorted(taken, start)
    column_of = np.arange(width) // cell_px
    for i in range(start, stop):
        if at < taken.shape[0] and taken[at] == i:
            at += 1
            continue
        while pixels[i] >= (row + 1) * width:
            row += 1
        name = wanted[row // cell_px, column_of[pixels[i] - row * width]]
        if name < 0:
            continue
        height = _height(points, i, plane)
        if limits_m[0] < height < limits_m[1]:
            rows[found], names[found], heights[found] = i, name, height
            found += 1
    return rows[:found], names[:found], heights[:found]


@jit
def tops(points: Points, clusters: NDArray[np.int64], count: int) -> Points:
    """The height of the highest point of each cluster.

    Args:
        points: (V, 3) float32, table frame, m.
        clusters: (V,) int64, -1 for none.
        count: of clusters, C.

    Returns:
        (C,) float32, m, 0 at least.
    """
    top = np.zeros(count, dtype=np.float32)
    for i in range(points.shape[0]):
        if clusters[i] >= 0:
            top[clusters[i]] = max(top[clusters[i]], points[i, 2])
    return top


@jit
def cell_owners(
    pixels: NDArray[np.int32], owners: NDArray[np.int64], cell_px: int, width: int, rows: int
) -> NDArray[np.int64]:
    """Whose pixels each cell holds most of, by one vote a pixel against another.

    Args:
        pixels: (S,) int32 flat pixels v * width + u.
        owners: (S,) int64, from 0.
        cell_px: edge of a cell, px.
        width: of the image, px.
        rows: of cells.

    Returns:
        (rows, columns) int64, -1 where no pixel has an owner.
    """
    columns = (width + cell_px - 1) // cell_px
    owner = np.full((rows, columns), -1, dtype=np.int64)
    lead = np.zeros((rows, columns), dtype=np.int64)
    for i in range(pixels.shape[0]):
        v, u = pixels[i] // width // cell_px, pixels[i] % width // cell_px
        if owner[v, u] == owners[i]:
            lead[v, u] += 1
        elif lead[v, u] == 0:
            owner[v, u] = owners[i]
            lead[v, u] = 1
        else:
            lead[v, u] -= 1
    return owner


@jit
def regions(inside: NDArray[np.bool_], corners: bool) -> tuple[NDArray[np.int64], int]:
    """Connected regions of cells.

    Args:
        inside: (rows, columns) bool.
        corners: whether cells that meet at a corner are connected.

    Returns:
        (rows, columns) int64 region of each cell, from 0, -1 outside; and how many there are.
    """
    ny, nx = inside.shape
    region = np.full((ny, nx), -1, dtype=np.int64)
    stack = np.empty((ny * nx, 2), dtype=np.int64)
    found = 0
    for y0 in range(ny):
        for x0 in range(nx):
            if region[y0, x0] != -1 or not inside[y0, x0]:
                continue
            region[y0, x0] = found
            stack[0, 0], stack[0, 1] = y0, x0
            depth = 1
            while depth > 0:
                depth -= 1
                y, x = stack[depth, 0], stack[depth, 1]
                for a in range(max(y - 1, 0), min(y + 2, ny)):
                    for b in range(max(x - 1, 0), min(x + 2, nx)):
                        if (corners or a == y or b == x) and inside[a, b] and region[a, b] == -1:
                            region[a, b] = found
                            stack[depth, 0], stack[depth, 1] = a, b
                            depth += 1
            found += 1
    return region, found


@jit
def hole_rim(shown: NDArray[np.int64], v: int, u: int, hole: int) -> NDArray[np.int64]:
    """What the pixels round a hole show.

    Args:
        shown: (H, W) int64 what each pixel shows.
        v: row of a pixel in the hole.
        u: its column.
        hole: what the pixels of holes show.

    Returns:
        (n,) int64 what the pixels round it show, each once; none where it ends with the image.
    """
    height, width = shown.shape
    seen = np.zeros((height, width), dtype=np.bool_)
    stack = np.empty((height * width, 2), dtype=np.int32)
    rim = np.empty(height * width, dtype=np.int64)
    seen[v, u] = True
    stack[0, 0], stack[0, 1] = v, u
    depth, found = 1, 0
    while depth > 0:
        depth -= 1
        y, x = stack[depth, 0], stack[depth, 1]
        if y == 0 or x == 0 or y == height - 1 or x == width - 1:
            return rim[:0]
        for step in range(4):
            a = y + (step == 0) - (step == 1)
            b = x + (step == 2) - (step == 3)
            if seen[a, b]:
                continue
            seen[a, b] = True
            if shown[a, b] == hole:
                stack[depth, 0], stack[depth, 1] = a, b
                depth += 1
            else:
                rim[found] = shown[a, b]
                found += 1
    return rim[:found]


@jit
def most_round(owner: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int8]]:
    """What lies round each free cell: the owner that is met first in most of eight directions.

    Args:
        owner: (rows, columns) int64 whose each cell is, -1 for a free one.

    Returns:
        (rows, columns) int64 that owner, -1 where none is met and in cells that are not free; and
        (rows, columns) int8 in how many directions it is.
    """
    rows, columns = owner.shape
    met = np.full((rows + 2, columns + 2, 8), -1, dtype=np.int64)  # with a free rim
    for way in range(8):
        turned = way >= 4
        dv, du = ((0, -1), (-1, -1), (-1, 0), (-1, 1))[way % 4]
        for i in range(rows):
            v = rows - i if turned else i + 1
            for j in range(columns):
                u = columns - j if turned else j + 1
                own = owner[v - 1, u - 1]
                if turned:
                    met[v, u, way] = own if own >= 0 else met[v - dv, u - du, way]
                else:
                    met[v, u, way] = own if own >= 0 else met[v + dv, u + du, way]
    most = np.full((rows, columns), -1, dtype=np.int64)
    hits = np.zeros((rows, columns), dtype=np.int8)
    for v in range(rows):
        for u in range(columns):
            if owner[v, u] >= 0:
                continue
            for way in range(8):
                found, count = met[v + 1, u + 1, way], 0
                for other in range(8):
                    count += found >= 0 and met[v + 1, u + 1, other] == found
                if count > hits[v, u]:
                    most[v, u], hits[v, u] = found, count
    return most, hits


def dilated(inside: NDArray[np.bool_], rings: int) -> NDArray[np.bool_]:
    """Cells within some rings of inside ones, over eight neighbors.

    Args:
        inside: (rows, columns) bool.
        rings: how far.

    Returns:
        (rows, columns) bool.
    """
    grown = inside.copy()
    for _ in range(rings):
        wide = grown.copy()
        wide[1:] |= grown[:-1]
        wide[:-1] |= grown[1:]
        grown = wide.copy()
        grown[:, 1:] |= wide[:, :-1]
        grown[:, :-1] |= wide[:, 1:]
    return grown


def box_sums(values: Array, reach: int) -> Floats:
    """Sums over the square of cells round each cell.

    Args:
        values: (rows, columns).
        reach: cells to each side.

    Returns:
        (rows, columns) float64.
    """
    edge = 2 * reach + 1
    padded = np.pad(values, ((reach + 1, reach), (reach + 1, reach)))
    sums = np.cumsum(np.cumsum(padded, axis=0, dtype=np.float64), axis=1)
    upper, lower = sums[:-edge], sums[edge:]
    return np.asarray(lower[:, edge:] - lower[:, :-edge] - upper[:, edge:] + upper[:, :-edge])
