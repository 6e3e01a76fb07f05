"""The models that ship: an SVM's word alone (the thesis), and the same with the check after it.

Needs the extra `svm`.
"""

from boxgrasp import GraspSelector
from boxgrasp.simulate.scenario import Recipe, draw_scenario, targets_of

bare = GraspSelector({"ranker": "cascade-grid", "unchecked": True})
checked = GraspSelector({"ranker": "cascade-grid"})
crowded = Recipe(targets_of("novel"), obstacles=(4, 4))  # targets the models were not trained on

for number in range(8):
    view, _ = draw_scenario(crowded, seed=3, number=number).capture("xtion")
    word, answer = bare.select(view), checked.select(view)
    lacks = word.candidate(word.label).rejected
    taken = answer.label if answer.status == "grasp" else "none, ask"
    print(f"scene {number}: bare {word.label}, checked {taken}")
    print(f"  the bare one: {lacks or 'passes'}")
