"""Points in cells: voxel centroids, Euclidean clusters by the exact rule, neighbor distances."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Points
from boxgrasp.kernels._jit import jit
from boxgrasp.kernels._threads import run_chunks

_BIAS = 1 << 20  # a key holds three cell numbers of 21 bits
_MASK = (1 << 21) - 1


@jit
def _slot(table: NDArray[np.int64], key: int) -> int:
    """Where a key stands in an open-addressing table of packed cells, or the empty place for it."""
    size = table.shape[0] - 1
    h = (key * -7046029254386353131) >> 20
    h = h & size
    while table[h] != -1 and table[h] != key:
        h = (h + 1) & size
    return int(h)


@jit
def group_by_cell(
    points: Points, cell_m: float
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Number the cells that hold points, in the order in which their first points come.

    Args:
        points: (N, 3) float32, m.
        cell_m: edge of a cell, m.

    Returns:
        (N,) int64 cell of each point, (C,) int64 packed keys of the cells, and an open-addressing
        table (S,) int64 of keys with (S,) int64 their cells.
    """
    count = points.shape[0]
    size = 1024
    while size < 2 * count:
        size *= 2
    table = np.full(size, -1, dtype=np.int64)
    value = np.empty(size, dtype=np.int64)
    keys = np.empty(count, dtype=np.int64)
    member = np.empty(count, dtype=np.int64)
    cells = 0
    for i in range(count):
        kx = int(np.floor(points[i, 0] / cell_m)) + _BIAS
        ky = int(np.floor(points[i, 1] / cell_m)) + _BIAS
        kz = int(np.floor(points[i, 2] / cell_m)) + _BIAS
        key = (kx << 42) | (ky << 21) | kz
        at = _slot(table, key)
        if table[at] == -1:
            table[at] = key
            value[at] = cells
            keys[cells] = key
            cells += 1
        member[i] = value[at]
    return member, keys[:cells], table, value


@jit
def voxel_centroids(points: Points, voxel_m: float) -> tuple[Points, NDArray[np.int64]]:
    """Downsample points to a centroid a voxel.

    Args:
        points: (N, 3) float32, m.
        voxel_m: edge of a voxel, m.

    Returns:
        (K, 3) float32 centroids, m, and (N,) int64 which voxel a point is in.
    """
    member, keys, _table, _value = group_by_cell(points, voxel_m)
    sums = np.zeros((keys.shape[0], 4))
    for i in range(points.shape[0]):
        k = member[i]
        sums[k, 0] += points[i, 0]
        sums[k, 1] += points[i, 1]
        sums[k, 2] += points[i, 2]
        sums[k, 3] += 1.0
    centroids = np.empty((keys.shape[0], 3), dtype=np.float32)
    for k in range(keys.shape[0]):
        for a in range(3):
            centroids[k, a] = sums[k, a] / sums[k, 3]
    return centroids, member


