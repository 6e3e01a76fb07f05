"""Clear of the hidden bodies under and behind what is seen."""

from __future__ import annotations

from dataclasses import dataclass

from boxgrasp.grasps.checks.check import Check, CheckResult
from boxgrasp.grasps.checks.context import CheckContext


@dataclass(frozen=True)
class OccludedClearance(Check):
    """The hand's box keeps its distance from obstacles, their hidden sides included.

    Attributes:
        limit_m: the least distance, m.
        noise_gain: how many standard deviations of the distance are asked beside it.
    """

    limit_m: float
    noise_gain: float
    name = "occluded_clearance"

    def evaluate(self, context: CheckContext) -> CheckResult:
        """Distances to the nearest visible obstacle or hidden body."""
        return context.keeps_off(context.occluded, self.limit_m, self.noise_gain)
