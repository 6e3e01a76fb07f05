"""Off the support plane, which the thesis does not ask."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from boxgrasp.arrays import readonly
from boxgrasp.geometry import hand_distance
from boxgrasp.grasps.checks.check import NO_OBJECT, Check, CheckResult, Witness
from boxgrasp.grasps.checks.context import CheckContext


@dataclass(frozen=True)
class PlaneClearance(Check):
    """The hand's lowest corner is over the support plane, when its fingers have closed too.

    Attributes:
        limit_m: the least height, m; a height below 0 is inside the plane.
    """

    limit_m: float
    name = "plane_clearance"

    def evaluate(self, context: CheckContext) -> CheckResult:
        """Signed heights of the hand's lowest corner, and where it is."""
        hands, plane = context.hand_boxes, context.scene.plane
        height = hand_distance.to_plane(hands, plane.normal, plane.offset_m)
        down = np.clip(-(context.candidates.T_base_gripper[:, :3, 0] @ plane.normal), 0.0, 1.0)
        height = height - down * context.gripper.advance_m(context.candidates.width_m)
        corner = hand_distance.lowest_corners(hands, plane.normal)
        witness = Witness(readonly(np.full(len(hands), NO_OBJECT)), readonly(corner))
        return CheckResult.at_least(height, self.limit_m, witness)
