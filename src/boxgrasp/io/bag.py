"""One message out of a ROS 1 bag, a ROS 2 bag or an MCAP file, through rosbags.

Messages are decoded with the library's own definitions of sensor_msgs, never with those that
the bag carries: rosbags turns a bag's definitions into Python code.
"""

from __future__ import annotations

import io
import math
import struct
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from boxgrasp.errors import CaptureError, CodedWarning
from boxgrasp.io.colors import unpack_rgb
from boxgrasp.io.extent import MAX_PIXELS, validate_cloud_size
from boxgrasp.io.images import read_depth_png
from boxgrasp.sensing.capture import Capture
from boxgrasp.sensing.validation import CloudFrame

_CLOUD: Final = "sensor_msgs/msg/PointCloud2"
_IMAGE: Final = "sensor_msgs/msg/Image"
_COMPRESSED: Final = "sensor_msgs/msg/CompressedImage"
_INFO: Final = "sensor_msgs/msg/CameraInfo"
_DEPTH_ENCODINGS: Final = {"16UC1": ("u2", 0.001), "mono16": ("u2", 0.001), "32FC1": ("f4", 1.0)}
_COLOR_ENCODINGS: Final = {"rgb8": (3, 1), "bgr8": (3, -1), "rgba8": (4, 1), "bgra8": (4, -1)}
_POINT_TYPES: Final = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
_COMPRESSED_HEADER: Final = 12  # of compressed_depth_image_transport, before the PNG
_NEAR_S: Final = 1.0  # how far from the bag's messages a stamp may lie
_COLOR_NEAR_S: Final = 0.1  # between depth and the color image beside it
_WINDOW_NS: Final = 2_000_000_000  # round a message, in which those beside it were recorded
_TRIES: Final = 20  # messages of a topic before it is given up


@dataclass(frozen=True)
class _Message:
    """A message not decoded yet: its topic, type, stamp (s, its header's), and bytes.

    `recorded` is when the bag got it, in ns, the only time by which a bag can be searched.
    """

    topic: str
    kind: str
    stamp: float
    recorded: int
    raw: bytes


@dataclass(frozen=True)
class _Bag:
    """An open bag: topics by message type, and how to read and decode.

    `read` takes topics, and the message whose neighbors in time are wanted, or None for all.
    """

    topics: dict[str, list[str]]
    read: Callable[[Iterable[str], _Message | None], Iterator[_Message]]
    decode: Callable[[_Message], Any]


def load_bag(
    path: Path, cloud_frame: CloudFrame, topic: str | None, stamp: float | None
) -> Capture:
    """A capture of a PointCloud2, or of a depth Image with its CameraInfo.

    Args:
        path: a .bag, .db3 or .mcap file, or a ROS 2 bag's folder.
        cloud_frame: 'optical' or 'base', of a cloud's points.
        topic: of the message; None for the first that can be used, in the bag's order.
        stamp: the message on its topic that is nearest in time is taken, s; None for the first.

    Returns:
        The capture.

    Raises:
        CaptureError: damaged, no such topic or time, or no usable message.
        ImportError: rosbags is not installed.
    """
    if stamp is not None and not math.isfinite(stamp):
        raise CaptureError(f"stamp is {stamp}; valid: seconds, finite")
    from rosbags.rosbag1 import Reader as Reader1  # the extra `io`
    from rosbags.rosbag2 import Reader as Reader2
    from rosbags.typesys import Stores, get_typestore

    ros2 = path.suffix.lower() != ".bag"
    store = get_typestore(Stores.ROS2_HUMBLE if ros2 else Stores.ROS1_NOETIC)
    reader: Any = Reader2(path) if ros2 else Reader1(path)
    reader.open()
    with closing(reader):
        by_kind: dict[str, list[str]] = {}
        for connection in reader.connections:
            by_kind.setdefault(connection.msgtype, []).append(connection.topic)

        def read(topics: Iterable[str], near: _Message | None) -> Iterator[_Message]:
            names = set(topics)
            wanted = [c for c in reader.connections if c.topic in names]
            if not wanted:  # rosbags takes no connection for every connection
                return
            start = near.recorded - _WINDOW_NS if near is not None else None
            stop = near.recorded + _WINDOW_NS if near is not None else None
            for connection, recorded, raw in reader.messages(wanted, start, stop):
                stamped = _stamp(raw, ros2)
                yield _Message(connection.topic, connection.msgtype, stamped, recorded, bytes(raw))

        def decode(message: _Message) -> Any:
            decoder = store.deserialize_cdr if ros2 else store.deserialize_ros1
            return decoder(message.raw, message.kind)

        return _capture(_Bag(by_kind, read, decode), cloud_frame, topic, stamp)


