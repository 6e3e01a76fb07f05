"""Objects found on labeled real captures, one segmentation beside the other.

    python benchmarks/labelled_captures.py [FOLDER] [--segmentation split euclidean] [--scenes]
                                           [--network FILE] [--pictures DIR]
                                           [--grasps] [--refine none]

FOLDER holds a folder a capture: `depth.png`, `intrinsics.json`, perhaps `color.jpg`, and
`labels.png`, the truth: 0 nothing, 1 the table, 2 and up an object each. Each capture is segmented
with the package's defaults but for the segmentation, and its objects are matched one to one with
the true ones, so that their overlap F is greatest. Only pixels with depth count. Printed for each
segmentation:

- overlap P, R, F: pixels of matched pairs over all found, over all true, and their harmonic mean, a
  capture, then the mean of the captures;
- objects at F 0.75: share of the true objects whose match has F of 0.75 or more, a capture, then
  the mean;
- over all true objects of 400 pixels and more: at IoU 0.75, the share whose largest found piece has
  an intersection over union of 0.75 or more; merged, the share whose largest piece also holds over
  30 % of another object; missed, the share of which nothing was found;
- ghosts a capture: found objects of which under half is any true object;
- the median time of `segment`.

`--pictures DIR` draws each capture, the true objects on the left and the found ones on the right.

`--grasps` asks for every object of 400 pixels and more in place of that: by one pixel, by its true
mask, and by masks grown, shrunk and shifted by 3 pixels. Of the answerable ones (`_held.py` says
which) is printed how many were answered; of all grasps how many are good, close on air, hold by an
edge, touch something, or come nearer than 1.5 cm to another thing.

The captures are read where they lie: in FOLDER, else in BOXGRASP_LABELED, else in ../shared/osd
beside the repository (the learning half of OSD: Richtsfeld et al., IROS 2012). Without them there
is nothing to do. They do not ship with the project.
"""

from __future__ import annotations

import argparse
import os
import time
from dataclasses import dataclass
from pathlib import Path

import _held
import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.optimize import linear_sum_assignment

from boxgrasp import BoxgraspError, Capture, GraspSelector, Target, load_capture
from boxgrasp.perception.segmentation import SEGMENTATIONS

BESIDE = Path(__file__).resolve().parents[2] / "shared" / "osd"
FIRST_OBJECT = _held.FIRST_OBJECT  # in labels.png; below it are nothing and the table
LEAST_PX = 400
GOOD = 0.75
HELD = 0.30
GHOST = 0.5

Numbers = NDArray[np.int64]


@dataclass(frozen=True)
class Judged:
    """One capture's figures; per object of `LEAST_PX` and more: IoU, merged, missed."""

    precision: float
    recall: float
    f: float
    good: float
    iou: tuple[float, ...]
    merged: tuple[bool, ...]
    missed: tuple[bool, ...]
    ghosts: int


def judged(truth: Numbers, found: Numbers, measured: NDArray[np.bool_]) -> Judged:
    """Hold found object numbers against true ones.

    truth: (H, W) as labels.png; found: (H, W), 0 for none; measured: (H, W) pixels with depth.
    """
    truth, found = np.where(measured, truth, 0), np.where(measured, found, 0)
    things = np.unique(truth[truth >= FIRST_OBJECT])
    pieces = np.unique(found[found > 0])
    shared = np.array(
        [[np.count_nonzero((truth == a) & (found == b)) for b in pieces] for a in things]
    ).reshape(len(things), len(pieces))
    of_thing = np.array([np.count_nonzero(truth == a) for a in things])
    of_piece = np.array([np.count_nonzero(found == b) for b in pieces])
    f = 2 * shared / np.maximum(of_thing[:, None] + of_piece[None], 1)
    rows, columns = linear_sum_assignment(-f)
    matched = float(shared[rows, columns].sum())
    precision = matched / max(float(of_piece.sum()), 1.0)
    recall = matched / max(float(of_thing.sum()), 1.0)
    large = np.flatnonzero(of_thing >= LEAST_PX).tolist()
    largest = {a: int(np.argmax(shared[a])) if len(pieces) else -1 for a in large}
    some = {a: largest[a] >= 0 and shared[a, largest[a]] > 0 for a in large}
    return Judged(
        precision=precision,
        recall=recall,
        f=2 * precision * recall / max(precision + recall, 1e-9),
        good=float(np.count_nonzero(f[rows, columns] >= GOOD)) / max(len(things), 1),
        iou=tuple(
            float(shared[a, b] / (of_thing[a] + of_piece[b] - shared[a, b])) if some[a] else 0.0
            for a, b in largest.items()
        ),
        merged=tuple(
            some[a] and any(shared[o, b] > HELD * of_thing[o] for o in range(len(things)) if o != a)
            for a, b in largest.items()
        ),
        missed=tuple(not some[a] for a in large),
        ghosts=int(np.count_nonzero(shared.sum(axis=0) < GHOST * of_piece)) if len(pieces) else 0,
    )


