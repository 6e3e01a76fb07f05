"""The scene as its target sees it: over the plane that carries the target, fitted near it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from boxgrasp.arrays import Array, Floats, Points, readonly
from boxgrasp.geometry.plane import Plane
from boxgrasp.geometry.transforms import invert, transform
from boxgrasp.kernels.levels import points_near
from boxgrasp.perception.scene import Scene
from boxgrasp.perception.support_plane import fitted_plane, support_frame
from boxgrasp.perception.target import TargetPoints

_NEAR_M = 0.40  # m from the target's foot: what it stands on, not a table's far end
_DEEP_M = 0.2  # m over or under the support plane: more than any surface beside it
_SAMPLE = 20_000  # points tell the plane as well as all
_ON_M = 0.008  # m, what points on the plane may be off
_ENOUGH = 300  # points of the sample near the target
_SPREAD_M = 0.05  # m, their standard deviation along their narrower side at least
_TURNED = np.cos(np.deg2rad(2.0))  # of the angle that the plane turns at most near the target
_OVER_M = 0.004  # m over the target's plane: what is lower is the plane's concern
_STEP_M = 0.010  # m over it, from which a surface is another one's: the own one has noise


def stand_target(scene: Scene, points: TargetPoints) -> tuple[Scene, TargetPoints]:
    """The scene over the plane that carries the target, and which of its points are in the way.

    A surface beside it that is higher becomes an obstacle. Where the base frame is the support
    plane's and the target stands on another surface, it becomes that surface's.

    Args:
        scene: as it was found, before a target was known.
        points: which of its points are the target's.

    Returns:
        A scene that shares what it can, and the masks over its points.
    """
    T_table_base = invert(scene.T_base_table)
    target = transform(T_table_base, scene.points[points.target_mask])
    owners = scene.supports.owners(target)
    number = int(np.argmax(np.bincount(owners, minlength=len(scene.supports.planes))))
    values = _near(scene, number, target.mean(axis=0, dtype=np.float64))
    plane = Plane(readonly(values[:3].copy()), float(values[3])).moved(scene.T_base_table)
    scene = replace(scene, plane=plane)
    if len(scene.supports.planes) > 1:
        scene, points = _with_surfaces(scene, points)
    return (_reframed(scene) if scene.frame == "support" and number > 0 else scene), points


def _near(scene: Scene, number: int, middle_m: Floats) -> Floats:
    """(4,) a surface's plane by its points near the target, table frame."""
    plane: Floats = scene.supports.planes[number]
    view = scene.views[0]
    T_table_source = invert(scene.T_base_table) @ view.T_base_source
    foot_m = np.array([middle_m[0], middle_m[1], -plane[:2] @ middle_m[:2] - plane[3]])
    foot_source_m = transform(invert(T_table_source), foot_m[None])[0]
    step = max(1, len(view.points) // _SAMPLE)
    near: Points = np.empty((len(view.points) // step + 1, 3), dtype=np.float32)
    count = points_near(view.points, step, T_table_source, foot_source_m, _NEAR_M, _DEEP_M, near)
    near = near[:count]
    if len(scene.supports.planes) > 1:
        near = near[scene.supports.owners(near) == number]
    on = near[np.abs(near @ plane[:3].astype(np.float32) + np.float32(plane[3])) < _ON_M, :2]
    if len(on) < _ENOUGH or np.linalg.eigvalsh(np.cov(on.T))[0] < _SPREAD_M**2:
        return plane
    fitted = fitted_plane(near, plane, (_ON_M, _ON_M))
    if fitted is None or fitted[:3] @ plane[:3] < _TURNED:
        return plane
    return fitted


def _with_surfaces(scene: Scene, points: TargetPoints) -> tuple[Scene, TargetPoints]:
    """The scene with points on the surfaces that are higher than the target's, as obstacles.

    What is lower than its plane is none: the hand stays over that.
    """
    obstacles = points.obstacle_mask & (scene.plane.heights(scene.points) > _OVER_M)
    added = transform(scene.T_base_table, np.vstack(scene.supports.points_m))
    added = added[scene.plane.heights(added) > _STEP_M]
    count, cluster = len(added), int(scene.clusters.max(initial=-1)) + 1
    scene = replace(
        scene,
        points=readonly(np.vstack((scene.points, added))),
        object_numbers=_extended(scene.object_numbers, 0, count),
        clusters=_extended(scene.clusters, cluster, count),
        floor_mask=_extended(scene.floor_mask, 0, count),
    )
    return scene, TargetPoints(
        _extended(points.target_mask, 0, count), _extended(obstacles, 1, count), points.warnings
    )


def _extended(array: Array, value: int, count: int) -> Array:
    """An array with a value added so many times."""
    return readonly(np.concatenate((array, np.full(count, value, dtype=array.dtype))))


def _reframed(scene: Scene) -> Scene:
    """The scene in the frame of its own plane."""
    if scene.T_base_camera is None:
        return scene
    plane = scene.plane.moved(invert(scene.T_base_camera))
    T_base_camera = readonly(invert(support_frame(plane, optical=True)))
    T_new_base = T_base_camera @ invert(scene.T_base_camera)
    objects = tuple(
        replace(item, center_m=readonly(transform(T_new_base, item.center_m[None])[0]))
        for item in scene.objects
    )
    views = tuple(
        replace(
            view,
            T_base_source=readonly(T_new_base @ view.T_base_source),
            T_base_camera=None
            if view.T_base_camera is None
            else readonly(T_new_base @ view.T_base_camera),
        )
        for view in scene.views
    )
    return replace(
        scene,
        points=readonly(transform(T_new_base, scene.points)),
        objects=objects,
        plane=scene.plane.moved(T_new_base),
        T_base_camera=T_base_camera,
        T_base_table=readonly(T_new_base @ scene.T_base_table),
        views=views,
    )
