"""A point cloud without a camera pose: the base frame comes from the support plane."""

from boxgrasp import Capture, GraspSelector, Target
from boxgrasp.simulate import demo_capture

points, _ = demo_capture().valid_points()  # (N, 3) float32, optical frame, unorganized
capture = Capture.from_cloud(points)

selector = GraspSelector()
selection = selector.select(capture, Target(object=selector.objects(capture)[0].number))
print(selection.frame, "frame;", selection.status)
print("T_base_camera:\n", selection.T_base_camera)
for warning in selection.warnings:
    print(f"warning {warning.code}: {warning.message}")
assert selection.frame == "support"
