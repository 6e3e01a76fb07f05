"""Where the view ends before the target does: edges hidden by nearer things or by the border."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Array, Floats, Points
from boxgrasp.geometry.box import Box
from boxgrasp.geometry.transforms import invert, transform
from boxgrasp.perception.scene import Scene
from boxgrasp.sensing.capture import Capture

_REACH_PX = 6
_NEARER_M = 0.02
_EDGE_BAND_M = 0.012
_HIDDEN_SHARE = 0.5
_FREE_SHARE = 0.12
_LEAST_PX = 4
_CROWD_M = 0.005
_BELOW_TOP_M = 0.012
_FACING = 0.85
_WALL_PX = 20
_CROWD_SHARE = 0.58
_STEPS = ((0, -1), (0, 1), (-1, 0), (1, 0))  # rows, columns: left, right, up, down


@dataclass(frozen=True)
class Truncation:
    """width_known: whether the box's x and y dimensions are more than lower bounds.

    cut: whether the image border cuts the target.
    """

    width_known: tuple[bool, bool]
    cut: bool


def find_truncation(capture: Capture, scene: Scene, own: NDArray[np.bool_], box: Box) -> Truncation:
    """Which edges of the box end at something nearer or at the border (docs/how-it-works.md).

    own: (K,) the target's voxels. Without an image every edge counts as seen, but the one along
    the view where the camera looks from below the box's top.
    """
    known = [True, True]
    cut = False
    if scene.shape is not None and scene.T_base_camera is not None:
        window = _window(capture, scene, own)
        if window is not None:
            cut, edges = _edges(window, scene, box)
            for axis in edges:
                known[axis] = False
    eye = scene.camera_position_m
    if eye is not None:
        along = invert(box.T_base_box)[:3, :3] @ (box.T_base_box[:3, 3] - eye)
        if eye[2] < box.T_base_box[2, 3] + box.dimensions_m[2] / 2 + _NEARER_M:
            known[int(np.argmax(np.abs(along[:2])))] = False
    return Truncation((known[0], known[1]), cut)


@dataclass(frozen=True, eq=False)
class _Window:
    """The image round the target: own (h, w), depth (h, w) with inf for none, points, offset."""

    own: NDArray[np.bool_]
    depth: NDArray[np.float32]
    points: NDArray[np.float32]
    open_sides: tuple[bool, bool, bool, bool]


def _window(capture: Capture, scene: Scene, own: NDArray[np.bool_]) -> _Window | None:
    assert scene.shape is not None
    height, width = scene.shape
    seen = scene.voxel_of_above >= 0
    seen[seen] = own[scene.voxel_of_above[seen]]
    rows = scene.pixels[scene.above[seen]]
    if len(rows) == 0:
        return None
    v, u = np.divmod(rows, width)
    v0, v1 = max(int(v.min()) - _REACH_PX, 0), min(int(v.max()) + _REACH_PX + 1, height)
    u0, u1 = max(int(u.min()) - _REACH_PX, 0), min(int(u.max()) + _REACH_PX + 1, width)
    mask = np.zeros((v1 - v0, u1 - u0), dtype=bool)
    mask[v - v0, u - u0] = True
    # Rows of the view are in pixel order, so each image row is a slice of them.
    points = np.full((*mask.shape, 3), np.nan, dtype=np.float32)
    starts = (np.arange(v0, v1, dtype=np.int32) * width + u0).astype(np.int32)
    firsts = np.searchsorted(scene.pixels, starts).tolist()
    lasts = np.searchsorted(scene.pixels, starts + np.int32(u1 - u0)).tolist()
    for row, (start, first, last) in enumerate(zip(starts, firsts, lasts, strict=True)):
        points[row, scene.pixels[first:last] - start] = scene.source_points[first:last]
    points = transform(scene.T_base_source, points)
    assert scene.T_base_camera is not None
    forward = scene.T_base_camera[:3, 2].astype(np.float32)
    depth = (points - scene.T_base_camera[:3, 3].astype(np.float32)) @ forward
    depth = np.where(np.isnan(depth), np.float32(np.inf), depth)
    if capture.robot_mask is not None:  # the arm is nearer than what it hides
        depth[capture.robot_mask.reshape(height, width)[v0:v1, u0:u1]] = 0.0
    return _Window(mask, depth, points, (u0 == 0, u1 == width, v0 == 0, v1 == height))


def _edges(window: _Window, scene: Scene, box: Box) -> tuple[bool, list[int]]:
    """Whether the border cuts the target, and the axis of each hidden edge."""
    own, depth = window.own, window.depth
    ends, beyond, cut = [], [], False
    for way, open_side in zip(_STEPS, window.open_sides, strict=True):
        end, nearer, border = _scan_side(own, depth, way, open_side)
        ends.append(end)
        beyond.append(nearer | border)
        cut = cut or int(np.count_nonzero(border)) >= _LEAST_PX
    T_box_base = invert(box.T_base_box)
    local = transform(T_box_base, window.points)
    found = []
    assert scene.T_base_camera is not None
    view = T_box_base[:3, :3] @ (box.T_base_box[:3, 3] - scene.T_base_camera[:3, 3])
    for axis in (0, 1):
        for side in (-1, 1):
            step = _image_step(scene.T_base_camera, side * box.T_base_box[:3, axis])
            with np.errstate(invalid="ignore"):
                at_edge = local[..., axis] * side > box.dimensions_m[axis] / 2 - _EDGE_BAND_M
            end = ends[step] & at_edge
            inside = box.dimensions_m[axis] / 2 - local[own & at_edge][:, axis] * side
            if _is_face(inside):
                continue
            low = box.dimensions_m[2] / 2 - _BELOW_TOP_M
            wall = np.count_nonzero(local[own & at_edge][:, 2] < low)
            if side * view[axis] < -_FACING * np.hypot(view[0], view[1]) and wall >= _WALL_PX:
                continue  # the face towards the camera is seen below the top
            if _is_hidden(end, ends[step], beyond[step]):
                found.append(axis)
    return cut, found


def _is_face(depths_m: Points) -> bool:
    """Whether points in the band at an edge crowd at its end: a face seen, not a rim cut off.

    depths_m: (N,) how far inside the edge each point lies. A surface that runs on under what
    hides it fills the band evenly.
    """
    if len(depths_m) < _LEAST_PX:
        return False
    first = np.partition(depths_m, len(depths_m) // 20)[len(depths_m) // 20]  # noise reaches out
    if first > _CROWD_M:
        return False
    return bool(np.count_nonzero(depths_m < first + _CROWD_M) > _CROWD_SHARE * len(depths_m))


def _is_hidden(
    at_edge: NDArray[np.bool_], ends: NDArray[np.bool_], beyond: NDArray[np.bool_]
) -> bool:
    """Whether the target's end on one side of the image is mostly something nearer's doing.

    Not so where a fair stretch of the box's edge itself ends freely: its place is seen there.
    """
    total = int(np.count_nonzero(ends))
    free = int(np.count_nonzero(at_edge & ~beyond))
    if free >= max(_LEAST_PX, _FREE_SHARE * total):
        return False
    counts = [
        (np.count_nonzero(where & beyond), np.count_nonzero(where)) for where in (at_edge, ends)
    ]
    return any(hid >= _LEAST_PX and hid > _HIDDEN_SHARE * of for hid, of in counts)


def _image_step(T_base_camera: Floats, outward: Floats) -> int:
    """Which of `_STEPS` leads out over an edge: sideways, or away (up) and back (down) in view.

    outward: (3,) base frame. Compared on the table, not in the image, which shortens depth.
    """
    right, down = T_base_camera[:3, 0], T_base_camera[:3, 1]
    away = np.cross((0.0, 0.0, 1.0), -right)
    away = away if away @ T_base_camera[:3, 2] >= 0 or away @ down <= 0 else -away
    sideways, along = float(outward @ right), float(outward @ away)
    if abs(sideways) >= abs(along):
        return 0 if sideways < 0 else 1
    return 2 if along > 0 else 3


def _scan_side(
    own: NDArray[np.bool_], depth: NDArray[np.float32], step: tuple[int, int], at_border: bool
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
    """Own pixels that end to one side; those where a nearer thing is next; those at the border."""
    dv, du = step
    reach = _REACH_PX
    padded = np.pad(own, reach)
    deep = np.pad(depth, reach, constant_values=np.inf)
    h, w = own.shape

    def shifted(array: Array, k: int) -> Array:
        return array[reach + dv * k : reach + dv * k + h, reach + du * k : reach + du * k + w]

    ends = own.copy()
    for k in range(1, reach + 1):  # a hole in the depth is no end
        ends &= ~shifted(padded, k).astype(bool)
    nearer = np.zeros_like(own)
    decided = np.zeros_like(own)
    for k in range(1, reach + 1):
        other = shifted(deep, k)
        has = np.isfinite(other) & ~decided
        nearer |= has & (other < depth - _NEARER_M)
        decided |= has
    border = np.zeros_like(own)
    if at_border:
        rim = {(0, -1): border[:, :2], (0, 1): border[:, -2:], (-1, 0): border[:2]}
        rim.get(step, border[-2:])[:] = True
    return ends, ends & nearer, ends & border
