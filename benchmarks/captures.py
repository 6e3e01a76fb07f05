"""Every good target of the ten real captures, answered twice. `python benchmarks/captures.py`.

Each object is answered by a process of the command line and in Python, which must agree in all but
the timings. Printed: status, face and line, clearance, box beside the visible extents that the
captures' `reference.json` gives (an independent estimate), why a person is asked; and for each
depth capture how far the support plane lies from the reference. `--pictures DIR` draws
every answer; the table says what was found, only the pictures say whether it is right.

The captures are read where they lie: in BOXGRASP_CAPTURES, else in ../shared/captures beside the
repository. Without them there is nothing to do.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from boxgrasp import BoxgraspError, Capture, GraspSelector, Selection, Target, load_capture
from boxgrasp.draw import draw_selection
from boxgrasp.geometry.transforms import invert, transform

BESIDE = Path(__file__).resolve().parents[2] / "shared" / "captures"


@dataclass(frozen=True)
class Setting:
    """What one capture needs beyond the defaults."""

    config: Mapping[str, Any] = field(default_factory=dict)
    cloud_frame: str = "optical"
    by_mask: bool = False


# Everything that is not the default, capture by capture.
SETTINGS = {
    "6dofgn_cheezit": Setting(by_mask=True),
    "haf_table1": Setting(cloud_frame="base"),
    "indus_table": Setting(cloud_frame="base"),
    "pcl_milk_clorox": Setting({"scene": {"max_range_m": 2.6}}),  # five targets lie beyond 1.6 m
    "posecnn_02": Setting(),
    "posecnn_03": Setting(),
    "uois_00": Setting(),
    "uois_02": Setting(),
    "uois_05": Setting(),
    "uois_08": Setting(),
}
PLANE_DEG, PLANE_M = 1.5, 0.015  # the bar
GRASPS = 36


@dataclass(frozen=True, eq=False)
class Job:
    """One target: where it is, how it is named, what the reference says of it."""

    name: str
    number: int
    path: Path
    setting: Setting
    words: tuple[str, ...]
    target: Target | None
    reference: Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class Answer:
    """The Python answer, or why there is none, and whether the command line says the same."""

    selection: Selection | None
    error: str
    same: bool


def captures_folder() -> Path:
    """Where the captures lie."""
    return Path(os.environ.get("BOXGRASP_CAPTURES", BESIDE))


def cloud_of(folder: Path) -> Path:
    """The folder itself where it holds a depth image, else its cloud."""
    if (folder / "depth.png").exists():
        return folder
    return next(folder / name for name in ("cloud.pcd", "cloud.ply") if (folder / name).exists())


def jobs_of(name: str, folder: Path) -> list[Job]:
    """The good targets of one capture; the masked one where it is named by its mask."""
    reference = json.loads((folder / "reference.json").read_text("utf-8"))
    setting, path = SETTINGS[name], cloud_of(folder)
    found = []
    for number, thing in enumerate(reference["objects"]):
        if setting.by_mask:
            words: tuple[str, ...] = ()
            target = None
        elif not thing["good_target"]:
            continue
        elif "pixel" in thing:
            words = ("--pixel", *map(str, thing["pixel"]))
            target = Target(pixel=tuple(thing["pixel"]))
        else:
            point = nearest_point(path, setting, reference, thing)
            words = ("--point", *map(repr, point))
            target = Target(point=point)
        found.append(Job(name, number, path, setting, words, target, {**reference, "own": thing}))
    return found


def nearest_point(
    path: Path, setting: Setting, reference: Mapping[str, Any], thing: Mapping[str, Any]
) -> tuple[float, float, float]:
    """The cloud's point nearest to an object's middle, in the cloud's own frame."""
    points, _ = load_capture(path, cloud_frame=setting.cloud_frame).valid_points()
    T_cloud_base = invert(np.array(reference["T_base_cloud"]))
    middle = transform(T_cloud_base, np.array([thing["centroid_base_m"]]))[0]
    nearest = points[np.argmin(np.linalg.norm(points - middle, axis=1))]
    x, y, z = (round(float(value), 4) for value in nearest)
    return x, y, z


def by_command_line(job: Job, config: Path) -> dict[str, Any] | str:
    """The answer of a process of its own, or its complaint."""
    done = subprocess.run(
        [sys.executable, "-m", "boxgrasp", "select", str(job.path), "--json"]
        + ["--config", str(config), "--cloud-frame", job.setting.cloud_frame, *job.words],
        capture_output=True,
        text=True,
    )
    if done.returncode:
        return done.stderr.strip().splitlines()[-1]
    answer: dict[str, Any] = json.loads(done.stdout)
    return answer


def answered(job: Job, capture: Capture, said: dict[str, Any] | str) -> Answer:
    """The Python answer beside what the command line said."""
    try:
        selection = GraspSelector(job.setting.config).select(capture, job.target)
    except BoxgraspError as error:
        return Answer(None, str(error), isinstance(said, str) and str(error) in said)
    if isinstance(said, str):
        return Answer(selection, f"command line: {said}", False)
    own = json.loads(selection.to_json())
    for side in (own, said):
        del side["timings_ms"], side["capture"]
    return Answer(selection, "", own == said)