def _stamp(raw: bytes, ros2: bool) -> float:
    """Seconds in the header with which every message used here starts."""
    if ros2:
        seconds, nanoseconds = struct.unpack_from("<iI" if raw[1] & 1 else ">iI", raw, 4)
    else:
        seconds, nanoseconds = struct.unpack_from("<II", raw, 4)
    return float(seconds) + float(nanoseconds) * 1e-9


def _capture(bag: _Bag, cloud_frame: CloudFrame, topic: str | None, stamp: float | None) -> Capture:
    usable = sorted({name for kind in (_CLOUD, _IMAGE) for name in bag.topics.get(kind, [])})
    usable += sorted(n for n in bag.topics.get(_COMPRESSED, []) if n.endswith("/compressedDepth"))
    listed = ", ".join(usable) or "none (a PointCloud2, or a depth Image with CameraInfo)"
    if topic is not None and topic not in usable:
        raise CaptureError(f"bag has no cloud or image on topic {topic!r}; valid: {listed}")
    if topic is not None and stamp is not None:
        return _nearest_capture(bag, topic, cloud_frame, stamp)
    reason, tries = "", Counter[str]()
    for message in bag.read(usable if topic is None else [topic], None):
        if tries[message.topic] == _TRIES:
            continue
        try:
            capture = _read_message(bag, message, cloud_frame)
        except CaptureError as error:
            tries[message.topic] += 1
            reason = reason or f"{message.topic}: {error}"
            continue
        if stamp is None:
            return capture
        return _nearest_capture(bag, message.topic, cloud_frame, stamp)
    raise CaptureError(reason or f"bag has no message to use; topics: {listed}")


def _nearest_capture(bag: _Bag, topic: str, cloud_frame: CloudFrame, stamp: float) -> Capture:
    message, first, last = _nearest(bag.read([topic], None), stamp)
    if message is None or not first - _NEAR_S <= stamp <= last + _NEAR_S:
        raise CaptureError(f"stamp {stamp} is not on topic {topic}; valid: {first} to {last}")
    return _read_message(bag, message, cloud_frame)


def _nearest(messages: Iterable[_Message], stamp: float) -> tuple[_Message | None, float, float]:
    """The message nearest in time, the earlier of two as near; first and last stamp."""
    best, first, last = None, math.inf, -math.inf
    for message in messages:
        first, last = min(first, message.stamp), max(last, message.stamp)
        if best is None or abs(message.stamp - stamp) < abs(best.stamp - stamp):
            best = message
    return best, first, last


def _read_message(bag: _Bag, message: _Message, cloud_frame: CloudFrame) -> Capture:
    if message.kind == _CLOUD:
        return _cloud(bag.decode(message), cloud_frame)
    decoded = bag.decode(message)
    if message.kind == _COMPRESSED:
        depth, topic = _compressed_depth(decoded), message.topic.removesuffix("/compressedDepth")
    else:
        depth, topic = _depth(decoded), message.topic
    size = (depth.shape[1], depth.shape[0])
    intrinsics = _intrinsics(bag, topic, message, size)
    rgb = _rgb(bag, message, size, str(decoded.header.frame_id))
    return Capture(depth, intrinsics, rgb=rgb)


def _pixels(image: Any, kind: str, channels: int) -> NDArray[Any]:
    """(H, W, channels) of a sensor_msgs/Image, its rows cut to the width."""
    width, height, step = int(image.width), int(image.height), int(image.step)
    row = np.dtype(kind).itemsize * channels * width
    if not 0 < width * height <= MAX_PIXELS or step < row or len(image.data) < step * height:
        raise CaptureError(
            f"image of {width} x {height} in rows of {step} bytes does not fit its "
            f"{len(image.data)} bytes; truncated?"
        )
    rows = np.frombuffer(bytes(image.data), np.uint8, step * height).reshape(height, step)
    order = ">" if image.is_bigendian else "<"
    cut = np.ascontiguousarray(rows[:, :row]).view(np.dtype(order + kind))
    return cut.reshape(height, width, channels)


def _depth(image: Any) -> NDArray[np.float32]:
    """(H, W) float32 m of a depth image."""
    encoding = str(image.encoding)
    if encoding not in _DEPTH_ENCODINGS:
        raise CaptureError(f"image is {encoding!r:.40}; valid: {', '.join(_DEPTH_ENCODINGS)}")
    kind, scale = _DEPTH_ENCODINGS[encoding]
    values = _pixels(image, kind, 1)[..., 0]
    return values.astype(np.float32) if kind == "f4" else (values * scale).astype(np.float32)


def _compressed_depth(image: Any) -> NDArray[np.float32]:
    """(H, W) float32 m of a compressedDepth message that holds a PNG of millimeters."""
    told = str(image.format)
    if not told.startswith("16UC1") or "rvl" in told.lower():
        raise CaptureError(f"compressed depth is {told!r:.60}; valid: 16UC1 as PNG")
    data = io.BytesIO(bytes(image.data)[_COMPRESSED_HEADER:])
    return (read_depth_png(data, None) * 0.001).astype(np.float32)


