"""Points as low as the table that are a thing's, added to those over it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Points, readonly
from boxgrasp.kernels.cells import voxel_centroids
from boxgrasp.kernels.table_cells import tops
from boxgrasp.perception.flat_things import flat_things
from boxgrasp.perception.hollow_things import hollow_things
from boxgrasp.perception.placement import Placement
from boxgrasp.perception.scene import ShownPoints
from boxgrasp.perception.scene_config import SceneConfig
from boxgrasp.perception.segmentation.clusters import Clusters
from boxgrasp.perception.segmentation.protocol import Segments
from boxgrasp.perception.table_level import LevelPoints, TableLevel
from boxgrasp.perception.view import View
from boxgrasp.sensing.sensor_model import SensorModel

_PART_SHARE = 0.2  # of a segment's points, from which the rest of it belongs to a flat thing too
_LOW_M = 0.02  # m, up to which a segment may be the noisy part of a flat thing


@dataclass(frozen=True, eq=False)
class FoundPoints:
    """Points that are a thing's, or an outlier.

    Attributes:
        points: (V, 3) float32 voxel centroids, table frame, m.
        segments: of them.
        shown: which pixels show them; one that shows an outlier may show another point too.
        floor_mask: (V,) bool, those of hollow things' floors.
    """

    points: Points
    segments: Segments
    shown: ShownPoints
    floor_mask: NDArray[np.bool_]

    @staticmethod
    def over_table(points: Points, segments: Segments, shown: ShownPoints) -> FoundPoints:
        """Points of which none is a floor's.

        Args:
            points: as `FoundPoints.points`.
            segments: of them.
            shown: as `FoundPoints.shown`.

        Returns:
            The points.
        """
        return FoundPoints(points, segments, shown, np.zeros(len(points), dtype=np.bool_))


def with_low_points(
    found: FoundPoints,
    over: NDArray[np.int32],
    view: View,
    placement: Placement,
    sensor: SensorModel,
    config: SceneConfig,
) -> FoundPoints:
    """The same with the floors of hollow things, and with flat things as segments of their own.

    Args:
        found: the points over the table.
        over: (P,) int32, rising, rows of the view's points that `found` shows.
        view: the first view; without an image nothing is added.
        placement: where it lies.
        sensor: that saw it.
        config: least height over the table, and the voxels' edge.

    Returns:
        More points, or the same.
    """
    if view.shape is None:
        return found
    segments = found.segments
    shown = segments.clusters[found.shown.rows]
    # Noise lifts some of a floor's or a flat thing's pixels clear of the table: what is low and no
    # object may be a floor's, and whatever is low a flat thing's.
    low = np.append(_are_low(found.points, segments), False)
    no_object = low & ~np.append(segments.objects, True)
    level = TableLevel.of(view, placement, over, np.where(no_object[shown], -1, shown))
    hollow = hollow_things(level, found.points, segments)
    floors, segments = hollow.floors, hollow.segments
    deep = ~_are_low(found.points, segments)[floors.owners]  # in a thing that is not low itself
    if low[:-1].any():
        level = TableLevel.of(view, placement, over, np.where(low[shown], -1, shown))
    flat = [
        rows
        for rows in flat_things(level, sensor, config.min_height_m)
        if not np.isin(rows, floors.rows[deep]).any()
    ]
    own = ~deep & ~np.isin(floors.rows, np.concatenate(flat) if flat else ())
    over_table = len(found.points)
    found = _with_part(replace(found, segments=segments), level, floors.of(deep), config.voxel_m)
    found = replace(found, floor_mask=np.arange(len(found.points)) >= over_table)
    found = _with_part(found, level, floors.of(own), config.voxel_m)
    for rows in flat:
        owners = np.full(len(rows), len(found.segments.objects))
        found = _with_part(found, level, LevelPoints(rows, owners), config.voxel_m)
    return found


def _are_low(points: Points, segments: Segments) -> NDArray[np.bool_]:
    """(C,) whether each segment ends within 2 cm of the table."""
    top = tops(points, segments.clusters, len(segments.objects))
    return np.asarray(top < _LOW_M)


def _with_part(
    found: FoundPoints, level: TableLevel, part: LevelPoints, voxel_m: float
) -> FoundPoints:
    """The same with more points in voxels of their own, in place of what their pixels showed."""
    if len(part.rows) == 0:
        return found
    centroids, voxel_of = voxel_centroids(level.in_table_frame(part.rows), voxel_m)
    owners = np.empty(len(centroids), dtype=np.int64)
    owners[voxel_of] = part.owners
    pixels = level.view.pixels[part.rows]
    its = np.isin(found.shown.pixels, pixels)
    objects = found.segments.objects
    clusters = np.append(_without(found, found.shown.rows[its], int(owners.max())), owners)
    pixels = np.concatenate((found.shown.pixels[~its], pixels))
    rows = np.concatenate((found.shown.rows[~its], len(found.points) + voxel_of))
    order = np.argsort(pixels, kind="stable")
    more = int(owners.max()) + 1 - len(objects)
    return FoundPoints(
        points=np.vstack((found.points, centroids)),
        segments=Segments(clusters, np.append(objects, np.ones(max(more, 0), dtype=np.bool_))),
        shown=ShownPoints(readonly(pixels[order]), readonly(rows[order])),
        floor_mask=np.append(found.floor_mask, np.zeros(len(centroids), dtype=np.bool_)),
    )


def _without(found: FoundPoints, rows: NDArray[np.int64], thing: int) -> Clusters:
    """The segments without some points; what is left of one that loses many is the thing's rim."""
    clusters, count = found.segments.clusters, len(found.segments.objects)
    taken = np.zeros(len(clusters), dtype=np.bool_)
    taken[rows] = True
    held = clusters >= 0
    lost = np.bincount(clusters[held & taken], minlength=count)
    rim = np.append(lost > _PART_SHARE * np.bincount(clusters[held], minlength=count), False)
    return np.where(taken, -1, np.where(rim[clusters], thing, clusters))
