"""Where the half sphere over the target is sampled: grid, spiral, dense, and portions per face.

All points are in the half sphere's frame: origin at its center, turned with the box, z up. Counts
are those of the thesis (sections 2-2 and 3-2): 184 for both samplings, 2,256 at 3 cm, portions of
60 and 120 (grid), 57 and 118 (spiral).
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from boxgrasp.arrays import Floats, readonly
from boxgrasp.errors import ConfigError
from boxgrasp.geometry.transforms import rotation_z
from boxgrasp.grasps.candidates import FRONT, LEFT, RIGHT, TOP_PARALLEL, TOP_PERPENDICULAR

RADIUS_M = 0.30
PORTION_WIDTH_M = 0.30
LAYERS: tuple[tuple[float, int], ...] = ((0.075, 6), (0.15, 25), (0.225, 55), (0.30, 98))
# Cell size of the local map that each sampling reads in the thesis.
RESOLUTION_M = {"grid": 0.07, "spiral": 0.03, "dense": 0.03}

# Turn about z from the face a portion is cut for (right, top-perpendicular) to each face: -y goes
# to the face's outward side, and for top-parallel line 1 of the one goes to line 1 of the other.
_TURN = {LEFT: math.pi, FRONT: -math.pi / 2, RIGHT: 0.0, TOP_PARALLEL: -math.pi / 2,
         TOP_PERPENDICULAR: 0.0}  # fmt: skip

_SLACK = 1e-9  # meters: a point on the sphere's surface is inside
_MOST_STEPS = 200


@cache
def grid(resolution_m: float = RESOLUTION_M["grid"], radius_m: float = RADIUS_M) -> Floats:
    """Points of a square grid in the half sphere (thesis algorithm 4).

    x and y are odd multiples of half the spacing, z its multiples from 0 up, so that none lies on
    the border between cells of a local map of that resolution. The algorithm's start is moved by
    half a cell: as printed it gives 195 points where the thesis counts 184.

    Args:
        resolution_m: spacing, m.
        radius_m: of the half sphere, m.

    Returns:
        (P, 3) float64, map frame, m, read-only; z, then y, then x rise.

    Raises:
        ConfigError: spacing or radius not positive, or more than 200 steps a radius.
    """
    s = resolution_m
    _validate_positive("sample spacing", s)
    _validate_positive("half sphere radius", radius_m)
    if radius_m / s > _MOST_STEPS:
        raise ConfigError(
            f"sample spacing is {s} m; valid: at least radius / {_MOST_STEPS} = "
            f"{radius_m / _MOST_STEPS:.4g} m"
        )
    n = math.ceil(radius_m / s) + 1
    across = (np.arange(-n, n) + 0.5) * s
    up = np.arange(0, n + 1) * s
    z, y, x = np.meshgrid(up, across, across, indexing="ij")
    points = np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)
    kept = points[np.linalg.norm(points, axis=1) <= radius_m + _SLACK]
    return _closed(kept)


def dense(radius_m: float = RADIUS_M) -> Floats:
    """A point for each 3 cm cell of the half sphere (thesis figure 2-5).

    Args:
        radius_m: of the half sphere, m.

    Returns:
        (2256, 3) float64 with the thesis's radius, map frame, m, read-only.

    Raises:
        ConfigError: a radius that is not positive.
    """
    return grid(RESOLUTION_M["dense"], radius_m)


@cache
def spiral(layers: tuple[tuple[float, int], ...] = LAYERS) -> Floats:
    """Points on half spheres, each layer half a golden spiral (thesis algorithms 2 and 3).

    Angles start at 0, not at 1 as printed: then the portions have the thesis's 57 and 118 points.

    Args:
        layers: (radius in m, number of points) of each.

    Returns:
        (P, 3) float64, map frame, m, read-only.

    Raises:
        ConfigError: a radius that is not positive, a number of points below 1.
    """
    golden = math.pi * (3.0 - math.sqrt(5.0))
    parts = []
    for radius, count in layers:
        _validate_positive("spiral layer radius", radius)
        if count != int(count) or count < 1:
            raise ConfigError(f"spiral layer has {count} points; valid: a whole number from 1")
        whole = 2 * int(count)
        z = np.linspace(1 - 1 / whole, 1 / whole - 1, whole)[: int(count)]
        across = np.sqrt(1 - z * z)
        angle = golden * np.arange(int(count))
        unit = np.stack([across * np.cos(angle), across * np.sin(angle), z], axis=1)
        parts.append(radius * unit)
    if not parts:
        raise ConfigError("spiral has no layers; valid: at least one (radius_m, points)")
    return _closed(np.concatenate(parts))


def sampling(name: str) -> Floats:
    """The points of a sampling with the thesis's parameters.

    Args:
        name: `grid` (184), `spiral` (184) or `dense` (2,256).

    Returns:
        (P, 3) float64, map frame, m, read-only.

    Raises:
        ConfigError: another name.
    """
    if name == "grid":
        return grid()
    if name == "spiral":
        return spiral()
    if name == "dense":
        return dense()
    raise ConfigError(f"sampling is {name!r}; valid: {', '.join(RESOLUTION_M)}")


def portion(points: Floats, face: int, width_m: float = PORTION_WIDTH_M) -> Floats:
    """The points in front of a face, their order kept (thesis 3-2-2).

    Cut once for the right face (|x| at most width_m / 2, y below 0) and once for top-perpendicular
    (|x| at most width_m / 2); for the other faces the same list is turned about the vertical.
    Feature i therefore stands for the same place relative to the gripper, whatever the face.

    Args:
        points: (P, 3) float64, map frame, m.
        face: 1 to 5.
        width_m: of the slab, m.

    Returns:
        (p, 3) float64, map frame, m, read-only.

    Raises:
        ConfigError: a face other than 1 to 5, a width that is not positive.
    """
    if face not in _TURN:
        raise ConfigError(f"face is {face!r}; valid: 1 to 5")
    _validate_positive("portion width", width_m)
    kept = np.abs(points[:, 0]) <= width_m / 2 + _SLACK
    if is_side(face):
        kept &= points[:, 1] < -_SLACK
    return _closed(points[kept] @ rotation_z(_TURN[face]).T)


def is_side(face: int) -> bool:
    """Whether a face is left, front or right; these share a portion, and both top faces another.

    Args:
        face: 1 to 5.

    Returns:
        Whether it is.
    """
    return face <= RIGHT


def _closed(points: Floats) -> Floats:
    readonly(points)
    return points


def _validate_positive(what: str, value: float) -> None:
    if not (math.isfinite(value) and value > 0):
        raise ConfigError(f"{what} is {value}; valid: a positive number of meters")
