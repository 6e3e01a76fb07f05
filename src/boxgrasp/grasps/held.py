"""Which points lie between a hand's fingertips, and which where its fingers are."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Floats, Points, readonly
from boxgrasp.grasps.gripper import Gripper
from boxgrasp.kernels.held import mark_in_hand

TIP_M: Final = 0.015  # m, the fingers' last stretch, between which the target must be
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
        in the hand's box beyond the opening.
    """
    held, in_fingers = np.empty((2, len(points)), dtype=np.bool_)
    T = np.array(T_base_gripper)  # a copy: for read-only arrays numba would compile once more
    mark_in_hand(
        T, np.ascontiguousarray(points), gripper.half_m, gripper.max_opening_m, TIP_M, MIDDLE_M,
        held, in_fingers,
    )  # fmt: skip
    return readonly(held), readonly(in_fingers)
