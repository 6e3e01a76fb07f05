"""The target's box: on the support plane, upright, aligned or turned to the smallest area (2-1)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from msgspec import Meta

from boxgrasp.arrays import Array, Floats, Points, readonly
from boxgrasp.errors import TargetError
from boxgrasp.geometry.box import Box
from boxgrasp.geometry.plane import Plane
from boxgrasp.geometry.transforms import make_transform, rotation_z
from boxgrasp.kernels.footprint import extents_over_yaws

_COARSE = np.deg2rad(np.arange(-44.0, 46.0, 2.0))  # rad; a rectangle repeats after a quarter turn
_FINE = np.deg2rad(np.arange(-1.75, 2.0, 0.25))  # rad, round the best of those
_LEAST_M = 0.005  # m, a dimension at least: a wall seen edge on has no thickness
_FEWEST_CUT = 2  # points, where the share of few is none
_SEARCHED = 1500  # points tell the turn as well as all
_TIE = 1e-9  # share of an area up to which two are equal


@dataclass(frozen=True)
class BoxConfig:
    """How the box is fitted.

    So that stray pixels cannot inflate it, its outer slab must hold a share of the points on every
    side (a veil of flying pixels behind an outline does not), and then some may lie outside.

    Attributes:
        fit: `yaw` turns to the smallest area where that shrinks it enough; `aligned` is the
            thesis's.
        turn_gain: share of the area by which turning must shrink it.
        slab_m: thickness of the outer slab, m.
        slab_share: share of the points that the slab must hold.
        trim_share: share of the points, at least two, that may lie outside at each end of an axis.
    """

    fit: Literal["yaw", "aligned"] = "yaw"
    turn_gain: Annotated[float, Meta(ge=0.0, lt=1.0)] = 0.07
    slab_m: Annotated[float, Meta(gt=0.0, le=0.1)] = 0.01
    slab_share: Annotated[float, Meta(ge=0.0, le=0.2)] = 0.01
    trim_share: Annotated[float, Meta(ge=0.0, le=0.1)] = 0.001


def fit_box(points: Points, plane: Plane, heading_rad: float, config: BoxConfig) -> Box:
    """The box round a target's points, standing on the plane (thesis section 2-1).

    Args:
        points: (N, 3) float32, base frame, m.
        plane: the support plane, base frame.
        heading_rad: where the camera looks in the base, rad; the box's x is kept within 45 degrees
            of the base axis nearest to it, so that `front` is the face towards the robot.
        config: how it is fitted.

    Returns:
        The box.

    Raises:
        TargetError: no points.
    """
    if len(points) == 0:
        raise TargetError("the target has no points; valid: at least one above the plane")
    quarter = float(np.round(heading_rad / (np.pi / 2)) * (np.pi / 2)) + 0.0
    middle = points[:, :2].mean(axis=0, dtype=np.float64)
    footprint = (points[:, :2] - middle) @ rotation_z(quarter)[:2, :2]
    footprint = np.ascontiguousarray(footprint)
    yaw, extent = _turn(footprint, config)
    turn = rotation_z(quarter) @ rotation_z(yaw)
    size = np.maximum(extent[1::2] - extent[::2], _LEAST_M)
    center = middle + turn[:2, :2] @ ((extent[1::2] + extent[::2]) / 2)
    foot = -(plane.normal[:2] @ center + plane.offset_m) / plane.normal[2]
    top = float(np.partition(points[:, 2], -_cut(points, config) - 1)[-_cut(points, config) - 1])
    height = max(top - foot, _LEAST_M)
    return Box(
        readonly(make_transform(turn, (center[0], center[1], foot + height / 2))),
        readonly(np.array([size[0], size[1], height])),
    )


def _cut(points: Array, config: BoxConfig) -> int:
    """How many points are left outside at each end."""
    return min(max(_FEWEST_CUT, int(config.trim_share * len(points))), (len(points) - 1) // 2)


def _turn(footprint: Floats, config: BoxConfig) -> tuple[float, Floats]:
    """Yaw and extents (4,) of the footprint: straight, unless turning shrinks it enough."""
    straight = _extents(footprint, np.zeros(1), config)
    if config.fit == "aligned":
        return 0.0, straight[0]
    # Every few points tell the turn as well; the extents then come from all.
    some = np.ascontiguousarray(footprint[:: max(1, len(footprint) // _SEARCHED)])
    yaw = _least_area(_COARSE, some, config)
    yaw = _least_area(yaw + _FINE, some, config)
    turned = _extents(footprint, np.array([yaw]), config)
    if _areas(turned)[0] >= (1.0 - config.turn_gain) * _areas(straight)[0]:
        return 0.0, straight[0]
    if not -np.pi / 4 < yaw <= np.pi / 4:  # the same rectangle, named from its other side
        yaw -= float(np.copysign(np.pi / 2, yaw))
        turned = _extents(footprint, np.array([yaw]), config)
    return yaw, turned[0]


def _extents(footprint: Floats, yaws: Floats, config: BoxConfig) -> Floats:
    """(A, 4) extents of the footprint in axes turned by each yaw, strays left out."""
    # The corners of a turned thing are sparse too, and the thesis's box holds them.
    share = 0.0 if config.fit == "aligned" else config.slab_share
    return extents_over_yaws(footprint, yaws, _cut(footprint, config), config.slab_m, share)


def _areas(extents: Floats) -> Floats:
    return np.asarray((extents[:, 1] - extents[:, 0]) * (extents[:, 3] - extents[:, 2]))


def _least_area(yaws: Floats, footprint: Floats, config: BoxConfig) -> float:
    """The yaw of the smallest rectangle, of equals the least turned."""
    areas = _areas(_extents(footprint, yaws, config))
    ties = np.flatnonzero(areas <= areas.min() * (1 + _TIE))
    return float(yaws[ties[np.argmin(np.abs(yaws[ties]))]])
