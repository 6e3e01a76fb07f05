"""Publish a bag reliably, one frame at a time, and print a node's answer to each.

The node must follow /clock: `-p use_sim_time:=true`. Topics are its own: cloud, depth,
compressed_depth, camera_info and color, which can be remapped here as there. Without a target the
node's latched one is meant.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import islice, pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Final, NoReturn

import rclpy
from boxgrasp_msgs.msg import Status, Target
from boxgrasp_msgs.srv import SelectGrasp
from geometry_msgs.msg import Point, PointStamped
from rclpy.duration import Duration
from rclpy.exceptions import InvalidTopicNameException
from rclpy.executors import SingleThreadedExecutor
from rclpy.expand_topic_name import expand_topic_name
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rclpy.time import Time
from rclpy.utilities import remove_ros_args
from rclpy.validate_full_topic_name import validate_full_topic_name
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2, RegionOfInterest
from tf2_msgs.msg import TFMessage

from boxgrasp.errors import BoxgraspError
from boxgrasp.io.bag import BagFrame, read_frames
from boxgrasp.io.images import read_mask
from boxgrasp.result import Selection

ANSWERED, FAILED, INTERRUPTED, BROKEN_PIPE = 0, 2, 130, 141
_RELIABLE: Final = QoSProfile(depth=10)
_TF: Final = QoSProfile(depth=100)
_LATCHED: Final = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
_PER_MESSAGE: Final = 1000  # transforms: so many messages that none leaves the node's queue unread
_FIRST_CALL_S: Final = 2.0  # after which a call is taken as lost; twice as long the next time
_ACKED_S: Final = 5.0  # how long a message may take: what was lost is sent again within 3 s
_VIEW_ACKED_S: Final = 0.1  # for a view no longer: a lost one is seen by the answer
_SETTLE_S: Final = 0.02  # for small messages, which a burst of large ones can push out
_CLOCK_S: Final = 2.0  # how much later than its other topics the node's /clock may be seen
_POLL_S: Final = 0.02
_SPIN_S: Final = 0.1  # how soon the executor sees the end
_PAUSE_S: Final = 0.2  # before a busy node is asked again
_TF_KIND: Final = "tf2_msgs/msg/TFMessage"
_TF_DEFINITION: Final = "geometry_msgs/TransformStamped[] transforms"

# What a message that was lost, or is on its way, looks like.
_NO_VIEW: Final = (Status.NO_VIEW, Status.STALE_VIEW)
_NO_POSE: Final = (Status.NO_TRANSFORM, Status.TRANSFORM_TOO_OLD)


class _Unanswered(Exception):  # noqa: N818 - told of one frame; the others go on
    """Why a frame has no answer."""


class _Unusable(Exception):  # noqa: N818 - ends the replay
    """Why no frame can have one."""


@dataclass(frozen=True, eq=False)
class _Sink:
    """A topic of the node, and what is published there."""

    topic: str
    kind: type
    qos: QoSProfile


_CLOCK: Final = _Sink("/clock", Clock, _RELIABLE)
_DYNAMIC: Final = _Sink("/tf", TFMessage, _TF)
_STATIC: Final = _Sink("/tf_static", TFMessage, _LATCHED)
_INFO: Final = _Sink("camera_info", CameraInfo, _RELIABLE)
_COLOR: Final = _Sink("color", Image, _RELIABLE)
_VIEWS: Final = {
    "sensor_msgs/msg/PointCloud2": _Sink("cloud", PointCloud2, _RELIABLE),
    "sensor_msgs/msg/Image": _Sink("depth", Image, _RELIABLE),
    "sensor_msgs/msg/CompressedImage": _Sink("compressed_depth", CompressedImage, _RELIABLE),
}


class _Cdr:
    """Messages of any bag as the bytes that ROS 2 sends."""

    def __init__(self) -> None:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        self._store = get_typestore(Stores.ROS2_HUMBLE)
        if _TF_KIND not in self._store.types:
            self._store.register(get_types_from_msg(_TF_DEFINITION, _TF_KIND))

    def of(self, message: Any) -> bytes:
        """One message, decoded by rosbags; ROS 1 has a camera's matrices in capitals."""
        kind = message.__msgtype__
        if hasattr(message, "K"):
            message = SimpleNamespace(**{k.lower(): v for k, v in vars(message).items()})
        return bytes(self._store.serialize_cdr(message, kind))

    def of_transforms(self, transforms: Iterable[Any]) -> Iterator[bytes]:
        """Many transforms in few messages."""
        left = iter(transforms)
        while part := list(islice(left, _PER_MESSAGE)):
            yield bytes(self._store.serialize_cdr(SimpleNamespace(transforms=part), _TF_KIND))


