"""What stands over the support plane, in voxels of the table's own frame (appendix A)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Floats, Points
from boxgrasp.errors import SceneError
from boxgrasp.kernels._threads import run_chunks
from boxgrasp.kernels.above import above_plane
from boxgrasp.kernels.cells import Neighbors, voxel_centroids
from boxgrasp.perception.scene_config import SceneConfig
from boxgrasp.perception.supports import Supports
from boxgrasp.sensing.sensor_model import UNKNOWN_RANGE_M, SensorModel

# Said where there is no point over the plane, and where no cluster of them is an object.
NOTHING = "nothing stands on the support plane; valid: at least one object in view"

_OBSTACLES_BEYOND_M = 0.6  # past max_range_m, from where a thing may still be in a hand's way
_EVERYWHERE_M = 1e6  # a range that leaves out nothing
# Bounds memory and time: cluttered tables have some 20,000, the fullest of 63 real captures 34,000;
# noise all over a view has 200,000.
_MOST_VOXELS = 80_000
_LEAST_COARSER = 1.1  # times the edge, in each round
_FARTHEST_M = 1000.0  # cells are numbered in 21 bits
_REACH = 2.4  # spacings of the points within which neighbors are looked for; farther count as so
_LEAST_LIMIT = 1.5  # of the median: an even surface has next to no deviation to trim by
_MEASURED_CELLS = 8  # every so many cells tell what is usual


@dataclass(frozen=True, eq=False)
class Voxels:
    """Points downsampled to a centroid a voxel.

    Attributes:
        centroids: (V, 3) float32, table frame, m.
        voxel_of: (P,) int64, the voxel of each point.
        edge_m: of a voxel, m.
    """

    centroids: Points
    voxel_of: NDArray[np.int64]
    edge_m: float


def points_over(
    points: Points,
    T_table_source: Floats,
    camera_position_m: Floats | None,
    supports: Supports,
    sensor: SensorModel,
    config: SceneConfig,
) -> tuple[Points, NDArray[np.int32]]:
    """The points over the surfaces that they stand on, out of those surfaces' noise.

    Args:
        points: (N, 3) float32, source frame, m.
        T_table_source: (4, 4).
        camera_position_m: (3,) table frame, m, or None where it is unknown.
        supports: the surfaces, table frame.
        sensor: whose noise the table has.
        config: heights and ranges.

    Returns:
        (P, 3) float32, table frame, m, and (P,) int32 their rows, rising.
    """
    origin: Floats
    if camera_position_m is None:
        origin, farthest_m = np.zeros(3), _EVERYWHERE_M
        noise_m = float(sensor.axial_noise_m(np.asarray(UNKNOWN_RANGE_M)))
        band_m, noise_gain = config.min_height_m + config.noise_gain * noise_m, 0.0
    else:
        origin, farthest_m = camera_position_m, config.max_range_m + _OBSTACLES_BEYOND_M
        band_m, noise_gain = config.min_height_m, config.noise_gain
    plan = (*supports.corner_m.tolist(), supports.cell_m)
    parts: list[tuple[int, Points, NDArray[np.int32]]] = []

    def work(first: int, last: int) -> None:
        found = np.empty((last - first, 3), dtype=np.float32)
        rows = np.empty(last - first, dtype=np.int32)
        count = above_plane(
            points[first:last], T_table_source, origin, band_m, noise_gain, sensor.noise,
            config.max_height_m, farthest_m, supports.planes, supports.owner, plan, found, rows,
        )  # fmt: skip
        parts.append((first, found[:count], rows[:count] + np.int32(first)))

    run_chunks(work, len(points), smallest=50_000)
    parts.sort(key=lambda part: part[0])
    return np.vstack([part[1] for part in parts]), np.concatenate([part[2] for part in parts])


def downsampled(points: Points, voxel_m: float) -> Voxels:
    """The centroids of the voxels that hold points; larger voxels where there would be too many.

    Args:
        points: (P, 3) float32, table frame, m.
        voxel_m: edge of a voxel, m.

    Returns:
        The voxels, in the order in which their first points come.

    Raises:
        SceneError: no points, or points too far away to number their voxels.
    """
    if len(points) == 0:
        raise SceneError(NOTHING)
    farthest = float(np.abs(points).max())
    if farthest > _FARTHEST_M:
        raise SceneError(
            f"points lie {farthest / 1000:.1f} km from the frame's origin; valid: "
            f"within {_FARTHEST_M / 1000:g} km"
        )
    centroids, voxel_of = voxel_centroids(points, voxel_m)
    while len(centroids) > _MOST_VOXELS:
        # Of points on surfaces the right edge at once; of points all over space in some rounds.
        voxel_m *= max(_LEAST_COARSER, float(np.sqrt(len(centroids) / _MOST_VOXELS)))
        centroids, coarser_of = voxel_centroids(centroids, voxel_m)
        voxel_of = coarser_of[voxel_of]
    return Voxels(centroids, voxel_of, voxel_m)


def inliers(
    centroids: Points,
    camera_position_m: Floats | None,
    sensor: SensorModel,
    config: SceneConfig,
) -> NDArray[np.bool_]:
    """Statistical trimming: mean neighbor distance within sigma of the usual, at its range.

    What is usual is measured in every eighth cell; the others are measured only as far as it
    takes to tell on which side of the limit their points lie.

    Args:
        centroids: (V, 3) float32, table frame, m.
        camera_position_m: (3,) table frame, m, or None where it is unknown.
        sensor: how far apart its pixels lie.
        config: voxel size and what is trimmed.

    Returns:
        (V,) bool, False for outliers.
    """
    spread: NDArray[np.floating] = np.full(len(centroids), config.voxel_m, dtype=np.float32)
    if camera_position_m is not None:  # a farther surface is sampled more thinly
        off = centroids - camera_position_m.astype(np.float32)
        range_m = np.sqrt(np.einsum("ij,ij->i", off, off))
        spread = np.maximum(spread, sensor.pixel_spacing_m(range_m))
    reach_m = _REACH * float(np.median(spread))
    neighbors = Neighbors(centroids, config.outlier_nb_neighbors, reach_m)
    measured = neighbors.means(np.zeros(len(centroids), dtype=np.float32), _MEASURED_CELLS)
    usual = (measured / spread)[np.isfinite(measured)]
    limit = float(
        usual.mean(dtype=np.float64) + config.outlier_std_ratio * usual.std(dtype=np.float64)
    )
    limits = np.float32(max(limit, _LEAST_LIMIT * float(np.median(usual)))) * spread
    return np.asarray(neighbors.means(limits) <= limits)


def voxel_colors(
    colors: NDArray[np.uint8], voxel_of: NDArray[np.int64], count: int
) -> Points | None:
    """Mean color of each voxel.

    Args:
        colors: (P, 3) uint8, of each point.
        voxel_of: (P,) int64, the voxel of each point.
        count: number of voxels, V.

    Returns:
        (V, 3) float32, 0 to 255, NaN where no point was seen; None without points.
    """
    if len(voxel_of) == 0:
        return None
    hits = np.bincount(voxel_of, minlength=count)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.column_stack(
            [np.bincount(voxel_of, colors[:, k], minlength=count) / hits for k in range(3)]
        ).astype(np.float32)
