"""Mostly in space that was seen to be free."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from boxgrasp.geometry.hand_distance import filled_fraction
from boxgrasp.grasps.checks.check import Check, CheckResult
from boxgrasp.grasps.checks.context import CheckContext
from boxgrasp.mapping.local_map import FREE


@dataclass(frozen=True)
class UnseenFraction(Check):
    """Little of the hand's boxes, somewhat grown, is unseen space.

    Attributes:
        limit: the largest fraction, 0 to 1.
        grow_m: by how much each box is grown to every side, m.
    """

    limit: float
    grow_m: float
    name = "unseen_fraction"

    def evaluate(self, context: CheckContext) -> CheckResult:
        """Fractions from 0 to 1; all 0 where no cell is free, since no camera is known."""
        local_map = context.local_map
        fraction = filled_fraction(
            context.hand_boxes, context.unseen_cells, local_map.resolution_m, self.grow_m
        )
        if not np.any(local_map.state == FREE):  # the answer warns instead
            fraction = np.zeros(len(fraction))
        return CheckResult.at_most(fraction, self.limit, unit="fraction")
