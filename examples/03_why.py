"""Every candidate comes with its numbers and, if it fell out, with the reason."""

from boxgrasp import GraspSelector
from boxgrasp.grasps.candidates import FACES
from boxgrasp.simulate import demo_capture

selection = GraspSelector().select(demo_capture())

for candidate in selection.candidates:
    print(
        f"{candidate.label:2} {FACES[candidate.face - 1]:18} line {candidate.line}"
        f"  {100 * candidate.visible_clearance_m:5.1f} cm to seen, {100 * candidate.unseen_distance_m:5.1f} cm to unseen"
        f"  {candidate.rejected or 'kept'}"
    )
print(f"chosen: {selection.label}")