class _Player:
    """Publishes frames to a node until it has answered them."""

    def __init__(self, node: Node, selector: str, timeout_s: float) -> None:
        self._node, self._selector, self._timeout_s = node, selector, timeout_s
        self._client = node.create_client(SelectGrasp, f"{selector}/select")
        self._cdr = _Cdr()
        self._publishers: dict[str, Publisher] = {}
        self._is_first, self._loses = True, False
        self._camera: tuple[Any, ...] = ()

    def connect(self, frames: Iterable[BagFrame]) -> None:
        """Wait for the node's service and for its subscriptions to what these frames hold."""
        name = self._client.srv_name
        _wait_until(
            self._client.service_is_ready, self._timeout_s, f"nobody offers the service {name}"
        )
        if (offers := self._node.count_services(name)) > 1:
            raise _Unusable(f"{offers} nodes offer the service {name}; valid: one")
        found = list(frames)
        sinks = [_VIEWS[frame.message.__msgtype__] for frame in found]
        sinks += [_INFO for frame in found if frame.info is not None]
        sinks += [_COLOR for frame in found if frame.color is not None]
        self._open([*sinks, _DYNAMIC, _STATIC])
        self._open([_CLOCK])

    def answer(self, frame: BagFrame, following: BagFrame | None, target: Target) -> Any:
        """The GraspSelection of a frame.

        Raises:
            _Unanswered: the node says why, or says nothing in time.
            _Unusable: it does not listen to a topic.
        """
        request = SelectGrasp.Request(target=target)
        request.view.min_stamp = Time(nanoseconds=frame.stamp_ns).to_msg()
        patience_s = _FIRST_CALL_S
        end = time.monotonic() + self._timeout_s
        why = f"{self._selector} gave no answer within {self._timeout_s:g} s"
        for number in range(1, sys.maxsize):
            if (left := end - time.monotonic()) <= 0:
                break
            self._publish(frame, following, again=number > 1)
            reply = self._call(request, min(patience_s, left))
            if reply is None:
                patience_s *= 2
                continue
            code = reply.status.code
            if code == Status.SUCCEEDED:
                stamp = Time.from_msg(reply.selection.header.stamp).nanoseconds
                if stamp == frame.stamp_ns:
                    self._is_first = False
                    return reply.selection
                why = f"{self._selector} answers a view of {_seconds(stamp)} s: another publishes"
            else:
                why = reply.status.message or f"status {code}"
                if code == Status.BUSY:
                    time.sleep(_PAUSE_S)
                elif number >= self._tries(code):
                    break
        self._is_first = False
        raise _Unanswered(why)

    def _tries(self, code: int) -> float:
        """How often a frame is sent before a failure is believed."""
        if code in _NO_VIEW:
            return math.inf if self._loses else 3
        # Transforms are known to have arrived the second time; and until the first answer the node
        # may hold a view of another time, on which it failed.
        return 2 if code in _NO_POSE or self._is_first else 1

    def _publish(self, frame: BagFrame, following: BagFrame | None, again: bool) -> None:
        """Publish a frame, the view last.

        With it goes the color image of the frame that follows: a node waits for one that is not
        older than the view, since that may be nearer. Color, and a camera that has changed, must
        have arrived: without them there would be an answer too, another one.
        """
        colors = [f.color for f in (frame, following) if f is not None and f.color is not None]
        self._send(_COLOR, map(self._cdr.of, colors))
        self._await({_COLOR: bool(colors)})  # before what is small
        self._send(_CLOCK, [Clock(clock=Time(nanoseconds=frame.stamp_ns).to_msg())])
        for sink, is_static in ((_STATIC, True), (_DYNAMIC, False)):
            told = (t for m, s in frame.transforms if s == is_static for t in m.transforms)
            self._send(sink, self._cdr.of_transforms(told))
        has_changed = False
        if frame.info is not None:
            camera = _camera_of(frame.info)
            has_changed, self._camera = camera != self._camera, camera
            self._send(_INFO, [self._cdr.of(frame.info)])
        time.sleep(_SETTLE_S)
        has_info = frame.info is not None and (has_changed or again)
        self._await({_STATIC: again, _DYNAMIC: again, _INFO: has_info})
        view = _VIEWS[frame.message.__msgtype__]
        self._send(view, [self._cdr.of(frame.message)])
        self._await({view: True}, _VIEW_ACKED_S)

    def _send(self, sink: _Sink, messages: Iterable[Any]) -> None:
        for message in messages:
            if sink.topic not in self._publishers:
                self._open([sink])
            self._publishers[sink.topic].publish(message)

    def _await(self, wanted: Mapping[_Sink, bool], seconds: float = _ACKED_S) -> None:
        """Wait until what was published on some topics has arrived, or for some seconds."""
        end = time.monotonic() + seconds
        for sink, is_wanted in wanted.items():
            if is_wanted and (left := end - time.monotonic()) > 0:
                self._publishers[sink.topic].wait_for_all_acked(Duration(seconds=left))

    def _open(self, sinks: Iterable[_Sink]) -> None:
        """Make publishers, and wait until the node has found them."""
        made = list({s.topic: s for s in sinks if s.topic not in self._publishers}.values())
        for sink in made:
            publisher = self._node.create_publisher(sink.kind, sink.topic, sink.qos)
            self._publishers[sink.topic] = publisher
        lossy = []
        for sink in made:
            publisher = self._publishers[sink.topic]
            name, option = publisher.topic_name, f"-r {sink.topic}:={publisher.topic_name}"
            wait_s, hint = self._timeout_s, f"start the node, or this, with {option}"
            if sink is _CLOCK:
                wait_s, hint = min(wait_s, _CLOCK_S), "start it with -p use_sim_time:=true"
            _wait_until(
                partial(self._is_heard, publisher),
                wait_s,
                f"{self._selector} does not listen to {name}; {hint}",
            )
            if sink is not _CLOCK and self._is_lossy(publisher):
                lossy.append(name)
        if lossy:
            self._loses = True
            _complain(
                f"{self._selector} listens to {', '.join(lossy)} as best effort: views may be lost "
                "and sent again, colors lost; start it with "
                f"-p qos_overrides.{lossy[0]}.subscription.reliability:=reliable"
            )

    def _is_heard(self, publisher: Publisher) -> bool:
        everyone = self._node.get_subscriptions_info_by_topic(publisher.topic_name)
        has_all = publisher.get_subscription_count() >= len(everyone)
        return has_all and bool(self._endpoints(publisher))

    def _is_lossy(self, publisher: Publisher) -> bool:
        return any(
            endpoint.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
            for endpoint in self._endpoints(publisher)
        )

    def _endpoints(self, publisher: Publisher) -> list[Any]:
        """The node's own subscriptions of a topic."""
        return [
            endpoint
            for endpoint in self._node.get_subscriptions_info_by_topic(publisher.topic_name)
            if f"{endpoint.node_namespace.rstrip('/')}/{endpoint.node_name}" == self._selector
        ]

    def _call(self, request: Any, wait_s: float) -> Any:
        """What the service replies, None where nothing came in time."""
        came = threading.Event()
        future = self._client.call_async(request)
        future.add_done_callback(lambda _: came.set())
        if came.wait(wait_s):
            return future.result()
        self._client.remove_pending_request(future)
        return None


