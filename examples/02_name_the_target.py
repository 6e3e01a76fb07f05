"""Five ways to say which object is meant; all of them name the same one here."""

from boxgrasp import GraspSelector, Target
from boxgrasp.simulate import demo_capture

view = demo_capture()
selector = GraspSelector()

objects = selector.objects(view)
for item in objects:
    print(f"object {item.number}: size {item.size_m.round(3)} m, at pixel {item.pixel}")

largest = max(objects, key=lambda item: item.points)
red = (view.rgb[..., 0] > 2.0 * view.rgb[..., 1]) & (view.rgb[..., 0] > 2.0 * view.rgb[..., 2])
ways = {
    "number": Target(object=largest.number),
    "pixel": Target(pixel=largest.pixel),
    "point": Target(point=(0.80, -0.02, 0.88)),  # base frame, m, within 3 cm of it
    "mask": Target(mask=red),  # stands for your own segmentation; a mask always wins
    "own": None,  # the capture's own mask, else its own pixel
}
for name, target in ways.items():
    box = selector.select(view, target).box
    print(f"by {name}: {box.dimensions_m.round(3)} m at {box.T_base_box[:3, 3].round(3)}")
