"""Not too wide for the hand (thesis section 5-2-1)."""

from __future__ import annotations

from dataclasses import dataclass

from boxgrasp.errors import GripperError
from boxgrasp.grasps.checks.check import Check, CheckResult
from boxgrasp.grasps.checks.context import CheckContext


@dataclass(frozen=True)
class Width(Check):
    """The target is narrower than the fingers open.

    Attributes:
        margin_m: by how much at least, m.
    """

    margin_m: float
    name = "width"

    def evaluate(self, context: CheckContext) -> CheckResult:
        """Widths of the target's box along the finger opening.

        Raises:
            GripperError: the fingers cannot open wider than the margin.
        """
        opening_m = context.gripper.max_opening_m
        if opening_m <= self.margin_m:
            raise GripperError(
                f"gripper max_opening_m {opening_m} cannot hold anything: checks.width_margin_m "
                f"is {self.margin_m}; valid: a wider opening"
            )
        return CheckResult.at_most(context.candidates.width_m, opening_m - self.margin_m)
