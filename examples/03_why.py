"""Every option comes with its numbers and, if it fell out, with the reason."""

from boxgrasp import GraspSelector
from boxgrasp.grasps.candidates import FACES
from boxgrasp.simulate import demo_capture

selection = GraspSelector().select(demo_capture())

for option in selection.options:
    print(
        f"{option.label:2} {FACES[option.face - 1]:18} line {option.line}"
        f"  {100 * option.seen_m:5.1f} cm to seen, {100 * option.unseen_m:5.1f} cm to unseen"
        f"  {option.rejected or 'kept'}"
    )
print(f"chosen: {selection.label}")
