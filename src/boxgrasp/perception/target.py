"""Which object is meant: by pixel, mask, point, number or box, else as the capture says."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import readonly
from boxgrasp.errors import CodedWarning, TargetError, shown
from boxgrasp.perception.hollow_things import RIM_SHARE
from boxgrasp.perception.masked_points import masked_points
from boxgrasp.perception.scene import MISSING, Scene
from boxgrasp.sensing.capture import Capture

_PIXEL_REACH = 5  # px from a pixel without depth to one that has it
_POINT_REACH_M = 0.03  # m from a point given to an object's
_CLEARLY_M = 0.006  # m over the support plane, where its noise does not reach
_BOX_OVERLAP = 0.4  # least intersection over union of a box given with the box round an object
_BOX_LEAD = 0.1  # by which the best object must overlap it better than the next


_NUMBERS = (int, float, np.integer, np.floating)


@dataclass(frozen=True, eq=False)
class Target:
    """Which object is meant, by at most one of its attributes.

    Attributes:
        pixel: (u, v) on it.
        mask: (H, W) bool or uint8, True on it; (N,) for an unorganized cloud.
        point: (3,) on it, base frame, m.
        object: its number, as `boxgrasp objects` counts.
        box: (u_min, v_min, u_max, v_max) pixels round what is seen of it, the last ones inside,
            as an object detector gives them.

    Raises:
        TargetError: more than one is given.
    """

    pixel: tuple[int, int] | None = None
    mask: Any = None
    point: tuple[float, float, float] | None = None
    object: int | None = None
    box: tuple[float, float, float, float] | None = None

    def __post_init__(self) -> None:
        given = [item.name for item in fields(self) if self._has(item.name)]
        if len(given) > 1:
            raise TargetError(f"target given by {' and '.join(given)}; valid: one of them")

    def _has(self, name: str) -> bool:
        return getattr(self, name) is not None


@dataclass(frozen=True, eq=False)
class TargetPoints:
    """Which of a scene's K points are the target's, and which are in its way.

    A mask's rim is neither: its pixels belong to the target or to what touches it.

    Attributes:
        target_mask: (K,) bool, the target's points.
        obstacle_mask: (K,) bool, those of obstacles.
        warnings: what the user should know of how the target was given.
    """

    target_mask: NDArray[np.bool_]
    obstacle_mask: NDArray[np.bool_]
    warnings: tuple[CodedWarning, ...] = ()


def find_target(scene: Scene, capture: Capture, target: Target | None) -> TargetPoints:
    """Which of the scene's points are the target's, and which are in its way.

    Args:
        scene: its K points, and which pixels show them.
        capture: the view.
        target: what is meant; None for the capture's mask, else its target_pixel.

    Returns:
        Two masks over the points.

    Raises:
        TargetError: nothing given, outside the image, on the table, on nothing, unknown number, or
            a mask of two things or of the background.
    """
    chosen = Target() if target is None else target
    if chosen.mask is not None:
        return _under_mask(scene, _validated_mask(capture, chosen.mask))
    if chosen.object is not None:
        number = _known_number(scene, chosen.object)
    elif chosen.point is not None:
        number = _object_at(scene, chosen.point)
    elif chosen.pixel is not None:
        number = _object_under(scene, chosen.pixel)
    elif chosen.box is not None:
        number = _object_in(scene, chosen.box)
    elif capture.mask is not None:
        return _under_mask(scene, capture.mask)
    elif capture.target_pixel is not None:
        number = _object_under(scene, capture.target_pixel)
    else:
        raise TargetError(
            "no target given; valid: a pixel, mask, point, object number or box, or a capture with "
            "a pixel or mask"
        )
    target_mask = np.asarray(scene.object_numbers == number)
    return TargetPoints(readonly(target_mask), readonly(~target_mask & ~scene.floor_mask))


def _known_number(scene: Scene, number: int) -> int:
    if isinstance(number, bool) or not isinstance(number, int | np.integer):
        raise TargetError(
            f"object is {shown(number)}; valid: a number from 1 to {len(scene.objects)}"
        )
    if not 1 <= number <= len(scene.objects):
        raise TargetError(f"no object {number}; valid: 1 to {len(scene.objects)}")
    return int(number)


def _object_at(scene: Scene, point: tuple[float, float, float]) -> int:
    try:
        place = np.array(point, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise TargetError("target point is not numeric; valid: x, y, z in meters") from None
    if place.shape != (3,) or not np.isfinite(place).all():
        raise TargetError("target point is not three finite numbers; valid: x, y, z in meters")
    with np.errstate(over="ignore"):  # a place beyond all numbers is far away
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
    """Object number under a pixel; without depth there, that round it or nearest to it."""
    if scene.shape is None:
        raise TargetError("an unorganized cloud has no pixels; valid: a point or object number")
    u, v = _pixel_inside(pixel, scene.shape)
    round_it = _round_hole(scene, u, v)
    if len(round_it) == 1:
        return round_it[0]
    near = _nearest_shown(scene, u, v, scene.shape, round_it)
    if near.number > 0:
        return near.number
    if near.nearest_object is not None and scene.height_at(near.pixel) > _CLEARLY_M:
        return near.nearest_object  # a trimmed pixel beside or inside one
    if near.number == 0:
        raise TargetError(
            f"pixel {u} {v} is on no object: too small, out of range or off the support plane; "
            "valid: an object that `boxgrasp objects` lists (see scene.min_range_m, "
            "scene.max_range_m)"
        )
    raise TargetError(f"pixel {u} {v} is on the table or behind it; valid: a pixel on an object")


def _pixel_inside(pixel: tuple[int, int], shape: tuple[int, int]) -> tuple[int, int]:
    height, width = shape
    try:
        u, v = (_whole(k) for k in pixel)
    except (TypeError, ValueError, OverflowError):
        raise TargetError(f"target pixel is {shown(pixel)}; valid: u v, whole numbers") from None
    if not (0 <= u < width and 0 <= v < height):
        raise TargetError(f"pixel {u} {v} is outside; valid: 0..{width - 1} 0..{height - 1}")
    return u, v


def _whole(number: Any) -> int:
    """A coordinate of a pixel; text and truth values are none.

    Raises:
        TypeError: no number.
        ValueError: NaN.
        OverflowError: infinite.
    """
    if isinstance(number, bool) or not isinstance(number, _NUMBERS):
        raise TypeError
    return int(number)


def _object_in(scene: Scene, box: tuple[float, float, float, float]) -> int:
    """The object round which the smallest box of pixels overlaps the one given best."""
    low, high = _validated_box(scene, box)
    image = scene.object_image()
    v, u = np.nonzero(image)
    numbers = image[v, u]
    overlaps = []
    for item in scene.objects:
        own = np.stack((u[numbers == item.number], v[numbers == item.number]), axis=1)
        if len(own) == 0:
            overlaps.append(0.0)
            continue
        own_low, own_high = own.min(axis=0), own.max(axis=0) + 1
        shared = np.prod(np.maximum(np.minimum(high, own_high) - np.maximum(low, own_low), 0))
        union = np.prod(high - low) + np.prod(own_high - own_low) - shared
        overlaps.append(float(shared / union))
    best, *others = (int(k) for k in np.argsort(overlaps)[::-1])
    if overlaps[best] < _BOX_OVERLAP:
        raise TargetError(
            f"target box fits no object: the one nearest to it is {best + 1}, with an overlap of "
            f"{overlaps[best]:.2f}; valid: at least {_BOX_OVERLAP}"
        )
    if others and overlaps[best] - overlaps[others[0]] < _BOX_LEAD:
        raise TargetError(
            f"target box fits objects {best + 1} and {others[0] + 1} alike; valid: a pixel or mask"
        )
    return best + 1


def _validated_box(
    scene: Scene, box: tuple[float, float, float, float]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(u, v) of a box's first pixel and of the one past its last, inside the image."""
    if scene.shape is None:
        raise TargetError("an unorganized cloud has no pixels; valid: a point or object number")
    try:
        ends = np.array(box, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise TargetError("target box is not numeric; valid: u_min v_min u_max v_max") from None
    if ends.shape != (4,) or not np.isfinite(ends).all():
        raise TargetError("target box is not four finite numbers; valid: u_min v_min u_max v_max")
    low = np.maximum(ends[:2], 0)
    high = np.minimum(ends[2:] + 1, scene.shape[::-1])
    if (ends[2:] < ends[:2]).any() or (high <= low).any():
        height, width = scene.shape
        raise TargetError(
            f"target box is {ends.tolist()}; valid: u_min v_min u_max v_max in {width} x {height} "
            "pixels"
        )
    return low, high


@dataclass(frozen=True)
class _Near:
    """What the pixels near one show.

    Attributes:
        pixel: the flat pixel with depth that is nearest, of equals one on an object: the one
            without depth was pointed at, not the table.
        number: of the object that it shows, 0 for a point of none, -1 for table or background.
        nearest_object: number of the object nearest in the image, or None.
    """

    pixel: int
    number: int
    nearest_object: int | None


def _round_hole(scene: Scene, u: int, v: int) -> tuple[int, ...]:
    """The object that encloses a hole in the depth, or those that do so together; none else.

    A dark, shiny or transparent surface has no depth, and what shows round it is the same thing's.
    """
    pixel = v * (scene.shape or (0, 0))[1] + u
    if scene.rows_at(np.array([pixel]))[0] != MISSING:
        return ()
    rim = scene.hole_rim(pixel)
    counts = np.bincount(rim, minlength=1)
    counts[0] = 0
    if len(rim) == 0 or counts.sum() < RIM_SHARE * len(rim):
        return ()
    main = int(np.argmax(counts))
    if counts[main] >= RIM_SHARE * len(rim):
        return (main,)
    return tuple(np.argsort(-counts, kind="stable")[:2].tolist())


def _nearest_shown(
    scene: Scene, u: int, v: int, shape: tuple[int, int], round_it: tuple[int, ...]
) -> _Near:
    height, width = shape
    v0, u0 = max(v - _PIXEL_REACH, 0), max(u - _PIXEL_REACH, 0)
    down = np.arange(v0, min(v + _PIXEL_REACH + 1, height))
    along = np.arange(u0, min(u + _PIXEL_REACH + 1, width))
    shown = scene.rows_at(down[:, None] * width + along)
    rows, columns = np.nonzero(shown != MISSING)
    off = (rows + v0 - v) ** 2 + (columns + u0 - u) ** 2
    if len(off) == 0 or off.min() > _PIXEL_REACH**2:
        if round_it:
            raise TargetError(
                f"pixel {u} {v} has no depth and lies between objects {round_it[0]} and "
                f"{round_it[1]}; valid: a pixel on one of them, or its number"
            )
        raise TargetError(f"pixel {u} {v} has no depth near it; valid: a pixel on an object")
    point = shown[rows, columns]
    numbers = np.where(point >= 0, scene.object_numbers[np.maximum(point, 0)], -1)
    first = np.lexsort((columns, rows, numbers <= 0, off))[0]
    near = np.flatnonzero(numbers > 0)
    return _Near(
        pixel=int((v0 + rows[first]) * width + u0 + columns[first]),
        number=int(numbers[first]),
        nearest_object=int(numbers[near[np.argmin(off[near])]]) if len(near) else None,
    )


def _validated_mask(capture: Capture, mask: Any) -> NDArray[np.bool_]:
    shape = capture.shape
    if shape is None and capture.points is not None:
        shape = (len(capture.points),)  # type: ignore[assignment]
    try:
        array = np.asarray(mask)
    except ValueError:
        raise TargetError(f"mask is {shown(mask)}; valid: bool {shape}") from None
    if array.shape != shape or array.dtype not in (np.bool_, np.uint8):
        raise TargetError(f"mask is {array.dtype} {array.shape}; valid: bool {shape}")
    if not array.any():
        raise TargetError("mask is empty; valid: True on the target's pixels")
    return np.asarray(array != 0)


def _under_mask(scene: Scene, mask: NDArray[np.bool_]) -> TargetPoints:
    found = masked_points(scene, mask)
    obstacle_mask = readonly(~found.target_mask & ~found.rim_mask & ~scene.floor_mask)
    return TargetPoints(found.target_mask, obstacle_mask, found.warnings)
