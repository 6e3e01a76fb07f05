"""Mutex watershed: groups of cells from edges that attract or repel (Wolf et al., ECCV 2018)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from boxgrasp.kernels._jit import jit
from boxgrasp.kernels.cells import root


@jit
def _apart(
    parent: NDArray[np.int64],
    head: NDArray[np.int64],
    following: NDArray[np.int64],
    against: NDArray[np.int64],
    one: int,
    other: int,
) -> bool:
    """Whether a mutex of group `one` holds against group `other`."""
    at = head[one]
    while at >= 0:
        if root(parent, against[at]) == other:
            return True
        at = following[at]
    return False


@jit
def mutex_watershed(
    first: NDArray[np.int64], second: NDArray[np.int64], attract: NDArray[np.bool_], count: int
) -> NDArray[np.int64]:
    """Group cells: edges in their order, strongest first.

    An attractive edge joins two groups unless a mutex holds between them; a repulsive edge sets
    one. Each group keeps its mutexes as a chain, so that joining two takes no copy; the shorter
    chain is searched.

    Args:
        first: (E,) int64, a cell of each edge.
        second: (E,) int64, its other cell.
        attract: (E,) bool, False for a repulsive edge.
        count: cells, C.

    Returns:
        (C,) int64, a cell of its group for each cell, the same for all of a group.
    """
    parent = np.arange(count)
    size = np.ones(count, dtype=np.int64)
    head = np.full(count, -1, dtype=np.int64)
    tail = np.full(count, -1, dtype=np.int64)
    length = np.zeros(count, dtype=np.int64)
    edges = first.shape[0]
    following = np.full(2 * edges, -1, dtype=np.int64)
    against = np.empty(2 * edges, dtype=np.int64)
    for e in range(edges):
        a, b = root(parent, first[e]), root(parent, second[e])
        if a == b:
            continue
        one, other = (a, b) if length[a] <= length[b] else (b, a)
        held = _apart(parent, head, following, against, one, other)
        if attract[e]:
            if held:
                continue
            if size[a] < size[b]:
                a, b = b, a
            parent[b] = a
            size[a] += size[b]
            if head[b] >= 0:
                if head[a] < 0:
                    head[a] = head[b]
                else:
                    following[tail[a]] = head[b]
                tail[a] = tail[b]
                length[a] += length[b]
        elif not held:
            for k, own, foreign in ((2 * e, a, b), (2 * e + 1, b, a)):
                against[k] = foreign
                if head[own] < 0:
                    head[own] = k
                else:
                    following[tail[own]] = k
                tail[own] = k
                length[own] += 1
    groups = np.empty(count, dtype=np.int64)
    for cell in range(count):
        groups[cell] = root(parent, cell)
    return groups


def mutex_watershed_naive(
    first: NDArray[np.int64], second: NDArray[np.int64], attract: NDArray[np.bool_], count: int
) -> list[set[int]]:
    """The same groups, with sets.

    Args:
        first: (E,) int64, a cell of each edge.
        second: (E,) int64, its other cell.
        attract: (E,) bool.
        count: cells, C.

    Returns:
        The groups.
    """
    groups = [{cell} for cell in range(count)]
    barred: list[tuple[int, int]] = []
    for a, b, joins in zip(first.tolist(), second.tolist(), attract.tolist(), strict=True):
        one = next(group for group in groups if a in group)
        other = next(group for group in groups if b in group)
        if one is other:
            continue
        held = any((x in one and y in other) or (x in other and y in one) for x, y in barred)
        if joins and not held:
            groups.remove(other)
            one |= other
        elif not joins:
            barred.append((a, b))
    return groups
