"""Another hand: a name, a YAML file or a mapping, as one box or as palm and fingers."""

from boxgrasp import GraspSelector
from boxgrasp.simulate import demo_capture

box = {
    "name": "small, one box",
    "length_m": 0.16,  # mounting face to fingertips, along the approach
    "width_m": 0.12,  # along the finger opening
    "thickness_m": 0.06,
    "max_opening_m": 0.08,
    "insertion_depth_m": 0.02,  # the fingers pass the face by this much
}
fingers = {
    **box,
    "name": "small, palm and fingers",  # clearance is to these boxes
    "palm": [{"x_m": [0.0, 0.10], "y_m": [-0.06, 0.06], "z_m": [-0.03, 0.03]}],
    "finger": [{"x_m": [0.10, 0.16], "y_m": [0.04, 0.055], "z_m": [-0.01, 0.01]}],
}
view = demo_capture()
for hand in ("thesis", "robotiq-2f-85", box, fingers):
    selection = GraspSelector({"gripper": hand}).select(view)
    print(f"{selection.gripper.name}: {selection}")
    print("  best first:", ", ".join(candidate.name for candidate in selection.passing))
