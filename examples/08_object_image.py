"""The number of the object that each pixel shows: masks of everything on the support plane."""

import numpy as np

from boxgrasp import GraspSelector, Target
from boxgrasp.simulate import demo_capture

view = demo_capture()
selector = GraspSelector()
image = selector.segment(view)  # (480, 640) int32, 0 where no object is

for item in selector.objects(view):
    v, u = np.nonzero(image == item.number)
    print(f"object {item.number}: {len(u)} pixels, columns {u.min()} to {u.max()}")

u, v = view.target_pixel
by_mask = selector.select(view, Target(mask=image == image[v, u]))
by_number = selector.select(view, Target(object=int(image[v, u])))
print(by_mask, by_number, sep="\n")