def _intrinsics(
    bag: _Bag, topic: str, image: _Message, size: tuple[int, int]
) -> NDArray[np.float64]:
    """(3, 3) of the CameraInfo beside the topic, else of the only one; the nearest in time."""
    infos = sorted(set(bag.topics.get(_INFO, [])))
    beside = topic.rpartition("/")[0] + "/camera_info"
    if beside not in infos and len(infos) != 1:
        found = ", ".join(infos) or "none"
        raise CaptureError(f"depth image has no CameraInfo on {beside}; found: {found}")
    name = beside if beside in infos else infos[0]
    nearest, _, _ = _nearest(bag.read([name], image), image.stamp)
    if nearest is None:  # told once at the start, as latched topics are
        nearest, _, _ = _nearest(bag.read([name], None), image.stamp)
    if nearest is None:
        raise CaptureError(f"depth image has no CameraInfo: topic {name} holds no message")
    info = bag.decode(nearest)
    if (int(info.width), int(info.height)) != size:
        raise CaptureError(
            f"CameraInfo on {name} is for {info.width} x {info.height} pixels; "
            f"valid: {size[0]} x {size[1]}, as the image"
        )
    if topic.rpartition("/")[2].startswith("image_rect"):
        projection = np.array(info.P if hasattr(info, "P") else info.p, np.float64)
        return projection.reshape(3, 4)[:, :3]  # a rectified image obeys P, whatever D says
    distortion = np.array(info.D if hasattr(info, "D") else info.d, np.float64)
    if not (distortion == 0).all():
        raise CaptureError(
            f"CameraInfo on {name} has lens distortion; valid: a rectified image (image_rect)"
        )
    return np.array(info.K if hasattr(info, "K") else info.k, np.float64).reshape(3, 3)


def _rgb(
    bag: _Bag, depth: _Message, size: tuple[int, int], frame_id: str
) -> NDArray[np.uint8] | None:
    """(H, W, 3) uint8 of the color image of the same frame, size and time, if there is one."""
    best, apart = None, _COLOR_NEAR_S
    for message in bag.read(bag.topics.get(_IMAGE, []), depth):
        if abs(message.stamp - depth.stamp) >= apart:
            continue
        image = bag.decode(message)
        registered = str(image.header.frame_id) == frame_id
        if registered and (image.width, image.height) == size:
            if image.encoding in _COLOR_ENCODINGS:
                best, apart = image, abs(message.stamp - depth.stamp)
    if best is None:
        return None
    channels, order = _COLOR_ENCODINGS[str(best.encoding)]
    return np.ascontiguousarray(_pixels(best, "u1", channels)[..., :3][..., ::order])


def _cloud(message: Any, cloud_frame: CloudFrame) -> Capture:
    """A capture of a PointCloud2, organized where its height is above 1."""
    width, height = int(message.width), int(message.height)
    point, row = int(message.point_step), int(message.row_step)
    validate_cloud_size(width * height, row * height, len(message.data))
    if row < width * point:
        raise CaptureError(f"cloud has rows of {row} bytes for {width} points of {point}")
    order = ">" if message.is_bigendian else "<"
    fields = {str(f.name): f for f in message.fields if f.datatype in _POINT_TYPES}
    for axis in "xyz":
        if axis not in fields or fields[axis].datatype not in (7, 8):
            raise CaptureError(f"cloud has fields {', '.join(fields):.80}; valid: float x, y, z")
    wanted = [name for name in ("x", "y", "z", "rgb", "rgba") if name in fields]
    dtype = np.dtype(
        {
            "names": wanted,
            "formats": [order + _POINT_TYPES[fields[name].datatype] for name in wanted],
            "offsets": [int(fields[name].offset) for name in wanted],
            "itemsize": point,
        }
    )
    data = np.frombuffer(bytes(message.data), np.uint8, row * height).reshape(height, row)
    cells = np.ascontiguousarray(data[:, : width * point]).view(dtype)
    xyz = np.stack([cells[axis] for axis in "xyz"], axis=-1).astype(np.float32)
    packed = next((cells[name] for name in wanted[3:]), None)
    colors = unpack_rgb(packed.reshape(-1)) if packed is not None else None
    shape = (height, width, 3) if height > 1 else (width, 3)
    capture = Capture.from_cloud(xyz.reshape(shape), cloud_frame=cloud_frame, colors=colors)
    frame_id = str(message.header.frame_id)
    if cloud_frame == "optical" and frame_id and "optical" not in frame_id:
        return capture.with_warnings(
            CodedWarning(
                "frame_taken_as_optical",
                f"cloud's frame {frame_id!r:.60} is taken as a camera's optical frame",
            )
        )
    return capture
