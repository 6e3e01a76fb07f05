"""The nearest of other points, by a k-d tree: its work is bounded wherever the points lie."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Points
from boxgrasp.kernels._jit import jit

_LEAF = 8  # points up to which a node is not divided
_DEPTH = 64  # of the stacks: the tree of 2^31 points is half as deep


@jit
def _select(points: Points, order: NDArray[np.int64], low: int, high: int, axis: int) -> int:
    """Put the lower half of order[low:high] along an axis before the upper one; the middle.

    Quickselect with three parts, so that many equal coordinates cost nothing more.
    """
    middle = (low + high) // 2
    first, last = low, high - 1
    while first < last:
        a = points[order[first], axis]
        b = points[order[(first + last) // 2], axis]
        c = points[order[last], axis]
        pivot = max(min(a, b), min(max(a, b), c))
        left, right, at = first, last, first
        while at <= right:
            value = points[order[at], axis]
            if value < pivot:
                order[left], order[at] = order[at], order[left]
                left += 1
                at += 1
            elif value > pivot:
                order[right], order[at] = order[at], order[right]
                right -= 1
            else:
                at += 1
        if middle < left:
            last = left - 1
        elif middle > right:
            first = right + 1
        else:
            break
    return middle


@jit
def _square_to_box(points: Points, i: int, box: Points) -> np.float32:
    """Square distance of a point to a box (2, 3), rounded as that to a point in it: never more."""
    total = np.float32(0.0)
    for k in range(3):
        off = max(box[0, k] - points[i, k], points[i, k] - box[1, k], np.float32(0.0))
        total += off * off
    return total


@jit
def nearest_counted(points: Points, others: Points) -> tuple[NDArray[np.int64], int]:
    """The other point nearest to each point; the first of equals.

    Args:
        points: (N, 3) float32, m.
        others: (M, 3) float32, m, at least one.

    Returns:
        (N,) int64 rows of the others, and how many distances were measured, to points and nodes.
    """
    count = others.shape[0]
    order = np.arange(count)
    # Nodes are halves of halves of `order`, each named by its middle, and hold what lies in a box.
    boxes = np.empty((count, 2, 3), dtype=np.float32)
    stack = np.empty((_DEPTH, 2), dtype=np.int64)
    stack[0, 0], stack[0, 1] = 0, count
    depth = 1
    while depth > 0:
        depth -= 1
        low, high = stack[depth, 0], stack[depth, 1]
        box = boxes[(low + high) // 2]
        axis = 0
        for k in range(3):
            box[0, k] = box[1, k] = others[order[low], k]
            for i in range(low + 1, high):
                box[0, k] = min(box[0, k], others[order[i], k])
                box[1, k] = max(box[1, k], others[order[i], k])
            if box[1, k] - box[0, k] > box[1, axis] - box[0, axis]:
                axis = k
        if high - low > _LEAF:
            middle = _select(others, order, low, high, axis)
            stack[depth, 0], stack[depth, 1] = low, middle
            stack[depth + 1, 0], stack[depth + 1, 1] = middle, high
            depth += 2
    found = np.zeros(points.shape[0], dtype=np.int64)
    gaps = np.empty(_DEPTH, dtype=np.float32)  # square distance to each node's box
    measured = 0
    for i in range(points.shape[0]):
        least, best = np.float32(np.inf), count
        stack[0, 0], stack[0, 1], gaps[0] = 0, count, np.float32(0.0)
        depth = 1
        while depth > 0:
            depth -= 1
            if gaps[depth] > least:
                continue
            low, high = stack[depth, 0], stack[depth, 1]
            if high - low <= _LEAF:
                measured += high - low
                for j in range(low, high):
                    row = order[j]
                    x = points[i, 0] - others[row, 0]
                    y = points[i, 1] - others[row, 1]
                    z = points[i, 2] - others[row, 2]
                    square = x * x + y * y + z * z
                    if square < least or (square == least and row < best):
                        least, best = square, row
                continue
            measured += 2
            middle = (low + high) // 2
            lower = _square_to_box(points, i, boxes[(low + middle) // 2])
            upper = _square_to_box(points, i, boxes[(middle + high) // 2])
            # The nearer half is looked at first.
            first, last = (depth + 1, depth) if lower <= upper else (depth, depth + 1)
            stack[first, 0], stack[first, 1], gaps[first] = low, middle, lower
            stack[last, 0], stack[last, 1], gaps[last] = middle, high, upper
            depth += 2
        found[i] = best
    return found, measured


def nearest(points: Points, others: Points) -> NDArray[np.int64]:
    """The other point nearest to each point; the first of equals.

    Args:
        points: (N, 3) float32, m.
        others: (M, 3) float32, m, at least one.

    Returns:
        (N,) int64 rows of the others.
    """
    return nearest_counted(points, others)[0]


def nearest_naive(points: Points, others: Points) -> NDArray[np.int64]:
    """The same rows, from all distances.

    Args:
        points: (N, 3) float32, m.
        others: (M, 3) float32, m, at least one.

    Returns:
        (N,) int64.
    """
    away = points[:, None] - others[None]
    squares = (
        away[..., 0] * away[..., 0] + away[..., 1] * away[..., 1] + away[..., 2] * away[..., 2]
    )
    return np.asarray(np.argmin(squares, axis=1))
