"""Whether two versions of the package give the same answers, to the last bit.

    python tools/compare_answers.py BEFORE AFTER [--scenes 300] [--seed 9173] [--captures DIR]

BEFORE and AFTER are folders that hold a checkout. Each answers the same cast scenes (every chosen
ranker in turn) and the objects of every capture in DIR, in a process of its own; the answers are
brought to one set of names (`OLD_NAMES`) and compared field by field as the bits they are. Left
out: wording, timings, the candidate that came nearest in a refusal (counted), and captures that
one of the two refuses (counted).
"""

from __future__ import annotations

import argparse
import hashlib
import importlib
import json
import os
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import Any

# What a schema 1 answer and its numbers were called, by what they are called now.
OLD_NAMES = {
    "visible_clearance": "seen_m",
    "occluded_clearance": "body_m",
    "unseen_distance": "unseen_m",
    "unseen_fraction": "unseen_share",
    "approach_clearance": "approach_m",
    "plane_clearance": "support_m",
    "width": "fits",
    "width_known": "known",
}
RANKERS = ("clearance", "clearance", "cascade-grid", "single-spiral", "top-down")
FITS = ("yaw", "yaw", "yaw", "aligned")
GRASP = ("label", "face", "line", "T_base_gripper", "T_base_tcp", "T_base_pregrasp",
         "position_m", "quaternion_xyzw", "opening_m", "clearance_m")  # fmt: skip


def bits(value: Any) -> Any:
    """A value with every float as its exact bits."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [bits(item) for item in value]
    return value.hex() if isinstance(value, float) else value


def old_answer(selector: Any, capture: Any, target: Any, scene: Any) -> dict[str, Any]:
    """An answer of the version with `options`, by the names of now."""
    sight = selector.sight(capture, target, scene=scene, cells_m=selector._chooser.resolutions_m)
    selection = selector.select(capture, target)
    numbers = sight.situation.numbers
    candidates = [
        {
            "label": option.label,
            "face": option.face,
            "line": option.line,
            "T_base_gripper": bits(option.T_base_gripper),
            "width_m": bits(option.width_m),
            "passed": option.rejected is None,
            "rank": option.preference,
            **{
                new: bits(float(getattr(numbers, old)[k]))
                if old.endswith(("_m", "_share"))
                else bool(getattr(numbers, old)[k])
                for new, old in OLD_NAMES.items()
            },
        }
        for k, option in enumerate(selection.options)
    ]
    grasp = None
    if selection.status == "grasp":
        grasp = {name: bits(getattr(selection, name)) for name in GRASP}
    return {
        "status": selection.status,
        "frame": selection.frame,
        "T_base_camera": bits(selection.T_base_camera),
        "box": [bits(selection.box.T_base_box), bits(selection.box.dimensions_m)],
        "candidates": candidates,
        "grasp": grasp,
        "nearest_label": selection.best_rejected if grasp is None else None,
    }


def new_answer(selector: Any, capture: Any, target: Any) -> dict[str, Any]:
    """An answer of this version."""
    selection = selector.select(capture, target)
    candidates = [
        {
            "label": item.label,
            "face": item.face,
            "line": item.line,
            "T_base_gripper": bits(item.T_base_gripper),
            "width_m": bits(item.width_m),
            "passed": item.passed,
            "rank": item.rank,
            **{
                name: item.checks[name].passed
                if name.startswith("width")
                else bits(item.checks[name].value)
                for name in OLD_NAMES
            },
        }
        for item in selection.candidates
    ]
    grasp = selection.grasp
    return {
        "status": selection.status,
        "frame": selection.frame,
        "T_base_camera": bits(selection.T_base_camera),
        "box": [bits(selection.box.T_base_box), bits(selection.box.dimensions_m)],
        "candidates": candidates,
        "grasp": None if grasp is None else {name: bits(getattr(grasp, name)) for name in GRASP},
        "nearest_label": None if selection.refusal is None else selection.refusal.nearest_label,
    }


def scene_part(scene: Any) -> dict[str, Any]:
    """The objects of a scene and every point's number."""
    labels = scene.labels if hasattr(scene, "labels") else scene.object_numbers
    return {
        "points": hashlib.sha256(scene.points.tobytes()).hexdigest(),
        "numbers": hashlib.sha256(labels.tobytes()).hexdigest(),
        "plane": bits([*scene.plane.normal.tolist(), scene.plane.offset_m]),
    }


