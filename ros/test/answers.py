"""Answers to cast views that several tests share, and rules that every message keeps."""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import Header

from boxgrasp import Capture, GraspSelector, Selection, Target, load_capture
from boxgrasp.selector import SceneAnalysis
from boxgrasp.simulate import build_scene, to_capture

HEADER = Header(frame_id="base_link")
HEADER.stamp.sec, HEADER.stamp.nanosec = 12, 345

Answer = tuple[SceneAnalysis, Selection]


def cast(target: tuple[Any, ...], *obstacles: tuple[Any, ...]) -> Capture:
    """The exact view of a table with a target and obstacles, each name, x, y, yaw."""
    things = [
        {"name": name, "x": x, "y": y, "z": 0.0, "yaw": yaw, "color": [200, 60 + 40 * k, 50]}
        for k, (name, x, y, yaw) in enumerate((target, *obstacles))
    ]
    camera = {"position": [0.10, 0.0, 1.40], "gaze": [0.85, 0.0, 0.85]}
    spec = {"target": things[0], "obstacles": things[1:], "camera": camera}
    return to_capture(build_scene(spec), noise=False)[0]


def answer_to(
    capture: Capture,
    target: Target | None = None,
    ranker: str = "clearance",
    hand: str = "thesis",
) -> Answer:
    """An answer with what it rests on."""
    selector = GraspSelector({"ranker": ranker, "gripper": hand})
    analysis = selector.analyze(capture, target)
    return analysis, selector.choose(analysis)


@cache
def answer(kind: str) -> Answer:
    """A `grasp` or an `ask`, both beside obstacles."""
    if kind == "grasp":
        return answer_to(cast(("green_cube", 0.85, 0.0, 0.3), ("beans_can", 0.80, 0.22, 0.0)))
    tubes = [("crisps_tube", 0.85 + x, y, 0.0) for x, y in ((0.09, 0), (0, 0.09), (0, -0.09))]
    return answer_to(cast(("green_cube", 0.85, 0.0, 0.0), *tubes))


def real_answer(name: str, number: int) -> Answer:
    """An answer to a real capture, which does not ship with the package."""
    beside = Path(__file__).resolve().parents[3] / "shared"
    folder = Path(os.environ.get("BOXGRASP_SHARED", beside)) / "captures" / name
    if not folder.is_dir():
        pytest.skip(f"no real capture in {folder} (set BOXGRASP_SHARED)")
    return answer_to(load_capture(folder), Target(object=number))


@contextmanager
def checked_fields() -> Iterator[None]:
    """Messages that check the type and range of what is set, which robots leave out for speed."""
    name = "ros_python_check_fields"
    modules = [module for module in list(sys.modules.values()) if name in vars(module)]
    before = [getattr(module, name) for module in modules]
    for module in modules:
        setattr(module, name, "1")
    yield
    for module, value in zip(modules, before, strict=True):
        setattr(module, name, value)


def told(message: Any) -> Any:
    """A message as nested maps and lists; NaN as text, for it equals nothing."""
    if hasattr(message, "get_fields_and_field_types"):
        names = message.get_fields_and_field_types()
        return {name: told(getattr(message, name)) for name in names}
    if isinstance(message, list | tuple) or hasattr(message, "tolist"):
        return [told(item) for item in message]
    return "nan" if isinstance(message, float) and math.isnan(message) else message


def sent(message: Any) -> Any:
    """The message as it arrives at another node."""
    return deserialize_message(serialize_message(message), type(message))


def matrix(pose: Any) -> np.ndarray:
    """(4, 4) of a pose; its quaternion must be one."""
    x, y, z, w = (getattr(pose.orientation, name) for name in "xyzw")
    assert abs(x * x + y * y + z * z + w * w - 1) < 1e-9
    T = np.eye(4)
    T[:3, :3] = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    )
    T[:3, 3] = xyz(pose.position)
    return T


def xyz(of: Any) -> np.ndarray:
    """(3,) of a point or vector."""
    return np.array((of.x, of.y, of.z))
