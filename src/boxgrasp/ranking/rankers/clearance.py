"""Geometry alone: most clearance up to the safe 6 cm, ties by the operator's habits (5-1)."""

from __future__ import annotations

import numpy as np

from boxgrasp.grasps.candidates import FRONT, TOP_PARALLEL
from boxgrasp.grasps.scoring import GREEN_FROM_M
from boxgrasp.ranking.ranker import Ranker, Ranking, RankingContext

# What unseen space in the hand's box costs: 3 cm of clearance if all of it is unseen.
_UNSEEN_COST_M = 0.03
_DIGITS = 3  # millimeters: no camera tells less, and habit is worth more


class ByClearance(Ranker):
    """Most clearance first; front and top-parallel before the rest, line 2 before the outer."""

    name = "clearance"

    def rank(self, context: RankingContext) -> Ranking:
        """Order by clearance, then habit, then label."""
        candidates = context.candidates
        clearance_m = np.minimum(
            context.result("visible_clearance").value, context.result("occluded_clearance").value
        )
        clearance_m = np.minimum(clearance_m, GREEN_FROM_M)
        unseen = context.result("unseen_fraction").value
        clearance_m = np.round(clearance_m - _UNSEEN_COST_M * unseen, _DIGITS)
        unhabitual = ~np.isin(candidates.face, (FRONT, TOP_PARALLEL))
        off_center = np.abs(candidates.line - (candidates.lines + 1) / 2)
        order = np.lexsort((candidates.label, off_center, unhabitual, -clearance_m))
        return Ranking(order, np.clip(clearance_m / GREEN_FROM_M, 0.0, 1.0))
