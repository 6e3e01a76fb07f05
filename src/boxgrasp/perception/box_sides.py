"""Where the sides of a target's box are: at a face that was seen, or where its outline ends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from boxgrasp.arrays import Array, Floats, readonly
from boxgrasp.geometry.box import Box
from boxgrasp.kernels.outline import outline_points
from boxgrasp.kernels.side_end import side_end
from boxgrasp.perception.scene import REACH_PX, TargetWindow
from boxgrasp.sensing.sensor_model import EDGE_NOISE, SensorModel

_SLANTS_RAD = (0.45, -0.45, 0.9, -0.9)  # from the front; a square is no circle at all of them


@dataclass(frozen=True)
class SideParams:
    """How the sides are looked for.

    Measured on cast tables of other seeds than the benchmarks' (61 turned as the thesis's, 62 at
    random; 319 and 310 targets that nothing hides).

    Attributes:
        inward_m: how far inside the box of all points a side may be, m.
        outward_m: how far outside, m.
        deep_m: how far inward points tell where a side is, m.
        facing_m: how far before a side's plane the camera must be for its face to be seen, m.
        least_points: near a side; with fewer the box of all points keeps it.
        same_m: what is as near to an outline in space is the thing itself, m.
        nearer_m: what is nearer to the camera by more than this hides an outline, m.
        outline_noise: standard deviation of an outline's points, spacings of the pixels there.
        face_noise_m: least standard deviation of points across a face, m.
        round_m: how far four further places may be off the circle of a round thing, m.
        round_share: the same beside it, share of the radius.
        round_far: how far its far side may be off, spacings of the pixels there.
        least_noise_m: standard deviation of a side at the least, m.
        unplaced_m: standard deviation of a dimension whose sides are where all points end, m.
    """

    inward_m: float = 0.009
    outward_m: float = 0.005
    deep_m: float = 0.015
    facing_m: float = 0.05
    least_points: int = 12
    same_m: float = 0.012
    nearer_m: float = 0.01
    outline_noise: float = 0.5
    face_noise_m: float = 0.0004
    round_m: float = 0.0015
    round_share: float = 0.02
    round_far: float = 2.0
    least_noise_m: float = 0.0003
    unplaced_m: float = 0.001


@dataclass(frozen=True, eq=False)
class PlacedBox:
    """A box and how well its sides are known.

    Attributes:
        box: the box.
        noise_m: (3,) float64 standard deviation of each dimension, m.
    """

    box: Box
    noise_m: Floats


def unplaced(box: Box, params: SideParams = SideParams()) -> PlacedBox:
    """A box whose sides stay where all points end.

    Args:
        box: the box.
        params: how well such sides are known.

    Returns:
        The box, with that noise.
    """
    return PlacedBox(box, readonly(np.full(3, params.unplaced_m)))


def place_sides(
    box: Box,
    window: TargetWindow,
    camera_position_m: Floats,
    sensor: SensorModel,
    params: SideParams = SideParams(),
) -> PlacedBox:
    """Move each side of the box of all points to where the thing itself ends.

    Noise pushes the box of all points out over a face; where pixels at an outline are lost, it
    ends too early.

    Args:
        box: round all points of the target.
        window: the image round the target.
        camera_position_m: (3,) base frame, m.
        sensor: whose noise the points have.
        params: how.

    Returns:
        The box with the same turn and the same foot.
    """
    sides = _Sides(box, window, camera_position_m, sensor, params)
    low, high, noise = sides.own()
    circle = sides.circle()
    if circle is not None:
        center, radius_m, noise_m = circle
        low[:2], high[:2], noise[:2] = center - radius_m, center + radius_m, noise_m
    size = np.maximum(high - low, params.least_noise_m)
    T = np.array(box.T_base_box)
    T[:3, 3] += T[:3, :3] @ ((high + low) / 2)
    return PlacedBox(Box(readonly(T), readonly(size)), readonly(noise))


class _Sides:
    """The target's points, outline and camera in the box's own frame."""

    def __init__(
        self,
        box: Box,
        window: TargetWindow,
        camera_position_m: Floats,
        sensor: SensorModel,
        params: SideParams,
    ) -> None:
        self._params = params
        self._half = box.dimensions_m / 2
        turn, center = box.T_base_box[:3, :3], box.T_base_box[:3, 3]
        seen = window.points_m[window.target_mask]
        found = np.empty((4 * len(seen), 3))
        count = outline_points(
            window.target_mask, window.points_m, np.ascontiguousarray(camera_position_m, float),
            REACH_PX, params.same_m, params.nearer_m, found,
        )  # fmt: skip
        self._surface = (seen - center) @ turn
        self._outline = (found[:count] - center) @ turn
        self._camera = (camera_position_m - center) @ turn
        range_m = float(np.linalg.norm(self._surface.mean(axis=0) - self._camera))
        self._noise_m = float(sensor.axial_noise_m(np.asarray(range_m, np.float32)))
        self._spacing_m = float(sensor.pixel_spacing_m(np.asarray(range_m, np.float32)))
        self._range_m = range_m
        flat_m = max(float(np.hypot(*self._camera[:2])), 1e-6)
        self._away = -self._camera[:2] / flat_m
        self._fall = max(abs(float(self._camera[2])) / range_m, 0.05)  # how steeply one looks down

    def own(self) -> tuple[Floats, Floats, Floats]:
        """Each side by itself: (3,) low ends, (3,) high ends and (3,) noise, m."""
        low, high = -self._half, self._half.copy()
        variance = np.zeros(3)
        for axis in range(3):
            for side in (-1.0, 1.0):
                if axis == 2 and side < 0:
                    continue  # the foot stands on the plane
                outward = np.zeros(3)
                outward[axis] = side
                end_m, noise_m = self._end(outward, float(self._half[axis]))
                (low if side < 0 else high)[axis] = side * end_m
                variance[axis] += noise_m**2
        return low, high, np.sqrt(variance)

    def circle(self) -> tuple[Floats, float, float] | None:
        """Center (2,), radius and noise of a round thing's footprint, m; None for others.

        Its width across the view and its front tell the circle; its front at some slants and its
        far side must lie on it.
        """
        params = self._params
        away, across = self._away, np.array([-self._away[1], self._away[0]])
        left_m, left_noise = self._outermost(-across)
        right_m, right_noise = self._outermost(across)
        front_m, _ = self._outermost(-away)
        if np.isnan(left_m + right_m + front_m):
            return None
        radius_m = (left_m + right_m) / 2
        center = across * (right_m - left_m) / 2 + away * (radius_m - front_m)
        most_m = params.round_m + params.round_share * radius_m
        for slant in _SLANTS_RAD:
            direction = np.sin(slant) * across - np.cos(slant) * away
            end_m, _ = self._outermost(direction)
            if not abs(end_m - center @ direction - radius_m) <= most_m:
                return None
        back_m, _ = self._outermost(away)
        most_m = params.round_far * self._spacing_along(away)
        if not abs(back_m - center @ away - radius_m) <= most_m:
            return None
        return center, radius_m, float(np.hypot(left_noise, right_noise))

    def _outermost(self, direction: Floats) -> tuple[float, float]:
        """Where the thing ends in a level direction, and noise; NaN where too little tells it."""
        outward = np.array([direction[0], direction[1], 0.0])
        points = self._surface if self._faces(outward, 0.0) else self._outline
        if len(points) < self._params.least_points:
            return np.nan, np.nan
        values = points @ outward
        rank = len(values) - 1 - self._params.least_points // 4
        about_m = float(np.partition(values, rank)[rank])
        return self._end(outward, about_m)

    def _faces(self, outward: Floats, about_m: float) -> bool:
        return bool(self._camera @ outward > about_m + self._params.facing_m)

    def _spacing_along(self, direction: Array) -> float:
        """How far apart pixels fall on the level top, m, along a level direction (2,)."""
        along = float(abs(direction @ self._away))
        aside = np.sqrt(max(0.0, 1.0 - along**2))
        return float(self._spacing_m * np.hypot(aside, along / self._fall))

    def _end(self, outward: Floats, about_m: float) -> tuple[float, float]:
        """Place of a side and its standard deviation, m; as it was where too little tells it."""
        params = self._params
        faces = self._faces(outward, about_m)
        values = np.ascontiguousarray((self._surface if faces else self._outline) @ outward)
        near = np.abs(values - about_m) < params.deep_m
        count = int(np.count_nonzero(near))
        if count < params.least_points:
            return about_m, params.unplaced_m / np.sqrt(2.0)
        if faces:
            slope = abs(float(values[near].mean() - self._camera @ outward)) / self._range_m
            spread_m = max(slope * self._noise_m, params.face_noise_m)
            noise_m = spread_m / np.sqrt(count)
        else:
            spacing_m = self._spacing_along(outward[:2])
            spread_m, noise_m = params.outline_noise * spacing_m, float(EDGE_NOISE) * spacing_m
        end_m = side_end(
            values, about_m, params.inward_m, params.outward_m, params.deep_m, spread_m
        )
        return end_m, max(noise_m, params.least_noise_m)
