"""The few solids a picture shows: boxes, the gripper with its fingers, a candidate's line."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from boxgrasp.arrays import Floats
from boxgrasp.geometry.transforms import invert, transform
from boxgrasp.grasps.gripper import Gripper
from boxgrasp.result import Candidate, TargetBox

_FINGER_M: Final = 0.06  # of the fingers before the target's face, as they are drawn
_THINNEST_M: Final = 0.004
_SIGNS: Final = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
# Pairs of corners that differ in one axis.
EDGES: Final = (
    (0, 1), (0, 2), (0, 4), (1, 3), (1, 5), (2, 3), (2, 6), (3, 7), (4, 5), (4, 6), (5, 7), (6, 7),
)  # fmt: skip
# For each edge the two faces that meet there, as (axis, sign) in box coordinates.
EDGE_FACES: Final = tuple(
    tuple((axis, float(_SIGNS[a, axis])) for axis in range(3) if _SIGNS[a, axis] == _SIGNS[b, axis])
    for a, b in EDGES
)


@dataclass(frozen=True, eq=False)
class Hand:
    """A hand at a candidate.

    Attributes:
        gripper: its sizes.
        T_base_gripper: (4, 4) float64, m, where it closes.
        T_base_pregrasp: (4, 4) float64, m, where its approach starts; None in an ask.
    """

    gripper: Gripper
    T_base_gripper: Floats
    T_base_pregrasp: Floats | None = None

    @property
    def size_m(self) -> Floats:
        """(3,) sizes of its outer box along the gripper's x, y, z."""
        return 2 * self.gripper.half_m

    @property
    def approach_m(self) -> float:
        """From the pregrasp to the grasp; in an ask half its length, which shows the direction."""
        if self.T_base_pregrasp is None:
            return self.gripper.length_m / 2
        way = self.T_base_gripper[:3, 3] - self.T_base_pregrasp[:3, 3]
        return float(np.linalg.norm(way))

    def nearest(self, point: Floats, *, on_the_way: bool = False) -> Floats:
        """The place of its boxes that is nearest to a point.

        Args:
            point: (3,) float64, base frame, m.
            on_the_way: whether the boxes are drawn out backwards along its approach.

        Returns:
            (3,) float64, base frame, m; the point itself where it lies inside.
        """
        boxes = np.array(self.gripper.boxes_m)
        if on_the_way:
            boxes[:, 0, 0] = -np.inf
        local = transform(invert(self.T_base_gripper), point[None])
        held = np.clip(local, boxes[:, 0], boxes[:, 1])
        nearest = np.argmin(np.linalg.norm(held - local, axis=1))
        return np.asarray(transform(self.T_base_gripper, held[nearest, None])[0])

    def solids(self, T_base_gripper: Floats) -> list[Floats]:
        """Its boxes at a pose.

        Args:
            T_base_gripper: (4, 4) float64, m.

        Returns:
            (8, 3) float64 corners of each, base frame, m.
        """
        return [_placed(T_base_gripper, box) for box in self.gripper.boxes_m]


def corners(T_base_box: Floats, size_m: Floats) -> Floats:
    """The corners of a box.

    Args:
        T_base_box: (4, 4) float64 at its center, m.
        size_m: (3,) along its x, y, z.

    Returns:
        (8, 3) float64, base frame, m.
    """
    return np.asarray(transform(T_base_box, _SIGNS * np.asarray(size_m, np.float64) / 2))


def fingers(T_base_gripper: Floats, gripper: Gripper) -> list[Floats]:
    """The boxes of both fingers where they stand on the way in.

    Args:
        T_base_gripper: (4, 4) float64, m.
        gripper: the hand.

    Returns:
        (8, 3) float64 corners of each, base frame, m; a hand of one box has two, as deep as its
        palm is likely to be.
    """
    if gripper.palm:
        return [_placed(T_base_gripper, box) for box in gripper.finger_boxes_m]
    depth = _depth_m(gripper)
    gap = gripper.fingers_open_m / 2
    wide = max(gripper.width_m / 2 - gap, _THINNEST_M)
    found = []
    for side in (1.0, -1.0):
        T = np.array(T_base_gripper)
        offset = (gripper.length_m / 2 - depth / 2, side * (gap + wide / 2), 0.0)
        T[:3, 3] = transform(T_base_gripper, np.array([offset]))[0]
        found.append(corners(T, np.array((depth, wide, gripper.thickness_m * 0.5))))
    return found


def skeleton(T_base_gripper: Floats, gripper: Gripper) -> list[Floats]:
    """The hand as strokes.

    Args:
        T_base_gripper: (4, 4) float64, m.
        gripper: the hand.

    Returns:
        (2, 3) float64 ends of each, base frame, m: two fingers, the palm, the wrist.
    """
    tip, y = gripper.length_m / 2, gripper.fingers_open_m / 2
    palm = tip - _depth_m(gripper)
    flat = (
        ((tip, y), (palm, y)),
        ((palm, y), (palm, -y)),
        ((palm, -y), (tip, -y)),
        ((palm, 0.0), (-gripper.length_m / 2, 0.0)),
    )
    strokes = [np.array([(*a, 0.0), (*b, 0.0)]) for a, b in flat]
    return [np.asarray(transform(T_base_gripper, stroke)) for stroke in strokes]


def face_point(candidate: Candidate, box: TargetBox) -> Floats:
    """Where a candidate's approach meets its face: the middle of its line.

    Args:
        candidate: any.
        box: the target's.

    Returns:
        (3,) float64, base frame, m.
    """
    position, approach = candidate.T_base_gripper[:3, 3], candidate.T_base_gripper[:3, 0]
    along = box.T_base_box[:3, :3].T @ approach
    reach = np.abs(along) @ box.dimensions_m / 2
    return np.asarray(
        position + approach * (-reach - (position - box.T_base_box[:3, 3]) @ approach)
    )


def contact_line(candidate: Candidate, box: TargetBox) -> Floats:
    """A candidate's line on its face, where the fingers close.

    Args:
        candidate: any.
        box: the target's.

    Returns:
        (2, 3) float64 ends, base frame, m.
    """
    half = candidate.T_base_gripper[:3, 1] * candidate.width_m / 2
    middle = face_point(candidate, box)
    return np.array((middle - half, middle + half))


def _placed(T_base_gripper: Floats, box: Floats) -> Floats:
    """(8, 3) corners of a box of the hand, (2, 3) in its own frame, m."""
    T = np.array(T_base_gripper)
    T[:3, 3] = transform(T, box.mean(axis=0)[None])[0]
    return corners(T, box[1] - box[0])


def _depth_m(gripper: Gripper) -> float:
    if gripper.palm:
        return gripper.finger_length_m
    return min(gripper.length_m / 2, gripper.insertion_depth_m + _FINGER_M)