def answers(args: argparse.Namespace) -> None:
    """Print one line of JSON a question, answered by the package on the path."""
    import numpy as np

    from boxgrasp import GraspSelector, Target
    from boxgrasp.simulate import draw_scene, to_capture

    package: Any = importlib.import_module("boxgrasp")
    old = not hasattr(package, "load_capture")
    load_capture = package.Capture.load if old else package.load_capture
    selectors: dict[str, Any] = {}

    def selector_of(**config: Any) -> Any:
        key = json.dumps(config, sort_keys=True)
        if key not in selectors:
            if old and "ranker" in config:
                config["chooser"] = config.pop("ranker")
            if old and "scene" in config:
                config["scene"] = {"far_m": config["scene"]["max_range_m"]}
            selectors[key] = GraspSelector(config)
        return selectors[key]

    def ask(name: str, capture: Any, target: Any, config: dict[str, Any]) -> None:
        selector = selector_of(**config)
        line: dict[str, Any] = {"question": name}
        try:
            scene = selector.scene(capture)
            line |= scene_part(scene)
            line |= (
                old_answer(selector, capture, target, scene)
                if old
                else new_answer(selector, capture, target)
            )
        except Exception as error:
            line["error"] = type(error).__name__
            line["said"] = str(error)
        print(json.dumps(line), flush=True)

    for k in range(args.scenes):
        rng = np.random.default_rng((args.seed, k))
        capture: Any = to_capture(draw_scene(rng), rng, noise=k % 5 != 4)[0]
        config = {"ranker": RANKERS[k % 5], "box": {"fit": FITS[k % 4]}}
        digest = hashlib.sha256(capture.depth.tobytes()).hexdigest()[:16]
        ask(f"cast {k} {digest}", capture, None, config)
    for path in sorted(Path(args.captures).iterdir()) if args.captures else ():
        inner = next((path / n for n in ("cloud.pcd", "cloud.ply") if (path / n).exists()), path)
        if path.is_dir() and (path / "depth.png").exists():
            inner = path
        elif path.suffix not in ("", ".npz", ".pcd", ".ply"):
            continue
        for frame in ("optical", "base") if inner.suffix in (".pcd", ".ply") else ("optical",):
            reach = {"scene": {"max_range_m": 2.6}} if "milk" in path.name else {}
            try:
                capture = load_capture(inner, cloud_frame=frame)
                objects = len(selector_of(**reach).objects(capture))
            except Exception as error:
                print(json.dumps({"question": f"{path.name} {frame}", "error": str(error)}))
                continue
            if capture.mask is not None or capture.target_pixel is not None:
                ask(f"{path.name} {frame} own", capture, None, reach)
            for number in range(1, objects + 1):
                ask(f"{path.name} {frame} {number}", capture, Target(object=number), reach)


def run(checkout: str, args: argparse.Namespace) -> dict[str, dict[str, Any]]:
    """The answers of one checkout by question."""
    source = str(Path(checkout).resolve() / "src")
    words = [sys.executable, __file__, "--answer", "--scenes", str(args.scenes)]
    words += ["--seed", str(args.seed), *(["--captures", args.captures] if args.captures else [])]
    done = subprocess.run(
        words, env={**os.environ, "PYTHONPATH": source}, capture_output=True, text=True
    )
    if done.returncode:
        raise SystemExit(f"{checkout}: {done.stderr}")
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    return {line["question"]: line for line in lines}


def differences(before: Any, after: Any, place: str = "") -> list[str]:
    """The paths at which two plain values differ."""
    if isinstance(before, dict) and isinstance(after, dict):
        keys = sorted({*before, *after})
        return [d for k in keys for d in differences(before.get(k), after.get(k), f"{place}.{k}")]
    if isinstance(before, list) and isinstance(after, list) and len(before) == len(after):
        pairs = enumerate(zip(before, after, strict=True))
        return [d for k, (a, b) in pairs for d in differences(a, b, f"{place}[{k}]")]
    return [] if before == after else [place.lstrip(".")]


def main() -> int:
    """Compare, print the counts, and end with 1 where anything differs."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("checkouts", nargs="*", metavar="BEFORE AFTER")
    parser.add_argument("--scenes", type=int, default=300)
    parser.add_argument("--seed", type=int, default=9173)
    parser.add_argument("--captures", metavar="DIR")
    parser.add_argument("--keep", metavar="DIR", help="read and write BEFORE's answers here")
    parser.add_argument("--answer", action="store_true", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.answer:
        answers(args)
        return 0
    if len(args.checkouts) != 2:
        parser.error("two checkouts are needed: BEFORE AFTER")
    kept = Path(args.keep) / f"before-{args.seed}-{args.scenes}.json" if args.keep else None
    if kept and kept.exists():
        before = json.loads(kept.read_text("utf-8"))
    else:
        before = run(args.checkouts[0], args)
        if kept:
            kept.write_text(json.dumps(before), "utf-8")
    after = run(args.checkouts[1], args)
    counts: Counter[str] = Counter()
    nearest = 0
    for question in sorted({*before, *after}):
        a, b = before.get(question, {}), after.get(question, {})
        counts["questions"] += 1
        if "error" in a or "error" in b:
            same = a.get("error") == b.get("error")
            counts["refused by both" if same else "refused by one"] += 1
            if not same:
                print(f"{question}: {a.get('said', 'answered')} | {b.get('said', 'answered')}")
            continue
        counts[f"answered: {a['status']}"] += 1
        nearest += a.pop("nearest_label") != b.pop("nearest_label")
        found = differences(a, b)
        counts["different"] += bool(found)
        for place in found[:3]:
            print(f"{question}: {place}")
    for name, count in sorted(counts.items()):
        print(f"{count:6d} {name}")
    print(f"{nearest:6d} with another nearest candidate (not compared)")
    return int(bool(counts["different"] or counts["refused by one"]))


if __name__ == "__main__":
    sys.exit(main())
