"""Where the view ends before the target does: edges hidden by nearer things or by the border."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Array, Floats, Points
from boxgrasp.forks import cached_property
from boxgrasp.geometry.box import Box
from boxgrasp.geometry.transforms import invert, transform
from boxgrasp.perception.scene import REACH_PX, Scene, TargetWindow
from boxgrasp.sensing.capture import Capture
from boxgrasp.sensing.sensor_model import SensorModel

# Found on cast scenes, where the hidden edges are known.
_BRIDGED_M = 0.015  # m, holes as wide as this are bridged too
_NEARER_M = 0.02  # m, from which one thing is in front of another
_EDGE_BAND_M = 0.012  # m, inside the box's edge: what lies there is at the edge
_HIDDEN_SHARE = 0.5  # of the target's ends on a side, from which something else makes them
_FREE_SHARE = 0.12  # of them, from which the edge itself was seen to end
_LEAST_PX = 4  # fewer pixels tell nothing
_CROWD_M = 0.005  # m, depth of a face seen edge on, noise included
_BELOW_TOP_M = 0.012  # m, under the top: what lies there is a wall's
_FACING = 0.85  # cosine to the view from which a face is turned to the camera
_WALL_PX = 20  # pixels of a wall from which it was seen
_CROWD_SHARE = 0.58  # of the band's points, from which they crowd at its end
_RIM_PX = 2  # from the image's border
_STEPS = ((0, -1), (0, 1), (-1, 0), (1, 0))  # rows, columns: left, right, up, down


@dataclass(frozen=True)
class Truncation:
    """Where the view ends before the target does.

    Attributes:
        width_known: whether the box's x and y dimensions are more than lower bounds.
        cut: whether the image border cuts the target.
    """

    width_known: tuple[bool, bool]
    cut: bool


def find_truncation(
    capture: Capture, scene: Scene, window: TargetWindow | None, box: Box
) -> Truncation:
    """Which edges of the box end at something nearer or at the border (docs/how-it-works.md).

    Without an image every edge counts as seen, but the one along the view where the camera looks
    from below the box's top.

    Args:
        capture: the view, whose robot mask hides too.
        scene: its K points, and which pixels show them.
        window: the image round the target, `REACH_PX` round it; None without one.
        box: the target's.

    Returns:
        What is hidden.
    """
    known = [True, True]
    cut = False
    if window is not None and scene.T_base_camera is not None:
        depth = _depths(window, scene.T_base_camera, capture.robot_mask)
        sides = _sides(window, depth, _Shadow(capture, scene.sensor, scene.T_base_camera))
        cut = sides.cut
        for axis in _hidden_edges(sides, scene.T_base_camera, box):
            known[axis] = False
    camera = scene.camera_position_m
    if camera is not None:
        along = invert(box.T_base_box)[:3, :3] @ (box.T_base_box[:3, 3] - camera)
        if camera[2] < box.T_base_box[2, 3] + box.dimensions_m[2] / 2 + _NEARER_M:
            known[int(np.argmax(np.abs(along[:2])))] = False
    return Truncation((known[0], known[1]), cut)


def _depths(
    window: TargetWindow, T_base_camera: Floats, robot_mask: NDArray[np.bool_] | None
) -> NDArray[np.float32]:
    """(h, w) m along the optical axis, inf where it is missing."""
    forward = T_base_camera[:3, 2].astype(np.float32)
    depth = (window.points_m - T_base_camera[:3, 3].astype(np.float32)) @ forward
    depth = np.where(np.isnan(depth), np.float32(np.inf), depth)
    if robot_mask is not None:  # the arm is nearer than what it hides
        depth[robot_mask[window.rows, window.columns]] = 0.0
    return depth


@dataclass(frozen=True, eq=False)
class _Sides:
    """The target's pixels that end on each side of the image, in the order of `_STEPS`.

    Attributes:
        window: the image round the target.
        ends: (h, w) bool a side, pixels that end there.
        beyond: (h, w) bool a side, those where the target may go on: a nearer thing is next, the
            border, or a hole in the depth that no shadow explains.
        cut: whether the image border cuts the target.
    """

    window: TargetWindow
    ends: tuple[NDArray[np.bool_], ...]
    beyond: tuple[NDArray[np.bool_], ...]
    cut: bool


@dataclass(frozen=True, eq=False)
class _Shadow:
    """Which holes in the depth are shadows: seen by one of the sensor's eyes alone.

    Attributes:
        capture: the view.
        sensor: whose eyes lie a baseline apart.
        T_base_camera: (4, 4).
    """

    capture: Capture
    sensor: SensorModel
    T_base_camera: Floats

    @cached_property
    def image(self) -> NDArray[np.float32]:
        """(H, W) depth, m, 0 for missing."""
        capture, shape = self.capture, self.capture.shape
        if capture.depth is not None or capture.points is None or shape is None:
            return np.zeros((0, 0), np.float32) if capture.depth is None else capture.depth
        points = capture.points
        if capture.cloud_frame == "base":
            points = transform(invert(self.T_base_camera), points)
        return np.nan_to_num(points[:, 2], nan=0.0).reshape(shape)

    def explains(
        self,
        at: tuple[NDArray[np.int64], NDArray[np.int64]],
        step: tuple[int, int],
        depth: NDArray[np.float32],
    ) -> NDArray[np.bool_]:
        """Whether a surface is seen to end at pixels that have no depth beside them.

        An outline at depth z casts a shadow of f b (1 / z - 1 / z') pixels on what lies at z'
        behind it; past the image's border z' may be anything. A hole as wide as that, with a
        farther surface past it, hides nothing else. The eyes may lie along either image axis.

        at: (n,) rows v and (n,) columns u of the pixels; step: to the hole; depth: (n,) theirs, m.
        """
        found = np.zeros(len(depth), dtype=np.bool_)
        if len(depth) == 0:
            return found
        image, focal_px = self.image, self.capture.focal_px or self.sensor.focal_px
        bridged_px = np.maximum(REACH_PX, focal_px * _BRIDGED_M / depth)
        widest_px = focal_px * self.sensor.baseline_m / depth + bridged_px
        undecided = np.ones(len(depth), dtype=np.bool_)
        for by in range(REACH_PX + 1, int(widest_px.max()) + 1):
            undecided &= by <= widest_px
            v, u = at[0] + step[0] * by, at[1] + step[1] * by
            inside = (v >= 0) & (v < image.shape[0]) & (u >= 0) & (u < image.shape[1])
            found |= undecided & ~inside
            undecided &= inside
            if not undecided.any():
                break
            rows = np.flatnonzero(undecided)
            rows = rows[image[v[rows], u[rows]] > 0]
            next_m = image[v[rows], u[rows]]
            wide_px = (
                focal_px * self.sensor.baseline_m * np.maximum(1 / depth[rows] - 1 / next_m, 0)
            )
            farther = next_m > depth[rows] - _NEARER_M
            found[rows] = farther & (by <= wide_px + bridged_px[rows])
            undecided[rows] = False
        return found


@dataclass(frozen=True, eq=False)
class _Padded:
    """The window with a margin of `REACH_PX` round it, made once for all sides.

    Attributes:
        target_mask: bool, False in the margin.
        depth: float32, m, inf in the margin.
        measured: bool, where the depth is finite.
        near_limit: (h, w) float32, m: what is nearer than this hides the pixel's neighbor.
    """

    target_mask: NDArray[np.bool_]
    depth: NDArray[np.float32]
    measured: NDArray[np.bool_]
    near_limit: NDArray[np.float32]

    def shifted(self, array: Array, step: tuple[int, int], by: int) -> Array:
        """(h, w) what lies `by` steps beside each pixel of the window."""
        height, width = self.near_limit.shape
        v, u = REACH_PX + step[0] * by, REACH_PX + step[1] * by
        return array[v : v + height, u : u + width]


def _padded(array: Array, value: float) -> Array:
    reach = REACH_PX
    height, width = array.shape
    padded = np.full((height + 2 * reach, width + 2 * reach), value, dtype=array.dtype)
    padded[reach:-reach, reach:-reach] = array
    return padded


def _sides(window: TargetWindow, depth: NDArray[np.float32], shadow: _Shadow) -> _Sides:
    deep = _padded(depth, np.inf)
    padded = _Padded(_padded(window.target_mask, False), deep, np.isfinite(deep), depth - _NEARER_M)
    scanned = [
        _scan_side(padded, step, open_side)
        for step, open_side in zip(_STEPS, window.open_sides, strict=True)
    ]
    beyond = []
    for step, (_, hidden, blank, border) in zip(_STEPS, scanned, strict=True):
        unknown = blank & ~border
        rows, columns = np.nonzero(unknown)
        at = rows + window.rows.start, columns + window.columns.start
        unknown[rows, columns] = ~shadow.explains(at, step, depth[rows, columns])
        beyond.append(hidden | border | unknown)
    return _Sides(
        window,
        ends=tuple(ends for ends, _, _, _ in scanned),
        beyond=tuple(beyond),
        cut=any(int(np.count_nonzero(border)) >= _LEAST_PX for _, _, _, border in scanned),
    )


def _hidden_edges(sides: _Sides, T_base_camera: Floats, box: Box) -> list[int]:
    """The axis, 0 or 1, of each hidden edge."""
    target_mask = sides.window.target_mask
    T_box_base = invert(box.T_base_box)
    local = transform(T_box_base, sides.window.points_m)
    view = T_box_base[:3, :3] @ (box.T_base_box[:3, 3] - T_base_camera[:3, 3])
    found = []
    for axis in (0, 1):
        for side in (-1, 1):
            with np.errstate(invalid="ignore"):
                at_edge = local[..., axis] * side > box.dimensions_m[axis] / 2 - _EDGE_BAND_M
            band = local[target_mask & at_edge]
            if _is_face(box.dimensions_m[axis] / 2 - band[:, axis] * side):
                continue
            wall = np.count_nonzero(band[:, 2] < box.dimensions_m[2] / 2 - _BELOW_TOP_M)
            if side * view[axis] < -_FACING * np.hypot(view[0], view[1]) and wall >= _WALL_PX:
                continue  # the face towards the camera is seen below the top
            step = _image_step(T_base_camera, side * box.T_base_box[:3, axis])
            if _is_hidden(sides.ends[step] & at_edge, sides.ends[step], sides.beyond[step]):
                found.append(axis)
    return found


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
    """Whether most of the target's end on one side of the image may not be its own.

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
    padded: _Padded, step: tuple[int, int], open_side: bool
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
    """The target's pixels that end to one side; those of them where a nearer thing is next; where
    nothing is measured next; and at the image's border, where the window ends with it.
    """
    ends = padded.shifted(padded.target_mask, step, 0).copy()
    nearer = np.zeros_like(ends)
    decided = np.zeros_like(ends)
    for by in range(1, REACH_PX + 1):
        # A hole in the depth is no end.
        ends &= ~padded.shifted(padded.target_mask, step, by)
        found = padded.shifted(padded.measured, step, by) & ~decided
        nearer |= found & (padded.shifted(padded.depth, step, by) < padded.near_limit)
        decided |= found
    border = np.zeros_like(ends)
    if open_side:
        rims = (np.s_[:, :_RIM_PX], np.s_[:, -_RIM_PX:], np.s_[:_RIM_PX], np.s_[-_RIM_PX:])
        border[rims[_STEPS.index(step)]] = True
    return ends, ends & nearer, ends & ~decided, ends & border
