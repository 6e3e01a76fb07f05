"""A ranker is one class that orders the candidates; the checks after it are the same for all."""

import numpy as np

from boxgrasp import GraspSelector
from boxgrasp.ranking.ranker import Ranker, Ranking, RankingContext
from boxgrasp.simulate import demo_capture


class LowestHand(Ranker):
    """Prefers the hand that stays lowest, then the lower label."""

    name = "lowest-hand"

    def rank(self, context: RankingContext) -> Ranking:
        """Order by height in steps of 1 mm; every candidate gets the same confidence."""
        candidates = context.candidates
        height_m = candidates.T_base_gripper[:, 2, 3].round(3)
        order = np.lexsort((candidates.label, height_m))
        return Ranking(order, confidence=np.full(len(order), 0.5))


view = demo_capture()
for selector in (GraspSelector(), GraspSelector(ranker=LowestHand())):
    selection = selector.select(view)
    first = min(selection.candidates, key=lambda candidate: candidate.rank)
    print(f"{selection.ranker}: {selection}")
    print(f"  its first choice: {first}")
