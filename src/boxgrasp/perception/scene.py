"""From a view to objects on their support plane (appendix A)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from boxgrasp.arrays import Floats, Points, readonly
from boxgrasp.errors import SceneError
from boxgrasp.geometry.plane import Plane
from boxgrasp.geometry.transforms import invert, transform
from boxgrasp.kernels._threads import run_chunks
from boxgrasp.kernels.above import above_plane
from boxgrasp.kernels.cells import Neighbors, euclidean_clusters, voxel_centroids
from boxgrasp.perception.segmentation.split import by_label, split_clusters
from boxgrasp.perception.support_plane import find_support_plane, patch_over, support_frame
from boxgrasp.sensing.capture import Capture

Meters = Annotated[float, Meta(gt=0.0, le=20.0)]
Corner = tuple[float, float, float]

_OBSTACLES_BEYOND_M = 0.6
_NOTHING = "nothing stands on the support plane; valid: at least one object in view"
_SPECK = 8
_MOST_VOXELS = 1_000_000
_FARTHEST_M = 1000.0  # cells are numbered in 21 bits
_BORDER_PX = 3


@dataclass(frozen=True)
class SceneConfig:
    """How objects are found; appendix A's numbers unless said otherwise.

    min_range_m, max_range_m: pass-through, Euclidean distance from the camera. Things beyond are obstacles,
    but no objects. voxel_m: downsampling. cluster_tolerance_m: points nearer than this are one object.
    segmentation: `split` also parts things that stand closer; `euclidean` is the thesis's.
    min_height_m: height over the plane, beside noise_gain times the camera's axial noise, under
    which a point is the table's. outlier_*: statistical trimming. workspace_m: two opposite
    corners in the base frame; outside it are obstacles, but no objects.
    """

    min_range_m: Annotated[float, Meta(ge=0.0, le=20.0)] = 0.4
    max_range_m: Meters = 1.6
    voxel_m: Annotated[float, Meta(ge=0.001, le=0.02)] = 0.003
    cluster_tolerance_m: Annotated[float, Meta(ge=0.004, le=0.2)] = 0.015
    segmentation: Literal["split", "euclidean"] = "split"
    min_height_m: Annotated[float, Meta(ge=0.0, le=0.1)] = 0.003
    noise_gain: Annotated[float, Meta(ge=0.0, le=20.0)] = 2.5
    max_height_m: Meters = 1.0
    outlier_nb_neighbors: Annotated[int, Meta(ge=1, le=100)] = 5
    outlier_std_ratio: Annotated[float, Meta(gt=0.0, le=20.0)] = 2.0
    min_cluster_size: Annotated[int, Meta(ge=1)] = 20
    workspace_m: tuple[Corner, Corner] | None = None

    RENAMED: ClassVar = {
        "near_m": "min_range_m",
        "far_m": "max_range_m",
        "cluster_m": "cluster_tolerance_m",
        "lowest_m": "min_height_m",
        "highest_m": "max_height_m",
        "outlier_neighbours": "outlier_nb_neighbors",
        "outlier_sigma": "outlier_std_ratio",
        "least_points": "min_cluster_size",
    }


@dataclass(frozen=True, eq=False)
class SceneObject:
    """One thing on the support plane.

    number counts from the nearest, from 1; center_m, size_m (3,) of its visible points along
    the base's axes; distance_m from the camera; points: how many 3 mm voxels; pixel: (u, v) of
    one of its pixels near its middle, None without an image.
    """

    number: int
    center_m: Floats
    size_m: Floats
    distance_m: float
    points: int
    pixel: tuple[int, int] | None


@dataclass(frozen=True, eq=False)
class Scene:
    """What stands over the support plane, base frame, meters.

    points: (K, 3) float32 voxel centroids over the plane; labels: (K,) object number, 0 for what
    is no object; clusters: (K,) which points belong together, objects or not. plane: the support
    plane. T_base_camera: None where the camera is unknown; T_base_table: z on the plane's normal,
    z = 0 on it; frame: `given` or `support`. shape: (H, W) of the first view, or None.
    source_points: (N, 3) of the first view in its own frame, which T_base_source maps; pixels:
    (N,) their pixels, rising; above: (P,) which of them lie over the plane, and voxel_of_above
    (P,) the row of each in `points`, -1 for a trimmed one.
    """

    points: Points
    object_numbers: NDArray[np.int64]
    clusters: NDArray[np.int64]
    objects: tuple[SceneObject, ...]
    plane: Plane
    frame: str
    T_base_camera: Floats | None
    T_base_table: Floats
    shape: tuple[int, int] | None
    pixels: NDArray[np.int32]
    above: NDArray[np.int32]
    voxel_of_above: NDArray[np.int64]
    source_points: Points
    T_base_source: Floats

    def voxels_at(self, pixels: NDArray[np.int64]) -> NDArray[np.int64]:
        """Row of the voxel at each flat pixel; -1 table or background, -2 no depth."""
        row = _rows_of(pixels, self.pixels)
        over = _rows_of(row, self.above)
        voxel = np.where(over >= 0, self.voxel_of_above[over], -1)
        return np.where(row >= 0, voxel, -2)

    @cached_property
    def at_border(self) -> NDArray[np.int64]:
        """Rows of the points that lie at the image border, in rising order."""
        if self.shape is None:
            return np.empty(0, dtype=np.int64)
        height, width = self.shape
        ok = self.voxel_of_above >= 0
        v, u = np.divmod(self.pixels[self.above[ok]], width)
        far = (u >= width - _BORDER_PX) | (v >= height - _BORDER_PX)
        return np.unique(self.voxel_of_above[ok][far | (np.minimum(u, v) < _BORDER_PX)])

    def object_image(self) -> NDArray[np.int32]:
        """The number of the object that each pixel shows.

        Returns:
            (H, W) int32, 0 for none.

        Raises:
            SceneError: the view has no image.
        """
        if self.shape is None:
            raise SceneError("an unorganized cloud has no pixels; valid: a view with an image")
        image = np.zeros(self.shape[0] * self.shape[1], dtype=np.int32)
        ok = self.voxel_of_above >= 0
        image[self.pixels[self.above[ok]]] = self.object_numbers[self.voxel_of_above[ok]]
        return image.reshape(self.shape)

    @property
    def camera_position_m(self) -> Floats | None:
        """(3,) camera position in the base frame."""
        return None if self.T_base_camera is None else self.T_base_camera[:3, 3]


def find_scene(capture: Capture, scans: Sequence[Capture], config: SceneConfig) -> Scene:
    """Support plane, voxels over it, objects; further scans are fused into the same voxels.

    Raises:
        SceneError: no support plane, nothing on it, or a scan whose place is unknown.
    """
    # 1. The plane that carries the objects, and with it every frame.
    points, pixels = capture.valid_points()
    place = _place(capture, points, config)
    # 2. What stands over it, in voxels of the table's own frame.
    found, above = _over(points, invert(place.T_source_table), place.camera_position_m, config)
    first = len(found)
    for scan in scans:
        found = np.vstack((found, _scan_over(scan, place.T_base_table, config)))
    voxels, voxel_of = _voxels(found, config)
    # 3. Clusters, and their parts where things stand closer.
    colors = _voxel_colors(capture, pixels, above, voxel_of[:first], len(voxels))
    labels = _clusters(voxels, colors, place.camera_position_m, config)
    # 4. Objects: the clusters over the seen table that are in reach, from the nearest.
    over = patch_over(points, place.T_source_table, _middles(voxels, labels))
    points_base = transform(place.T_base_table, voxels)
    T_base_camera = place.T_base_camera
    eye = None if T_base_camera is None else T_base_camera[:3, 3]
    numbers, objects = _number(points_base, labels, over, eye, config)
    if not objects:
        raise SceneError(_NOTHING)
    alive = labels >= 0
    row = np.where(alive, np.cumsum(alive) - 1, -1)
    if capture.shape is None:
        pixels = np.arange(len(points), dtype=np.int32)
    return Scene(
        points=readonly(np.ascontiguousarray(points_base[alive])),
        object_numbers=readonly(numbers[alive]),
        clusters=readonly(labels[alive]),
        objects=tuple(objects),
        plane=place.plane.moved(place.T_base_source),
        frame=place.frame,
        T_base_camera=None if T_base_camera is None else readonly(T_base_camera),
        T_base_table=readonly(place.T_base_table),
        shape=capture.shape,
        pixels=readonly(pixels),
        above=readonly(above),
        voxel_of_above=readonly(row[voxel_of[:first]]),
        source_points=points,
        T_base_source=readonly(place.T_base_source),
    )


@dataclass(frozen=True, eq=False)
class _Place:
    """The plane in the view's own frame (source), and how the frames lie to each other."""

    plane: Plane
    T_source_table: Floats
    T_base_source: Floats
    T_base_table: Floats
    T_base_camera: Floats | None
    frame: str

    @property
    def camera_position_m(self) -> Floats | None:
        """(3,) camera position in the table frame."""
        if self.T_base_camera is None:
            return None
        place: Floats = transform(invert(self.T_base_table), self.T_base_camera[None, :3, 3])[0]
        return place


