"""Four ways to say which object is meant; all of them name the same one here."""

import numpy as np

from boxgrasp import GraspSelector, Target
from boxgrasp.simulate import demo_capture

view = demo_capture()
selector = GraspSelector()

for item in selector.objects(view):
    print(f"object {item.number}: centre {item.centre_m}, size {item.size_m}, at {item.pixel}")

u, v = view.target_pixel
by_pixel = selector.select(view, Target(pixel=(u, v)))
box = by_pixel.box.T_base_box[:3, 3]

nearest = min(
    selector.objects(view), key=lambda item: float(np.linalg.norm((item.centre_m - box)[:2]))
)
by_number = selector.select(view, Target(object=nearest.number))
by_own = selector.select(view)  # the capture's own mask or pixel

for name, selection in (("pixel", by_pixel), ("number", by_number), ("own", by_own)):
    print(f"by {name}: box at {selection.box.T_base_box[:3, 3].round(3)}")
assert by_pixel.label == by_number.label == by_own.label
