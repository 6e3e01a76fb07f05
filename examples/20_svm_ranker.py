"""The models that ship: an SVM's first choice alone (the thesis), and with the checks after it."""

from boxgrasp import GraspSelector
from boxgrasp.simulate.scenario import Recipe, draw_scenario, targets_of

bare = GraspSelector({"ranker": "cascade-grid", "unchecked": True})
checked = GraspSelector({"ranker": "cascade-grid"})
crowded = Recipe(targets_of("novel"), obstacles=(4, 4))  # targets the models were not trained on

for number in range(8):
    view, _ = draw_scenario(crowded, seed=3, number=number).capture("xtion")
    first, answer = bare.select(view), checked.select(view)
    reasons = [reason.sentence for reason in first.shown.rejections]
    taken = answer.grasp.label if answer.grasp else "none, ask"
    print(f"scene {number}: unchecked {first.grasp.label}, checked {taken}")
    print(f"  the unchecked one: {'; '.join(reasons) or 'passes'}")
