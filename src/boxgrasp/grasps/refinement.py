"""Candidates moved along their approach to the target's own surface, which is not its box's.

A thing that is uneven, leaning, necked or hollow lies behind the face of its box, so that a pose at
the face closes on air.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from boxgrasp.arrays import Floats, Points, readonly
from boxgrasp.geometry.plane import Plane
from boxgrasp.grasps.candidates import Candidates
from boxgrasp.grasps.gripper import Gripper
from boxgrasp.kernels.held import steady_depths, surfaces_ahead


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
        step_m: of depth, in which the target's sides are followed, m.
        most_m: how far the fingertips go past the surface at most, m.
        growth_m: of the width over two steps, up to which its sides are steady, m: 35 degrees off
            the approach on both sides. Fingers slip off sides that run apart more, as the front of
            a cylinder does.
        plane_gap_m: between fingertips that go deeper than least_depth_m and the support plane, m.
        least_depth_m: of the fingertips past the surface, whatever the plane, m: the thesis's; a
            hand that inserts deeper goes less deep into what is low.
    """

    middle_m: float = 0.010
    least_points: int = 16
    rim_points: int = 8
    stray: int = 3
    gap_m: float = 0.003
    step_m: float = 0.0025
    most_m: float = 0.03
    growth_m: float = 0.007
    plane_gap_m: float = 0.006
    least_depth_m: float = 0.01


def moved_to_surface(
    candidates: Candidates,
    target_points: Points,
    gripper: Gripper,
    plane: Plane,
    params: RefinementParams = RefinementParams(),
) -> Candidates:
    """Each candidate with its fingertips as far past the target's surface as past the box's face.

    They go deeper where the target's sides still run apart, down to where these are steady. A
    finger stops before what of the target is in its way, and the palm before the target.

    Args:
        candidates: of the target's box.
        target_points: (N, 3) float32, base frame, m.
        gripper: the hand.
        plane: the support plane.
        params: how.

    Returns:
        The candidates, moved along their approach alone.
    """
    T = np.array(candidates.T_base_gripper)
    ahead_m = np.empty((len(T), 3))
    slab_m = np.array((gripper.fingers_open_m / 2, params.middle_m))
    counts = (params.least_points, params.rim_points, params.stray)
    surfaces_ahead(T, target_points, ways_m(gripper), slab_m, counts, ahead_m)
    surface, finger, palm = ahead_m.T
    least = round(gripper.insertion_depth_m / params.step_m)
    deeper = np.empty(len(T))
    steady_depths(
        T, target_points, slab_m, surface,
        params.step_m, least, params.growth_m, round(params.most_m / params.step_m), deeper,
    )  # fmt: skip
    # No deeper than the plane allows: how high the fingertips are, and how steeply they go down.
    tips = T[:, :3, 3] + T[:, :3, 0] * gripper.half_m[0]
    fall = np.maximum(-(T[:, :3, 0] @ plane.normal), 1e-3)
    room = gripper.half_m[0] + (tips @ plane.normal + plane.offset_m - params.plane_gap_m) / fall
    room -= gripper.advance_m(candidates.width_m)
    allowed = np.fmax(room - surface, params.least_depth_m)
    tip = surface + np.fmin(gripper.insertion_depth_m, allowed)
    tip = np.fmax(tip, np.fmin(surface + deeper, room))
    tip = np.fmin(tip, finger - params.gap_m)
    tip = np.fmin(tip, palm)
    by = np.where(np.isnan(surface), 0.0, tip - gripper.half_m[0])
    T[:, :3, 3] += T[:, :3, 0] * by[:, None]
    return replace(candidates, T_base_gripper=readonly(T))


def ways_m(gripper: Gripper) -> Floats:
    """What each part of a hand meets on its way.

    Args:
        gripper: the hand.

    Returns:
        (W, 6) float64 as `kernels.held.surfaces_ahead` takes it.
    """
    tip = gripper.length_m / 2
    parts = [(box, tip - box[1, 0], 0.0) for box in gripper.finger_boxes_m]
    if gripper.palm:
        palm = gripper.boxes_m[: len(gripper.palm)]
        parts += [(box, tip - box[1, 0], 1.0) for box in palm]
    else:  # between its fingers
        parts.append((gripper.between_m, gripper.free_length_m, 1.0))
    return np.array([(*box[:, 1], *box[:, 2], behind, part) for box, behind, part in parts])
