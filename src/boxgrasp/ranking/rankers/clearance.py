"""Geometry alone: most room up to the safe 6 cm, ties by the operator's habits (section 5-1)."""

from __future__ import annotations

import numpy as np

from boxgrasp.grasps.candidates import FRONT, TOP_PARALLEL
from boxgrasp.grasps.scoring import GREEN_FROM_M
from boxgrasp.ranking.ranker import Chooser, Preference, Situation

# What unseen space in the gripper's room costs: 3 cm of room if all of it is unseen.
_UNSEEN_COST_M = 0.03


class ByClearance(Chooser):
    """Most clearance first; front and top-parallel before the rest, line 2 before the outer."""

    def prefer(self, situation: Situation) -> Preference:
        """Order by room, then habit, then label."""
        options, numbers = situation.options, situation.numbers
        room = np.minimum(np.minimum(numbers.seen_m, numbers.body_m), GREEN_FROM_M)
        room = np.round(room - _UNSEEN_COST_M * numbers.unseen_share, 4)
        unhabitual = ~np.isin(options.face, (FRONT, TOP_PARALLEL))
        off_center = np.abs(options.line - (options.lines + 1) / 2)
        order = np.lexsort((options.label, off_center, unhabitual, -room))
        return Preference(order, np.clip(room / GREEN_FROM_M, 0.0, 1.0))
