"""Away from space that no ray crossed."""

from __future__ import annotations

from dataclasses import dataclass

from boxgrasp.grasps.checks.check import Check, CheckResult
from boxgrasp.grasps.checks.context import CheckContext


@dataclass(frozen=True)
class UnseenDistance(Check):
    """The hand's box keeps its distance from whatever may hold something.

    Attributes:
        limit_m: the least distance, m; 0 reports the distance and refuses nothing.
    """

    limit_m: float
    name = "unseen_distance"

    def evaluate(self, context: CheckContext) -> CheckResult:
        """Distances to the nearest obstacle, hidden body or unseen cell."""
        near = context.unseen
        return CheckResult.at_least(near.distance_m, self.limit_m, near.witness)
