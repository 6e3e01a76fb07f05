"""What a hand's own boxes are worth on cast scenes. `python benchmarks/hands.py`.

The same scenes are answered with the thesis's hand, and with makers' hands twice: as the one box
round them, and as palm and fingers. Told are the share of scenes that are answered by a grasp, how
many of these are good against exact surfaces, hidden sides included (clear of the hand's own boxes
by 2 cm, nothing but the target between the fingers, off the table, a free way in, fits), and the
mean strict score (thesis section 3-4, over the hand's own valid candidates of the true box, 0 for a
question). Two kinds of scenes: the thesis's, up to 4 obstacles, and dense clutter, 7 to 10 of them.

Last, what boxes cost: `select` with palm and fingers against one box, in turns, by the median
ratio.
"""

from __future__ import annotations

import argparse
import multiprocessing
import statistics
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np
from cast_scenes import share

from boxgrasp import BoxgraspError, GraspSelector
from boxgrasp.config import load_gripper
from boxgrasp.grasps.gripper import Gripper
from boxgrasp.grasps.scoring import ScoreFunction, squared
from boxgrasp.simulate import TableScene, candidate_truth, draw_scene, to_capture, true_candidates
from boxgrasp.strict import plain

HANDS = ("thesis", "robotiq-2f-85", "franka-hand")
KINDS = {"the thesis's kind": (0, 4), "dense clutter": (7, 10)}
STRICT = ScoreFunction("strict", squared)


@cache
def hands() -> dict[str, Gripper]:
    """Each hand, those of several boxes as one box too."""
    found = {}
    for name in HANDS:
        hand = load_gripper(name)
        if hand.palm:
            found[f"{name}, one box"] = replace(hand, palm=(), finger=())
        found[name if not hand.palm else f"{name}, palm and fingers"] = hand
    return found


@cache
def selector(name: str) -> GraspSelector:
    """One a hand and process."""
    return GraspSelector({"gripper": plain(hands()[name])})


@dataclass(frozen=True)
class Outcome:
    """One scene with one hand."""

    answerable: bool
    answered: bool
    good: bool
    score: float


def outcomes(number: int, seed: int, kind: str) -> dict[str, Outcome]:
    """One scene with every hand."""
    scene = draw_scene(np.random.default_rng((seed, number, 0)), obstacles=KINDS[kind])
    capture, _ = to_capture(scene, np.random.default_rng((seed, number, 1)))
    found = {}
    for name, hand in hands().items():
        truth = candidate_truth(
            scene, true_candidates(scene, gripper=hand).T_base_gripper, gripper=hand
        )
        best_m, score, good, grasp = truth.best_m, 0.0, False, None
        try:
            grasp = selector(name).select(capture).grasp
        except BoxgraspError:
            pass
        if grasp is not None:
            good, score = verdict_of(scene, grasp.T_base_gripper, hand, best_m)
        found[name] = Outcome(best_m >= 0.025, grasp is not None, good, score)
    return found


def verdict_of(
    scene: TableScene, T: np.ndarray, hand: Gripper, best_m: float
) -> tuple[bool, float]:
    """Whether a grasp is good, and its strict score."""
    truth = candidate_truth(scene, T[None], gripper=hand)
    clearance_m = float(truth.clearance_m[0]) if truth.valid[0] else 0.0
    largest_m = max(best_m, clearance_m)
    return clearance_m >= 0.02, float(STRICT(clearance_m, largest_m))


def report(kind: str, count: int, seed: int, processes: int) -> None:
    """All hands on one kind of scenes."""
    work = partial(outcomes, seed=seed, kind=kind)
    with multiprocessing.get_context("spawn").Pool(processes) as pool:
        found = list(shown(pool.imap(work, range(count), chunksize=4), count))
    print(f"\n{kind}: {count} scenes")
    for name in hands():
        own = [item[name] for item in found]
        print(f" {name}")
        can = [o for o in own if o.answerable]
        share("scenes with a grasp clear by 2.5 cm", len(can), count)
        share("answered, of all", sum(o.answered for o in own), count)
        share("answered, of those with one", sum(o.answered for o in can), len(can))
        share("good, of the answered", sum(o.good for o in own), sum(o.answered for o in own))
        print(f"  strict score, all scenes {statistics.mean(o.score for o in own):.3f}")


def shown(items: Iterator[dict[str, Outcome]], count: int) -> Iterator[dict[str, Outcome]]:
    """The items, with progress."""
    for number, item in enumerate(items, start=1):
        print(f"{number} of {count} scenes", end="\r", file=sys.stderr, flush=True)
        yield item


def cost(rounds: int) -> None:
    """How much longer `select` takes with several boxes than with one."""
    scene = draw_scene(np.random.default_rng((1, 0)), obstacles=4)
    capture, _ = to_capture(scene, np.random.default_rng((1, 1)))
    for name in HANDS[1:]:
        pair = [selector(f"{name}, {kind}") for kind in ("one box", "palm and fingers")]
        ratios = []
        for _ in range(rounds):
            spent = []
            for chosen in pair:
                start = time.perf_counter()
                chosen.select(capture)
                spent.append(time.perf_counter() - start)
            ratios.append(spent[1] / spent[0])
        low, middle, high = np.quantile(ratios[2:], (0.25, 0.5, 0.75))
        boxes = len(hands()[f"{name}, palm and fingers"].boxes_m)
        print(f"{name}: {boxes} boxes take {middle:.3f} times one ({low:.3f} to {high:.3f})")


def main() -> None:
    """Answer, judge, print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--scenes", type=int, default=1000, help="of each kind")
    parser.add_argument("--seed", type=int, default=6174)
    parser.add_argument("--rounds", type=int, default=60, help="of the timing")
    parser.add_argument("--processes", type=int, default=2)
    args = parser.parse_args()
    for kind in KINDS:
        report(kind, args.scenes, args.seed, args.processes)
    print()
    cost(args.rounds)


if __name__ == "__main__":
    main()
