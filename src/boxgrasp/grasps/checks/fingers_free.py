"""The fingers are not where the target is."""

from __future__ import annotations

from dataclasses import dataclass

from boxgrasp.grasps.checks.check import Check, CheckResult
from boxgrasp.grasps.checks.context import CheckContext


@dataclass(frozen=True)
class FingersFree(Check):
    """Next to nothing of the target's seen surface lies in the fingers themselves.

    A target wider than the opening passes here: `width` tells it.

    Attributes:
        most_m2: the most surface, m2: stray points.
    """

    most_m2: float
    name = "fingers_free"

    def evaluate(self, context: CheckContext) -> CheckResult:
        """Seen surface of the target in the hand's box beyond the opening."""
        return context.unless_too_wide(
            CheckResult.at_most(context.in_fingers_m2, self.most_m2, unit="m2")
        )