def depth_of(capture: Capture) -> NDArray[np.bool_]:
    """(H, W) pixels that were measured."""
    assert capture.depth is not None
    return np.asarray(capture.depth > 0)


def found_in(selector: GraspSelector, capture: Capture) -> Numbers:
    """(H, W) numbers of the objects found; none where the package finds no scene."""
    try:
        return selector.segment(capture).astype(np.int64)
    except BoxgraspError as error:
        print(f"  refused: {error}")
        return np.zeros(depth_of(capture).shape, dtype=np.int64)


def told(name: str, results: list[Judged], milliseconds: list[float]) -> str:
    """One segmentation's line."""
    objects = [len(item.iou) for item in results]
    iou = np.array([value for item in results for value in item.iou])
    merged = np.array([value for item in results for value in item.merged])
    missed = np.array([value for item in results for value in item.missed])
    means = np.mean([(item.precision, item.recall, item.f, item.good) for item in results], axis=0)
    return (
        f"{name:12} P {means[0]:.3f}  R {means[1]:.3f}  F {means[2]:.3f}  "
        f"at F {GOOD}: {means[3]:.3f}  at IoU {GOOD}: {np.mean(iou >= GOOD):.3f}  "
        f"merged {np.mean(merged):.3f}  missed {np.mean(missed):.3f}  "
        f"ghosts {np.mean([item.ghosts for item in results]):.2f}  "
        f"{np.median(milliseconds):.0f} ms  ({sum(objects)} objects)"
    )


