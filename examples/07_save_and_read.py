"""Captures and answers are plain files: .npz in, one line of JSON out and back."""

import tempfile
from pathlib import Path

from boxgrasp import GraspSelector, Selection, load_capture
from boxgrasp.io.npz import save_npz
from boxgrasp.simulate import demo_capture

with tempfile.TemporaryDirectory() as folder:
    path = Path(folder) / "table.npz"
    save_npz(demo_capture(), path)
    selection = GraspSelector().select(load_capture(path))

line = selection.to_json()
again = Selection.from_json(line)
assert again.to_json() == line
print(f"{len(line)} characters, {again.timings_ms['total']:.0f} ms, {again}")
