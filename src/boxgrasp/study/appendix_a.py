"""The thesis's own way from a cloud to an object's points, in appendix A's order.

The package finds objects otherwise: it takes the plane that carries the objects, downsamples in the
table's frame, trims by range and mends what is hidden. Here nothing is mended, so that the failure
of figure 5-6 can occur.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Array, Bools, Points
from boxgrasp.errors import MissingExtraError, SceneError
from boxgrasp.forks import cached_property
from boxgrasp.geometry.plane import Plane
from boxgrasp.kernels.cells import euclidean_clusters, voxel_centroids
from boxgrasp.kernels.plane import plane_votes
from boxgrasp.perception.support_plane import fitted_plane

_LEAST_AREA_M2 = 1e-6  # m2 that three points span, or they tell no plane


@dataclass(frozen=True)
class AppendixParams:
    """The numbers of appendix A, and those that it does not print.

    Attributes:
        nearest_m: from the camera to the first point kept, m (printed).
        farthest_m: from the camera to the last point kept, m (printed).
        voxel_m: edge of the voxels of the downsampling, m (printed).
        tolerance_m: nearer points are one cluster's, m (printed).
        plane_m: from the plane, up to which points are the table's, m. Ours: the value of PCL's
            tutorial on plane models.
        plane_tries: planes drawn. Ours: twice that of PCL's tutorial; the table holds over half of
            the points of every cast view, so that one try in eight or so hits it.
        neighbors: k, whose mean distance tells an outlier. Ours: that of PCL's tutorial on the
            filter that the thesis names.
        deviations: n, standard deviations over the mean from which it is one. Ours: likewise.
        fewest: points of a cluster at least. Ours: 2.7 cm2 of a surface; PCL's tutorial has 100.
    """

    nearest_m: float = 0.4
    farthest_m: float = 1.6
    voxel_m: float = 0.003
    tolerance_m: float = 0.015
    plane_m: float = 0.01
    plane_tries: int = 100
    neighbors: int = 50
    deviations: float = 1.0
    fewest: int = 30


@dataclass(frozen=True, eq=False)
class Stages:
    """What each stage leaves of a cloud; V points are left by the downsampling.

    Attributes:
        points: (V, 3) float32, camera frame, m.
        voxel_of: (N,) int64, which of them each point of the cloud went into; -1 for what the
            pass-through dropped.
        plane: the main plane, camera frame, the camera above it.
        on_plane: (V,) bool, the table's cluster.
        kept: (V,) bool, the rest without its outliers.
        clusters: (V,) int64, number of the object's cluster from 0, -1 for none.
        params: what was used.
    """

    points: Points
    voxel_of: NDArray[np.int64]
    plane: Plane
    on_plane: Bools
    kept: Bools
    clusters: NDArray[np.int64]
    params: AppendixParams

    @cached_property
    def table_kept(self) -> Bools:
        """(V,) bool, the table's cluster without its outliers; no later stage reads it."""
        return _trimmed(self.points, self.on_plane, self.params)


def segmented(points: Points, params: AppendixParams = AppendixParams()) -> Stages:
    """All stages of appendix A but the choice of the cluster, which a person makes.

    Args:
        points: (N, 3) float32, camera frame, m.
        params: of the stages.

    Returns:
        What each leaves.

    Raises:
        SceneError: no points in range, or no plane through them.
        MissingExtraError: scipy is not installed.
    """
    in_range = passed_through(points, params)
    if not in_range.any():
        raise SceneError(
            f"no point lies {params.nearest_m} to {params.farthest_m} m from the camera; valid: a "
            "view with points there"
        )
    centroids, member = voxel_centroids(np.ascontiguousarray(points[in_range]), params.voxel_m)
    voxel_of = np.full(len(points), -1, dtype=np.int64)
    voxel_of[in_range] = member
    plane = main_plane(centroids, params)
    on_plane = np.asarray(np.abs(plane.heights(centroids)) < params.plane_m)
    kept = _trimmed(centroids, ~on_plane, params)
    clusters = np.full(len(centroids), -1, dtype=np.int64)
    clusters[kept] = clusters_of(centroids[kept], params)
    return Stages(centroids, voxel_of, plane, on_plane, kept, clusters, params)


