"""Many captures, two threads, one selector; one that fails does not stop the others."""

from concurrent.futures import ThreadPoolExecutor

from boxgrasp import BoxgraspError, GraspSelector, Target
from boxgrasp.simulate import demo_capture

selector = GraspSelector()
selector.warm_up()  # loads every kernel, so that the first answer is as quick as the next


def answer(seed: int) -> str:
    """One line for one view; every error on purpose is a BoxgraspError of one line."""
    try:
        # The third asks for an object that is not there.
        target = Target(object=99) if seed == 2 else None
        selection = selector.select(demo_capture(seed), target)
    except BoxgraspError as error:
        return f"failed: {error}"
    return f"{selection} in {selection.timings_ms['total']:.0f} ms"


with ThreadPoolExecutor(2) as pool:
    for seed, line in enumerate(pool.map(answer, range(4))):
        print(f"view {seed}: {line}")
