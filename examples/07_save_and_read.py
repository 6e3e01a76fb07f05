"""Captures and answers are plain files: .npz in, one line of JSON out and back."""

import tempfile
from pathlib import Path

import numpy as np

from boxgrasp import GraspSelector, Selection, load_capture
from boxgrasp.simulate import demo_capture

view = demo_capture()
with tempfile.TemporaryDirectory() as folder:
    path = Path(folder) / "table.npz"
    np.savez(
        path,
        depth=view.depth,
        intrinsics=view.intrinsics,
        T_base_camera=view.T_base_camera,
        target_pixel=view.target_pixel,
    )
    selection = GraspSelector().select(load_capture(path))

line = selection.to_json()
again = Selection.from_json(line)
assert again.to_json() == line
print(f"{len(line)} characters, {again.timings_ms['total']:.0f} ms, {again}")
