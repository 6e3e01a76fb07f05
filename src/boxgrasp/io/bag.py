"""Views out of a ROS 1 bag, a ROS 2 bag or an MCAP file, through rosbags: one, or all of a topic.

Messages are decoded with the library's own definitions of them, never with those that the bag
carries: rosbags turns a bag's definitions into Python code.
"""

from __future__ import annotations

import math
import os
import struct
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from boxgrasp.arrays import Floats
from boxgrasp.errors import CaptureError, MissingExtraError, TransformError
from boxgrasp.io.fields import frame_id_of
from boxgrasp.io.frames import TransformBuffer
from boxgrasp.io.messages import COLOR_NEAR_NS, cloud_capture, depth_capture, nearest_color
from boxgrasp.io.refusals import refusals_of
from boxgrasp.sensing.capture import Capture
from boxgrasp.sensing.validation import CloudFrame

_CLOUD: Final = "sensor_msgs/msg/PointCloud2"
_IMAGE: Final = "sensor_msgs/msg/Image"
_COMPRESSED: Final = "sensor_msgs/msg/CompressedImage"
_INFO: Final = "sensor_msgs/msg/CameraInfo"
_TF_KINDS: Final = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
_TF_DEFINITION: Final = "geometry_msgs/TransformStamped[] transforms"  # of both
_TF, _TF_STATIC = "/tf", "/tf_static"
_NEAR_S: Final = 1.0  # how far from the bag's messages a stamp may lie
_WINDOW_NS: Final = 2_000_000_000  # round a message, in which those beside it were recorded
_TF_KEPT_NS: Final = 10_000_000_000  # before a view, as long as a TransformBuffer keeps them
_TRIES: Final = 20  # messages of a topic before it is given up


@dataclass(frozen=True)
class BagFrame:
    """One view of a bag, with what lies beside it; messages are decoded.

    Attributes:
        topic: of the view.
        is_cloud: whether it is a PointCloud2; else it is an Image or a CompressedImage of depth.
        stamp_ns: its header's time, ns.
        message: the view.
        info: its CameraInfo, or None.
        color: the color Image registered to it, or None.
        transforms: the TF messages since the view before, recorded up to 2 s after this one, and
            whether each is static. The static ones of the whole bag come with the first view.
    """

    topic: str
    is_cloud: bool
    stamp_ns: int
    message: Any
    info: Any | None
    color: Any | None
    transforms: tuple[tuple[Any, bool], ...]


@dataclass(frozen=True)
class _Message:
    """A message not decoded yet; `recorded` is when the bag got it, ns.

    That is the only time by which a bag can be searched.
    """

    topic: str
    kind: str
    recorded: int
    raw: bytes
    ros2: bool

    @property
    def stamp_ns(self) -> int:
        """Of the header with which every message but TF's starts."""
        if self.ros2:
            layout = "<iI" if self.raw[1] & 1 else ">iI"
            seconds, nanoseconds = struct.unpack_from(layout, self.raw, 4)
        else:
            seconds, nanoseconds = struct.unpack_from("<II", self.raw, 4)
        return int(seconds) * 1_000_000_000 + int(nanoseconds)

    @property
    def stamp(self) -> float:
        """The same in seconds."""
        return self.stamp_ns * 1e-9


@dataclass(frozen=True)
class _Bag:
    """An open bag: topics by message type, and how to read and decode.

    `read` takes topics, and the message whose neighbors in time are wanted, or None for all.
    """

    topics: dict[str, list[str]]
    read: Callable[[Iterable[str], _Message | None], Iterator[_Message]]
    decode: Callable[[_Message], Any]
    kept: dict[str, list[_Message]] = field(default_factory=dict)

    def whole(self, topic: str) -> list[_Message]:
        """All messages of a topic that has few or small ones, read once."""
        if topic not in self.kept:
            self.kept[topic] = list(self.read([topic], None))
        return self.kept[topic]

    def decoded(self, messages: Iterable[_Message]) -> Iterator[Any]:
        """Those of the messages that can be decoded."""
        for message in messages:
            try:
                yield self.decode(message)
            except Exception:  # rosbags raises nearly anything at damaged bytes
                continue

    def of_kind(self, *kinds: str) -> list[str]:
        """The topics of some types, in order."""
        return sorted({name for kind in kinds for name in self.topics.get(kind, [])})

    @property
    def usable(self) -> list[str]:
        """Topics that may hold views."""
        packed = [name for name in self.of_kind(_COMPRESSED) if name.endswith("/compressedDepth")]
        return self.of_kind(_CLOUD, _IMAGE) + packed

    def validate_topic(self, topic: str) -> None:
        """Refuse a topic that holds no views."""
        if topic not in self.usable:
            listed = ", ".join(self.usable) or _NO_VIEW
            raise CaptureError(f"bag has no cloud or image on topic {topic!r}; valid: {listed}")


