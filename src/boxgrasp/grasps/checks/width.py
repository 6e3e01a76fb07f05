"""Not too wide for the hand (thesis section 5-2-1)."""

from __future__ import annotations

from dataclasses import dataclass

from boxgrasp.grasps.checks.check import Check, CheckResult
from boxgrasp.grasps.checks.context import CheckContext


@dataclass(frozen=True)
class Width(Check):
    """The target is narrower than the fingers open, by more than the noise of its width.

    Attributes:
        noise_gain: how many standard deviations of the width it must be narrower.
    """

    noise_gain: float
    name = "width"

    def evaluate(self, context: CheckContext) -> CheckResult:
        """Widths of the target's box along the finger opening."""
        margin_m = self.noise_gain * context.box_noise_m[context.candidates.width_axis]
        return CheckResult.at_most(
            context.candidates.width_m, context.gripper.fingers_open_m - margin_m
        )
