"""Further views of the same scene turn unseen space into free or occupied space."""

import numpy as np

from boxgrasp import GraspSelector
from boxgrasp.simulate import demo_capture, to_capture
from boxgrasp.simulate.demo import DEMO_SPEC
from boxgrasp.simulate.scenes import build_scene

view = demo_capture()
other_camera = {"position": [1.1, -0.75, 1.4], "gaze": [0.86, 0.0, 0.87]}
scene = build_scene(DEMO_SPEC | {"camera": other_camera})
other_view, _ = to_capture(scene, np.random.default_rng(1))

selector = GraspSelector()
one = selector.select(view)
two = selector.select(view, scans=[other_view])  # all views need T_base_camera

for name, selection in (("one view", one), ("two views", two)):
    unseen = [candidate.checks["unseen_distance"].value for candidate in selection.candidates]
    print(f"{name}: {selection}")
    print("  cm to unseen space:", *(f"{100 * value:.1f}" for value in unseen))
