"""Tables with things of your own: an object set is a YAML file."""

import tempfile
from pathlib import Path

from boxgrasp import GraspSelector
from boxgrasp.simulate.scenario import Recipe, draw_scenario, targets_of

OBJECTS = """
objects:
  milk:                        # set: known, novel or real may be a target
    set: known
    color: [230, 230, 235]
    parts:
      - {shape: box, dimensions_m: [0.07, 0.07, 0.20]}
  funnel:                      # parts stand on the object's base unless center_m says otherwise
    set: obstacle
    color: [70, 170, 80]
    parts:
      - {shape: cylinder, radius_m: 0.03, height_m: 0.05}
      - {shape: cylinder, radius_m: 0.06, height_m: 0.04, center_m: [0.0, 0.0, 0.07]}
"""

with tempfile.TemporaryDirectory() as folder:
    path = Path(folder) / "kitchen.yaml"
    path.write_text(OBJECTS, "utf-8")
    recipe = Recipe(targets_of("known", str(path)), objects=str(path), obstacles=(2, 3))
    scenario = draw_scenario(recipe, seed=1, number=0)

print(f"target {scenario.target}, {len(scenario.scene.spec['obstacles'])} obstacles")
print(f"best true clearance of a candidate that can be taken: {scenario.truth.best_m:.3f} m")
capture, _ = scenario.capture("xtion")  # a capture like any other, with the sensor's noise
selection = GraspSelector().select(capture)
print(selection)
