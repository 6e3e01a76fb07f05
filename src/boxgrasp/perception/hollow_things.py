"""The floors of hollow things: a mug's lies as low as the table, but within the mug.

What the image shows at the table's level enclosed by things' pixels is one thing's floor where it
lies within that thing's outline on the table. The table seen through a handle lies beyond it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Floats, Points
from boxgrasp.kernels.table_cells import dilated, most_round, regions
from boxgrasp.perception.segmentation.protocol import Segments
from boxgrasp.perception.table_level import LevelPoints, TableLevel

RIM_SHARE: Final = 0.8  # of what is round a region, from which things enclose it
_MAIN_SHARE = 0.4  # of it, that a hollow thing in pieces has at least: its far wall
_LEAST_PIECED = 12  # cells of a region that pieces enclose: a gap between touching things is less
_PIECE_SHARE = 0.1  # of it, from which another segment may be a piece of the same thing
SAME_TOP_M: Final = 0.012  # m, up to which the pieces of one rim differ in height
_TOP_SHARE = 0.98  # of a segment's points that lie lower than its top
_WITHIN_SHARE = 0.7  # of a region's points, from which it lies within an outline
_WITHIN_M = 0.004  # m past an outline: a voxel's centroid lies so far inside its edge
_LOWEST_M = -0.003  # m, a floor's middle height: a table's waves reach so far down, no floor does
_DIRECTIONS = 24  # half planes that an outline is cut from
_WAYS = np.array(
    [np.cos(np.arange(_DIRECTIONS) * (2 * np.pi / _DIRECTIONS)),
     np.sin(np.arange(_DIRECTIONS) * (2 * np.pi / _DIRECTIONS))], dtype=np.float32,
)  # fmt: skip
_SIDES = 5  # of 8, on which a floor whose near rim is lost has its thing at least
_MOST_SIDES = 6  # of 8, in the middle of such a floor
_ROUND = (
    0.92  # of a circle's area: a square has 0.79, a drill on its side 0.88, bowls 0.94 and more
)
_MOST_OUTLINE = 2000  # points tell an outline as well as all
_MOST = 64  # regions looked at, the largest ones


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
    pieces = _Pieces(centroids, segments, np.append(np.arange(len(segments.objects)), -1))
    whose = level.owner.copy()
    for inside, places, heights in _enclosed(level):
        ring = _ring(level.owner, inside)
        thing = pieces.round_floor(ring, int(np.count_nonzero(inside)))
        if thing is not None and _is_floor(places, heights, pieces.points(thing)):
            whose[inside] = thing
            pieces.join(ring, thing)
    met, sides = _met(level)
    for inside, places, heights in _half_enclosed(level, (sides >= _MOST_SIDES) & (whose < 0)):
        segment = int(np.bincount(met[inside]).argmax())
        thing = int(pieces.owner_of[segment])
        points = pieces.points(thing)
        if _is_round(points[:, :2]) and _is_floor(places, heights, points):
            pieces.join(_ring(level.owner, inside), thing)
            amid = (met == segment) & (sides >= _SIDES) & (level.count > 0)
            whose[_cells_within(level, amid, points[:, :2])] = thing
    whose = pieces.owner_of[whose]
    # Its rim and its floor share cells, and noise lifts some of the floor's pixels off the table.
    wanted = np.where((level.count > 0) & _amid(whose), whose, -1)
    if not (wanted >= 0).any():
        nothing = LevelPoints(np.empty(0, dtype=np.int32), np.empty(0, dtype=np.int64))
        return HollowThings(nothing, pieces.joined())
    rows, owners, _ = level.rows_in(wanted)
    places = level.in_table_frame(rows)[:, :2]
    kept = np.zeros(len(rows), dtype=np.bool_)
    for thing in np.unique(owners).tolist():
        kept[owners == thing] = _within(places[owners == thing], pieces.points(thing)[:, :2])
    return HollowThings(LevelPoints(rows[kept], pieces.names[owners[kept]]), pieces.joined())


@dataclass(frozen=True, eq=False)
class _Pieces:
    """Segments, some of them joined.

    Attributes:
        centroids: (V, 3) float32, table frame, m.
        segments: of them, C.
        owner_of: (C + 1,) int64 the segment that each belongs to, changed; last, -1, for none.
    """

    centroids: Points
    segments: Segments
    owner_of: NDArray[np.int64]

    def _shares(self, ring: NDArray[np.int64]) -> Floats:
        """(C,) each one's share of the cells round a region."""
        owners = self.owner_of[ring]
        return np.bincount(owners[owners >= 0], minlength=len(self.segments.objects)) / len(ring)

    def points(self, thing: int) -> Points:
        """(n, 3) points of a thing with its pieces, m."""
        points: Points = self.centroids[self.owner_of[self.segments.clusters] == thing]
        return points

    def round_floor(self, ring: NDArray[np.int64], cells: int) -> int | None:
        """The thing that encloses a region of so many cells, alone or with its pieces."""
        shares = self._shares(ring)
        thing = int(np.argmax(shares))
        pieced = cells >= _LEAST_PIECED and shares[thing] >= _MAIN_SHARE
        enclosed = shares.sum() >= RIM_SHARE and (pieced or shares[thing] >= RIM_SHARE)
        return thing if enclosed else None

    def join(self, ring: NDArray[np.int64], thing: int) -> None:
        """Join to a hollow thing the pieces of its rim: what else is round its floor, as high."""
        shares = self._shares(ring)
        objects = self.segments.objects
        if shares[thing] >= RIM_SHARE or not objects[thing]:
            return
        top_m = top(self.points(thing))
        for piece in np.flatnonzero((shares >= _PIECE_SHARE) & objects).tolist():
            if abs(top(self.points(piece)) - top_m) <= SAME_TOP_M:
                self.owner_of[self.owner_of == piece] = thing

    @property
    def names(self) -> NDArray[np.int64]:
        """(C + 1,) the ids of the joined segments, without gaps; last, -1, for none."""
        left = self.owner_of[:-1] == np.arange(len(self.segments.objects))
        return np.append((np.cumsum(left) - 1)[self.owner_of[:-1]], -1)

    def joined(self) -> Segments:
        """The segments with their pieces."""
        left = self.owner_of[:-1] == np.arange(len(self.segments.objects))
        return Segments(self.names[self.segments.clusters], self.segments.objects[left])