def _place(capture: Capture, points: Points, config: SceneConfig) -> _Place:
    """Where the view lies: as given, or over the plane it sees (docs/conventions.md)."""
    optical = capture.cloud_frame == "optical"
    given = capture.T_base_camera
    up = np.array([0.0, 0.0, 1.0]) if not optical else None if given is None else given[2, :3]
    eye = np.zeros(3) if optical else None if given is None else given[:3, 3]
    plane = find_support_plane(points, up, eye, config.max_range_m)
    T_source_table = support_frame(plane, optical)
    T_base_source = np.eye(4)
    if optical:
        T_base_source = np.array(given) if given is not None else invert(T_source_table)
    return _Place(
        plane=plane,
        T_source_table=T_source_table,
        T_base_source=T_base_source,
        T_base_table=T_base_source @ T_source_table,
        T_base_camera=T_base_source if optical else given,
        frame="support" if optical and given is None else "given",
    )


def _voxels(found: Points, config: SceneConfig) -> tuple[Points, NDArray[np.int64]]:
    """(K, 3) voxel centroids of the points over the plane, and (P,) which voxel each is in."""
    if len(found) == 0:
        raise SceneError(_NOTHING)
    farthest = float(np.abs(found).max())
    if farthest > _FARTHEST_M:
        raise SceneError(
            f"points lie {farthest / 1000:.1f} km from the frame's origin; valid: "
            f"within {_FARTHEST_M / 1000:g} km"
        )
    voxels, voxel_of = voxel_centroids(found, config.voxel_m)
    if len(voxels) > _MOST_VOXELS:
        raise SceneError(
            f"{len(voxels)} voxels stand over the support plane; valid: up to {_MOST_VOXELS} "
            "(a smaller scene.max_range_m or a larger scene.voxel_m)"
        )
    return voxels, voxel_of