def _camera_of(info: Any) -> tuple[Any, ...]:
    """What a CameraInfo says of the camera; ROS 1 has the matrices in capitals."""
    lists = [getattr(info, n.upper() if hasattr(info, n.upper()) else n) for n in "dkrp"]
    return (info.width, info.height, *(tuple(values) for values in lists))


def _wait_until(done: Callable[[], bool], seconds: float, what: str) -> None:
    end = time.monotonic() + seconds
    while not done():
        if time.monotonic() > end:
            raise _Unusable(what)
        time.sleep(_POLL_S)


def _seconds(stamp_ns: int) -> str:
    return f"{stamp_ns // 10**9}.{stamp_ns % 10**9:09d}"


def _with_next(frames: Iterable[BagFrame]) -> Iterator[tuple[BagFrame, BagFrame | None]]:
    def ended() -> Iterator[BagFrame | None]:
        yield from frames
        yield None

    for frame, following in pairwise(ended()):
        assert frame is not None  # only the last is
        yield frame, following


def _replay(player: _Player, args: argparse.Namespace, target: Target) -> int:
    """Every frame's answer, printed; the exit status."""
    status, answered = ANSWERED, 0
    for frame, following in islice(_with_next(read_frames(args.bag, args.topic)), args.frames):
        name = f"{args.bag}#{_seconds(frame.stamp_ns)}"
        if not answered:
            player.connect([f for f in (frame, following) if f is not None])
        answered += 1
        try:
            if not frame.is_cloud and frame.info is None:
                raise _Unanswered("depth image has no CameraInfo")
            message = player.answer(frame, following, target)
            found = message.header.frame_id
            if args.base_frame is not None and found != args.base_frame.lstrip("/"):
                raise _Unanswered(f"answered in frame {found!r}; valid: the node's base_frame")
            _tell(name, message.json, args.json)
        except _Unanswered as error:
            status = FAILED
            _complain(f"{name}: {error}")
            if args.json:
                print(json.dumps({"capture": name, "error": str(error)}), flush=True)
    if not answered:
        raise _Unusable(f"{args.bag}: no frame on topic {args.topic}")
    return status


