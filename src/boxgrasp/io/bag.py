"""One message out of a ROS 1 bag, a ROS 2 bag or an MCAP file, through rosbags.

Messages are decoded with the library's own definitions of sensor_msgs, never with those that
the bag carries: rosbags turns a bag's definitions into Python code.
"""

from __future__ import annotations

import math
import struct
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from boxgrasp.arrays import Floats
from boxgrasp.errors import CaptureError
from boxgrasp.io.messages import (
    cloud_capture,
    is_color,
    read_color,
    read_compressed_depth,
    read_depth,
    read_intrinsics,
)
from boxgrasp.sensing.capture import Capture
from boxgrasp.sensing.validation import Bytes, CloudFrame

_CLOUD: Final = "sensor_msgs/msg/PointCloud2"
_IMAGE: Final = "sensor_msgs/msg/Image"
_COMPRESSED: Final = "sensor_msgs/msg/CompressedImage"
_INFO: Final = "sensor_msgs/msg/CameraInfo"
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
        return cloud_capture(bag.decode(message), cloud_frame)
    decoded = bag.decode(message)
    if message.kind == _COMPRESSED:
        depth = read_compressed_depth(decoded)
        topic = message.topic.removesuffix("/compressedDepth")
    else:
        depth, topic = read_depth(decoded), message.topic
    size = (depth.shape[1], depth.shape[0])
    intrinsics = _intrinsics(bag, topic, message, size)
    rgb = _rgb(bag, message, size, str(decoded.header.frame_id))
    return Capture(depth, intrinsics, rgb=rgb)


def _intrinsics(bag: _Bag, topic: str, image: _Message, size: tuple[int, int]) -> Floats:
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
    return read_intrinsics(bag.decode(nearest), name, topic, size)


def _rgb(bag: _Bag, depth: _Message, size: tuple[int, int], frame_id: str) -> Bytes | None:
    """(H, W, 3) uint8 of the color image of the same frame, size and time, if there is one."""
    best, apart = None, _COLOR_NEAR_S
    for message in bag.read(bag.topics.get(_IMAGE, []), depth):
        if abs(message.stamp - depth.stamp) >= apart:
            continue
        image = bag.decode(message)
        registered = str(image.header.frame_id) == frame_id
        if registered and (image.width, image.height) == size and is_color(image):
            best, apart = image, abs(message.stamp - depth.stamp)
    return read_color(best) if best is not None else None
