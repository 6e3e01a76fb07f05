"""What a scene was seen to hold, as messages show it: level surfaces, obstacles, the target."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Floats, Points
from boxgrasp.geometry.plane import Plane
from boxgrasp.geometry.transforms import invert, make_transform, transform
from boxgrasp.kernels.plan import patches
from boxgrasp.perception.scene import Scene
from boxgrasp.selector import SceneAnalysis

NO_NUMBER = 0  # of obstacles that are no object

_SAMPLE = 8_000  # points tell where a surface was seen
_ON_M = 0.010  # m from a surface: a sensor's noise
_CELL_M = 0.04  # m, cells of its plan: two points or more of the sample at 1 m
_PART = 0.1  # of the largest patch: what things part from it, and no speck beyond its edge
_FEWEST = 20  # points of a surface
_DIRECTIONS = 36  # in which an outline's corners are looked for
_MOST_CELLS = 2000  # a side of the plan: 60 m


@dataclass(frozen=True, eq=False)
class Surface:
    """A level surface where it was seen.

    Attributes:
        T_base_surface: (4, 4), m, z on its normal, z = 0 on it.
        outline_m: (n, 2) float64, convex, counter-clockwise from above, surface frame, m.
    """

    T_base_surface: Floats
    outline_m: Floats

    @property
    def outline_base_m(self) -> Floats:
        """(n, 3) float64, base frame, m."""
        flat = np.column_stack((self.outline_m, np.zeros(len(self.outline_m))))
        return np.asarray(transform(self.T_base_surface, flat))


@dataclass(frozen=True, eq=False)
class Thing:
    """What is in the hand's way.

    Attributes:
        number: the object's, or `NO_NUMBER`.
        points: (N, 3) float32, base frame, m.
    """

    number: int
    points: Points


def target_number(analysis: SceneAnalysis) -> int:
    """The number of the object that holds most of the target's points.

    Args:
        analysis: of the view.

    Returns:
        Its number; `NO_NUMBER` for a mask on what is no object.
    """
    numbers = analysis.scene.object_numbers[analysis.target_points.target_mask]
    return int(np.argmax(np.bincount(numbers, minlength=1)))


def things(analysis: SceneAnalysis) -> list[Thing]:
    """The obstacles, object by object.

    Args:
        analysis: of the view.

    Returns:
        By their numbers, `NO_NUMBER` first, where it has any points. What a mask leaves of the
        target's own object is an obstacle of that number.
    """
    mask = analysis.target_points.obstacle_mask
    numbers, points = analysis.scene.object_numbers[mask], analysis.scene.points[mask]
    return [Thing(number, points[numbers == number]) for number in np.unique(numbers).tolist()]


def surfaces(analysis: SceneAnalysis) -> list[Surface]:
    """The level surfaces that were seen.

    Args:
        analysis: of the view.

    Returns:
        The target's own first; none of a surface that shows too few points.
    """
    scene, foot = analysis.scene, analysis.context.box.base_center_m
    found = [_surface(_frame(scene.plane, scene, foot), _view_points(scene))]
    supports = scene.supports
    at = np.append(transform(invert(scene.T_base_table), foot[None])[0], 1.0)
    own = int(np.argmin(np.abs(supports.planes @ at)))
    for number, points in enumerate(supports.points_m):
        if number == own:
            continue
        values = supports.planes[number]
        plane = Plane(values[:3], float(values[3])).moved(scene.T_base_table)
        base = transform(scene.T_base_table, points)
        found.append(_surface(_frame(plane, scene, foot), base))
    return [surface for surface in found if surface is not None]


def _view_points(scene: Scene) -> Points:
    """(n, 3) float32 some of the first view's points, base frame, m."""
    view = scene.views[0]
    return transform(view.T_base_source, view.points[:: max(1, len(view.points) // _SAMPLE)])


def _frame(plane: Plane, scene: Scene, foot_m: Floats) -> Floats:
    """(4, 4) a plane's frame at the target's foot, x as the table's."""
    z = plane.normal
    y = np.cross(z, scene.T_base_table[:3, 0])
    y = y / np.linalg.norm(y)
    origin = foot_m - z * (z @ foot_m + plane.offset_m)
    return make_transform(np.column_stack((np.cross(y, z), y, z)), origin)


def _surface(T_base_surface: Floats, points: Points) -> Surface | None:
    """A surface by the points on it, without what lies level with it beyond its edge."""
    local = transform(invert(T_base_surface), points)
    flat = local[np.abs(local[:, 2]) < _ON_M, :2].astype(np.float64)
    held = flat[_in_large_patches(flat)] if len(flat) >= _FEWEST else flat
    outline = _outline(held)
    return Surface(T_base_surface, outline) if len(outline) > 2 else None


def _in_large_patches(flat: Floats) -> NDArray[np.bool_]:
    """(n,) which points lie in the largest patch of cells, or in one not much smaller."""
    at = np.floor(flat / _CELL_M).astype(np.int64)
    at -= at.min(axis=0)
    shape = at.max(axis=0) + 1
    if np.any(shape > _MOST_CELLS):
        return np.ones(len(flat), dtype=bool)
    cells = np.zeros(shape, dtype=bool)
    cells[tuple(at.T)] = True
    nothing = np.zeros((*cells.shape, 3), dtype=np.float32)
    patch = patches(cells, nothing[..., 0], nothing, np.inf, np.inf)
    area = np.bincount(patch[cells])
    return np.asarray((area >= _PART * area.max())[patch[tuple(at.T)]])


def _outline(flat: Floats) -> Floats:
    """(m, 2) the points that lie farthest in some directions, counter-clockwise."""
    if len(flat) == 0:
        return flat
    angle = np.arange(_DIRECTIONS) * (2 * np.pi / _DIRECTIONS)
    farthest = np.argmax(flat @ np.array((np.cos(angle), np.sin(angle))), axis=0)
    return np.asarray(flat[farthest[farthest != np.roll(farthest, 1)]])
