"""The floors of hollow things: a mug's lies as low as the table, but within the mug.

What the image shows at the table's level enclosed by things' pixels is one thing's floor where it
lies within that thing's outline on the table. The table seen through a handle lies beyond it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Points
from boxgrasp.kernels.table_cells import dilated, regions
from boxgrasp.perception.segmentation.protocol import Segments
from boxgrasp.perception.table_level import LevelPoints, TableLevel

RIM_SHARE: Final = 0.8  # of what is round a region, from which things enclose it
_MAIN_SHARE = 0.4  # of it, that a hollow thing in pieces has at least: its far wall
_LEAST_PIECED = 12  # cells of a region that pieces enclose: a gap between touching things is less
_PIECE_SHARE = 0.1  # of it, from which another segment may be a piece of the same thing
_SAME_TOP_M = 0.012  # m, up to which the pieces of one rim differ in height
_TOP_SHARE = 0.98  # of a segment's points that lie lower than its top
_WITHIN_SHARE = 0.7  # of a region's points, from which it lies within an outline
_WITHIN_M = 0.004  # m past an outline: a voxel's centroid lies so far inside its edge
_LOWEST_M = -0.003  # m, a floor's middle height: a table's waves reach so far down, no floor does
_DIRECTIONS = 24  # half planes that an outline is cut from
_MOST_OUTLINE = 2000  # points tell an outline as well as all
_MOST = 32  # regions looked at, the largest ones


@dataclass(frozen=True, eq=False)
class HollowThings:
    """What hollow things add to the segments.

    Attributes:
        floors: points at the table's level that lie in them.
        segments: with those that are pieces of one rim joined.
    """

    floors: LevelPoints
    segments: Segments


def hollow_things(level: TableLevel, centroids: Points, segments: Segments) -> HollowThings:
    """The points at the table's level that lie in hollow things, and the pieces of their rims.

    Args:
        level: the table's level in the image.
        centroids: (V, 3) float32, table frame, m.
        segments: of these points.

    Returns:
        Floors and segments.
    """
    clusters, objects = segments.clusters, segments.objects
    region, count = regions(level.owner < 0, False)
    border = (region[0], region[-1], region[:, 0], region[:, -1])
    sizes = np.bincount(region[region >= 0], minlength=count)
    sizes[np.setdiff1d(np.concatenate(border), (-1,))] = 0
    owner_of = np.append(np.arange(len(objects)), -1)  # of each segment, -1 for none
    parts: list[LevelPoints] = []
    for name in np.argsort(-sizes, kind="stable")[: min(_MOST, np.count_nonzero(sizes))].tolist():
        inside = region == name
        ring = level.owner[dilated(inside, 1) & ~inside]
        shares = np.bincount(owner_of[ring[ring >= 0]], minlength=len(objects)) / len(ring)
        thing = int(np.argmax(shares))
        pieced = sizes[name] >= _LEAST_PIECED and shares[thing] >= _MAIN_SHARE
        if shares.sum() < RIM_SHARE or not (pieced or shares[thing] >= RIM_SHARE):
            continue
        rows = _floor(level, inside, centroids[owner_of[clusters] == thing])
        if len(rows) == 0:
            continue
        parts.append(LevelPoints(rows, np.full(len(rows), thing)))
        for piece in np.flatnonzero(pieced & (shares >= _PIECE_SHARE)).tolist():
            tops = [_top(centroids[owner_of[clusters] == k]) for k in (thing, piece)]
            if objects[thing] and objects[piece] and abs(tops[0] - tops[1]) <= _SAME_TOP_M:
                owner_of[owner_of == piece] = thing
    if not parts:
        nothing = LevelPoints(np.empty(0, dtype=np.int32), np.empty(0, dtype=np.int64))
        return HollowThings(nothing, segments)
    rows = np.concatenate([part.rows for part in parts])
    owners = owner_of[np.concatenate([part.owners for part in parts])]
    order = np.argsort(rows)
    left = owner_of == np.append(np.arange(len(objects)), -2)  # no others' pieces
    names = np.append(np.cumsum(left[:-1]) - 1, -1)
    joined = Segments(names[owner_of[clusters]], objects[left[:-1]])
    return HollowThings(LevelPoints(rows[order], names[owners[order]]), joined)


def _floor(level: TableLevel, inside: NDArray[np.bool_], thing: Points) -> NDArray[np.int32]:
    """(n,) rows of the points in a region that are a thing's floor; none where it is the table.

    thing: (m, 3) the thing's points, table frame, m.
    """
    rows, _, heights = level.rows_in(np.where(inside, 0, -1))
    if len(rows) == 0 or len(thing) == 0 or float(np.median(heights)) < _LOWEST_M:
        return rows[:0]
    within = _within(level.in_table_frame(rows)[:, :2], thing[:, :2])
    return rows[within] if np.count_nonzero(within) >= _WITHIN_SHARE * len(rows) else rows[:0]


def _within(places: Points, outline: Points) -> NDArray[np.bool_]:
    """Whether places on the table lie within the convex outline of others, both (n, 2), m."""
    angles = np.arange(_DIRECTIONS) * (2 * np.pi / _DIRECTIONS)
    directions = np.stack((np.cos(angles), np.sin(angles))).astype(np.float32)
    some = outline[:: max(1, len(outline) // _MOST_OUTLINE)]
    farthest = (some @ directions).max(axis=0) + np.float32(_WITHIN_M)
    return np.asarray((places @ directions <= farthest).all(axis=1))


def _top(points: Points) -> float:
    """The height of a segment's top, m."""
    return float(np.quantile(points[:, 2], _TOP_SHARE))
