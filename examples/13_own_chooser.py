"""A chooser orders the options; the check that follows is the same for all of them."""

import numpy as np

from boxgrasp import GraspSelector
from boxgrasp.ranking import ranker
from boxgrasp.ranking.ranker import Chooser, Preference, Situation
from boxgrasp.simulate import demo_capture


class Lowest(Chooser):
    """Prefers the hand that stays lowest, then the lower label."""

    def prefer(self, situation: Situation) -> Preference:
        options = situation.options
        height = options.T_base_gripper[:, 2, 3].round(3)
        order = np.lexsort((options.label, height))
        return Preference(order, sureness=np.full(len(order), 0.5))


ranker.NAMES["lowest"] = f"{__name__}:Lowest"  # module:class, found by its name

view = demo_capture()
for name in ("clearance", "lowest"):
    selection = GraspSelector({"chooser": name}).select(view)
    first = min(selection.options, key=lambda option: option.preference)
    print(f"{name}: {selection.status} {selection.label}")
    print(f"  first choice {first.label}: {first.rejected or 'passes'}")
