"""Part things that stand closer than the Euclidean rule can tell, by how they look from above.

Things that stand on a table differ in the height of their tops, leave a notch in their common
outline, or differ in color. Each Euclidean cluster is laid out in plan: cells join into patches
unless the top steps (a depth edge or a concave crease in the view) or the color does. Scraps and
patches that another one encloses (a cap, a rim, a handle) go back to it, and so does a step whose
lower side is not level: a bottle's shoulder is no other thing, a box before a bottle is. What is
left with a narrow neck in an outline that is not convex is cut there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Floats, Points
from boxgrasp.kernels.nearest import nearest
from boxgrasp.kernels.plan import (
    borders,
    filled,
    grow,
    hull_area,
    inward,
    patches,
    plan_grid,
    smooth_cells,
)
from boxgrasp.perception.segmentation.clusters import rows_by_cluster
from boxgrasp.perception.segmentation.euclidean import clusters_without_specks
from boxgrasp.perception.segmentation.protocol import SeenPoints, SegmentationConfig, Segments
from boxgrasp.sensing.sensor_model import SensorModel

Patches = NDArray[np.int64]  # of the cells of a plan, from 0, -1 for none

# Found on cast scenes of the thesis's objects, unless said otherwise.
_CELL_M = 0.004  # m, edge of a cell of the plan
_MOST_CELL_M = 0.010  # m, to which it grows with the distance: a can is 7 cm wide
_GAP_CELLS = 1.25  # a cell holds at least so many rows of pixels
_LEAST_OVER_M = 0.05  # m, height of the camera over a top under which rows say nothing
_STEP_M = 0.008  # m, between neighboring cells from which a top steps
_TINT_STEP = 0.10  # sum of differences of the three shares of color
_LEAST_BRIGHTNESS = 30.0  # of 3 x 255: darker colors are noise
_RAGGED = 3  # neighbors of a smooth cell that may be missing or a step away
_LEAST_M2 = 0.0005  # m2, smooth ground of a thing of its own: 2.2 cm squared
_BROAD = 3  # cells from its middle to its rim at least
_ENCLOSED = 0.42  # share of its outline on a neighbor from which a patch is part of it
_EVEN_SHARE = 0.8  # of the smooth ground in large patches of one color, for color to count
_EVEN_TINT = 0.012  # standard deviation of a share of color up to which a patch has one color
_OVERLAP = 0.3  # share of the smaller of two outlines from which they overlap
_NOTCHED = 0.86  # parts must fill their outlines this much better than the whole
_CONVEX = 0.90  # share of its hull that a part fills at least
_LEVEL_M = 0.005  # m, from the middle height to the 90 % one, up to which a top is level


def split_segments(seen: SeenPoints, config: SegmentationConfig) -> Segments:
    """Euclidean clusters, those of several things parted.

    Args:
        seen: points, colors and camera position.
        config: the tolerance.

    Returns:
        Clusters that may all be objects; a part keeps its cluster's id, others get new ones.
    """
    points, camera_position_m = seen.points, seen.camera_position_m
    clusters = clusters_without_specks(points, config.cluster_tolerance_m)
    parted = clusters.copy()
    tints = _tints(points, seen.colors)
    following = int(clusters.max(initial=-1)) + 1
    for rows in rows_by_cluster(clusters):
        if len(rows) < 2 * _LEAST_M2 / _CELL_M**2:
            continue
        cluster = np.ascontiguousarray(points[rows])
        cell_m = _CELL_M
        if camera_position_m is not None:
            cell_m = max(cell_m, _GAP_CELLS * _row_gap_m(cluster, camera_position_m, seen.sensor))
        pieces = _pieces(cluster, np.ascontiguousarray(tints[rows]), cell_m)
        for piece in range(1, int(pieces.max()) + 1):
            parted[rows[pieces == piece]] = following
            following += 1
    return Segments.all_objects(parted)


def _row_gap_m(points: Points, camera_position_m: Floats, sensor: SensorModel) -> float:
    """How far apart the camera's rows of pixels fall on a level top of these points."""
    middle = points.mean(axis=0, dtype=np.float64)
    away = float(np.sum((middle - camera_position_m) ** 2))
    over = max(float(camera_position_m[2] - points[:, 2].max()), _LEAST_OVER_M)
    return min(away / (sensor.focal_px * over), _MOST_CELL_M / _GAP_CELLS)


def _tints(points: Points, colors: Points | None) -> Points:
    """(K, 3) shares of red, green and blue: what shading leaves as it is."""
    if colors is None:
        return np.full((len(points), 3), np.nan, dtype=np.float32)
    shares = colors / np.maximum(colors.sum(axis=1, keepdims=True), _LEAST_BRIGHTNESS)
    return np.asarray(shares, dtype=np.float32)


