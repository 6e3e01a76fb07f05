"""The answer as a picture: in the camera's image, from above, from the side, and in words."""

import tempfile
from pathlib import Path

from boxgrasp import GraspSelector
from boxgrasp.draw import draw_objects, draw_selection
from boxgrasp.simulate import demo_capture

view = demo_capture()
selector = GraspSelector()
with tempfile.TemporaryDirectory() as folder:
    path = Path(folder) / "answer.png"
    image = draw_selection(view, selector.select(view), path)  # a notebook shows it by itself
    print(f"{path.name}: {image.size[0]} x {image.size[1]}, {path.stat().st_size // 1024} KB")
    draw_objects(view, selector.scene(view), Path(folder) / "objects.png")
