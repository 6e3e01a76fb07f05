"""Views as ROS messages: a cast table as depth with its camera, or as a cloud, with transforms."""

from __future__ import annotations

import array
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from boxgrasp_msgs.msg import Target
from builtin_interfaces.msg import Time
from geometry_msgs.msg import TransformStamped
from sensor_msgs.msg import CameraInfo, Image, PointCloud2, PointField
from tf2_msgs.msg import TFMessage

from boxgrasp import Capture
from boxgrasp.geometry.transforms import quaternion_xyzw
from boxgrasp.simulate import demo_capture, demo_scene, to_capture
from boxgrasp.simulate.camera import look_at

BASE, CAMERA = "base_link", "camera_depth_optical_frame"


@cache
def table() -> Capture:
    """A cast table with a target pixel."""
    return demo_capture()


@cache
def table_from(x: float, y: float, z: float) -> Capture:
    """The same table, seen from another place."""
    moved = replace(demo_scene(), T_base_camera=look_at((x, y, z), (0.86, 0.0, 0.87)))
    return to_capture(moved, noise=False)[0]


def time_of(stamp_ns: int) -> Time:
    """A stamp."""
    return Time(sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)


def _filled(message: Any, stamp_ns: int, frame: str) -> Any:
    message.header.stamp, message.header.frame_id = time_of(stamp_ns), frame
    return message


def _bytes(values: np.ndarray) -> array.array:
    return array.array("B", np.ascontiguousarray(values).tobytes())


def depth_image(capture: Capture, stamp_ns: int, frame: str = CAMERA) -> Image:
    """The depth of a capture, 32FC1."""
    height, width = capture.depth.shape
    message = Image(height=height, width=width, encoding="32FC1", step=4 * width)
    message.data = _bytes(capture.depth.astype("<f4"))
    return _filled(message, stamp_ns, frame)


def color_image(capture: Capture, stamp_ns: int, frame: str = CAMERA) -> Image:
    """Its colors, rgb8."""
    height, width, _ = capture.rgb.shape
    message = Image(height=height, width=width, encoding="rgb8", step=3 * width)
    message.data = _bytes(capture.rgb)
    return _filled(message, stamp_ns, frame)


def mask_image(mask: np.ndarray, stamp_ns: int, frame: str = CAMERA) -> Image:
    """A mask, mono8."""
    height, width = mask.shape
    message = Image(height=height, width=width, encoding="mono8", step=width)
    message.data = _bytes(mask.astype(np.uint8) * 255)
    return _filled(message, stamp_ns, frame)


def camera_info(capture: Capture, stamp_ns: int, frame: str = CAMERA) -> CameraInfo:
    """Its camera, without distortion."""
    height, width = capture.depth.shape
    message = CameraInfo(height=height, width=width, distortion_model="plumb_bob", d=[0.0] * 5)
    message.k = capture.intrinsics.reshape(-1).tolist()
    message.p = np.hstack((capture.intrinsics, np.zeros((3, 1)))).reshape(-1).tolist()
    return _filled(message, stamp_ns, frame)


def organized_points(capture: Capture) -> np.ndarray:
    """(H, W, 3) float32, camera frame, NaN where missing."""
    height, width = capture.depth.shape
    v, u = np.mgrid[:height, :width].astype(np.float64)
    fx, fy, cx, cy = (capture.intrinsics[at] for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
    z = np.where(capture.depth > 0, capture.depth, np.nan).astype(np.float64)
    points = np.stack(((u - cx) / fx * z, (v - cy) / fy * z, z), axis=-1)
    return points.astype(np.float32)


def cloud(capture: Capture, stamp_ns: int, frame: str = CAMERA) -> PointCloud2:
    """An organized cloud with colors, 16 bytes a point."""
    points = organized_points(capture)
    height, width, _ = points.shape
    layout = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("rgb", "<u4")])
    packed = np.zeros((height, width), layout)
    for k, axis in enumerate("xyz"):
        packed[axis] = points[..., k]
    if capture.rgb is not None:
        red, green, blue = (capture.rgb[..., k].astype(np.uint32) for k in range(3))
        packed["rgb"] = red << 16 | green << 8 | blue
    message = PointCloud2(height=height, width=width, point_step=16, row_step=16 * width)
    kinds = (PointField.FLOAT32,) * 3 + (PointField.UINT32,)
    message.fields = [
        PointField(name=name, offset=4 * k, datatype=kind, count=1)
        for k, (name, kind) in enumerate(zip(("x", "y", "z", "rgb"), kinds, strict=True))
    ]
    message.data = _bytes(packed)
    return _filled(message, stamp_ns, frame)


def transform(T: np.ndarray, stamp_ns: int, parent: str = BASE, child: str = CAMERA) -> Any:
    """A transform with its frames, as /tf has it."""
    stamped = _filled(TransformStamped(child_frame_id=child), stamp_ns, parent)
    at, turn = stamped.transform.translation, stamped.transform.rotation
    at.x, at.y, at.z = T[:3, 3].tolist()
    turn.x, turn.y, turn.z, turn.w = quaternion_xyzw(T[:3, :3]).tolist()
    return TFMessage(transforms=[stamped])


def pixel_target(capture: Capture) -> Target:
    """The capture's own target, by its pixel."""
    u, v = capture.target_pixel
    return Target(kind=Target.PIXEL, u=u, v=v)
