"""A bag of 30 frames with TF, replayed live and read offline: the same 30 selections.

    .venv-ros/bin/python ros/benchmarks/bag_equality.py [--frames 30] [--cast]

The node and `replay` are processes of their own; offline each frame is read by `load_capture` and
answered in Python. All of the JSON must be equal but for timings and the capture's name; a frame
that cannot be answered must fail in the same words. The bag holds real captures in turn, each with
its own camera, where they lie in BOXGRASP_CAPTURES, else in ../shared/captures beside the
repository; else, or with --cast, cast views from a camera that moves. Transforms move between the
frames' times. Printed is how many are equal, for clouds, raw depth and compressed depth.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import _node
import numpy as np

BESIDE = _node.ROOT.parent / "shared" / "captures"
MARGIN_S = 0.03  # between a real frame and the transforms before and after it


def main() -> int:
    """Write the bag, replay it, compare, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=30)
    parser.add_argument("--cast", action="store_true", help="whatever captures there are")
    args = parser.parse_args()
    from moving_bags import CLOUD, DEPTH, PACKED, cast_bag

    captures = Path(os.environ.get("BOXGRASP_CAPTURES", BESIDE))
    topics, missing = (CLOUD, DEPTH, PACKED), 0
    reliable = ("cloud", "depth", "compressed_depth", "camera_info", "color")
    given = [f"qos_overrides./{topic}.subscription.reliability:=reliable" for topic in reliable]
    given += ["use_sim_time:=true", "publish_markers:=false"]
    with tempfile.TemporaryDirectory() as folder:
        if captures.is_dir() and not args.cast:
            bag = real_bag(captures, Path(folder), args.frames, topics)
        else:
            bag = cast_bag("mcap", Path(folder), args.frames, topics)
        with _node.running(*(word for item in given for word in ("-p", item))):
            for topic in topics:
                missing += compared(bag, topic, args.frames)
    return 1 if missing else 0


def compared(bag: Path, topic: str, frames: int) -> int:
    """Print how many answers of a topic are the same; how many are not."""
    from moving_bags import plain

    live, offline = list(live_answers(bag, topic)), list(offline_answers(bag, topic))
    answered = sum("error" not in answer for answer in offline)
    grasps = sum(answer.get("status") == "grasp" for answer in offline)
    same = 0
    for number, (ours, theirs) in enumerate(zip(live, offline, strict=False)):
        if plain(ours) == plain(theirs):
            same += 1
            continue
        names = [name for name in theirs if plain(ours).get(name) != plain(theirs)[name]]
        print(f"  frame {number} differs in {', '.join(names)} {ours.get('error', '')}")
    print(f"{topic}: {same} of {frames} equal; {answered} answered, {grasps} of them grasps")
    return frames - same


def live_answers(bag: Path, topic: str) -> Iterator[dict[str, Any]]:
    """What the node answers, by `replay`."""
    words = ("--topic", topic, "--object", "1", "--json", "--timeout", "90")
    done = subprocess.run(
        [sys.executable, "-m", "boxgrasp_ros.replay", str(bag), *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,  # in the answers too
        text=True,
    )
    for line in done.stdout.splitlines():
        yield json.loads(line)


def offline_answers(bag: Path, topic: str) -> Iterator[dict[str, Any]]:
    """What the library answers."""
    from scenes import BASE

    from boxgrasp import BoxgraspError, GraspSelector, Target, load_capture
    from boxgrasp.io.bag import read_frames

    selector = GraspSelector()
    for frame in read_frames(bag, topic):
        try:
            capture = load_capture(bag, topic=topic, stamp=frame.stamp_ns * 1e-9, base_frame=BASE)
            answer = selector.select(capture, Target(object=1))
        except BoxgraspError as error:
            yield {"error": str(error).removeprefix(f"{bag}: ")}
        else:
            yield json.loads(answer.to_json())


def real_bag(captures: Path, folder: Path, frames: int, topics: tuple[str, ...]) -> Path:
    """Real captures in turn, from a camera that moves with its arm."""
    from moving_bags import (
        ARM,
        BASE,
        CAMERA,
        EVERY_S,
        START_S,
        BagMaker,
        add_pose,
        add_view,
        arm_from_camera,
        arm_pose,
        written,
    )

    from boxgrasp import load_capture
    from boxgrasp.geometry.transforms import invert

    seen = []
    for place in sorted(captures.iterdir()):
        if (place / "depth.png").exists() and (place / "reference.json").exists():
            reference = json.loads((place / "reference.json").read_text())
            pose = np.array(reference["T_base_camera"], float)
            seen.append((load_capture(place), pose))
    maker, to_arm = BagMaker("mcap"), invert(arm_from_camera())
    add_pose(maker, START_S, np.asarray(arm_from_camera()), ARM, CAMERA, static=True)
    for number in range(frames):
        capture, pose = seen[number % len(seen)]
        stamp = START_S + EVERY_S * number
        for at in (stamp - MARGIN_S, stamp + MARGIN_S / 2):
            add_pose(maker, at, arm_pose(at) @ pose @ to_arm, BASE, ARM)
        add_view(maker, stamp, capture, topics)
    return written(maker, folder)


if __name__ == "__main__":
    sys.exit(main())