def _tell(name: str, answer: str, as_json: bool) -> None:
    if as_json:
        print(json.dumps({**json.loads(answer), "capture": name}, allow_nan=False), flush=True)
        return
    selection = Selection.from_json(answer)
    print(f"{name}: {selection.status}: {selection.headline()}", flush=True)


def _complain(sentence: object) -> None:
    print(f"replay: {' '.join(str(sentence).split())}", file=sys.stderr, flush=True)


class _Parser(argparse.ArgumentParser):
    """Says what is wrong in one line."""

    def error(self, message: str) -> NoReturn:
        _complain(message)
        raise SystemExit(FAILED)


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="replay",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    add = parser.add_argument
    add("bag", metavar="BAG", help=".bag, .db3 or .mcap, or a ROS 2 bag's folder")
    add("--topic", metavar="T", help="of clouds or depth images (default: the first usable)")
    add("--base-frame", metavar="F", help="refuse answers in another frame")
    add("--node", default="grasp_selector", help="name of the node (default: %(default)s)")
    add("--frames", type=_count, metavar="N", help="only the first N")
    add("--json", action="store_true", help="one JSON object a line a frame")
    add(
        "--timeout",
        type=_positive,
        default=30.0,
        metavar="S",
        help="how long the node, and each frame's answer, is waited for (default: %(default)g s)",
    )
    target = parser.add_argument_group("target").add_mutually_exclusive_group()
    add = target.add_argument
    add("--pixel", type=_whole, nargs=2, metavar=("U", "V"), help="column and row")
    add("--point", type=float, nargs=3, metavar=("X", "Y", "Z"), help="base frame, m")
    add("--object", type=_whole, metavar="N", help="number of ~/objects, 1 is the nearest")
    add(
        "--box",
        type=_whole,
        nargs=4,
        metavar=("U0", "V0", "U1", "V1"),
        help="pixels round it, as an object detector gives them",
    )
    add("--mask", metavar="FILE", help="PNG, nonzero on the target")
    return parser


