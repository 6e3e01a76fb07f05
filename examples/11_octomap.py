"""A map from a file (MoveIt, octomap_server) takes the place of free and unseen space.

Reading needs nothing more; writing, as here, needs the extra `io`.
"""

import tempfile
from pathlib import Path

import numpy as np

from boxgrasp import GraspSelector
from boxgrasp.geometry.transforms import make_transform, transform
from boxgrasp.io.octomap import read_octomap, write_octomap
from boxgrasp.mapping.ray_insertion import build_local_map
from boxgrasp.simulate import demo_capture

view = demo_capture()
points, _ = view.valid_points()
points = transform(view.T_base_camera, points)  # optical to base
T_base_map = make_transform(np.eye(3), (0.84, 0.0, 0.85))
local_map = build_local_map([(points, view.T_base_camera[:3, 3])], T_base_map)

with tempfile.TemporaryDirectory() as folder:
    path = Path(folder) / "scene.bt"
    write_octomap(path, local_map)
    octomap = read_octomap(path)

selection = GraspSelector().select(view, octomap=octomap)
print(f"{len(octomap)} leaves; {selection}")
