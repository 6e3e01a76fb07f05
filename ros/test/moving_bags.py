"""Bags of a camera that moves: views at times other than those of the transforms."""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from scenes import BASE, organized_points

from boxgrasp import Capture
from boxgrasp.geometry.transforms import invert, make_transform, quaternion_xyzw
from boxgrasp.simulate import demo_scene, to_capture

sys.path.append(str(Path(__file__).parents[2] / "tests"))
from bag_files import BagMaker  # type: ignore[import-not-found]

ARM, CAMERA = "tool0", "camera_optical_frame"
CLOUD, DEPTH, PACKED = "/camera/points", "/camera/depth/image_raw", "/camera/depth/compressedDepth"
START_S, EVERY_S = 100.0, 0.1
COLOR_EARLIER_S = 0.013
TARGET_POINT = (0.82, -0.01, 0.95)  # in the cereal box of `demo_scene`
_TF_EVERY_S, _TF_LATER_S = 0.07, 0.01


def arm_pose(stamp: float) -> np.ndarray:
    """T_base_arm: on a line, turning steadily about z, so that interpolation is exact."""
    t = stamp - START_S
    c, s = np.cos(0.05 * t), np.sin(0.05 * t)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return make_transform(turn, np.array([0.02 * t, 0.03 * t, -0.03 * t]))


@cache
def arm_from_camera() -> np.ndarray:
    """T_arm_camera: at the start the camera stands as the demo's does."""
    return np.asarray(invert(arm_pose(START_S)) @ demo_scene().T_base_camera)


@cache
def cast_view(number: int) -> Capture:
    """The demo's table from where the camera is at a frame's time, with noise; it zooms."""
    T, zoom = arm_pose(START_S + EVERY_S * number) @ arm_from_camera(), 1 + 0.01 * (number // 3)
    K = demo_scene().intrinsics * [[zoom], [zoom], [1]]
    scene = dataclasses.replace(demo_scene(), T_base_camera=T, intrinsics=K)
    return to_capture(scene, np.random.default_rng(number))[0]


def cast_bag(kind: str, folder: Path, frames: int = 4, topics: Iterable[str] = (DEPTH,)) -> Path:
    """Views of the demo's table, a frame each `EVERY_S`; color comes a little before depth."""
    maker = BagMaker(kind)
    end = START_S + EVERY_S * frames
    for stamp in np.arange(START_S - _TF_EVERY_S / 2, end, _TF_EVERY_S).tolist():
        add_pose(maker, stamp, arm_pose(stamp), BASE, ARM)
    add_pose(maker, START_S, arm_from_camera(), ARM, CAMERA, static=True)
    for number in range(frames):
        add_view(maker, START_S + EVERY_S * number, cast_view(number), topics)
    return written(maker, folder)


def add_pose(
    maker: BagMaker,
    stamp: float,
    T: np.ndarray,
    parent: str,
    child: str,
    *,
    static: bool = False,
) -> None:
    """A transform, recorded a little later than it was true."""
    turn = quaternion_xyzw(T[:3, :3])
    maker.tf(stamp + _TF_LATER_S, (parent, child, stamp, T[:3, 3], turn), static=static)


def add_view(maker: BagMaker, stamp: float, seen: Capture, topics: Iterable[str]) -> None:
    """A view on each of the topics, with camera and color beside depth."""
    assert seen.depth is not None and seen.intrinsics is not None
    height, width = seen.depth.shape
    millimeters = np.round(np.nan_to_num(seen.depth) * 1000).astype(np.uint16)
    if seen.rgb is not None:
        color_stamp = stamp - COLOR_EARLIER_S
        maker.image("/camera/color/image_raw", color_stamp, seen.rgb, "rgb8", frame_id=CAMERA)
    maker.info("/camera/camera_info", stamp, seen.intrinsics, size=(width, height))
    maker.info("/camera/depth/camera_info", stamp, seen.intrinsics, size=(width, height))
    if DEPTH in topics:
        maker.image(DEPTH, stamp, millimeters, "16UC1", padding=6, frame_id=CAMERA)
    if PACKED in topics:
        maker.compressed_depth(PACKED, stamp, millimeters)
    if CLOUD in topics:
        maker.cloud(CLOUD, stamp, organized_points(seen), rgb=seen.rgb, frame_id=CAMERA)


def written(maker: BagMaker, folder: Path) -> Path:
    """The bag's path, its messages in the order in which they were recorded."""
    maker.messages.sort(key=lambda message: message[2])
    folder.mkdir(parents=True, exist_ok=True)
    path: Path = maker.write(folder)
    return path


def plain(answer: dict[str, Any]) -> dict[str, Any]:
    """An answer but for what is not the same live and offline: times, and where it comes from."""
    return {**answer, "timings_ms": None, "capture": None}