def _whole(text: str) -> int:
    value = int(text)
    if not -(2**31) <= value < 2**31:
        raise argparse.ArgumentTypeError(f"{text} is too large")
    return value


def _count(text: str) -> int:
    if (value := int(text)) < 1:
        raise argparse.ArgumentTypeError(f"{text}; valid: 1 or more")
    return value


def _positive(text: str) -> float:
    value = float(text)
    if not (value > 0 and math.isfinite(value)):
        raise argparse.ArgumentTypeError(f"{text}; valid: seconds above 0")
    return value


def _target_of(args: argparse.Namespace) -> Target:
    """The target that the options name, for every frame."""
    if args.pixel:
        u, v = args.pixel
        return Target(kind=Target.PIXEL, u=u, v=v)
    if args.point:
        x, y, z = args.point
        return Target(kind=Target.POINT, point=PointStamped(point=Point(x=x, y=y, z=z)))
    if args.object is not None:
        return Target(kind=Target.OBJECT, object=args.object)
    if args.box:
        u0, v0, u1, v1 = args.box
        if not (0 <= u0 <= u1 and 0 <= v0 <= v1):
            raise _Unusable(f"box is {args.box}; valid: 0 <= U0 <= U1 and 0 <= V0 <= V1")
        box = RegionOfInterest(x_offset=u0, y_offset=v0, width=u1 - u0 + 1, height=v1 - v0 + 1)
        return Target(kind=Target.BOX, box=box)
    if args.mask:
        return Target(kind=Target.MASK, mask=_mask_of(args.mask))
    return Target()


def _mask_of(path: str) -> Image:
    try:
        mask = read_mask(Path(path))
    except BoxgraspError as error:
        raise _Unusable(f"{path}: {error}") from None
    except (OSError, ValueError, SyntaxError) as error:
        what = getattr(error, "strerror", None) or "damaged image"
        raise _Unusable(f"{path}: {what}; valid: a PNG, not black on the object") from None
    height, width = mask.shape
    data = mask.astype("u1").tobytes()
    return Image(height=height, width=width, encoding="mono8", step=width, data=data)


def _full_name(name: str, node: Node) -> str:
    """A node's name with its namespace; a name without a leading / is beside this node."""
    try:
        full = str(expand_topic_name(name, node.get_name(), node.get_namespace()))
        validate_full_topic_name(full)
    except (InvalidTopicNameException, ValueError):
        raise _Unusable(f"node is {name!r}; valid: a node's name") from None
    return full


def _run(args: argparse.Namespace) -> int:
    """With ROS up: make the node, spin it beside, play."""
    node = Node("replay")
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    stop = threading.Event()

    def spin() -> None:
        while not stop.is_set():  # a shutdown beside a wait without end may not be seen
            executor.spin_once(timeout_sec=_SPIN_S)

    thread = threading.Thread(target=spin, name="executor", daemon=True)
    thread.start()
    try:
        player = _Player(node, _full_name(args.node, node), args.timeout)
        return _replay(player, args, _target_of(args))
    finally:
        stop.set()
        thread.join()
        executor.shutdown()
        node.destroy_node()


def main(argv: list[str] | None = None) -> int:
    """Replay a bag.

    Args:
        argv: of the process, with its name and ROS's arguments; None for its own.

    Returns:
        Exit status: 0 all frames answered, 2 something failed, 130 interrupted, 141 nobody reads.
    """
    arguments = list(sys.argv if argv is None else argv)
    try:
        args = _parser().parse_args(remove_ros_args(arguments)[1:])
    except SystemExit as stop:  # argparse ends the process itself for --help and errors
        return stop.code if isinstance(stop.code, int) else FAILED
    try:
        rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
        return _run(args)
    except KeyboardInterrupt:
        return INTERRUPTED
    except (BoxgraspError, _Unusable) as error:
        _complain(error)
        return FAILED
    except BrokenPipeError:  # what is buffered must not raise again at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return BROKEN_PIPE
    finally:
        rclpy.try_shutdown()


if __name__ == "__main__":
    sys.exit(main())
