"""What the checks of one view share; each distance is measured once, when first asked for."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Floats, Points, readonly
from boxgrasp.forks import cached_property
from boxgrasp.geometry import hand_distance
from boxgrasp.geometry.box import Box
from boxgrasp.grasps.candidates import Candidates
from boxgrasp.grasps.checks.check import NO_OBJECT, CheckResult, Witness
from boxgrasp.grasps.gripper import Gripper
from boxgrasp.grasps.held import points_in_hand
from boxgrasp.mapping.local_map import LocalMap
from boxgrasp.mapping.unseen_space import MapObstacles, columns_under, deepened, unseen_cells
from boxgrasp.perception.scene import Scene
from boxgrasp.sensing.sensor_model import UNKNOWN_RANGE_M

# m, off the fingers' plane: as approach_clearance_m, what closing fingers keep from what is beside.
BETWEEN_MARGIN_M: Final = 0.005
_TOUCH_M: Final = 1e-6  # m: nearer is inside


@dataclass(frozen=True, eq=False)
class Nearest:
    """What is nearest to each of M hands.

    Attributes:
        distance_m: (M,) float64, m, capped at 0.50, 0 inside.
        witness: which object, and where.
    """

    distance_m: Floats
    witness: Witness

    def or_nearer(self, other: Nearest) -> Nearest:
        """The nearer of two, hand by hand; this one where they are equal.

        Args:
            other: of the same M hands.

        Returns:
            For each hand the smaller distance, with its witness.
        """
        closer = other.distance_m < self.distance_m
        return Nearest(
            np.minimum(self.distance_m, other.distance_m),
            Witness(
                np.where(closer, other.witness.objects, self.witness.objects),
                np.where(closer[:, None], other.witness.points_m, self.witness.points_m),
            ),
        )


@dataclass(frozen=True, eq=False)
class CheckContext:
    """The candidates of one view, and all that is known round them; base frame, m.

    Attributes:
        candidates: the M candidates.
        gripper: the hand.
        box: the target's box.
        box_noise_m: (3,) standard deviation of each of its dimensions, m.
        scene: the support plane and what stands on it.
        target_mask: (K,) bool, which of the scene's points are the target's.
        obstacle_mask: (K,) bool, which of the scene's points are obstacles.
        local_map: occupied, free and unseen cells round the target.
        local_maps: local maps by their cell size, m, those that checks asked for among them.
        map_obstacles: occupied cells of a map file that no point explains.
        width_known: whether the box's x and y dimensions are more than lower bounds.
    """

    candidates: Candidates
    gripper: Gripper
    box: Box
    box_noise_m: Floats
    scene: Scene
    target_mask: NDArray[np.bool_]
    obstacle_mask: NDArray[np.bool_]
    local_map: LocalMap
    local_maps: Mapping[float, LocalMap]
    map_obstacles: MapObstacles
    width_known: tuple[bool, bool]

    @cached_property
    def hands(self) -> Floats:
        """(M, 8) the hand's outer box at each candidate, as `hand_distance.uprights` gives it."""
        T = self.candidates.T_base_gripper
        return readonly(hand_distance.uprights(T, self.gripper.half_m))

    @cached_property
    def hand_boxes(self) -> Floats:
        """(M, B, 8) the hand's own boxes, as `hand_distance.hand_uprights` gives them."""
        return self.swept_hands(0.0)

    def swept_hands(self, back_m: float) -> Floats:
        """The space that the hand's boxes pass over its last stretch of approach.

        Args:
            back_m: length of that stretch, m.

        Returns:
            (M, B, 8) float64 upright boxes, as `hand_distance.hand_uprights` gives them.
        """
        T = self.candidates.T_base_gripper
        return readonly(hand_distance.hand_uprights(T, self.gripper.boxes_m, back_m))

    @cached_property
    def _between(self) -> Floats:
        """(M, 1, 8) the space between each hand's fingers, where only the target may be.

        Fingers that close sweep it. A hand of one box has none beside that box.
        """
        margin_m = np.array((0.0, 0.0, BETWEEN_MARGIN_M))
        grown_m = self.gripper.between_m + np.array((-margin_m, margin_m))
        T = self.candidates.T_base_gripper
        return readonly(hand_distance.hand_uprights(T, grown_m[None]))

    @cached_property
    def obstacle_points(self) -> Points:
        """(N, 3) float32, base frame, m: the visible points of all obstacles."""
        return readonly(np.ascontiguousarray(self.scene.points[self.obstacle_mask]))

    @cached_property
    def obstacle_objects(self) -> NDArray[np.int64]:
        """(N,) number of the object of each obstacle point, 0 for none."""
        return readonly(self.scene.object_numbers[self.obstacle_mask])

    def unless_too_wide(self, found: CheckResult) -> CheckResult:
        """A result that passes too where the target's box does not go between the fingers at all.

        Args:
            found: of a check of what the fingers hold; there `width` alone tells what is wrong.

        Returns:
            The result.
        """
        too_wide = self.candidates.width_m > self.gripper.fingers_open_m
        return replace(found, passed=readonly(found.passed | too_wide))

    @property
    def held_m2(self) -> Floats:
        """(M,) float64 the target's seen surface between each hand's fingertips, m2."""
        return self._held[0]

    @property
    def in_fingers_m2(self) -> Floats:
        """(M,) float64 the target's seen surface, a mask's rim too, where the fingers are, m2."""
        return self._held[1]

    @cached_property
    def _held(self) -> tuple[Floats, Floats]:
        scene, own = self.scene, self.target_mask
        rim = ~self.obstacle_mask & ~scene.floor_mask
        near = own | rim
        points = np.ascontiguousarray(scene.points[near])
        own, rim = own[near], rim[near]
        counts = np.empty((len(self.candidates.T_base_gripper), 2))
        for m, T in enumerate(self.candidates.T_base_gripper):
            held, in_fingers = points_in_hand(T, points, self.gripper)
            counts[m] = np.count_nonzero(held & own), np.count_nonzero(in_fingers & rim)
        held_m2, in_fingers_m2 = counts.T * scene.point_area_m2(points[own])
        return readonly(held_m2), readonly(in_fingers_m2)

    @cached_property
    def _columns(self) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
        """(N, 4) hidden bodies as columns x, y, z low, z high, and (N,) object numbers."""
        behind, objects = deepened(self.scene, self.obstacle_mask, self.box, self.local_map)
        under = columns_under(self.obstacle_points, self.local_map, self.scene.plane)
        return np.vstack((under, behind)), np.concatenate((self.obstacle_objects, objects))

    @cached_property
    def unseen_cells(self) -> Floats:
        """(U, 3) float64, m: centers of the local map's cells that may hold something unseen."""
        return readonly(unseen_cells(self.local_map, self.box))

    @cached_property
    def visible(self) -> Nearest:
        """The visible obstacle nearest to each hand, occupied cells of a map file included."""
        near = self._to_hand(self._points)
        return near.or_nearer(self._to_hand(self._map_cells)) if len(self.map_obstacles) else near

    def _to_hand(self, measure: Callable[[Floats, float], Nearest]) -> Nearest:
        """The nearest to each hand's boxes, at no distance where it is between the fingers."""
        near = measure(self.hand_boxes, hand_distance.CAP_M)
        if not self.gripper.palm:
            return near
        between = measure(self._between, _TOUCH_M)
        inside = between.distance_m < _TOUCH_M
        return near.or_nearer(Nearest(np.where(inside, 0.0, np.inf), between.witness))

    def _points(self, hands: Floats, cap_m: float) -> Nearest:
        distance, row = hand_distance.to_points(hands, self.obstacle_points, cap_m)
        return Nearest(distance, self._witness(row, self.obstacle_points, self.obstacle_objects))

    def keeps_off(self, near: Nearest, limit_m: float, noise_gain: float) -> CheckResult:
        """The result of a check of the distance to what was measured.

        Args:
            near: the nearest to each of the M hands.
            limit_m: the least distance, m.
            noise_gain: how many standard deviations of the distance are asked beside it.

        Returns:
            The result.
        """
        limits_m = limit_m + noise_gain * self._distance_noise_m(near.witness.points_m)
        return CheckResult.at_least(near.distance_m, limits_m, near.witness)

    def _distance_noise_m(self, points_m: Floats) -> Floats:
        """(M,) standard deviation of the distance to what lies at (M, 3) points, m; NaN: nowhere.

        A surface ends somewhere past its last pixel. Noise of the depth asks for nothing more:
        what it brings nearest is nearer than it is. 0 where there is no point.
        """
        scene, camera = self.scene, self.scene.camera_position_m
        ranges_m = np.full(len(points_m), UNKNOWN_RANGE_M)
        if camera is not None:
            ranges_m = np.linalg.norm(points_m - camera, axis=1).astype(np.float32)
        noise_m = scene.sensor.edge_noise_m(ranges_m).astype(np.float64)
        return np.where(np.isnan(points_m[:, 0]), 0.0, noise_m)

    @cached_property
    def occluded(self) -> Nearest:
        """The visible obstacle or hidden body nearest to each hand."""
        return self._to_hand(self._bodies).or_nearer(self.visible)

    def on_the_way(self, back_m: float) -> Nearest:
        """The obstacle or hidden body nearest to each hand over its last stretch of approach.

        Args:
            back_m: length of that stretch, m.

        Returns:
            For each of the M hands the nearest on its way.
        """
        swept = self.swept_hands(back_m)
        near = self._bodies(swept)
        return near.or_nearer(self._map_cells(swept)) if len(self.map_obstacles) else near

    @cached_property
    def unseen(self) -> Nearest:
        """The obstacle, hidden body or unseen cell nearest to each hand."""
        edges = np.full(len(self.unseen_cells), self.local_map.resolution_m)
        cells = self._cells(self.hand_boxes, self.unseen_cells, edges, self.box.yaw_rad)
        return self.occluded.or_nearer(cells)

    def _bodies(self, hands: Floats, cap_m: float = hand_distance.CAP_M) -> Nearest:
        columns, objects = self._columns
        distance, row = hand_distance.to_columns(hands, columns, cap_m)
        boxes = hands.reshape(len(hands), -1, 8)
        middle = (boxes[:, :, 6].min(axis=1) + boxes[:, :, 7].max(axis=1)) / 2
        known = np.maximum(row, 0)
        points = np.full((len(hands), 3), np.nan)
        if len(columns):
            points[:, :2] = columns[known, :2]
            points[:, 2] = np.clip(middle, columns[known, 2], columns[known, 3])
        return Nearest(distance, self._witness(row, points, objects, of_rows=False))

    def _map_cells(self, hands: Floats, cap_m: float = hand_distance.CAP_M) -> Nearest:
        cells = self.map_obstacles
        return self._cells(hands, cells.centers_m, cells.edges_m, 0.0, cap_m)

    def _cells(
        self,
        hands: Floats,
        centers_m: Floats,
        edges_m: Floats,
        yaw_rad: float,
        cap_m: float = hand_distance.CAP_M,
    ) -> Nearest:
        distance, row = hand_distance.to_cells(hands, centers_m, edges_m, yaw_rad, cap_m)
        return Nearest(distance, self._witness(row, centers_m, None))

    @staticmethod
    def _witness(
        row: NDArray[np.int64],
        points: Points | Floats,
        objects: NDArray[np.int64] | None,
        *,
        of_rows: bool = True,
    ) -> Witness:
        """The witness of nearest rows, -1 for none; points: by row, or by hand."""
        some, known = row >= 0, np.maximum(row, 0)
        numbers: NDArray[np.int64] = np.full(len(row), NO_OBJECT)
        if objects is not None and len(objects):
            numbers = np.where(some, objects[known], NO_OBJECT)
        places: Floats = np.full((len(row), 3), np.nan)
        if len(points):
            places = np.where(some[:, None], points[known] if of_rows else points, np.nan)
        return Witness(readonly(numbers), readonly(places.astype(np.float64)))