def draw(capture: Capture, truth: Numbers, found: Numbers, path: Path) -> None:
    """True objects on the left, found ones on the right, each in a color of its own."""
    shades = np.random.default_rng(5).integers(60, 256, (256, 3))
    gray = np.repeat((130 * depth_of(capture))[:, :, None], 3, axis=2)
    under = gray if capture.rgb is None else capture.rgb.astype(np.int64)
    halves = []
    for numbers in (np.where(truth >= FIRST_OBJECT, truth, 0), found):
        painted = (under + 2 * shades[numbers % 256]) // 3
        halves.append(np.where(numbers[:, :, None] > 0, painted, under // 2))
    Image.fromarray(np.hstack(halves).astype(np.uint8)).save(path)


def measure(folders: list[Path], segmentation: str, args: argparse.Namespace) -> None:
    """Segment and judge every capture; print a line, and one a capture where asked."""
    scene = {"segmentation": segmentation, "network": args.network}
    selector = GraspSelector({"scene": scene})
    selector.warm_up()
    results, milliseconds = [], []
    for folder in folders:
        capture = load_capture(folder)
        truth = np.asarray(Image.open(folder / "labels.png")).astype(np.int64)
        start = time.perf_counter()
        found = found_in(selector, capture)
        milliseconds.append((time.perf_counter() - start) * 1e3)
        results.append(judged(truth, found, depth_of(capture)))
        if args.pictures:
            name = f"{segmentation}_{folder.name}.png"
            draw(capture, truth, found, args.pictures / name)
        if args.scenes:
            item = results[-1]
            print(
                f"  {folder.name:12} F {item.f:.3f}  at F {GOOD}: {item.good:.2f}  "
                f"merged {sum(item.merged)} of {len(item.merged)}  ghosts {item.ghosts}",
                flush=True,
            )
    print(told(segmentation, results, milliseconds), flush=True)


class Grasps:
    """Answers for labeled objects, by the way of asking."""

    def __init__(self, selector: GraspSelector) -> None:
        self.selector = selector
        self.answered: dict[str, list[bool]] = {}
        self.judged: dict[str, list[_held.Judged]] = {}

    def ask(
        self, capture: Capture, labeled: _held.Labeled, number: int, name: str = ""
    ) -> dict[str, tuple[_held.Floats, _held.Judged]]:
        """Ask for one object in every way; name: of the capture, to print grasps that are bad.

        T_camera_gripper and its verdict by the ways that were answered by a grasp.
        """
        mask = (labeled.labels == number) & depth_of(capture)
        gripper = self.selector.config.gripper
        given = {}
        answerable = labeled.answerable(number, gripper)
        masks = {"mask": mask, **_held.ragged(mask)}
        ways = {"pixel": Target(pixel=_held.middle_pixel(mask))}
        ways |= {way: Target(mask=own) for way, own in masks.items()}
        for way, target in ways.items():
            T_camera_gripper = grasp_of(self.selector, capture, target)
            if answerable:
                self.answered.setdefault(way, []).append(T_camera_gripper is not None)
            if T_camera_gripper is None:
                continue
            found = labeled.judge(number, T_camera_gripper, gripper)
            given[way] = T_camera_gripper, found
            self.judged.setdefault(way, []).append(found)
            if name and not found.good:
                print(f"  {name:12} object {number} by {way}: {found}", flush=True)
        return given

    def tell(self, name: str) -> None:
        """Print a line a way of asking."""
        for way, of in self.answered.items():
            print(f"{name:10} by {way:8} {told_grasps(of, self.judged.get(way, []))}", flush=True)


def measure_grasps(folders: list[Path], segmentation: str, args: argparse.Namespace) -> None:
    """Ask for every object, by pixel and by masks; print a line a way of asking."""
    scene = {"segmentation": segmentation, "network": args.network}
    grasps = Grasps(GraspSelector({"scene": scene, "candidates": {"refine": args.refine}}))
    for folder in folders:
        capture = load_capture(folder)
        truth = np.asarray(Image.open(folder / "labels.png")).astype(np.int64)
        labeled = _held.Labeled.of(capture, truth)
        shown = np.bincount(truth[depth_of(capture)])
        for number in np.flatnonzero(shown >= LEAST_PX).tolist():
            if number >= FIRST_OBJECT:
                grasps.ask(capture, labeled, number, folder.name if args.scenes else "")
    grasps.tell(segmentation)


def grasp_of(selector: GraspSelector, capture: Capture, target: Target) -> _held.Floats | None:
    """T_camera_gripper of the answer, None for a question or a refusal."""
    try:
        selection = selector.select(capture, target)
    except BoxgraspError:
        return None
    if selection.grasp is None:
        return None
    assert selection.T_base_camera is not None
    return np.asarray(np.linalg.inv(selection.T_base_camera) @ selection.grasp.T_base_gripper)


def told_grasps(answered: list[bool], grasps: list[_held.Judged]) -> str:
    """One way of asking in words."""
    count = max(len(grasps), 1)
    kinds = {
        "good": [item.good for item in grasps],
        "on air": [item.on_air for item in grasps],
        "by an edge": [item.by_an_edge for item in grasps],
        "touching": [item.touching for item in grasps],
        "under 1.5 cm": [item.clear_m < _held.CLEAR_M for item in grasps],
    }
    shares = ", ".join(f"{name} {sum(of) / count:.3f}" for name, of in kinds.items())
    return (
        f"answered {np.mean(answered):.3f} of {len(answered)} answerable; "
        f"of {len(grasps)} grasps: {shares}"
    )


def main(argv: list[str] | None = None) -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    beside = Path(os.environ.get("BOXGRASP_LABELED", BESIDE))
    parser.add_argument("folder", nargs="?", type=Path, default=beside, metavar="FOLDER")
    parser.add_argument(
        "--segmentation", nargs="+", choices=tuple(SEGMENTATIONS), default=list(SEGMENTATIONS)
    )
    parser.add_argument("--network", metavar="FILE", help="another network than the shipped one")
    parser.add_argument("--scenes", action="store_true", help="a line a capture too")
    parser.add_argument("--pictures", type=Path, metavar="DIR", help="draw every capture here")
    parser.add_argument("--grasps", action="store_true", help="judge answers, not objects")
    parser.add_argument("--refine", choices=("surface", "none"), default="surface")
    parser.add_argument("--most", type=int, metavar="N", help="only the first N captures")
    args = parser.parse_args(argv)
    folders = sorted(path.parent for path in args.folder.glob("*/labels.png"))[: args.most]
    if not folders:
        print(f"no labeled captures in {args.folder}: nothing done (set BOXGRASP_LABELED)")
        return
    print(f"{len(folders)} labeled captures")
    if args.pictures:
        args.pictures.mkdir(parents=True, exist_ok=True)
    for name in args.segmentation:
        (measure_grasps if args.grasps else measure)(folders, name, args)


if __name__ == "__main__":
    main()
