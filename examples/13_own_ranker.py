"""A ranker orders the candidates; the check that follows is the same for all of them."""

import numpy as np

from boxgrasp import GraspSelector
from boxgrasp.ranking import ranker
from boxgrasp.ranking.ranker import Ranker, Ranking, RankingContext
from boxgrasp.simulate import demo_capture


class Lowest(Ranker):
    """Prefers the hand that stays lowest, then the lower label."""

    def rank(self, context: RankingContext) -> Ranking:
        candidates = context.candidates
        height = candidates.T_base_gripper[:, 2, 3].round(3)
        order = np.lexsort((candidates.label, height))
        return Ranking(order, confidence=np.full(len(order), 0.5))


ranker.NAMES["lowest"] = f"{__name__}:Lowest"  # module:class, found by its name

view = demo_capture()
for name in ("clearance", "lowest"):
    selection = GraspSelector({"ranker": name}).select(view)
    first = min(selection.candidates, key=lambda candidate: candidate.ranking)
    print(f"{name}: {selection.status} {selection.label}")
    print(f"  first choice {first.label}: {first.rejected or 'passes'}")