def _clusters(
    voxels: Points, colors: Points | None, eye: Floats | None, config: SceneConfig
) -> NDArray[np.int64]:
    """(K,) cluster of each voxel, -1 for outliers and specks."""
    keep = _inliers(voxels, eye, config)
    labels = np.full(len(voxels), -1, dtype=np.int64)
    if keep.any():
        labels[keep] = euclidean_clusters(
            np.ascontiguousarray(voxels[keep]), config.cluster_tolerance_m
        )
    sizes = np.bincount(labels + 1, minlength=1)
    labels[sizes[labels + 1] < _SPECK] = -1
    if config.segmentation == "split":
        return split_clusters(voxels, labels, colors, eye)
    return labels


def _rows_of(values: NDArray[Any], among: NDArray[np.int32]) -> NDArray[np.int64]:
    """Where each value stands in a rising array, -1 where it does not."""
    if len(among) == 0:
        return np.full(np.shape(values), -1, dtype=np.int64)
    at = np.minimum(np.searchsorted(among, np.asarray(values, dtype=among.dtype)), len(among) - 1)
    return np.where(among[at] == values, at, -1)


def _over(
    points: Points, T_table_source: Floats, eye: Floats | None, config: SceneConfig
) -> tuple[Points, NDArray[np.int32]]:
    """(P, 3) points over the plane in the table frame, and their rows."""
    known = eye is not None
    parts: list[tuple[int, Points, NDArray[np.int32]]] = []

    def work(first: int, last: int) -> None:
        found = np.empty((last - first, 3), dtype=np.float32)
        rows = np.empty(last - first, dtype=np.int32)
        count = above_plane(
            points[first:last],
            T_table_source,
            eye if eye is not None else np.zeros(3),
            config.min_height_m if known else config.min_height_m + config.noise_gain * 0.002,
            config.noise_gain if known else 0.0,
            config.max_height_m,
            config.max_range_m + _OBSTACLES_BEYOND_M if known else 1e6,
            found,
            rows,
        )
        parts.append((first, found[:count], rows[:count] + np.int32(first)))

    run_chunks(work, len(points), smallest=50_000)
    parts.sort(key=lambda part: part[0])
    return np.vstack([part[1] for part in parts]), np.concatenate([part[2] for part in parts])


