"""Which object is meant: by pixel, mask, point or number, else as the capture says."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Points, readonly
from boxgrasp.errors import TargetError
from boxgrasp.geometry.transforms import transform
from boxgrasp.kernels.cells import euclidean_clusters
from boxgrasp.perception.scene import Scene
from boxgrasp.sensing.capture import Capture

_PIXEL_REACH = 5
_POINT_REACH_M = 0.03
_MASK_JOIN_M = 0.03
_CLEARLY_M = 0.006
_RIM_M = 0.008


@dataclass(frozen=True, eq=False)
class Target:
    """At most one of: pixel (u, v); mask (H, W) bool; point (3,) base frame, m; object number.

    Raises:
        TargetError: more than one is given.
    """

    pixel: tuple[int, int] | None = None
    mask: Any = None
    point: tuple[float, float, float] | None = None
    object: int | None = None

    def __post_init__(self) -> None:
        given = [name for name in ("pixel", "mask", "point", "object") if self._has(name)]
        if len(given) > 1:
            raise TargetError(f"target given by {' and '.join(given)}; valid: one of them")

    def _has(self, name: str) -> bool:
        return getattr(self, name) is not None


@dataclass(frozen=True, eq=False)
class TargetPoints:
    """own: (K,) the scene's points that are the target's; others: (K,) those that are obstacles.

    A mask's rim is neither: its pixels belong to the target or to what touches it.
    """

    target_mask: NDArray[np.bool_]
    obstacle_mask: NDArray[np.bool_]


def find_target(scene: Scene, capture: Capture, target: Target | None) -> TargetPoints:
    """Which of the scene's points are the target's, and which are in its way.

    Without a target the capture's mask counts, then its target_pixel.

    Raises:
        TargetError: nothing given, outside the image, on the table, on nothing, unknown number.
    """
    chosen = target or Target()
    if chosen.mask is not None:
        return _under_mask(scene, capture, _validated_mask(capture, chosen.mask))
    if chosen.object is not None:
        number = _known_number(scene, chosen.object)
    elif chosen.point is not None:
        number = _object_at(scene, chosen.point)
    elif chosen.pixel is not None:
        number = _object_under(scene, chosen.pixel)
    elif capture.mask is not None:
        return _under_mask(scene, capture, capture.mask)
    elif capture.target_pixel is not None:
        number = _object_under(scene, capture.target_pixel)
    else:
        raise TargetError(
            "no target given; valid: a pixel, mask, point or object number, or a capture with one"
        )
    own = np.asarray(scene.object_numbers == number)
    return TargetPoints(readonly(own), readonly(~own))


def _known_number(scene: Scene, number: int) -> int:
    if isinstance(number, bool) or not isinstance(number, int | np.integer):
        raise TargetError(f"object is {number!r}; valid: a number from 1 to {len(scene.objects)}")
    if not 1 <= number <= len(scene.objects):
        raise TargetError(f"no object {number}; valid: 1 to {len(scene.objects)}")
    return int(number)


def _object_at(scene: Scene, point: tuple[float, float, float]) -> int:
    try:
        place = np.array(point, dtype=np.float64)
    except (TypeError, ValueError):
        raise TargetError("target point is not numeric; valid: x, y, z in meters") from None
    if place.shape != (3,) or not np.isfinite(place).all():
        raise TargetError("target point is not three finite numbers; valid: x, y, z in meters")
    away = np.linalg.norm(scene.points - place, axis=1)
    away[scene.object_numbers == 0] = np.inf
    nearest = int(np.argmin(away))
    if away[nearest] > _POINT_REACH_M:
        raise TargetError(
            f"target point is on no object (nearest is {away[nearest] * 100:.0f} cm away); "
            f"valid: within {_POINT_REACH_M * 100:.0f} cm of one"
        )
    return int(scene.object_numbers[nearest])


def _object_under(scene: Scene, pixel: tuple[int, int]) -> int:
    """Object number under a pixel; without depth there, under the nearest pixel that has it."""
    if scene.shape is None:
        raise TargetError("an unorganized cloud has no pixels; valid: a point or object number")
    height, width = scene.shape
    try:
        u, v = (int(k) for k in pixel)
    except (TypeError, ValueError, OverflowError):
        raise TargetError(f"target pixel is {pixel!r}; valid: u v, whole numbers") from None
    if not (0 <= u < width and 0 <= v < height):
        raise TargetError(f"pixel {u} {v} is outside; valid: 0..{width - 1} 0..{height - 1}")
    v0, u0 = max(v - _PIXEL_REACH, 0), max(u - _PIXEL_REACH, 0)
    down = np.arange(v0, min(v + _PIXEL_REACH + 1, height))
    along = np.arange(u0, min(u + _PIXEL_REACH + 1, width))
    window = scene.voxels_at(down[:, None] * width + along)
    rows, columns = np.nonzero(window != -2)
    if len(rows) == 0:
        raise TargetError(f"pixel {u} {v} has no depth near it; valid: a pixel on an object")
    off = (rows + v0 - v) ** 2 + (columns + u0 - u) ** 2
    if off.min() > _PIXEL_REACH**2:
        raise TargetError(f"pixel {u} {v} has no depth near it; valid: a pixel on an object")
    # Ties go to a pixel on an object: the one without depth was pointed at, not the table.
    voxel = window[rows, columns]
    number = np.where(voxel >= 0, scene.object_numbers[np.maximum(voxel, 0)], -1)
    first = np.lexsort((columns, rows, number <= 0, off))[0]
    if number[first] > 0:
        return int(number[first])
    near = np.flatnonzero(number > 0)
    if (
        number[first] < 1
        and len(near)
        and _off_plane(scene, (v0 + rows[first]) * width + u0 + columns[first])
    ):
        return int(number[near[np.argmin(off[near])]])  # a trimmed pixel beside or inside one
    if number[first] == 0:
        raise TargetError(
            f"pixel {u} {v} is on no object: too small, out of range or off the support plane; "
            "valid: an object that `boxgrasp objects` lists (see scene.min_range_m, scene.max_range_m)"
        )
    raise TargetError(f"pixel {u} {v} is on the table or behind it; valid: a pixel on an object")


def _off_plane(scene: Scene, pixel: int) -> bool:
    """Whether a pixel's point is clearly no part of the support plane."""
    row = np.searchsorted(scene.pixels, pixel)
    point = transform(scene.T_base_source, scene.source_points[row : row + 1])
    return bool(scene.plane.heights(point)[0] > _CLEARLY_M)


