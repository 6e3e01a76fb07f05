"""A free way in."""

from __future__ import annotations

from dataclasses import dataclass

from boxgrasp.grasps.checks.check import Check, CheckResult
from boxgrasp.grasps.checks.context import CheckContext


@dataclass(frozen=True)
class ApproachClearance(Check):
    """Over its last `pregrasp_distance_m` the hand's box keeps `limit_m` from obstacles."""

    limit_m: float
    pregrasp_distance_m: float
    name = "approach_clearance"

    def evaluate(self, context: CheckContext) -> CheckResult:
        """Distances from the swept hand to the nearest visible obstacle or hidden body."""
        near = context.on_the_way(self.pregrasp_distance_m)
        return CheckResult.at_least(near.distance_m, self.limit_m, near.witness)
