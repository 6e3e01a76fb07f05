"""How good answers on cast scenes are. `python benchmarks/cast_scenes.py`.

Scenes of the thesis's kind (its known and novel objects, up to four obstacles and floating lamps),
seen with Xtion-like noise, the target named by a pixel, segmentation by the package itself; every
answered pose is judged against exact surfaces, hidden sides included. Bands by the best candidate
that is in truth off the table, fits and has a free approach: solvable (2.5 cm and more), hopeless
(under 1.5 cm), between. Shares with their Wilson 95 % intervals, for the package's segmentation
and for the thesis's Euclidean one. A wrong box: a dimension off by more than 1.5 cm from the true
box's; of targets that nothing hides and no border cuts, the error of each dimension is told too.
Of all grasps is told, too, how many close on air, hold the target by an edge, put an open
finger into it, or touch it by strips alone, by `boxgrasp.simulate.hold_truth`.

`--wide N` asks besides for N boxes 11.5 cm wide, alone on the table and turned at random: the hand
opens 12 cm.

Seeds: streams 7, 8, 31, 555, 2024, 424242, 90210 and 1717 were looked at while the defaults were
chosen; the default here, 2718, was not, but that `occluded_clearance` asks for the noise too was
decided after looking at its false grasps. `--seed S` draws scene n from (S, n), whatever else is
drawn; the worst are listed as numbers n, to be looked at with `_truth.judged(S, n)`.
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
from boxgrasp.simulate import TableScene, draw_scene, to_capture, true_box
from boxgrasp.simulate.camera import cast
from boxgrasp.simulate.objects import Part, SimulatedObject
from boxgrasp.study import intervals

Offs = tuple[float, float, float]
SEGMENTATIONS = ("network", "split", "euclidean")
LOWER_BOUNDS = ("width_x_lower_bound", "width_y_lower_bound")
WRONG_M = 0.015
CLOSE_M = 0.003
WIDE_M = (0.115, 0.18, 0.12)
_ON_TABLE = (0.0, 0.0, WIDE_M[2] / 2)
BATCH = 16
_SHOWN = 12


@dataclass(frozen=True)
class Outcome:
    """One answer: its status (`none` for an error), its verdict, its box and why it asked.

    The box by how much each dimension is too large.
    """

    status: str
    verdict: Verdict | None
    box_off_m: Offs
    width_warned: bool
    why: str


@dataclass(frozen=True)
class Record:
    """One scene, answered with each segmentation."""

    number: int
    band: str
    unhidden: bool
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
        return Outcome("none", None, (np.inf,) * 3, False, str(error))
    grasp, refusal = selection.grasp, selection.refusal
    return Outcome(
        selection.status,
        None if grasp is None else verdict(scene, grasp.T_base_gripper),
        box_off_m(scene.scene, selection),
        any(warning.code in LOWER_BOUNDS for warning in selection.warnings),
        "" if refusal is None else refusal.message,
    )


def box_off_m(scene: TableScene, selection: Selection) -> Offs:
    """How much too large each dimension is; a turn by a quarter is the same box."""
    _, true = true_box(scene)
    found = selection.box.dimensions_m
    straight, turned = found - true, found[[1, 0, 2]] - true
    x, y, z = min(straight, turned, key=lambda off: float(np.abs(off).max())).tolist()
    return x, y, z


def worst_m(outcome: Outcome) -> float:
    """How far the worst dimension is off."""
    return max(abs(off) for off in outcome.box_off_m)


def is_unhidden(scene: TableScene) -> bool:
    """Whether the camera sees of the target all that it would see without anything else."""
    shown = scene.view().object_ids == scene.target_id
    others = (*scene.obstacle_ids, *scene.floating_ids)
    left = [solid for solid in scene.primitives if solid.object_id not in others]
    alone = cast(left, scene.intrinsics, scene.T_base_camera).object_ids == scene.target_id
    whole = not (alone[[0, -1]].any() or alone[:, [0, -1]].any())
    return whole and bool(np.array_equal(shown, alone))


def record(number: int, seed: int, wanted: frozenset[str], refine: str) -> Record | None:
    """Scene `number`, answered if its band is still wanted."""
    scene = judged(seed, number)
    band = band_of(scene.truth.best_m)
    if band not in wanted:
        return None
    outcomes = {name: outcome(scene, name, refine) for name in SEGMENTATIONS}
    return Record(number, band, is_unhidden(scene.scene), outcomes)


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
    wrong = [number for number, o in every if worst_m(o) > WRONG_M]
    share("wrong boxes", len(wrong), len(every))
    listed("wrong boxes", wrong)
    unwarned = sum(worst_m(o) > WRONG_M and not o.width_warned for _, o in every)
    share("wrong boxes without a warning", unwarned, len(every))
    boxes_report([item.outcomes[segmentation] for item in found if item.unhidden])
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


def boxes_report(unhidden: list[Outcome]) -> None:
    """How well the boxes of targets fit that nothing hides."""
    fitted = [o for o in unhidden if o.status != "none"]
    if fitted:
        x, y, z = 1000 * np.median([o.box_off_m for o in fitted], axis=0)
        print(f"  unhidden targets: median error of x {x:+.2f} mm, y {y:+.2f} mm, z {z:+.2f} mm")
    of = len(unhidden)
    share("all three within 3 mm", sum(worst_m(o) <= CLOSE_M for o in fitted), of, "95 %")
    wrong = sum(worst_m(o) > WRONG_M and not o.width_warned for o in fitted)
    share("off by over 1.5 cm without a warning", wrong, of, "at most 1 %")


def wide_report(count: int, seed: int) -> None:
    """Boxes a little narrower than the hand opens."""
    wide = SimulatedObject("wide", "known", (200, 60, 50), (Part("box", WIDE_M, _ON_TABLE, None),))
    asked, off_m = GraspSelector(), []
    answered = 0
    for number in range(count):
        rng = np.random.default_rng((seed, number, 2))
        scene = draw_scene(rng, "wide", 0, yaw="random", objects={"wide": wide})
        selection = asked.select(to_capture(scene, rng)[0])
        answered += selection.status == "grasp"
        off_m.append(min(selection.box.dimensions_m[:2]) - min(WIDE_M[:2]))
    low_mm, middle, high = 1000 * np.percentile(off_m, (2.5, 50, 97.5))
    print("\nboxes 11.5 cm wide, turned at random, alone; the hand opens 12 cm")
    share("answered by a grasp", answered, count)
    print(f"  width off by {middle:+.2f} mm, 95 % from {low_mm:+.2f} to {high:+.2f} mm")


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
    parser.add_argument("--wide", type=int, default=180)
    parser.add_argument("--seed", type=int, default=2718)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--refine", choices=("surface", "none"), default="surface")
    args = parser.parse_args(argv)
    counts = {name: getattr(args, name) for name in ("solvable", "hopeless", "between")}
    found = list(records(args.seed, counts, args.processes, args.refine))
    print(f"seed {args.seed}, {len(found)} scenes, {os.cpu_count()} cores")
    for segmentation in SEGMENTATIONS:
        report(found, segmentation)
    if args.wide:
        wide_report(args.wide, args.seed)


if __name__ == "__main__":
    main()