_NO_VIEW: Final = "none (a PointCloud2, or a depth Image with CameraInfo)"


@dataclass(frozen=True)
class _How:
    """How views become captures."""

    cloud_frame: CloudFrame
    base_frame: str | None


def load_bag(
    path: Path,
    cloud_frame: CloudFrame,
    topic: str | None,
    stamp: float | None,
    base_frame: str | None = None,
) -> Capture:
    """A capture of a PointCloud2, or of a depth image with its CameraInfo.

    Args:
        path: a .bag, .db3 or .mcap file, or a ROS 2 bag's folder.
        cloud_frame: 'optical' or 'base', of a cloud's points.
        topic: of the message; None for the first that can be used, in the bag's order.
        stamp: the message on its topic that is nearest in time is taken, s; None for the first.
        base_frame: name of the base frame in the bag's TF; None leaves the camera's pose unknown.

    Returns:
        The capture.

    Raises:
        CaptureError: damaged, no such topic or time, no usable message, or no transform for it.
        ImportError: rosbags is not installed.
    """
    if stamp is not None and not math.isfinite(stamp):
        raise CaptureError(f"stamp is {stamp}; valid: seconds, finite")
    if base_frame is not None and not base_frame.strip("/"):
        raise CaptureError(f"base_frame is {base_frame!r}; valid: a frame's name")
    how = _How(cloud_frame, base_frame.lstrip("/") if base_frame is not None else None)
    with _opened(path) as bag:
        return _capture(bag, how, topic, stamp)


def read_frames(path: str | os.PathLike[str], topic: str | None = None) -> Iterator[BagFrame]:
    """The views of one topic of a bag, in the order in which they were recorded.

    The bag is read once from its start, and held for a few seconds round each view.

    Args:
        path: a .bag, .db3 or .mcap file, or a ROS 2 bag's folder.
        topic: of clouds or depth images; None for that which `load_capture` takes.

    Yields:
        Each view, with the very messages that `load_capture` would take with it.

    Raises:
        CaptureError: damaged, no such topic, or none with a usable view; names the path.
        MissingExtraError: rosbags is not installed.
    """
    place = Path(path)
    with refusals_of(place):
        if not place.exists():
            raise CaptureError("no such file or folder; valid: a bag")
        with _opened(place) as bag:
            if topic is not None:
                bag.validate_topic(topic)
            else:
                topic = _first_usable(bag, _How("optical", None), None)[0].topic
            yield from _frames(bag, topic)


@contextmanager
def _opened(path: Path) -> Iterator[_Bag]:
    from rosbags.rosbag1 import Reader as Reader1  # the extra `io`
    from rosbags.rosbag2 import Reader as Reader2
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    ros2 = path.suffix.lower() != ".bag"
    store = get_typestore(Stores.ROS2_HUMBLE if ros2 else Stores.ROS1_NOETIC)
    for kind in _TF_KINDS:
        if kind not in store.types:
            store.register(get_types_from_msg(_TF_DEFINITION, kind))
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
                yield _Message(connection.topic, connection.msgtype, recorded, bytes(raw), ros2)

        def decode(message: _Message) -> Any:
            decoder = store.deserialize_cdr if ros2 else store.deserialize_ros1
            return decoder(message.raw, message.kind)

        yield _Bag(by_kind, read, decode)


