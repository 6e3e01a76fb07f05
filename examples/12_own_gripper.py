"""Another hand: a mapping or a YAML file; keys that are left out keep their defaults."""

from boxgrasp import GraspSelector
from boxgrasp.simulate import demo_capture

small = {
    "length_m": 0.16,  # box of the hand with its fingers open, along the approach
    "width_m": 0.11,  # along the finger opening
    "thickness_m": 0.06,
    "max_opening_m": 0.08,
    "insertion_depth_m": 0.02,  # the fingers pass the face by this much
    "T_gripper_tcp": [[1, 0, 0, 0.08], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]],
}
view = demo_capture()
for name, config in (("default", {}), ("small", {"gripper": small})):
    selection = GraspSelector(config).select(view)
    print(f"{name} hand: {selection}")
    print("  best first:", ", ".join(candidate.name for candidate in selection.passing))
