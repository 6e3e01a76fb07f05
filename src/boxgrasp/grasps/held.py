"""Which points lie between a hand's fingertips, and which where its fingers are."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Floats, Points, readonly
from boxgrasp.grasps.gripper import Gripper
from boxgrasp.kernels.held import mark_in_hand

# m: the fingers' last stretch, between which the target must be, reaches so far before its face. A
# camera sees the face and often nothing else of what a deep grasp holds.
BEFORE_FACE_M: Final = 0.005
MIDDLE_M: Final = 0.010  # m from the hand's mid-plane: what lies farther off is held by an edge


def points_in_hand(
    T_base_gripper: Floats, points: Points, gripper: Gripper
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which points the checks `holds` and `fingers_free` count, and which pictures show.

    Args:
        T_base_gripper: (4, 4) float64, m, the hand's box where it closes.
        points: (N, 3) float32, base frame, m.
        gripper: the hand.

    Returns:
        (N,) bool, between the fingers' last stretches and near the hand's mid-plane; and (N,) bool,
        in its fingers or palm; of a hand of one box in what is beyond the opening.
    """
    held, in_fingers = np.empty((2, len(points)), dtype=np.bool_)
    T = np.array(T_base_gripper)  # a copy: for read-only arrays numba would compile once more
    boxes_m = gripper.boxes_m if gripper.palm else gripper.finger_boxes_m
    pads_m = np.array(gripper.between_m)
    pads_m[:, 2] = np.clip(pads_m[:, 2], -MIDDLE_M, MIDDLE_M)
    pads_m[0, 0] = max(pads_m[0, 0], pads_m[1, 0] - gripper.insertion_depth_m - BEFORE_FACE_M)
    mark_in_hand(T, np.ascontiguousarray(points), boxes_m, pads_m, held, in_fingers)
    return readonly(held), readonly(in_fingers)
