"""How good answers on cast scenes are. `python benchmarks/cast_scenes.py`.

Scenes of the thesis's kind (its known and novel objects, up to four obstacles and floating lamps),
seen with Xtion-like noise, the target named by a pixel, segmentation by the package itself; every
answered pose is judged against exact surfaces, hidden sides included. Bands by the best candidate
that is in truth off the table, fits and has a free approach: solvable (2.5 cm and more), hopeless
(under 1.5 cm), between. Shares with their Wilson 95 % intervals, for the package's segmentation
and for the thesis's Euclidean one. A wrong box: a dimension off by more than 1.5 cm from the true
box's. Of all grasps is told, too, how many close on air, hold the target by an edge, put an open
finger into it, or touch it by strips alone, by `boxgrasp.simulate.hold_truth`.

Seeds: streams 7, 8, 555, 424242, 90210 and 1717 were looked at while the defaults were chosen; the
default here, 2718, was not. `--seed S` draws scene n from (S, n), whatever else is drawn; the worst
are listed as numbers n, to be looked at with `_truth.judged(S, n)`.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, partial

import numpy as np
from _truth import JudgedScene, Verdict, band_of, judged, verdict

from boxgrasp import BoxgraspError, GraspSelector, Selection
from boxgrasp.simulate import to_capture, true_box
from boxgrasp.study import intervals

SEGMENTATIONS = ("network", "split", "euclidean")
LOWER_BOUNDS = ("width_x_lower_bound", "width_y_lower_bound")
WRONG_M = 0.015
BATCH = 16
_SHOWN = 12


@dataclass(frozen=True)
class Outcome:
    """One answer: its status (`none` for an error), its verdict, its box and why it asked."""

    status: str
    verdict: Verdict | None
    box_off_m: float
    width_warned: bool
    why: str


@dataclass(frozen=True)
class Record:
    """One scene, answered with each segmentation."""

    number: int
    band: str
    outcomes: dict[str, Outcome]


@cache
def selector(segmentation: str, refine: str) -> GraspSelector:
    """One for each segmentation and process."""
    return GraspSelector(
        {"scene": {"segmentation": segmentation}, "candidates": {"refine": refine}}
    )


def outcome(scene: JudgedScene, segmentation: str, refine: str) -> Outcome:
    """The answer to one scene, judged."""
    try:
        capture, _ = to_capture(scene.scene, scene.rng)
        selection = selector(segmentation, refine).select(capture)
    except BoxgraspError as error:
        return Outcome("none", None, np.inf, False, str(error))
    grasp, refusal = selection.grasp, selection.refusal
    return Outcome(
        selection.status,
        None if grasp is None else verdict(scene, grasp.T_base_gripper),
        box_error_m(scene, selection),
        any(warning.code in LOWER_BOUNDS for warning in selection.warnings),
        "" if refusal is None else refusal.message,
    )


def box_error_m(scene: JudgedScene, selection: Selection) -> float:
    """How far the worst dimension is off; a turn by a quarter is the same box."""
    _, true = true_box(scene.scene)
    found = selection.box.dimensions_m
    straight = np.abs(found - true).max()
    turned = np.abs(found[[1, 0, 2]] - true).max()
    return float(min(straight, turned))


def record(number: int, seed: int, wanted: frozenset[str], refine: str) -> Record | None:
    """Scene `number`, answered if its band is still wanted."""
    scene = judged(seed, number)
    band = band_of(scene.truth.best_m)
    if band not in wanted:
        return None
    return Record(number, band, {name: outcome(scene, name, refine) for name in SEGMENTATIONS})


def records(seed: int, counts: dict[str, int], processes: int, refine: str) -> Iterator[Record]:
    """The first scenes of each band, as many as asked for, in order."""
    left = {band: count for band, count in counts.items() if count > 0}
    number, total, start = 0, sum(left.values()), time.perf_counter()
    done = 0
    context = multiprocessing.get_context("spawn")
    with context.Pool(processes) as pool:
        while left:
            batch = range(number, number + BATCH * processes)
            number += len(batch)
            work = partial(record, seed=seed, wanted=frozenset(left), refine=refine)
            for found in pool.imap(work, batch, chunksize=4):
                if found is None or found.band not in left:
                    continue
                left[found.band] -= 1
                if left[found.band] == 0:
                    del left[found.band]
                done += 1
                yield found
            spent = time.perf_counter() - start
            progress = f"{done} of {total} scenes, {number} drawn, {spent:.0f} s"
            print(progress, end="\n" if not left else "\r", file=sys.stderr, flush=True)


def share(name: str, hits: int, of: int, bar: str = "") -> None:
    """One line: a share with its interval."""
    found = intervals.share(hits, of)
    part, bounds = "      -", ""
    if found.value is not None:
        part, bounds = f"{found.value:7.1%}", f"[{found.low:6.1%}, {found.high:6.1%}]"
    print(f"  {name:38s} {hits:5d} of {of:5d}  {part}  {bounds:16s}  {bar}".rstrip())


def listed(name: str, numbers: list[int]) -> None:
    """The numbers of the worst scenes, so that one can look."""
    if numbers:
        more = f" and {len(numbers) - _SHOWN} more" if len(numbers) > _SHOWN else ""
        print(f"    {name}: {', '.join(map(str, numbers[:_SHOWN]))}{more}")


def report(found: list[Record], segmentation: str) -> None:
    """All shares of one segmentation."""
    print(f"\nsegmentation {segmentation}")
    every = [(item.number, item.outcomes[segmentation]) for item in found]
    wrong = [number for number, o in every if o.box_off_m > WRONG_M]
    share("wrong boxes", len(wrong), len(every))
    listed("wrong boxes", wrong)
    unwarned = sum(o.box_off_m > WRONG_M and not o.width_warned for _, o in every)
    share("wrong boxes without a warning", unwarned, len(every))
    grasps = [(n, o.verdict) for n, o in every if o.verdict is not None]
    for name, bad in (
        ("closes on air", [n for n, v in grasps if v.on_air]),
        ("holds by an edge", [n for n, v in grasps if v.by_edge]),
        ("a finger in the target", [n for n, v in grasps if v.touching]),
        ("holds by a slope or corner alone", [n for n, v in grasps if v.glancing]),
    ):
        share(name, len(bad), len(grasps))
        listed(name, bad)
    for band in ("solvable", "between", "hopeless"):
        own = [(item.number, item.outcomes[segmentation]) for item in found if item.band == band]
        if own:
            print(f" {band}: {len(own)} scenes")
            band_report(band, own)


def band_report(band: str, own: list[tuple[int, Outcome]]) -> None:
    """The shares of one band, the bars beside them."""
    solvable = band == "solvable"
    grasps = [(n, o.verdict) for n, o in own if o.verdict is not None]
    asks = [n for n, o in own if o.status == "ask"]
    errors = [n for n, o in own if o.status == "none"]
    share("answered by a grasp", len(grasps), len(own), "at least 97 %" if solvable else "")
    if band == "hopeless":
        share("false grasps (every grasp)", len(grasps), len(own), "at most 5 %")
        share("false grasps (in truth not good)", sum(not v.good for _, v in grasps), len(own))
        listed("grasps", [n for n, _ in sorted(grasps, key=lambda pair: pair[1].clearance_m)])
        return
    of = len(grasps)
    share("clear by 2 cm", sum(v.clear for _, v in grasps), of, "98.5 %" if solvable else "")
    share("safe", sum(v.safe for _, v in grasps), of, "95 %" if solvable else "")
    share("into the table", sum(not v.off_table for _, v in grasps), of, "none" if solvable else "")
    share("too wide", sum(not v.fits for _, v in grasps), of, "none" if solvable else "")
    share("approach not free", sum(not v.free_approach for _, v in grasps), of)
    unclear = sorted((v.clearance_m, n) for n, v in grasps if not v.clear)
    listed("not clear, worst first", [n for _, n in unclear])
    listed("not safe", [n for n, v in grasps if v.clear and not v.safe])
    listed("into the table", [n for n, v in grasps if not v.off_table])
    listed("too wide", [n for n, v in grasps if not v.fits])
    listed("asks", asks if solvable else [])
    listed("errors", errors)
    if solvable:
        for number, answer in [(n, o) for n, o in own if o.verdict is None][:_SHOWN]:
            print(f"      {number}: {answer.why}")


def main(argv: list[str] | None = None) -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--solvable", type=int, default=1000)
    parser.add_argument("--hopeless", type=int, default=300)
    parser.add_argument("--between", type=int, default=100)
    parser.add_argument("--seed", type=int, default=2718)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--refine", choices=("surface", "none"), default="surface")
    args = parser.parse_args(argv)
    counts = {name: getattr(args, name) for name in ("solvable", "hopeless", "between")}
    found = list(records(args.seed, counts, args.processes, args.refine))
    print(f"seed {args.seed}, {len(found)} scenes, {os.cpu_count()} cores")
    for segmentation in SEGMENTATIONS:
        report(found, segmentation)


if __name__ == "__main__":
    main()