@jit
def bucket(member: NDArray[np.int64], cells: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows of the points cell by cell (counting sort).

    Args:
        member: (N,) int64 cell of each point.
        cells: number of cells, C.

    Returns:
        (N,) int64 rows, and (C + 1,) int64 where each cell starts in them.
    """
    start = np.zeros(cells + 1, dtype=np.int64)
    for i in range(member.shape[0]):
        start[member[i] + 1] += 1
    for k in range(cells):
        start[k + 1] += start[k]
    order = np.empty(member.shape[0], dtype=np.int64)
    fill = start[:-1].copy()
    for i in range(member.shape[0]):
        order[fill[member[i]]] = i
        fill[member[i]] += 1
    return order, start


@jit
def root(parent: NDArray[np.int64], k: int) -> int:
    """The root of an element in a union-find forest; halves the path to it.

    Args:
        parent: (N,) int64, changed.
        k: the element.

    Returns:
        Its root.
    """
    while parent[k] != k:
        parent[k] = parent[parent[k]]
        k = parent[k]
    return k


@jit
def euclidean_clusters(points: Points, radius_m: float) -> NDArray[np.int64]:
    """Clusters of points nearer to each other than a radius, exactly.

    Cells of radius / sqrt(3) lie within one cluster each; neighboring cells join when one pair of
    their points does.

    Args:
        points: (N, 3) float32, m.
        radius_m: m.

    Returns:
        (N,) int64 ids from 0, in the order in which the clusters' first points come.
    """
    member, keys, table, value = group_by_cell(points, radius_m / np.sqrt(3.0))
    cells = keys.shape[0]
    order, start = bucket(member, cells)
    parent = np.arange(cells)
    limit = radius_m * radius_m
    for a in range(cells):
        key = keys[a]
        kx, ky, kz = key >> 42, (key >> 21) & _MASK, key & _MASK
        for dx in range(0, 3):
            for dy in range(-2, 3):
                for dz in range(-2, 3):
                    if dx == 0 and (dy < 0 or (dy == 0 and dz <= 0)):
                        continue
                    other = ((kx + dx) << 42) | ((ky + dy) << 21) | (kz + dz)
                    at = _slot(table, other)
                    if table[at] == -1:
                        continue
                    b = value[at]
                    ra, rb = root(parent, a), root(parent, b)
                    if ra == rb:
                        continue
                    joined = False
                    for p in range(start[a], start[a + 1]):
                        i = order[p]
                        for q in range(start[b], start[b + 1]):
                            j = order[q]
                            x = points[i, 0] - points[j, 0]
                            y = points[i, 1] - points[j, 1]
                            z = points[i, 2] - points[j, 2]
                            if x * x + y * y + z * z < limit:
                                joined = True
                                break
                        if joined:
                            break
                    if joined:
                        parent[max(ra, rb)] = min(ra, rb)
    names = np.full(cells, -1, dtype=np.int64)
    clusters = np.empty(points.shape[0], dtype=np.int64)
    found = 0
    for i in range(points.shape[0]):
        r = root(parent, member[i])
        if names[r] == -1:
            names[r] = found
            found += 1
        clusters[i] = names[r]
    return clusters


@jit
def neighbor_means(
    points: Points,
    keys: NDArray[np.int64],
    table: NDArray[np.int64],
    value: NDArray[np.int64],
    order: NDArray[np.int64],
    start: NDArray[np.int64],
    around: NDArray[np.int64],
    reach_m: float,
    enough: Points,
    best: Points,
    means: Points,
    first: int,
    last: int,
    step: int,
) -> None:
    """Mean distances of points to their nearest neighbors, for every step-th cell of [first, last).

    A point all of whose neighbors are nearer than its own `enough` is not measured further; its
    mean is noted as 0.

    Args:
        points: (N, 3) float32, m.
        keys: (C,) int64, as `group_by_cell` has them.
        table: (S,) int64.
        value: (S,) int64.
        order: (N,) int64, as `bucket` has it.
        start: (C + 1,) int64, likewise.
        around: (27, 3) int64, a cell and its neighbors, nearest first.
        reach_m: edge of the cells, m; neighbors beyond count as so far.
        enough: (N,) float32, m.
        best: (p, k) float32 scratch, for the points of one cell and their k neighbors.
        means: (N,) float32 to fill, m.
        first: cell.
        last: cell.
        step: of cells.
    """
    far = np.float32(reach_m * reach_m)
    neighbors = best.shape[1]
    for a in range(first, last, step):
        base = start[a]
        pending = start[a + 1] - base
        for p in range(pending):
            for k in range(neighbors):
                best[p, k] = far
        for cell in range(around.shape[0]):
            shift = (around[cell, 0] << 42) + (around[cell, 1] << 21) + around[cell, 2]
            at = _slot(table, keys[a] + shift)
            if table[at] == -1:
                continue
            b = value[at]
            for p in range(start[a + 1] - base):
                i = order[base + p]
                near_enough = enough[i] * enough[i]
                if best[p, neighbors - 1] < near_enough:
                    continue
                for q in range(start[b], start[b + 1]):
                    j = order[q]
                    if j == i:
                        continue
                    x = points[i, 0] - points[j, 0]
                    y = points[i, 1] - points[j, 1]
                    z = points[i, 2] - points[j, 2]
                    d = x * x + y * y + z * z
                    if d < best[p, neighbors - 1]:
                        k = neighbors - 1
                        while k > 0 and best[p, k - 1] > d:
                            best[p, k] = best[p, k - 1]
                            k -= 1
                        best[p, k] = d
                if best[p, neighbors - 1] < near_enough:
                    pending -= 1
            if pending == 0:
                break
        for p in range(start[a + 1] - base):
            i = order[base + p]
            total = 0.0
            if best[p, neighbors - 1] >= enough[i] * enough[i]:
                for k in range(neighbors):
                    total += np.sqrt(float(best[p, k]))
            means[i] = total / neighbors


_AROUND = np.array(
    sorted(itertools.product((-1, 0, 1), repeat=3), key=lambda cell: sum(map(abs, cell)))
)


class Neighbors:
    """Points in cells of one reach, to measure mean distances to their nearest neighbors."""

    def __init__(self, points: Points, neighbors: int, reach_m: float) -> None:
        member, self._keys, self._table, self._value = group_by_cell(points, reach_m)
        self._order, self._start = bucket(member, self._keys.shape[0])
        self._points, self._neighbors, self._reach_m = points, neighbors, reach_m
        self._fullest = int(np.diff(self._start).max(initial=1))

    def means(self, enough_m: Points, cell_step: int = 1) -> Points:
        """Mean distances to the nearest neighbors; those beyond reach count as reach.

        Args:
            enough_m: (N,) float32, m; where a point's neighbors are all nearer than this, 0 comes
                out.
            cell_step: only every so many cells are measured.

        Returns:
            (N,) float32, m, NaN where it was not measured.
        """
        means = np.full(len(self._points), np.nan, dtype=np.float32)

        def work(first: int, last: int) -> None:
            first += -first % cell_step
            best = np.empty((self._fullest, self._neighbors), dtype=np.float32)
            neighbor_means(
                self._points, self._keys, self._table, self._value, self._order, self._start,
                _AROUND, self._reach_m, enough_m, best, means, first, last, cell_step,
            )  # fmt: skip

        run_chunks(work, self._keys.shape[0], smallest=500 * cell_step)
        return means


def mean_neighbor_distance(points: Points, neighbors: int, reach_m: float) -> Points:
    """Mean distance of each point to its nearest neighbors, none left out.

    Args:
        points: (N, 3) float32, m.
        neighbors: how many.
        reach_m: neighbors beyond count as so far, m.

    Returns:
        (N,) float32, m.
    """
    exact = np.zeros(len(points), dtype=np.float32)
    return Neighbors(points, neighbors, reach_m).means(exact)
