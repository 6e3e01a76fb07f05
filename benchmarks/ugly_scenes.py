"""Objects found on cast tables as ugly as real ones. `python benchmarks/ugly_scenes.py [--grasps]`.

The tables are those that the network learns from (`boxgrasp.simulate.ugly`), drawn from another
seed and measured by a random sensor; each segmentation beside the other, judged as
`labelled_captures.py` does. Views in which no thing shows 400 pixels are drawn again. It shows how
hard these tables are. How well the network does on tables that it has not learned to see, only
real captures show.

`--grasps` asks for things in place of that, as `labelled_captures.py --grasps` does: those of 1500
pixels and more that the image's border does not cut, in views within 1.3 m by the study's Xtion,
held against what the camera would see without noise (`seen`), and against the exact surfaces of the
thing, hidden sides included (`exact`). `--grasps --worst` prints the grasps that `exact` finds to
hold nothing, and those of which the two say different things.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import numpy as np
from _held import Floats, Labeled
from _held import Judged as HeldSeen
from labelled_captures import (
    FIRST_OBJECT,
    LEAST_PX,
    Grasps,
    Judged,
    found_in,
    judged,
    told,
)
from numpy.typing import NDArray

from boxgrasp import Capture, GraspSelector
from boxgrasp.grasps.gripper import Gripper
from boxgrasp.perception.segmentation import SEGMENTATIONS
from boxgrasp.simulate import HoldTruth, hold_truth
from boxgrasp.simulate.noise import add_noise
from boxgrasp.simulate.sensors import Image, sensed
from boxgrasp.simulate.ugly import View, draw_view

SEED = 271_828  # far from any seed of a training
FOCAL_PX = 525.0
FARTHEST_M = 2.6  # the cameras are up to 2.4 m away


LARGE_PX = 1500
NEAR_M = 1.3


def capture_of(view: View, depth: Image) -> Capture:
    """A view as it was measured."""
    u, v = view.center_px
    K = np.array([[view.focal_px, 0.0, u], [0.0, view.focal_px, v], [0.0, 0.0, 1.0]])
    return Capture(depth, K, view.T_table_camera)


def truth_of(view: View) -> NDArray[np.int64]:
    """(H, W) as labels.png has it, but that no table is told."""
    return np.where(view.things > 0, view.things + FIRST_OBJECT - 1, 0).astype(np.int64)


def objects(scenes: int, seed: int) -> None:
    """Print a line for each segmentation."""
    selectors = {
        name: GraspSelector({"scene": {"segmentation": name, "max_range_m": FARTHEST_M}})
        for name in SEGMENTATIONS
    }
    results: dict[str, list[Judged]] = {name: [] for name in SEGMENTATIONS}
    times: dict[str, list[float]] = {name: [] for name in SEGMENTATIONS}
    rng, drawn = np.random.default_rng(seed), 0
    while drawn < scenes:
        view = draw_view(rng, (480, 640), FOCAL_PX)
        depth, _ = sensed(view.depth_m, view.things, view.focal_px, rng)
        shown = np.bincount(view.things[(view.things > 0) & (depth > 0)], minlength=1)
        if shown.max() < LEAST_PX:
            continue
        drawn += 1
        capture = capture_of(view, depth)
        for name, selector in selectors.items():
            start = time.perf_counter()
            found = found_in(selector, capture)
            times[name].append((time.perf_counter() - start) * 1e3)
            results[name].append(judged(truth_of(view), found, depth > 0))
    for name in SEGMENTATIONS:
        print(told(name, results[name], times[name]))


class Exact:
    """What grasps hold by exact surfaces, by the way of asking."""

    def __init__(self, gripper: Gripper) -> None:
        self.gripper = gripper
        self.found: dict[str, list[HoldTruth]] = {}
        self.apart = 0

    def judge(self, view: View, thing: int, given: dict[str, tuple[Floats, HeldSeen]]) -> list[str]:
        """Judge the grasps of a thing; a line for each that holds nothing or is told otherwise."""
        lines = []
        for way, (T_camera_gripper, seen) in given.items():
            T = view.T_table_camera @ T_camera_gripper
            truth = hold_truth(view.solids_of(thing), T[None], gripper=self.gripper)
            self.found.setdefault(way, []).append(truth)
            said, exact = _word(seen.holds, seen.on_air, seen.by_an_edge), word(truth)
            self.apart += said != exact
            if said != exact or exact != "holds":
                cm2 = np.round(np.concatenate(list(vars(truth).values()), axis=None) * 1e4, 2)
                lines.append(
                    f"thing {thing} by {way}: seen {said}, exact {exact} {cm2} cm2; "
                    f"seen points {seen.held}, {seen.central}, {seen.outside}"
                )
        return lines

    def tell(self, name: str) -> None:
        """Print a line a way of asking."""
        for way, of in self.found.items():
            words = [word(truth) for truth in of]
            shares = ", ".join(f"{kind} {words.count(kind) / len(of):.3f}" for kind in WORDS)
            slipping = float(np.mean([truth.glancing[0] for truth in of]))
            print(
                f"{name:10} by {way:8} exact: of {len(of)} grasps: {shares}, "
                f"glancing {slipping:.3f}",
                flush=True,
            )
        print(f"{name:10} told otherwise by `seen`: {self.apart}", flush=True)


WORDS = ("holds", "on air", "by an edge", "touching")


def word(truth: HoldTruth) -> str:
    """What is said of one pose."""
    return _word(bool(truth.holds[0]), bool(truth.on_air[0]), bool(truth.by_edge[0]))


def _word(holds: bool, on_air: bool, by_edge: bool) -> str:
    said = (holds, on_air, by_edge, True)
    return WORDS[said.index(True)]


def grasps(scenes: int, seed: int, worst: bool) -> None:
    """Print a line for each way of asking: candidates at the surface, at the box, and unchecked.

    `unheld` is at the box, without the checks of what is held.
    """
    config = {"scene": {"max_range_m": FARTHEST_M}}
    ways: dict[str, dict[str, Any]] = {
        "surface": {},
        "box": {"candidates": {"refine": "none"}},
        "unheld": {
            "candidates": {"refine": "none"},
            "checks": {"held_area_m2": 0.0, "finger_area_m2": 0.01},
        },
    }
    tallies = {name: Grasps(GraspSelector({**config, **own})) for name, own in ways.items()}
    truths = {name: Exact(tally.selector.config.gripper) for name, tally in tallies.items()}
    rng, drawn = np.random.default_rng(seed), 0
    while drawn < scenes:
        view = draw_view(rng, (480, 640), FOCAL_PX)
        shown = np.bincount(view.things[view.things > 0], minlength=1)
        if shown.max() < LARGE_PX or np.median(view.depth_m[view.things > 0]) > NEAR_M:
            continue
        drawn += 1
        depth = add_noise(view.depth_m.astype(np.float64), np.random.default_rng((seed, drawn)))
        capture = capture_of(view, depth)
        up, over_m = view.T_table_camera[2, :3], float(view.T_table_camera[2, 3])
        exact = capture_of(view, view.depth_m)
        labeled = Labeled.over(exact, truth_of(view), up, over_m)
        for thing in np.flatnonzero(shown >= LARGE_PX).tolist():
            own = view.things == thing
            if not (own[[0, -1]].any() or own[:, [0, -1]].any()):
                for name, tally in tallies.items():
                    given = tally.ask(capture, labeled, thing + FIRST_OBJECT - 1)
                    for line in truths[name].judge(view, thing, given):
                        if worst:
                            print(f"  table {drawn} {name} {line}", flush=True)
    for name, tally in tallies.items():
        tally.tell(name)
        truths[name].tell(name)


def main(argv: list[str] | None = None) -> None:
    """Print objects or grasps."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=100)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--grasps", action="store_true", help="judge answers, not objects")
    parser.add_argument("--worst", action="store_true", help="with --grasps, print bad grasps")
    args = parser.parse_args(argv)
    print(f"{args.scenes} ugly tables, seed {args.seed}")
    if args.grasps:
        grasps(args.scenes, args.seed, args.worst)
    else:
        objects(args.scenes, args.seed)


if __name__ == "__main__":
    main()
