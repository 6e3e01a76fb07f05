"""When no candidate passes, the answer is a request for help with its reasons as data."""

from boxgrasp import GraspSelector
from boxgrasp.simulate import demo_capture

# A hand that opens by a finger's width can hold nothing here.
selection = GraspSelector({"gripper": {"max_opening_m": 0.01}}).select(demo_capture())

assert selection.status == "ask" and selection.grasp is None
refusal = selection.refusal
print(f"{refusal.code}: {refusal.message}")
print("nearest to passing:", selection.candidate(refusal.nearest_label).name)
for violation in refusal.violations:
    print(f"  {violation.check}: {violation.value} {violation.unit}, limit {violation.limit}")