def _capture(bag: _Bag, how: _How, topic: str | None, stamp: float | None) -> Capture:
    if topic is not None:
        bag.validate_topic(topic)
        if stamp is not None:
            return _nearest_capture(bag, topic, how, stamp)
    message, capture = _first_usable(bag, how, topic)
    return capture if stamp is None else _nearest_capture(bag, message.topic, how, stamp)


def _first_usable(bag: _Bag, how: _How, topic: str | None) -> tuple[_Message, Capture]:
    usable, tries = bag.usable, Counter[str]()
    reason: CaptureError | MissingExtraError | None = None
    for message in bag.read(usable if topic is None else [topic], None):
        if tries[message.topic] == _TRIES:
            continue
        try:
            return message, _capture_of(bag, message, how)
        except (CaptureError, MissingExtraError) as error:
            tries[message.topic] += 1
            reason = reason or type(error)(f"{message.topic}: {error}")
    listed = ", ".join(usable) or _NO_VIEW
    raise reason or CaptureError(f"bag has no message to use; topics: {listed}")


def _nearest_capture(bag: _Bag, topic: str, how: _How, stamp: float) -> Capture:
    """Of the message nearest in time, the earlier of two as near."""
    best, first, last = None, math.inf, -math.inf
    for message in bag.read([topic], None):
        first, last = min(first, message.stamp), max(last, message.stamp)
        if best is None or abs(message.stamp - stamp) < abs(best.stamp - stamp):
            best = message
    if best is None or not first - _NEAR_S <= stamp <= last + _NEAR_S:
        raise CaptureError(f"stamp {stamp} is not on topic {topic}; valid: {first} to {last}")
    return _capture_of(bag, best, how)


def _capture_of(bag: _Bag, message: _Message, how: _How) -> Capture:
    frame = _frame(bag, message, how.base_frame is not None)
    if frame.is_cloud:
        return _cloud(frame, how)
    if frame.info is None:
        raise CaptureError(_no_info(bag, frame.topic))
    T_base_camera = None
    if how.base_frame is not None:
        if frame_id_of(frame.message) == how.base_frame:
            raise CaptureError(
                f"depth image is in frame {how.base_frame!r:.60}, the base frame itself; "
                "valid: a base frame with z up"
            )
        T_base_camera = _T_base_view(frame, how.base_frame)
    return depth_capture(
        frame.message,
        frame.info,
        topic=frame.topic,
        color=frame.color,
        T_base_camera=T_base_camera,
    )


def _cloud(frame: BagFrame, how: _How) -> Capture:
    if how.base_frame is None:
        return cloud_capture(frame.message, how.cloud_frame)
    frame_id = frame_id_of(frame.message)
    if frame_id == how.base_frame:
        return cloud_capture(frame.message, "base")
    if how.cloud_frame == "base":
        raise CaptureError(
            f"cloud is in frame {frame_id!r:.60}; valid for cloud frame 'base': "
            f"{how.base_frame!r:.60}"
        )
    return cloud_capture(frame.message, how.cloud_frame, _T_base_view(frame, how.base_frame))


def _T_base_view(frame: BagFrame, base_frame: str) -> Floats:
    """(4, 4) m, out of the frame of a message at its own time."""
    buffer = TransformBuffer()
    for message, static in frame.transforms:
        try:
            buffer.add(message, static)
        except TransformError:  # the sound ones of it are taken
            continue
    try:
        return buffer.lookup(base_frame, frame_id_of(frame.message), frame.stamp_ns)
    except TransformError as error:
        raise CaptureError(str(error)) from None


def _frame(bag: _Bag, view: _Message, with_tf: bool) -> BagFrame:
    """The view that a message is, with what lies beside it."""
    beside = _Beside(bag, view.topic, with_tf)
    for message in bag.read(beside.topics, view):
        beside.take(message)
    return beside.frame(view)


def _frames(bag: _Bag, topic: str) -> Iterator[BagFrame]:
    """Every view of a topic, each as `_frame` has it."""
    beside = _Beside(bag, topic, with_tf=True)
    waiting: deque[_Message] = deque()
    for message in bag.read([topic, *beside.topics], None):
        while waiting and message.recorded >= waiting[0].recorded + _WINDOW_NS:
            yield beside.frame(waiting.popleft())
        beside.take(message)
        if message.topic == topic:
            waiting.append(message)
    while waiting:
        yield beside.frame(waiting.popleft())


