"""Every candidate comes with what each check measured and, if it was rejected, with the reasons."""

from boxgrasp import GraspSelector
from boxgrasp.simulate import demo_capture

selection = GraspSelector().select(demo_capture())

for candidate in selection.candidates:
    clear = candidate.checks["visible_clearance"]
    fits = candidate.checks["width"]
    print(
        f"{candidate.label:2} {candidate.name:24} rank {candidate.rank:2}"
        f"  clear {clear.value:.3f} m (at least {clear.limit:.3f}),"
        f" wide {fits.value:.3f} m (at most {fits.limit:.3f})"
    )
    for reason in candidate.rejections:  # data: check, value, limit, unit, object, nearest_point_m
        print(f"     {reason.sentence}")
print(selection)