def _enclosed(level: TableLevel) -> Iterator[tuple[NDArray[np.bool_], Points, Points]]:
    """The largest regions of the image that things enclose and that show the table's level.

    Yields (rows, columns) bool, (n, 2) places of its points on the table, m, and (n,) heights, m.
    """
    region, count = regions(level.owner < 0, False)
    sizes = np.bincount(region[(region >= 0) & (level.count > 0)], minlength=count)
    border = np.concatenate((region[0], region[-1], region[:, 0], region[:, -1]))
    sizes[np.unique(border[border >= 0])] = 0
    yield from _largest(level, region, sizes)


def _met(level: TableLevel) -> tuple[NDArray[np.int64], NDArray[np.int8]]:
    """The segment that each free cell has on most of 8 sides, -1 for none, and on how many."""
    met = np.full(level.owner.shape, -1, dtype=np.int64)
    sides = np.zeros(level.owner.shape, dtype=np.int8)
    held = [np.flatnonzero((level.owner >= 0).any(axis=1 - axis)) for axis in (0, 1)]
    if len(held[0]) > 0:
        window = np.s_[held[0][0] : held[0][-1] + 1, held[1][0] : held[1][-1] + 1]
        met[window], sides[window] = most_round(level.owner[window])
    return met, sides


def _half_enclosed(
    level: TableLevel, amid: NDArray[np.bool_]
) -> Iterator[tuple[NDArray[np.bool_], Points, Points]]:
    """As `_enclosed`, but for a gap in the near rim: regions of cells with a thing all round."""
    region, count = regions(amid, False)
    sizes = np.bincount(region[region >= 0], minlength=count)
    sizes[sizes < _LEAST_PIECED] = 0
    yield from _largest(level, region, sizes)


