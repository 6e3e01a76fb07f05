"""Segments and outlines in a panel's pixels."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

XY = tuple[float, float]
Rect = tuple[float, float, float, float]


def clip_to(a: XY, b: XY, rect: Rect) -> tuple[XY, XY] | None:
    """The part of a segment inside a rectangle (Liang and Barsky 1984).

    Args:
        a: x, y of one end, px.
        b: x, y of the other end, px.
        rect: left, upper, right, lower, px.

    Returns:
        Its two ends, or None where nothing is inside.
    """
    low, high = 0.0, 1.0
    for axis in (0, 1):
        step = b[axis] - a[axis]
        for edge, sign in ((rect[axis], 1.0), (rect[axis + 2], -1.0)):
            along, gap = -sign * step, sign * (a[axis] - edge)
            if along == 0.0:
                if gap < 0.0:
                    return None
                continue
            share = gap / along
            if along < 0.0:
                low = max(low, share)
            else:
                high = min(high, share)
    return None if low > high else (_between(a, b, low), _between(a, b, high))


def dashes(a: XY, b: XY, dash: tuple[float, float] | None) -> Iterable[tuple[XY, XY]]:
    """The pieces of a dashed segment.

    Args:
        a: x, y of one end, px.
        b: x, y of the other end, px.
        dash: lengths drawn and left out, px; None for no dashes.

    Returns:
        The two ends of each piece; the segment itself without dashes.
    """
    length = float(np.hypot(b[0] - a[0], b[1] - a[1]))
    if dash is None or length == 0.0:
        yield a, b
        return
    at = 0.0
    while at < length:
        end = min(at + dash[0], length)
        yield _between(a, b, at / length), _between(a, b, end / length)
        at += dash[0] + dash[1]


def hull(points: Sequence[XY]) -> list[XY]:
    """The convex outline of a few points (Andrew 1979).

    Args:
        points: x, y of each, px.

    Returns:
        The corners in order; the points themselves where they are fewer than three.
    """
    ordered = sorted(set(points))
    if len(ordered) < 3:
        return ordered

    def half(run: Iterable[XY]) -> list[XY]:
        chain: list[XY] = []
        for p in run:
            while len(chain) > 1 and _turn(chain[-2], chain[-1], p) <= 0:
                chain.pop()
            chain.append(p)
        return chain[:-1]

    return half(ordered) + half(reversed(ordered))


def overlap(a: Rect, b: Rect) -> bool:
    """Whether two rectangles share an area.

    Args:
        a: left, upper, right, lower, px.
        b: likewise.

    Returns:
        True where they do; touching edges share none.
    """
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]


def _between(a: XY, b: XY, share: float) -> XY:
    return (a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1]))


def _turn(o: XY, a: XY, b: XY) -> float:
    return (a[0] - o[0]) * (b[1] - o[1]) - (a[1] - o[1]) * (b[0] - o[0])
