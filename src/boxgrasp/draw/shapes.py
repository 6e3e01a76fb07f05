"""The few solids a picture shows: boxes, the gripper with its fingers, a candidate's line."""

from __future__ import annotations

from typing import Final

import numpy as np

from boxgrasp.arrays import Floats, Points
from boxgrasp.geometry.transforms import transform
from boxgrasp.grasps.gripper import Gripper
from boxgrasp.result import BoxReport, Candidate

_SIGNS: Final = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
EDGES: Final = (
    (0, 1),
    (0, 2),
    (0, 4),
    (1, 3),
    (1, 5),
    (2, 3),
    (2, 6),
    (3, 7),
    (4, 5),
    (4, 6),
    (5, 7),
    (6, 7),
)
# For each edge the two faces that meet there, as (axis, sign) in box coordinates.
EDGE_FACES: Final = tuple(
    tuple((axis, float(_SIGNS[a, axis])) for axis in range(3) if _SIGNS[a, axis] == _SIGNS[b, axis])
    for a, b in EDGES
)


def corners(T_base_box: Floats, size_m: Floats) -> Floats:
    """(8, 3) corners of a box at the center of its frame, base frame."""
    return np.asarray(transform(T_base_box, _SIGNS * np.asarray(size_m, np.float64) / 2))


def fingers(T_base_gripper: Floats, gripper: Gripper) -> tuple[Floats, Floats]:
    """(8, 3) corners of both fingers: open, as deep as the gripper's box is before its palm."""
    depth = min(gripper.length_m / 2, gripper.insertion_depth_m + 0.06)
    gap, wide = (
        gripper.max_opening_m / 2,
        max(gripper.width_m / 2 - gripper.max_opening_m / 2, 0.004),
    )
    found = []
    for side in (1.0, -1.0):
        T = np.array(T_base_gripper)
        offset = (gripper.length_m / 2 - depth / 2, side * (gap + wide / 2), 0.0)
        T[:3, 3] = transform(T_base_gripper, np.array([offset]))[0]
        found.append(corners(T, np.array((depth, wide, gripper.thickness_m * 0.5))))
    return found[0], found[1]


def skeleton(T_base_gripper: Floats, gripper: Gripper) -> list[Floats]:
    """(2, 3) strokes of the hand: two fingers, the palm, the wrist."""
    depth = min(gripper.length_m / 2, gripper.insertion_depth_m + 0.06)
    tip, palm, y = gripper.length_m / 2, gripper.length_m / 2 - depth, gripper.max_opening_m / 2
    flat = (
        ((tip, y), (palm, y)),
        ((palm, y), (palm, -y)),
        ((palm, -y), (tip, -y)),
        ((palm, 0.0), (-gripper.length_m / 2, 0.0)),
    )
    strokes = [np.array([(*a, 0.0), (*b, 0.0)]) for a, b in flat]
    return [np.asarray(transform(T_base_gripper, stroke)) for stroke in strokes]


def face_point(candidate: Candidate, box: BoxReport) -> Floats:
    """(3,) where a candidate's approach meets its face: the middle of its line, base frame."""
    position, approach = candidate.T_base_gripper[:3, 3], candidate.T_base_gripper[:3, 0]
    along = box.T_base_box[:3, :3].T @ approach
    reach = np.abs(along) @ box.dimensions_m / 2
    return np.asarray(
        position + approach * (-reach - (position - box.T_base_box[:3, 3]) @ approach)
    )


def contact_line(candidate: Candidate, box: BoxReport) -> Floats:
    """(2, 3) ends of the candidate's line on its face, where the fingers close."""
    half = candidate.T_base_gripper[:3, 1] * candidate.width_m / 2
    middle = face_point(candidate, box)
    return np.array((middle - half, middle + half))


def inside(
    points: Points, box: BoxReport, margin_m: float
) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """(N,) True for base points within the box and a margin round it."""
    R = box.T_base_box[:3, :3].astype(points.dtype)
    local = (points - box.T_base_box[:3, 3].astype(points.dtype)) @ R
    return np.asarray((np.abs(local) <= box.dimensions_m / 2 + margin_m).all(axis=1))