def _largest(
    level: TableLevel, region: NDArray[np.int64], sizes: NDArray[np.int64]
) -> Iterator[tuple[NDArray[np.bool_], Points, Points]]:
    """The largest regions, with places and heights of their points."""
    largest = np.argsort(-sizes, kind="stable")[: min(_MOST, int(np.count_nonzero(sizes)))]
    if len(largest) == 0:
        return
    rows, names, heights = level.rows_in(np.where(np.isin(region, largest), region, -1))
    places = level.in_table_frame(rows)[:, :2]
    for name in largest.tolist():
        yield region == name, places[names == name], heights[names == name]


def _cells_within(
    level: TableLevel, cells: NDArray[np.bool_], outline: Points
) -> NDArray[np.bool_]:
    """(rows, columns) those of some cells at the table's level that lie within an outline."""
    within = cells.copy()
    within[cells] = _within(level.in_table_frame(level.first[cells])[:, :2], outline)
    return within


def _is_floor(places: Points, heights: Points, points: Points) -> bool:
    """Whether most of a region lies within a thing's outline, and no lower than floors do."""
    within = _within(places, points[:, :2])
    deep = len(heights) > 0 and float(np.median(heights)) < _LOWEST_M
    return not deep and bool(np.count_nonzero(within) >= _WITHIN_SHARE * len(within))


def _is_round(outline: Points) -> bool:
    """Whether the convex outline of places (n, 2), m, holds nearly what a circle as long does."""
    corners = outline[np.argmax(outline @ _WAYS, axis=0)].astype(np.float64)
    after = np.roll(corners, -1, axis=0)
    area = abs(np.sum(corners[:, 0] * after[:, 1] - corners[:, 1] * after[:, 0])) / 2
    length = np.hypot(*(after - corners).T).sum()
    return bool(4 * np.pi * area > _ROUND * length**2)


def _ring(owner: NDArray[np.int64], inside: NDArray[np.bool_]) -> NDArray[np.int64]:
    """(n,) whose each cell round a region is that does not end with the image."""
    v, u = np.nonzero(inside)
    window = np.s_[v.min() - 1 : v.max() + 2, u.min() - 1 : u.max() + 2]
    return owner[window][dilated(inside[window], 1) & ~inside[window]]


def _amid(whose: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Cells that are a thing's and have nothing but its cells round them."""
    amid = np.zeros(whose.shape, dtype=np.bool_)
    middle = whose[1:-1, 1:-1]
    rows, columns = middle.shape
    same = middle >= 0
    for v in range(3):
        for u in range(3):
            same = same & (whose[v : v + rows, u : u + columns] == middle)
    amid[1:-1, 1:-1] = same
    return amid


def _within(places: Points, outline: Points) -> NDArray[np.bool_]:
    """Whether places on the table lie within the convex outline of others, both (n, 2), m."""
    return np.asarray((places @ _WAYS <= _farthest(outline) + np.float32(_WITHIN_M)).all(axis=1))


def _farthest(outline: Points) -> Points:
    """(24,) how far places (n, 2) reach along each direction, m."""
    reach: Points = (outline[:: max(1, len(outline) // _MOST_OUTLINE)] @ _WAYS).max(axis=0)
    return reach


def top(points: Points) -> float:
    """The height of a thing's top, but for stray points.

    Args:
        points: (N, 3) its points over what it stands on, m.

    Returns:
        The height, m.
    """
    return float(np.quantile(points[:, 2], _TOP_SHARE))
