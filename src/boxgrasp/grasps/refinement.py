"""Candidates moved along their approach to the target's own surface, which is not its box's.

A thing that is uneven, leaning, necked or hollow lies behind the face of its box, so that a pose at
the face closes on air.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from boxgrasp.arrays import Points, readonly
from boxgrasp.grasps.candidates import Candidates
from boxgrasp.grasps.gripper import Gripper
from boxgrasp.kernels.held import surfaces_ahead


@dataclass(frozen=True)
class RefinementParams:
    """Where the target's surface is, and what keeps the hand from going deeper.

    Measured on cast tables of uneven things (benchmarks/ugly_scenes.py --grasps).

    Attributes:
        middle_m: half the thickness of the slab round the hand's mid-plane that is looked at, m.
        least_points: in the slab, voxels of the scene; with fewer the box's face is kept.
        rim_points: of these that may lie nearer than the surface, voxels. A tenth of all goes
            deeper where a side is seen aslant, and costs safe grasps on plain boxes (1.5 %).
        stray: points that may lie in the way of a finger or the palm, voxels.
        gap_m: between a fingertip and what of the target is in its way, m.
        finger_m: how deep the target may reach between the fingers, from their tips to the palm,
            m. The hand's box does not say where its palm is: 4.5 cm suits common parallel grippers.
    """

    middle_m: float = 0.010
    least_points: int = 16
    rim_points: int = 8
    stray: int = 3
    gap_m: float = 0.003
    finger_m: float = 0.045


def moved_to_surface(
    candidates: Candidates,
    target_points: Points,
    gripper: Gripper,
    params: RefinementParams = RefinementParams(),
) -> Candidates:
    """Each candidate with its fingertips as far past the target's surface as past the box's face.

    A finger stops before what of the target is in its way, and the palm before the target.

    Args:
        candidates: of the target's box.
        target_points: (N, 3) float32, base frame, m.
        gripper: the hand.
        params: how.

    Returns:
        The candidates, moved along their approach alone.
    """
    T = np.array(candidates.T_base_gripper)
    ahead_m = np.empty((len(T), 3))
    surfaces_ahead(
        T, target_points, gripper.half_m, gripper.max_opening_m, params.middle_m,
        params.least_points, params.rim_points, params.stray, ahead_m,
    )  # fmt: skip
    surface, finger, palm = ahead_m.T
    tip = surface + gripper.insertion_depth_m
    tip = np.fmin(tip, finger - params.gap_m)
    tip = np.fmin(tip, palm + params.finger_m)
    by = np.where(np.isnan(surface), 0.0, tip - gripper.half_m[0])
    T[:, :3, 3] += T[:, :3, 0] * by[:, None]
    return replace(candidates, T_base_gripper=readonly(T))
