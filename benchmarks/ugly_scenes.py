"""Objects found on cast tables as ugly as real ones. `python benchmarks/ugly_scenes.py`.

The tables are those that the network learns from (`boxgrasp.simulate.ugly`), drawn from another
seed and measured by a random sensor; each segmentation beside the other, judged as
`labelled_captures.py` does. Views in which no thing shows 400 pixels are drawn again. It shows how
hard these tables are. How well the network does on tables that it has not learned to see, only
real captures show.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from labelled_captures import FIRST_OBJECT, LEAST_PX, Judged, found_in, judged, told

from boxgrasp import Capture, GraspSelector
from boxgrasp.perception.segmentation import SEGMENTATIONS
from boxgrasp.simulate.sensors import sensed
from boxgrasp.simulate.ugly import draw_view

SEED = 271_828  # far from any seed of a training
FOCAL_PX = 525.0
FARTHEST_M = 2.6  # the cameras are up to 2.4 m away


def main(argv: list[str] | None = None) -> None:
    """Print a line for each segmentation."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=100)
    parser.add_argument("--seed", type=int, default=SEED)
    args = parser.parse_args(argv)
    selectors = {
        name: GraspSelector({"scene": {"segmentation": name, "max_range_m": FARTHEST_M}})
        for name in SEGMENTATIONS
    }
    results: dict[str, list[Judged]] = {name: [] for name in SEGMENTATIONS}
    times: dict[str, list[float]] = {name: [] for name in SEGMENTATIONS}
    rng, drawn = np.random.default_rng(args.seed), 0
    while drawn < args.scenes:
        view = draw_view(rng, (480, 640), FOCAL_PX)
        depth, _ = sensed(view.depth_m, view.things, view.focal_px, rng)
        shown = np.bincount(view.things[(view.things > 0) & (depth > 0)], minlength=1)
        if shown.max() < LEAST_PX:
            continue
        drawn += 1
        u, v = view.center_px
        K = np.array([[view.focal_px, 0.0, u], [0.0, view.focal_px, v], [0.0, 0.0, 1.0]])
        capture = Capture(depth, K, view.T_table_camera)
        truth = np.where(view.things > 0, view.things + FIRST_OBJECT - 1, 0).astype(np.int64)
        for name, selector in selectors.items():
            start = time.perf_counter()
            found = found_in(selector, capture)
            times[name].append((time.perf_counter() - start) * 1e3)
            results[name].append(judged(truth, found, depth > 0))
    print(f"{args.scenes} ugly tables, seed {args.seed}")
    for name in SEGMENTATIONS:
        print(told(name, results[name], times[name]))


if __name__ == "__main__":
    main()