def all_answers(jobs: list[Job], processes: int) -> Iterator[tuple[Job, Capture, Answer]]:
    """Every job with its capture and answer, in order."""
    with tempfile.TemporaryDirectory() as place, ThreadPoolExecutor(processes) as pool:
        configs = {}
        for job in jobs:
            configs[job.name] = Path(place) / f"{job.name}.yaml"
            configs[job.name].write_text(json.dumps(job.setting.config), "utf-8")  # JSON is YAML
        said = pool.map(lambda job: by_command_line(job, configs[job.name]), jobs)
        captures: dict[str, Capture] = {}
        for job, words in zip(jobs, said, strict=True):
            if job.name not in captures:
                loaded = load_capture(job.path, cloud_frame=job.setting.cloud_frame)
                captures = {job.name: loaded}
            yield job, captures[job.name], answered(job, captures[job.name], words)


def row_of(job: Job, answer: Answer) -> str:
    """One line of the table; lengths in cm."""
    own, selection = job.reference["own"], answer.selection
    seen = (*(100 * x for x in own["size_xy_m"]), 100 * own["height_m"])
    head = f"{job.name:16s} {job.number:2d}  "
    agree = "same" if answer.same else "DIFFERS"
    if selection is None:
        return f"{head}{'none':6s} {agree:8s} {answer.error}"
    x, y, z = 100 * selection.box.dimensions_m
    T = selection.box.T_base_box
    turn = np.degrees(np.arctan2(T[1, 0], T[0, 0]))
    box = f"{x:5.1f} {y:5.1f} {z:5.1f} {turn:4.0f}  {seen[0]:5.1f} {seen[1]:5.1f} {seen[2]:5.1f}"
    return f"{head}{selection.status:6s} {agree:8s} {box}  {told(selection)}"


def told(selection: Selection) -> str:
    """The grasp and its clearance, or the nearest candidate and what it lacks."""
    assert selection.shown is not None
    name = selection.shown.name
    if selection.grasp is not None and selection.grasp.clearance_m is not None:
        return f"{name}, {100 * selection.grasp.clearance_m:.1f} cm clear"
    return f"nearest {name}: {'; '.join(why.sentence for why in selection.shown.rejections)}"


def plane_of(job: Job, selection: Selection) -> tuple[float, float] | None:
    """Angle (degrees) and distance (m) of the support plane from the reference's."""
    T = selection.T_base_camera
    if T is None or "table_normal_camera" not in job.reference:
        return None
    normal = np.array(job.reference["table_normal_camera"])
    cosine = float(T[2, :3] @ normal / np.linalg.norm(normal))
    angle = float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
    return angle, float(T[2, 3]) - job.reference["table_distance_m"]


def plane_of_scene(name: str, folder: Path) -> tuple[float, float] | None:
    """The plane of a capture without a good target, by whatever object it has."""
    reference = json.loads((folder / "reference.json").read_text("utf-8"))
    if "table_normal_camera" not in reference:
        return None
    capture = load_capture(cloud_of(folder))
    job = Job(name, 0, folder, SETTINGS[name], (), None, reference)
    return plane_of(job, GraspSelector(SETTINGS[name].config).select(capture, Target(object=1)))


def print_settings(names: list[str]) -> None:
    """What each capture needs beyond the defaults, and the head of the table."""
    for name in names:
        setting = SETTINGS[name]
        target = "its mask" if setting.by_mask else "a pixel"
        if setting.cloud_frame == "base":
            target = "a point, cloud frame base"
        print(f"{name:16s} target by {target}; {dict(setting.config) or 'defaults'}")
    print("\nlengths in cm; box: x y z and yaw in degrees; reference: seen short, long, high")


def print_planes(
    names: list[str], root: Path, planes: Mapping[str, tuple[float, float] | None]
) -> None:
    """How far each support plane lies from the reference's."""
    print(f"\nsupport plane from the reference's (bar: {PLANE_DEG} degrees, {100 * PLANE_M} cm)")
    for name in names:
        try:
            off = planes.get(name) or plane_of_scene(name, root / name)
        except BoxgraspError as error:
            print(f"{name:16s} MISSED: {error}")
            continue
        if off is not None:
            held = "held" if off[0] <= PLANE_DEG and abs(off[1]) <= PLANE_M else "MISSED"
            print(f"{name:16s} {off[0]:4.2f} degrees {100 * off[1]:+5.2f} cm  {held}")


def main(argv: list[str] | None = None) -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pictures", metavar="DIR", type=Path, help="draw every answer here")
    parser.add_argument("--only", metavar="NAME", nargs="+", default=list(SETTINGS))
    parser.add_argument("--processes", type=int, default=2)
    args = parser.parse_args(argv)
    root = captures_folder()
    names = [name for name in args.only if (root / name).is_dir()]
    if not names:
        print(f"no real captures in {root}: nothing done (set BOXGRASP_CAPTURES)")
        return
    if args.pictures:
        args.pictures.mkdir(parents=True, exist_ok=True)
    print_settings(names)
    planes: dict[str, tuple[float, float] | None] = {}
    counts = {"grasp": 0, "ask": 0, "none": 0}
    differ = 0
    jobs = [job for name in names for job in jobs_of(name, root / name)]
    for job, capture, answer in all_answers(jobs, args.processes):
        print(row_of(job, answer), flush=True)
        differ += not answer.same
        if not job.setting.by_mask:
            counts[answer.selection.status if answer.selection else "none"] += 1
        if answer.selection is None:
            continue
        planes[job.name] = plane_of(job, answer.selection)
        if args.pictures:
            place = args.pictures / f"{job.name}_{job.number:02d}.png"
            draw_selection(capture, answer.selection, place)
    print(
        f"\n{sum(counts.values())} good targets: {counts['grasp']} grasps (bar: {GRASPS} of 45), "
        f"{counts['ask']} asks, {counts['none']} without an answer; "
        f"command line and Python differ in {differ}"
    )
    print_planes(names, root, planes)


if __name__ == "__main__":
    main()
