"""Geometry alone: most room up to the safe 6 cm, ties by the operator's habits (section 5-1)."""

from __future__ import annotations

import numpy as np

from boxgrasp.grasps.candidates import FRONT, TOP_PARALLEL
from boxgrasp.grasps.scoring import GREEN_FROM_M
from boxgrasp.ranking.ranker import Ranker, Ranking, RankingContext

# What unseen space in the gripper's room costs: 3 cm of room if all of it is unseen.
_UNSEEN_COST_M = 0.03


class ByClearance(Ranker):
    """Most clearance first; front and top-parallel before the rest, line 2 before the outer."""

    def rank(self, context: RankingContext) -> Ranking:
        """Order by room, then habit, then label."""
        candidates, numbers = context.candidates, context.numbers
        room = np.minimum(
            np.minimum(numbers.visible_clearance_m, numbers.occluded_clearance_m), GREEN_FROM_M
        )
        room = np.round(room - _UNSEEN_COST_M * numbers.unseen_fraction, 4)
        unhabitual = ~np.isin(candidates.face, (FRONT, TOP_PARALLEL))
        off_center = np.abs(candidates.line - (candidates.lines + 1) / 2)
        order = np.lexsort((candidates.label, off_center, unhabitual, -room))
        return Ranking(order, np.clip(room / GREEN_FROM_M, 0.0, 1.0))
