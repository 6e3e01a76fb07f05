"""Random and malformed messages: whatever the types allow."""

from __future__ import annotations

import array
import random
from collections.abc import Callable
from typing import Any

from boxgrasp_msgs.msg import Target, View
from octomap_msgs.msg import Octomap
from scenes import (
    CAMERA,
    camera_info,
    cloud,
    color_image,
    depth_image,
    mask_image,
    pixel_target,
    table,
    transform,
)
from sensor_msgs.msg import CompressedImage, PointField

_NUMBERS = (0.0, -1.0, 1e-300, 1e300, float("nan"), float("inf"), float("-inf"))
_TEXTS = ("", "x", "\x00", "16UC1", "32FC1", "rgb8", "/" * 50, "é\n", "16UC1; compressedDepth rvl")
_TYPES = {"string": _TEXTS, "double": _NUMBERS, "boolean": (True, False)}


def random_view(rng: random.Random) -> View:
    """A request's view with some fields of it broken."""
    capture, stamp = table(), rng.choice((0, 5 * 10**9, 10**15))
    view = View()
    if rng.random() < 0.5:
        view.cloud = cloud(capture, stamp)
    else:
        view.depth = depth_image(capture, stamp)
        view.camera_info = camera_info(capture, stamp)
        if rng.random() < 0.3:
            view.color = color_image(capture, stamp)
        if rng.random() < 0.3:
            view.robot_mask = mask_image(capture.depth > rng.random() * 2, stamp)
    for _ in range(rng.randint(1, 4)):
        break_one(rng, view)
    return view


def random_target(rng: random.Random) -> Target:
    """A target with some fields broken."""
    target = pixel_target(table())
    target.kind = rng.randrange(8)
    for _ in range(rng.randint(0, 3)):
        break_one(rng, target)
    return target


def random_message(rng: random.Random) -> tuple[str, Any]:
    """A message of one of the node's topics, broken, and the topic."""
    capture, stamp = table(), rng.choice((0, 5 * 10**9, 10**15))
    kinds: dict[str, Callable[[], Any]] = {
        "cloud": lambda: cloud(capture, stamp),
        "depth": lambda: depth_image(capture, stamp),
        "compressed_depth": lambda: _compressed(rng),
        "camera_info": lambda: camera_info(capture, stamp),
        "color": lambda: color_image(capture, stamp),
        "robot_mask": lambda: mask_image(capture.depth > 1, stamp),
        "octomap": lambda: _octomap(rng),
        "tf": lambda: transform(capture.T_base_camera, stamp, child=rng.choice((CAMERA, "x"))),
        "tf_static": lambda: transform(capture.T_base_camera, stamp, child=f"f{rng.random()}"),
        "target": lambda: random_target(rng),
    }
    topic = rng.choice(tuple(kinds))
    message = kinds[topic]()
    for _ in range(rng.randint(0, 4)):
        break_one(rng, message)
    return topic, message


def _compressed(rng: random.Random) -> CompressedImage:
    data = rng.randbytes(rng.randrange(200))
    return CompressedImage(format=rng.choice(_TEXTS), data=array.array("B", data))


def _octomap(rng: random.Random) -> Octomap:
    data = array.array("b", rng.randbytes(rng.randrange(400)))
    known = Octomap(binary=rng.random() < 0.5, id="OcTree", resolution=0.03, data=data)
    known.header.frame_id = rng.choice(("base_link", "", "map"))
    return known


def break_one(rng: random.Random, message: Any) -> None:
    """Change one field somewhere in a message to what its type allows."""
    kinds = message.get_fields_and_field_types()
    name, kind = rng.choice(tuple(kinds.items()))
    value = getattr(message, name)
    if hasattr(value, "get_fields_and_field_types"):
        break_one(rng, value)
    elif kind in _TYPES:
        setattr(message, name, rng.choice(_TYPES[kind]))
    elif kind.startswith(("int", "uint")) and isinstance(value, int):
        bits = int(kind.removeprefix("u").removeprefix("int"))
        top = 2 ** (bits if kind[0] == "u" else bits - 1) - 1
        least = 0 if kind[0] == "u" else -top - 1
        setattr(message, name, rng.choice((least, top, 1, rng.randint(least, top))))
    elif kind.startswith("sequence<uint8") or kind.startswith("sequence<int8"):
        cut = value[: rng.randrange(len(value) + 1)]
        for _ in range(min(20, len(cut))):
            cut[rng.randrange(len(cut))] = rng.randrange(127)
        setattr(message, name, cut)
    elif "double[" in kind:
        numbers = [rng.choice((*_NUMBERS, rng.uniform(-1e3, 1e3))) for _ in range(len(value))]
        setattr(message, name, numbers)
    elif kind == "sequence<double>":
        setattr(message, name, [rng.choice(_NUMBERS) for _ in range(rng.randrange(20))])
    elif kind == "sequence<sensor_msgs/PointField>":
        setattr(message, name, [_point_field(rng) for _ in range(rng.randrange(6))])
    elif isinstance(value, list) and value:
        break_one(rng, rng.choice(value))


def _point_field(rng: random.Random) -> PointField:
    return PointField(
        name=rng.choice(("x", "y", "z", "rgb", "", "intensity")),
        offset=rng.choice((0, 4, 8, 12, 2**32 - 1)),
        datatype=rng.randrange(12),
        count=rng.choice((0, 1, 3, 2**32 - 1)),
    )
