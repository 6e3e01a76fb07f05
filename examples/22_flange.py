"""Where the arm's flange goes, as the arm's maker and MoveIt have it: z out of the flange."""

import numpy as np

from boxgrasp import GraspSelector
from boxgrasp.geometry.transforms import quaternion_xyzw
from boxgrasp.simulate import demo_capture

for hand, link in (("franka-hand", "panda_link8"), ("robotiq-2f-85", "tool0")):  # Franka, UR
    grasp = GraspSelector({"gripper": hand}).select(demo_capture()).grasp
    if grasp is None or grasp.T_base_flange is None:
        continue
    x, y, z = grasp.T_base_flange[:3, 3]
    qx, qy, qz, qw = quaternion_xyzw(grasp.T_base_flange[:3, :3])
    print(f"{hand}: goal of {link}, base frame")
    print(f"  position x {x:.4f}, y {y:.4f}, z {z:.4f} m")
    print(f"  orientation x {qx:.4f}, y {qy:.4f}, z {qz:.4f}, w {qw:.4f}")
    # The flange's z is the approach; the fingers open across it.
    approach, opening = grasp.T_base_gripper[:3, 0], grasp.T_base_gripper[:3, 1]
    across = grasp.T_base_flange[:3, :3].T @ opening
    print(f"  its z is the approach: {np.allclose(grasp.T_base_flange[:3, 2], approach)}")
    print(f"  the fingers open along {np.round(across, 3) + 0.0} of the flange")
