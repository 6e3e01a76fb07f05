"""When no candidate passes, the answer is a question that names what stands in the way."""

from boxgrasp import GraspSelector
from boxgrasp.simulate import demo_capture

# A hand that opens by a finger's width can hold nothing here.
selection = GraspSelector({"gripper": {"max_opening_m": 0.01}}).select(demo_capture())

assert selection.status == "ask" and selection.T_base_gripper is None
print("reason:", selection.reason)
print("nearest to passing:", selection.candidate(selection.best_rejected).rejected)
print("in the way:", selection.blocking)
