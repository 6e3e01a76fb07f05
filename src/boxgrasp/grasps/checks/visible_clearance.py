"""Clear of what is seen (thesis section 3-4)."""

from __future__ import annotations

from dataclasses import dataclass

from boxgrasp.grasps.checks.check import Check, CheckResult
from boxgrasp.grasps.checks.context import CheckContext


@dataclass(frozen=True)
class VisibleClearance(Check):
    """The hand's box keeps its distance from every visible obstacle point and occupied map cell.

    Attributes:
        limit_m: the least distance, m.
        noise_gain: how many standard deviations of the distance are asked beside it.
    """

    limit_m: float
    noise_gain: float
    name = "visible_clearance"

    def evaluate(self, context: CheckContext) -> CheckResult:
        """Distances to the nearest visible obstacle."""
        return context.keeps_off(context.visible, self.limit_m, self.noise_gain)