class _Beside:
    """What was recorded round the views of a topic, as long as one of them may want it."""

    def __init__(self, bag: _Bag, topic: str, with_tf: bool) -> None:
        self._bag = bag
        is_cloud = topic in bag.of_kind(_CLOUD)
        self._info_topic = None if is_cloud else _info_topic(bag, topic)
        self._color_topics = set() if is_cloud else set(bag.of_kind(_IMAGE))
        tf_topics = set(bag.of_kind(*_TF_KINDS)) & {_TF, _TF_STATIC} if with_tf else set()
        self._tf_topics = tf_topics - {_TF_STATIC}
        self._statics = bag.whole(_TF_STATIC) if _TF_STATIC in tf_topics else []
        self._infos: deque[_Message] = deque()
        self._images: deque[_Message] = deque()
        self._tf: deque[_Message] = deque()
        info_topics = {self._info_topic} if self._info_topic is not None else set()
        self.topics = info_topics | self._color_topics | self._tf_topics

    def take(self, message: _Message) -> None:
        if message.topic in self._tf_topics:
            self._tf.append(message)
        elif message.topic == self._info_topic:
            self._infos.append(message)
        elif message.topic in self._color_topics:
            self._images.append(message)
        # A view waits for `_WINDOW_NS`, and wants what is as much older than itself.
        _drop_before(self._infos, message.recorded - 2 * _WINDOW_NS)
        _drop_before(self._images, message.recorded - 2 * _WINDOW_NS)
        _drop_before(self._tf, message.recorded - _WINDOW_NS - _TF_KEPT_NS)

    def frame(self, view: _Message) -> BagFrame:
        bag, message = self._bag, self._bag.decode(view)
        told = [(m, False) for m in bag.decoded(self._tf)]
        told += [(m, True) for m in bag.decoded(self._statics)]
        self._tf.clear()
        self._statics = []
        return BagFrame(
            topic=view.topic,
            is_cloud=view.kind == _CLOUD,
            stamp_ns=view.stamp_ns,
            message=message,
            info=self._info(view),
            color=self._color(view, message),
            transforms=tuple(told),
        )

    def _info(self, view: _Message) -> Any | None:
        if self._info_topic is None:
            return None
        near = [m for m in self._infos if abs(m.recorded - view.recorded) <= _WINDOW_NS]
        if not near:  # told once at the start, as latched topics are
            near = self._bag.whole(self._info_topic)
        best = min(near, key=lambda info: _apart_ns(info, view), default=None)
        return self._bag.decode(best) if best is not None else None

    def _color(self, view: _Message, message: Any) -> Any | None:
        near = (
            m
            for m in self._images
            if abs(m.recorded - view.recorded) <= _WINDOW_NS and _apart_ns(m, view) < COLOR_NEAR_NS
        )
        try:
            return nearest_color(self._bag.decoded(near), message)
        except CaptureError:  # the view is damaged, which its capture will say
            return None


def _apart_ns(one: _Message, view: _Message) -> float:
    """Between the stamps of two messages, ns; of a damaged one infinity."""
    try:
        return abs(one.stamp_ns - view.stamp_ns)
    except (struct.error, IndexError):
        return math.inf


def _drop_before(messages: deque[_Message], recorded: int) -> None:
    while messages and messages[0].recorded < recorded:
        messages.popleft()


def _info_beside(topic: str) -> str:
    return topic.removesuffix("/compressedDepth").rpartition("/")[0] + "/camera_info"


def _info_topic(bag: _Bag, topic: str) -> str | None:
    """That of the CameraInfo beside a topic, else the only one."""
    infos, beside = bag.of_kind(_INFO), _info_beside(topic)
    if beside in infos:
        return beside
    return infos[0] if len(infos) == 1 else None


def _no_info(bag: _Bag, topic: str) -> str:
    infos, name = bag.of_kind(_INFO), _info_topic(bag, topic)
    if name is not None:
        return f"depth image has no CameraInfo: topic {name} holds no message"
    found = ", ".join(infos) or "none"
    return f"depth image has no CameraInfo on {_info_beside(topic)}; found: {found}"
