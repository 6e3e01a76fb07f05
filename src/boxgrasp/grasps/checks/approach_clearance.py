"""A free way in."""

from __future__ import annotations

from dataclasses import dataclass

from boxgrasp.grasps.checks.check import Check, CheckResult
from boxgrasp.grasps.checks.context import CheckContext


@dataclass(frozen=True)
class ApproachClearance(Check):
    """Over its last stretch of approach the hand's box keeps its distance from obstacles.

    Attributes:
        limit_m: the least distance, m.
        pregrasp_distance_m: length of that stretch, m.
    """

    limit_m: float
    pregrasp_distance_m: float
    name = "approach_clearance"

    def evaluate(self, context: CheckContext) -> CheckResult:
        """Distances from the swept hand to the nearest visible obstacle or hidden body."""
        near = context.on_the_way(self.pregrasp_distance_m)
        return CheckResult.at_least(near.distance_m, self.limit_m, near.witness)