def passed_through(points: Points, params: AppendixParams) -> Bools:
    """Which points the pass-through filter keeps: by distance from the camera, not by depth.

    Args:
        points: (N, 3) float32, camera frame, m.
        params: of the stages.

    Returns:
        (N,) bool.
    """
    away_m = np.sqrt(np.einsum("ij,ij->i", points, points, dtype=np.float64))
    return np.asarray((away_m >= params.nearest_m) & (away_m <= params.farthest_m))


def main_plane(points: Points, params: AppendixParams) -> Plane:
    """RANSAC: of planes through three drawn points the one that holds most, fitted to those.

    Args:
        points: (V, 3) float32, camera frame, m.
        params: of the stages.

    Returns:
        The plane, camera frame, the camera above it. The same points give the same plane.

    Raises:
        SceneError: no three points span a plane that holds enough to be fitted.
    """
    rng = np.random.default_rng(0)
    drawn = points[rng.integers(len(points), size=(params.plane_tries, 3))].astype(np.float64)
    normals = np.cross(drawn[:, 1] - drawn[:, 0], drawn[:, 2] - drawn[:, 0])
    length = np.linalg.norm(normals, axis=1)
    good = length > _LEAST_AREA_M2
    normals = normals[good] / length[good, None]
    planes = np.column_stack((normals, -np.sum(normals * drawn[good, 0], axis=1)))
    planes[planes[:, 3] < 0] *= -1  # the camera, at the origin, is above
    found = None
    if len(planes):
        votes = plane_votes(points, planes, params.plane_m)
        found = fitted_plane(points, planes[np.argmax(votes)], (params.plane_m,))
    if found is None:
        raise SceneError("no plane in range holds enough points; valid: a view of a table")
    return Plane(found[:3], float(found[3]))


def inliers(points: Points, neighbors: int, deviations: float) -> Bools:
    """Statistical trimming by PCL's rule.

    Args:
        points: (N, 3) float32, m.
        neighbors: k, nearest neighbors whose mean distance counts.
        deviations: n; what is over the mean of these by more than n standard deviations is an
            outlier.

    Returns:
        (N,) bool, False for outliers.

    Raises:
        MissingExtraError: scipy is not installed.
    """
    try:
        from scipy.spatial import cKDTree
    except ImportError:
        raise MissingExtraError(
            "appendix A needs scipy; install with: pip install 'boxgrasp[train]'"
        ) from None
    if len(points) < 3:
        return np.ones(len(points), dtype=np.bool_)
    reached = min(neighbors, len(points) - 1)
    away_m: Array = cKDTree(points).query(points, reached + 1)[0][:, 1:]  # the first is itself
    mean_m = away_m.mean(axis=1)
    return np.asarray(mean_m <= mean_m.mean() + deviations * mean_m.std(ddof=1))


def clusters_of(points: Points, params: AppendixParams) -> NDArray[np.int64]:
    """Euclidean clusters; what is smaller than the fewest points is none.

    Args:
        points: (N, 3) float32, m.
        params: of the stages.

    Returns:
        (N,) int64 numbers, -1 for none.
    """
    if len(points) == 0:
        return np.empty(0, dtype=np.int64)
    clusters = euclidean_clusters(np.ascontiguousarray(points), params.tolerance_m)
    clusters[np.bincount(clusters)[clusters] < params.fewest] = -1
    return clusters


def cluster_with(clusters: NDArray[np.int64], wanted: Bools) -> Bools:
    """The cluster that a person would select for the target: the one with most of its points.

    Args:
        clusters: (V,) int64, as `Stages.clusters`.
        wanted: (V,) bool, the points that truly show the target.

    Returns:
        (V,) bool, nowhere True where no cluster has any of them.
    """
    numbers = clusters[wanted & (clusters >= 0)]
    if len(numbers) == 0:
        return np.zeros(len(clusters), dtype=np.bool_)
    return np.asarray(clusters == np.bincount(numbers).argmax())


def _trimmed(points: Points, which: Bools, params: AppendixParams) -> Bools:
    kept = np.zeros(len(points), dtype=np.bool_)
    kept[which] = inliers(points[which], params.neighbors, params.deviations)
    return kept
