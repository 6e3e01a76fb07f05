"""Which clusters are objects, numbered from the nearest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Floats, Points, readonly
from boxgrasp.perception.scene_config import SceneConfig
from boxgrasp.perception.segmentation.clusters import Clusters, rows_by_cluster


@dataclass(frozen=True, eq=False)
class SceneObject:
    """One thing on the support plane.

    Attributes:
        number: counts from the nearest, from 1.
        center_m: (3,) float64, middle of its visible points' extent, base frame, m.
        size_m: (3,) float64, their extent along the base's axes, m.
        distance_m: of their mean from the camera, or from the base where that is unknown, m.
        points: how many of the scene's points it has.
        pixel: (u, v) of one of its pixels near its middle; None where it was not asked for, and
            without an image.
    """

    number: int
    center_m: Floats
    size_m: Floats
    distance_m: float
    points: int
    pixel: tuple[int, int] | None


@dataclass(frozen=True, eq=False)
class _Cluster:
    """A cluster's points and their rows, their mean (base frame, m), and how far that is."""

    rows: NDArray[np.int64]
    points: Points
    middle_m: Floats
    distance_m: float


def cluster_middles(points: Points, clusters: Clusters) -> Points:
    """Mean of the points of each cluster.

    Args:
        points: (K, 3) float32, any frame, m.
        clusters: (K,) int64 ids, -1 for none.

    Returns:
        (C, 3) float32, in the points' frame, m.
    """
    held = clusters >= 0
    ids, own = clusters[held], points[held]
    count = np.maximum(np.bincount(ids), 1)
    sums = [np.bincount(ids, own[:, k]) for k in range(3)]
    return np.column_stack([total / count for total in sums]).astype(np.float32)


def number_objects(
    points: Points,
    clusters: Clusters,
    over_table: NDArray[np.bool_],
    camera_position_m: Floats | None,
    config: SceneConfig,
) -> tuple[NDArray[np.int64], tuple[SceneObject, ...]]:
    """Number the clusters over the table that are in reach, from the nearest.

    Args:
        points: (K, 3) float32, base frame, m.
        clusters: (K,) int64 ids, -1 for none.
        over_table: (C,) bool, whether each cluster stands over the part of the plane that was seen.
        camera_position_m: (3,) base frame, m, or None where it is unknown.
        config: size, range and workspace.

    Returns:
        (K,) int64 object numbers, 0 for what is no object; and the objects by their numbers.
    """
    origin = camera_position_m if camera_position_m is not None else np.zeros(3)
    found = []
    for rows, over in zip(rows_by_cluster(clusters), over_table, strict=True):
        if len(rows) < config.min_cluster_size or not over:
            continue
        own = points[rows]
        middle = own.mean(axis=0, dtype=np.float64)
        cluster = _Cluster(rows, own, middle, float(np.linalg.norm(middle - origin)))
        if _is_in_reach(cluster, camera_position_m is not None, config):
            found.append(cluster)
    found.sort(key=lambda cluster: (cluster.distance_m, tuple(cluster.middle_m.tolist())))
    numbers = np.zeros(len(clusters), dtype=np.int64)
    objects = []
    for number, cluster in enumerate(found, start=1):
        numbers[cluster.rows] = number
        columns = np.ascontiguousarray(cluster.points.T)  # a row a coordinate: five times faster
        low, high = columns.min(axis=1), columns.max(axis=1)
        objects.append(
            SceneObject(
                number=number,
                center_m=readonly((low + high).astype(np.float64) / 2),
                size_m=readonly((high - low).astype(np.float64)),
                distance_m=cluster.distance_m,
                points=len(cluster.rows),
                pixel=None,
            )
        )
    return numbers, tuple(objects)


def _is_in_reach(cluster: _Cluster, camera_known: bool, config: SceneConfig) -> bool:
    if camera_known and not config.min_range_m <= cluster.distance_m <= config.max_range_m:
        return False
    if config.workspace_m is None:
        return True
    low, high = np.sort(np.array(config.workspace_m), axis=0)
    return not bool(np.any(cluster.middle_m < low) or np.any(cluster.middle_m > high))
