"""The target is between the fingers, which a pose at a box's face does not promise."""

from __future__ import annotations

from dataclasses import dataclass

from boxgrasp.grasps.checks.check import Check, CheckResult
from boxgrasp.grasps.checks.context import CheckContext


@dataclass(frozen=True)
class Holds(Check):
    """Enough of the target's seen surface lies between the fingertips, in their middle.

    A target wider than the opening passes here: `width` tells it.

    Attributes:
        least_m2: the least surface, m2.
    """

    least_m2: float
    name = "holds"

    def evaluate(self, context: CheckContext) -> CheckResult:
        """Seen surface between the fingers' last stretches and near the hand's mid-plane."""
        return context.unless_too_wide(
            CheckResult.at_least(context.held_m2, self.least_m2, unit="m2")
        )
