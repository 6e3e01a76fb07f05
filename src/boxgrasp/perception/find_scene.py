"""From a view to the objects on their support plane (appendix A)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Points, readonly
from boxgrasp.errors import CodedWarning, SceneError
from boxgrasp.geometry.transforms import invert, transform
from boxgrasp.kernels.backproject import depth_and_height
from boxgrasp.perception.carried import are_carried
from boxgrasp.perception.frame_doubts import FrameCheck, FrameDoubt
from boxgrasp.perception.low_points import FoundPoints, with_low_points
from boxgrasp.perception.numbering import cluster_middles, number_objects
from boxgrasp.perception.over_plane import (
    NOTHING,
    Voxels,
    downsampled,
    inliers,
    points_over,
    voxel_colors,
)
from boxgrasp.perception.placement import Placement, place_view
from boxgrasp.perception.scene import Scene, ShownPoints
from boxgrasp.perception.scene_config import SceneConfig
from boxgrasp.perception.segmentation import NEED_IMAGE, WITHOUT_IMAGE, segmentation_named
from boxgrasp.perception.segmentation.protocol import DepthImage, SeenPoints, Segments
from boxgrasp.perception.table_edges import are_no_things
from boxgrasp.perception.view import View, scan_views, seen_points
from boxgrasp.sensing.capture import Capture
from boxgrasp.sensing.sensor_model import SensorModel

_TOLD_SHARE = 0.001  # of the points: fewer flying pixels are not worth a warning


def find_scene(capture: Capture, scans: Sequence[Capture], config: SceneConfig) -> Scene:
    """Find the support plane, the points over it and the objects on it.

    Args:
        capture: the view.
        scans: further views of the same scene, each with its pose, fused into the same voxels.
        config: how objects are found.

    Returns:
        The scene.

    Raises:
        SceneError: no support plane, nothing on it, or a scan whose place is unknown.
    """
    # 1. The plane that carries the objects, and with it every frame.
    sensors = [config.sensor_model.seen_with(of.focal_px) for of in (capture, *scans)]
    points, pixels, flying = seen_points(capture, sensors[0])
    frames = FrameCheck(capture, points, config.max_range_m, sensors[0])
    placement, doubt = _placed(frames)
    T_base_source, T_base_camera = placement.T_base_source, placement.T_base_camera
    view = View(points, pixels, capture.shape, T_base_source, T_base_camera, flying)
    views = (view, *scan_views(scans, config.sensor_model))
    # 2. What stands over it, in voxels of the table's own frame.
    over, first_rows = _points_over(views, sensors, placement, config)
    voxels = _voxels(over, frames, doubt, config)
    config = replace(config, voxel_m=voxels.edge_m)  # coarser in a view full of noise
    shown = ShownPoints(pixels[first_rows], voxels.voxel_of[: len(first_rows)])
    # 3. Which of them belong together, outliers left out.
    colors = _voxel_colors(capture, shown, len(voxels.centroids))
    image = _depth_image(capture, view, placement, shown, config)
    camera_table_m = placement.camera_position_table_m(T_base_camera)
    seen = SeenPoints(voxels.centroids, colors, camera_table_m, image, sensors[0])
    segments = _segments(seen, config)
    # 4. What lies as low as the table but is a thing's: floors of hollow ones, and flat ones.
    found = FoundPoints.over_table(voxels.centroids, segments, shown)
    found = with_low_points(found, first_rows, view, placement, sensors[0], config)
    clusters, shown = found.segments.clusters, found.shown
    # 5. Objects: the clusters over the seen table that are in reach, from the nearest.
    over_table = _over_table(capture, points, placement, found)
    points_base = transform(placement.T_base_table, found.points)
    camera_position_m = None if T_base_camera is None else T_base_camera[:3, 3]
    numbers, objects = number_objects(points_base, clusters, over_table, camera_position_m, config)
    if not objects:
        raise _nothing(frames, doubt)
    kept = clusters >= 0
    return Scene(
        points=readonly(np.ascontiguousarray(points_base[kept])),
        object_numbers=readonly(numbers[kept]),
        clusters=readonly(clusters[kept]),
        floor_mask=readonly(found.floor_mask[kept]),
        objects=objects,
        plane=placement.plane.moved(T_base_source),
        supports=placement.supports,
        frame=placement.frame,
        T_base_camera=T_base_camera,
        T_base_table=placement.T_base_table,
        views=views,
        warnings=_warnings(config, image, placement, views, doubt),
        frame_doubt=doubt,
        sensor=sensors[0],
        voxel_m=config.voxel_m,
        _shown=_of_kept(shown, kept),
    )


def _placed(frames: FrameCheck) -> tuple[Placement, FrameDoubt | None]:
    """Plane and frames, and what speaks against the frames that were given."""
    try:
        placement = place_view(frames.capture, frames.points, frames.max_range_m, frames.sensor)
    except SceneError as error:
        doubt = frames.without_plane()
        raise error if doubt is None else doubt.error() from None
    return placement, frames.with_plane(placement.plane)


def _voxels(
    over: Points, frames: FrameCheck, doubt: FrameDoubt | None, config: SceneConfig
) -> Voxels:
    if len(over) == 0:
        raise _nothing(frames, doubt)
    return downsampled(over, config.voxel_m)


def _nothing(frames: FrameCheck, doubt: FrameDoubt | None) -> SceneError:
    """That nothing stands on the plane, and why the frames may be to blame."""
    doubt = doubt or frames.without_objects()
    return SceneError(NOTHING) if doubt is None else doubt.error(f"{NOTHING}; ")


def _over_table(
    capture: Capture, points: Points, placement: Placement, found: FoundPoints
) -> NDArray[np.bool_]:
    """(C,) which clusters a surface that was seen may carry, and are no strips of its edge."""
    clusters, T_source_table = found.segments.clusters, placement.T_source_table
    middles = cluster_middles(found.points, clusters)
    over = placement.over_seen(points, middles)
    strips = are_no_things(capture, T_source_table, found.points, clusters)
    carried = are_carried(capture, T_source_table, points, found.points, clusters)
    carried |= placement.supports.owners(middles) > 0
    objects = found.segments.objects[: len(over)]  # the last ones may have lost all their points
    return np.asarray(over & objects & carried & ~strips)


def _points_over(
    views: Sequence[View],
    sensors: Sequence[SensorModel],
    placement: Placement,
    config: SceneConfig,
) -> tuple[Points, NDArray[np.int32]]:
    """(P, 3) points of all views over the plane, table frame, and rows of those of the first."""
    places = [invert(placement.T_source_table)]
    places += [invert(placement.T_base_table) @ view.T_base_source for view in views[1:]]
    cameras = [placement.camera_position_table_m(view.T_base_camera) for view in views]
    found = [
        points_over(view.points, T, camera, placement.supports, sensor, config)
        for view, T, camera, sensor in zip(views, places, cameras, sensors, strict=True)
    ]
    return np.vstack([points for points, _ in found]), found[0][1]


def _voxel_colors(capture: Capture, shown: ShownPoints, count: int) -> Points | None:
    """(V, 3) mean color of each voxel; None without colors."""
    flat = capture.rgb.reshape(-1, 3) if capture.rgb is not None else capture.colors
    return None if flat is None else voxel_colors(flat[shown.pixels], shown.rows, count)


def _depth_image(
    capture: Capture,
    view: View,
    placement: Placement,
    shown: ShownPoints,
    config: SceneConfig,
) -> DepthImage | None:
    """The image that the first view's points were seen in; None for a cloud, or unless needed."""
    needed = config.segmentation in NEED_IMAGE
    if not needed or capture.depth is None or capture.intrinsics is None:
        return None
    depth_m, height_m = np.zeros((2, capture.depth.size), dtype=np.float32)
    plane = np.append(placement.plane.normal, placement.plane.offset_m)
    depth_and_height(view.points, view.pixels, plane, depth_m, height_m)  # the arm is left out
    if len(placement.supports.planes) > 1:
        height_m[view.pixels] = placement.heights(view.points)
    shape, focal_px = capture.depth.shape, float(capture.intrinsics[0, 0])
    images = depth_m.reshape(shape), focal_px, height_m.reshape(shape)
    return DepthImage(*images, shown.pixels, shown.rows)