def _scan_over(scan: Capture, T_base_table: Floats, config: SceneConfig) -> Points:
    points, _ = scan.valid_points()
    T_base_source = scan_pose(scan)
    T_table_source = invert(T_base_table) @ T_base_source
    eye = None
    if scan.T_base_camera is not None:
        eye = (invert(T_base_table) @ scan.T_base_camera)[:3, 3]
    return _over(points, T_table_source, eye, config)[0]


def scan_pose(scan: Capture) -> Floats:
    """T_base_source of a further scan.

    Raises:
        SceneError: the scan does not say where its camera stood.
    """
    if scan.cloud_frame == "base":
        return np.eye(4)
    if scan.T_base_camera is None:
        raise SceneError("a further scan has no T_base_camera; valid: every scan with its pose")
    return scan.T_base_camera


def _inliers(voxels: Points, eye: Floats | None, config: SceneConfig) -> NDArray[np.bool_]:
    """Statistical trimming: mean neighbor distance within sigma of the usual, at its range.

    What is usual is measured in every eighth cell; the others are measured only as far as it
    takes to tell on which side of the limit their points lie.
    """
    spread = np.full(len(voxels), config.voxel_m, dtype=np.float32)
    if eye is not None:  # a farther surface is sampled more thinly: a pixel at 525 px
        off = voxels - eye.astype(np.float32)
        spread = np.maximum(spread, np.sqrt(np.einsum("ij,ij->i", off, off)) / np.float32(525))
    neighbors = Neighbors(voxels, config.outlier_nb_neighbors, 2.4 * float(np.median(spread)))
    measured = neighbors.means(np.zeros(len(voxels), dtype=np.float32), cell_step=8)
    usual = (measured / spread)[np.isfinite(measured)]
    limit = float(
        usual.mean(dtype=np.float64) + config.outlier_std_ratio * usual.std(dtype=np.float64)
    )
    limits = np.float32(max(limit, 1.5 * float(np.median(usual)))) * spread
    return np.asarray(neighbors.means(limits) <= limits)


def _voxel_colors(
    capture: Capture,
    pixels: NDArray[np.int32],
    above: NDArray[np.int32],
    voxel_of: NDArray[np.int64],
    count: int,
) -> Points | None:
    """(K, 3) mean color of each voxel, NaN where none was seen; None without colors."""
    flat = capture.rgb.reshape(-1, 3) if capture.rgb is not None else capture.colors
    if flat is None or len(voxel_of) == 0:
        return None
    rows: NDArray[Any] = pixels[above] if capture.shape is not None else above
    if capture.shape is None and capture.robot_mask is not None:
        rows = np.flatnonzero(~capture.robot_mask.reshape(-1))[above]
    seen = flat[rows]
    hits = np.bincount(voxel_of, minlength=count)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.column_stack(
            [np.bincount(voxel_of, seen[:, k], minlength=count) / hits for k in range(3)]
        ).astype(np.float32)