def _pieces(points: Points, tints: Points, cell_m: float) -> Patches:
    """(N,) piece of each point of one cluster, from 0."""
    top, tint, cells = plan_grid(points, tints, cell_m)
    least = round(_LEAST_M2 / cell_m**2)
    inside = np.isfinite(top)
    ground = _ground(top, tint, np.inf, least)
    patch_of = np.where(inside, 0, -1)
    if ground.max() > 0:
        patch_of = _joined(grow(ground, inside), *_tops(ground, top))
    if np.isfinite(tint).any() and not _plain(tint):
        colored = _ground(top, tint, _TINT_STEP, least)
        if colored.max() > 0 and _even(colored, ground, tint):
            ground = colored
            always = np.ones(int(colored.max()) + 1, dtype=bool)
            patch_of = _joined(grow(colored, inside), always, always.astype(np.float64))
    patch_of = _cut_necks(_apart(patch_of), least)
    pieces = np.maximum(patch_of[cells[:, 0], cells[:, 1]], 0)
    if patch_of.max() > 0:
        rough = ground[cells[:, 0], cells[:, 1]] < 0
        if rough.any() and not rough.all():
            _give_to_nearest(points, pieces, rough)
    return pieces


def _ground(top: Points, tint: Points, tint_step: float, least: int) -> Patches:
    """(nx, ny) patch of each smooth cell, from 0; -1 where a wall's noise or a scrap is."""
    smooth = smooth_cells(top, tint, _STEP_M, tint_step, _RAGGED)
    patch_of = patches(smooth, top, tint, _STEP_M, tint_step)
    broad = np.bincount(patch_of[smooth], minlength=1) >= least
    for k in np.flatnonzero(broad).tolist():  # a wall seen aslant is long, but no ground to stand
        broad[k] = inward(filled(patch_of == k)).max() >= _BROAD
    names = np.where(broad, np.cumsum(broad) - 1, -1)
    return np.where(smooth, names[np.maximum(patch_of, 0)], -1)


def _plain(tint: Points) -> bool:
    """Whether the whole plan has one color, as most things have."""
    return float(np.nanstd(tint, axis=(0, 1)).max()) <= _EVEN_TINT


def _give_to_nearest(points: Points, pieces: Patches, rough: NDArray[np.bool_]) -> None:
    """Points off the smooth ground, a wall's mostly, join the nearest one's piece in space."""
    held = np.flatnonzero(~rough)
    pieces[rough] = pieces[held[nearest(points[rough], points[held])]]


def _even(colored: Patches, ground: Patches, tint: Points) -> bool:
    """Whether nearly all smooth ground lies in patches of one plain color each."""
    even = 0
    for k in range(int(colored.max()) + 1):
        cells = tint[colored == k]
        if float(np.nanstd(cells, axis=0).max()) <= _EVEN_TINT:
            even += len(cells)
    return even > 0 and even >= _EVEN_SHARE * int(np.count_nonzero(ground >= 0))