def _validated_mask(capture: Capture, mask: Any) -> NDArray[np.bool_]:
    shape = capture.shape
    if shape is None and capture.points is not None:
        shape = (len(capture.points),)  # type: ignore[assignment]
    array = np.asarray(mask)
    if array.shape != shape or array.dtype not in (np.bool_, np.uint8):
        raise TargetError(f"mask is {array.dtype} {array.shape}; valid: bool {shape}")
    if not array.any():
        raise TargetError("mask is empty; valid: True on the target's pixels")
    return np.asarray(array != 0)


def _under_mask(scene: Scene, capture: Capture, mask: NDArray[np.bool_]) -> TargetPoints:
    """The voxels mostly under the mask; of apart pieces the largest, so that bleed falls off."""
    flat = mask.reshape(-1)
    if scene.shape is None and capture.robot_mask is not None:
        flat = flat[~capture.robot_mask.reshape(-1)]
    ok = scene.voxel_of_above >= 0
    voxels = scene.voxel_of_above[ok]
    inside = flat[scene.pixels[scene.above[ok]]]
    count = len(scene.points)
    votes = np.bincount(voxels, inside, minlength=count)
    under = 2 * votes > np.bincount(voxels, minlength=count)
    if not under.any():
        raise TargetError("mask covers nothing above the support plane; valid: True on an object")
    rows = np.flatnonzero(under)
    pieces = euclidean_clusters(np.ascontiguousarray(scene.points[rows]), _MASK_JOIN_M)
    under[rows[pieces != np.bincount(pieces).argmax()]] = False
    rim = _beside(scene.points, under) & np.isin(scene.clusters, scene.clusters[under])
    return TargetPoints(readonly(under), readonly(~under & ~rim))


def _beside(points: Points, own: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(K,) points in or next to a cell that holds one of the target's own."""
    cells = np.floor(points / _RIM_M).astype(np.int64)
    keys = (cells[:, 0] << 42) + (cells[:, 1] << 21) + cells[:, 2]
    held = np.unique(keys[own])
    beside = np.zeros(len(points), dtype=bool)
    for x, y, z in itertools.product((-1, 0, 1), repeat=3):
        beside |= np.isin(keys + (x << 42) + (y << 21) + z, held)
    return beside