def _middles(voxels: Points, labels: NDArray[np.int64]) -> Points:
    """(C, 3) mean of the voxels of each cluster, in the table frame."""
    own = labels >= 0
    count = np.maximum(np.bincount(labels[own]), 1)
    return np.column_stack(
        [np.bincount(labels[own], voxels[own, k]) / count for k in range(3)]
    ).astype(np.float32)


def _number(
    points: Points,
    labels: NDArray[np.int64],
    over: NDArray[np.bool_],
    eye: Floats | None,
    config: SceneConfig,
) -> tuple[NDArray[np.int64], list[SceneObject]]:
    """Object numbers (K,) from the nearest, 0 for what is no object, and the objects.

    over: (C,) whether each cluster stands over the part of the plane that was seen.
    """
    order = by_label(labels)
    starts = np.searchsorted(labels[order], np.arange(labels.max(initial=-1) + 2))
    origin = eye if eye is not None else np.zeros(3)
    candidates = []
    for k in range(len(starts) - 1):
        rows = order[starts[k] : starts[k + 1]]
        if len(rows) < config.min_cluster_size or not over[k]:
            continue
        own = points[rows]
        middle = own.mean(axis=0, dtype=np.float64)
        distance = float(np.linalg.norm(middle - origin))
        if eye is not None and not config.min_range_m <= distance <= config.max_range_m:
            continue
        if config.workspace_m is not None:
            low, high = np.sort(np.array(config.workspace_m), axis=0)
            if np.any(middle < low) or np.any(middle > high):
                continue
        candidates.append((distance, tuple(middle.tolist()), k, rows))
    candidates.sort(key=lambda item: (item[0], item[1]))
    numbers = np.zeros(len(labels), dtype=np.int64)
    objects = []
    for number, (distance, _, _, rows) in enumerate(candidates, start=1):
        numbers[rows] = number
        low, high = points[rows].min(axis=0), points[rows].max(axis=0)
        objects.append(
            SceneObject(
                number=number,
                center_m=readonly((low + high).astype(np.float64) / 2),
                size_m=readonly((high - low).astype(np.float64)),
                distance_m=distance,
                points=len(rows),
                pixel=None,
            )
        )
    return numbers, objects


def with_pixels(scene: Scene) -> tuple[SceneObject, ...]:
    """The objects, each with one of its own pixels, the one nearest to their mean."""
    objects = scene.objects
    if scene.shape is None:
        return objects
    width = scene.shape[1]
    ok = scene.voxel_of_above >= 0
    pixels = scene.pixels[scene.above][ok].astype(np.int64)
    numbers = scene.object_numbers[scene.voxel_of_above[ok]]
    v, u = np.divmod(pixels, width)
    count = np.maximum(np.bincount(numbers, minlength=len(objects) + 1), 1)
    mean_u = np.bincount(numbers, u, minlength=len(objects) + 1) / count
    mean_v = np.bincount(numbers, v, minlength=len(objects) + 1) / count
    off = (u - mean_u[numbers]) ** 2 + (v - mean_v[numbers]) ** 2
    first = np.lexsort((pixels, off, numbers))
    at = np.searchsorted(numbers[first], np.arange(1, len(objects) + 1))
    found = []
    for item, k in zip(objects, at.tolist(), strict=True):
        pixel = None
        if k < len(first) and numbers[first[k]] == item.number:
            pixel = (int(u[first[k]]), int(v[first[k]]))
        found.append(
            SceneObject(
                item.number, item.center_m, item.size_m, item.distance_m, item.points, pixel
            )
        )
    return tuple(found)
