"""A check is one class: here the hand must stay out of a box, say one that a shelf takes up."""

from dataclasses import dataclass

import numpy as np

from boxgrasp import GraspSelector
from boxgrasp.grasps.checks import Check, CheckContext, CheckResult
from boxgrasp.selector import default_checks
from boxgrasp.simulate import demo_capture


@dataclass(frozen=True)
class KeepOutBox(Check):
    """The hand's box stays out of a box that is aligned with the base frame."""

    low_m: tuple[float, float, float]  # opposite corners, base frame
    high_m: tuple[float, float, float]
    name = "keep_out_box"

    def evaluate(self, context: CheckContext) -> CheckResult:
        """The widest gap between the two boxes along any face normal; below 0 where they meet."""
        low, high = np.array(self.low_m), np.array(self.high_m)
        # The hand's box is upright: its place in plan, how it is turned, half sizes, heights.
        x, y, cos, sin, along, across, bottom, top = context.hands.T
        gaps = [bottom - high[2], low[2] - top]
        for nx, ny in ((1.0, 0.0), (0.0, 1.0), (cos, sin), (-sin, cos)):
            center = nx * (x - (low[0] + high[0]) / 2) + ny * (y - (low[1] + high[1]) / 2)
            box = np.abs(nx) * (high[0] - low[0]) / 2 + np.abs(ny) * (high[1] - low[1]) / 2
            hand = np.abs(nx * cos + ny * sin) * along + np.abs(ny * cos - nx * sin) * across
            gaps.append(np.abs(center) - box - hand)
        return CheckResult.at_least(np.max(gaps, axis=0), 0.0)


shelf = KeepOutBox(low_m=(0.6, -0.5, 0.80), high_m=(1.1, -0.08, 1.2))
config = None  # the defaults; a mapping or a YAML file as elsewhere
selection = GraspSelector(config, checks=[*default_checks(config), shelf]).select(demo_capture())
print(selection)
for candidate in selection.candidates:
    for reason in candidate.rejections:
        if reason.check == shelf.name:
            print(f"{candidate.name}: {reason.sentence}")