def _segments(seen: SeenPoints, config: SceneConfig) -> Segments:
    """The voxels' clusters, -1 for outliers and what the segmentation leaves out."""
    kept = inliers(seen.points, seen.camera_position_m, seen.sensor, config)
    held = replace(
        seen,
        points=np.ascontiguousarray(seen.points[kept]),
        colors=None if seen.colors is None else seen.colors[kept],
        image=None if seen.image is None else _image_of_kept(seen.image, kept),
    )
    segments = segmentation_named(_segmentation(config, seen.image))(held, config)
    clusters = np.full(len(seen.points), -1, dtype=np.int64)
    clusters[kept] = segments.clusters
    return Segments(clusters, segments.objects)


def _image_of_kept(image: DepthImage, kept: NDArray[np.bool_]) -> DepthImage:
    shown = _of_kept(ShownPoints(image.pixels, image.rows), kept)
    return replace(image, pixels=shown.pixels, rows=shown.rows)


def _of_kept(shown: ShownPoints, kept: NDArray[np.bool_]) -> ShownPoints:
    """The pixels of the kept points alone, with their rows among these."""
    held = kept[shown.rows]
    rows = (np.cumsum(kept) - 1)[shown.rows[held]]
    return ShownPoints(readonly(shown.pixels[held]), readonly(rows))


def _segmentation(config: SceneConfig, image: DepthImage | None) -> str:
    """The name of the segmentation that is used."""
    without = image is None and config.segmentation in NEED_IMAGE
    return WITHOUT_IMAGE if without else config.segmentation


def _warnings(
    config: SceneConfig,
    image: DepthImage | None,
    placement: Placement,
    views: Sequence[View],
    doubt: FrameDoubt | None,
) -> tuple[CodedWarning, ...]:
    told = [] if doubt is None else [doubt.warning()]
    used = _segmentation(config, image)
    if used != config.segmentation:
        said = f"segmentation {config.segmentation} needs a depth image: {used} was used"
        told.append(CodedWarning("segmentation_without_image", said))
    told += placement.supports.warnings()
    count, of = sum(view.flying for view in views), sum(len(view.points) for view in views)
    if count > _TOLD_SHARE * of:
        said = f"{count} pixels lie between two surfaces and show neither: they were left out"
        told.append(CodedWarning("flying_pixels", said))
    return tuple(told)