def _tops(patch_of: Patches, top: Points) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Whether each patch is level, and its middle height."""
    inside = patch_of >= 0
    if not inside.any():
        return np.zeros(1, dtype=bool), np.zeros(1)
    patch, height = patch_of[inside], top[inside]
    order = np.lexsort((height, patch))
    edges = np.searchsorted(patch[order], np.arange(int(patch.max()) + 2))
    sizes = np.diff(edges) - 1
    middle, high = (
        height[order[edges[:-1] + (share * sizes).astype(np.int64)]] for share in (0.5, 0.9)
    )
    return high - middle <= _LEVEL_M, middle.astype(np.float64)


def _joined(patch_of: Patches, level: NDArray[np.bool_], height: NDArray[np.float64]) -> Patches:
    """Patches with enclosed ones and unlevel steps given to their main neighbor."""
    count = int(patch_of.max()) + 1
    if count < 2:
        return patch_of
    table = borders(patch_of, count)
    owner = np.arange(count)
    alive = list(range(count))
    while len(alive) > 1:
        pair = _pair_to_join(table, alive, level, height)
        if pair is None:
            break
        a, b = pair
        area = table[a, a] + table[b, b]
        table[b] += table[a]
        table[:, b] += table[:, a]
        table[b, b] = area
        table[a] = 0
        table[:, a] = 0
        owner[owner == a] = b
        alive.remove(a)
    names = np.full(count, -1, dtype=np.int64)
    names[alive] = np.arange(len(alive))
    return np.where(patch_of >= 0, names[owner[np.maximum(patch_of, 0)]], -1)


def _pair_to_join(
    table: NDArray[np.int64],
    alive: list[int],
    level: NDArray[np.bool_],
    height: NDArray[np.float64],
) -> tuple[int, int] | None:
    """The smallest patch that its main neighbor encloses or steps off, and that neighbor."""
    best = None
    outside = len(table) - 1
    for a in alive:
        area = int(table[a, a])
        sides = table[a].copy()
        sides[a] = 0
        outline = int(sides.sum())
        sides[outside] = 0
        b = int(np.argmax(sides))
        if sides[b] == 0:
            continue
        enclosed = sides[b] > _ENCLOSED * outline and area <= table[b, b]
        lower = a if height[a] < height[b] else b
        if (enclosed or not level[lower]) and (best is None or (area, a) < best[:2]):
            best = (area, a, b)
    return None if best is None else best[1:]


def _apart(patch_of: Patches) -> Patches:
    """Patches whose outlines overlap are one: a bowl's floor lies within its rim."""
    count = int(patch_of.max()) + 1
    outlines = [_Outline.of(*np.nonzero(patch_of == k)) for k in range(count)]
    a = 0
    while a < len(outlines):
        for b in range(a + 1, len(outlines)):
            both = outlines[a].overlapping(outlines[b])
            if both is not None:
                outlines[a] = both
                del outlines[b]
                a = -1
                break
        a += 1
    joined = np.full_like(patch_of, -1)
    for name, outline in enumerate(outlines):
        joined[outline.rows, outline.columns] = name
    return joined


@dataclass(frozen=True, eq=False)
class _Outline:
    """A patch with the convex hull of its cells.

    Attributes:
        rows: (C,) int64, of its cells.
        columns: (C,) int64.
        low: the least row and column.
        high: the greatest.
        hull: area, in cells.
    """

    rows: Patches
    columns: Patches
    low: tuple[int, int]
    high: tuple[int, int]
    hull: float

    @staticmethod
    def of(rows: Patches, columns: Patches) -> _Outline:
        """The outline of some cells."""
        low = int(rows.min()), int(columns.min())
        high = int(rows.max()), int(columns.max())
        inside = np.zeros((high[0] - low[0] + 1, high[1] - low[1] + 1), dtype=np.bool_)
        inside[rows - low[0], columns - low[1]] = True
        return _Outline(rows, columns, low, high, hull_area(inside))

    def overlapping(self, other: _Outline) -> _Outline | None:
        """The outline of both where they overlap; None else."""
        least = _OVERLAP * min(self.hull, other.hull)
        shared = 1
        for k in (0, 1):
            span = min(self.high[k], other.high[k]) - max(self.low[k], other.low[k]) + 1
            shared *= max(span, 0)
        if shared <= least:  # hulls overlap by no more than the rectangles round them
            return None
        both = _Outline.of(
            np.concatenate((self.rows, other.rows)), np.concatenate((self.columns, other.columns))
        )
        # Two convex outlines side by side span at least the sum of their areas.
        return both if self.hull + other.hull - both.hull > least else None


def _cut_necks(patch_of: Patches, least: int) -> Patches:
    """Patches whose outline is notched are cut at the neck, if both parts come out convex."""
    following = int(patch_of.max()) + 1
    for patch in range(following):
        part = _part_past_neck(patch_of == patch, least)
        if part is not None:
            patch_of = np.where(part, following, patch_of)
            following += 1
    return patch_of


def _part_past_neck(inside: NDArray[np.bool_], least: int) -> NDArray[np.bool_] | None:
    """The cells of a patch on one side of its neck; None where it is not to be cut.

    Rims are taken off until the core falls apart, and the cores grown again over the patch.
    """
    whole = hull_area(inside)
    if np.count_nonzero(inside) < 2 * least or np.count_nonzero(inside) > _NOTCHED * whole:
        return None
    steps = inward(inside)
    flat = np.zeros((*steps.shape, 3), dtype=np.float32)
    for width in range(1, int(steps.max())):
        cores = patches(steps > width, flat[..., 0].copy(), flat, 1.0, np.inf)
        if cores.max() < 1:
            continue
        parts = grow(cores, inside)
        sizes = np.bincount(parts[parts >= 0])
        hulls = [hull_area(parts == k) for k in range(len(sizes))]
        convex = all(s >= _CONVEX * h for s, h in zip(sizes, hulls, strict=True))
        cut = len(sizes) == 2 and sizes.min() >= least and convex
        return parts == 1 if cut and sum(hulls) < _NOTCHED * whole else None
    return None
