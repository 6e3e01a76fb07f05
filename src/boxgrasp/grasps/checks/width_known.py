"""Not closing across an edge that nobody saw."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from boxgrasp.grasps.checks.check import Check, CheckResult
from boxgrasp.grasps.checks.context import CheckContext


@dataclass(frozen=True)
class WidthKnown(Check):
    """The target's width between the fingers is more than a lower bound."""

    name = "width_known"

    def evaluate(self, context: CheckContext) -> CheckResult:
        """Yes where both edges that the fingers close on are seen."""
        return CheckResult.yes_no(np.array(context.width_known)[context.candidates.width_axis])
