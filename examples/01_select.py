"""Arrays in, a checked gripper pose out."""

from boxgrasp import Capture, GraspSelector
from boxgrasp.simulate import demo_capture

view = demo_capture()  # stands for your camera

capture = Capture(
    view.depth,  # (480, 640) float32, meters, 0 or NaN where missing
    view.intrinsics,  # (3, 3), pixels
    view.T_base_camera,  # (4, 4), maps camera into base coordinates; None is allowed
    target_pixel=view.target_pixel,  # (u, v) on the wanted object
)
selection = GraspSelector().select(capture)

print(selection.summary())
if selection.grasp is not None:
    print("T_base_gripper:\n", selection.grasp.T_base_gripper)
    print(f"clearance: {100 * selection.grasp.clearance_m:.1f} cm")
