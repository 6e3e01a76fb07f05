"""When your planner finds no way to the first grasp, the next one that passes is there."""

from boxgrasp import GraspSelector
from boxgrasp.simulate import demo_capture


def planner_reaches(T_base_gripper):
    """Stands for your motion planner: this arm reaches no farther to the right."""
    return T_base_gripper[1, 3] > -0.05


# The first is the grasp itself; the others follow in the ranker's order.
selection = GraspSelector().select(demo_capture())
reached = None
for candidate in selection.passing:
    if planner_reaches(candidate.T_base_gripper):
        reached = candidate
        break
    print(f"rank {candidate.rank}, {candidate.name}: no plan")
print("taken:", reached.name if reached else "none, ask for help")
