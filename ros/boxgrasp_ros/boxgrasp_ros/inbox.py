"""What arrived on the node's topics: the newest view, and what lies beside it in time."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Final, TypeVar

from boxgrasp_msgs.msg import Status

from boxgrasp.errors import CaptureError
from boxgrasp.io.fields import stamp_ns
from boxgrasp.io.messages import COLOR_NEAR_NS, nearest_color
from boxgrasp_ros.failures import Failure

T = TypeVar("T")

_KEPT: Final = 30  # messages of a topic: a second of a camera
_POLL_S: Final = 0.05  # how soon a wait sees that its request was cancelled


@dataclass(frozen=True, eq=False)
class RawView:
    """The messages of one view, not converted yet.

    Attributes:
        message: PointCloud2, depth Image, or CompressedImage of depth.
        topic: it came on; '' in a request.
        info: CameraInfo of a depth image; None for a cloud.
        color: Image beside a depth image, or None.
        robot_mask: Image, not 0 on the robot's own arm, or None.
        stamp_ns: of the view's header.
    """

    message: Any
    topic: str
    info: Any
    color: Any
    robot_mask: Any
    stamp_ns: int

    @property
    def is_cloud(self) -> bool:
        """Whether the view is a PointCloud2."""
        return _is_cloud(self.message)


@dataclass(frozen=True)
class Sources:
    """Names of the topics, and which of the optional ones somebody publishes now.

    Attributes:
        views: topics of clouds and depth images.
        info: topic of the CameraInfo.
        robot_mask: topic of the mask.
        expects_color: whether color images will come.
        expects_robot_mask: whether a mask will come with every view.
    """

    views: tuple[str, ...]
    info: str
    robot_mask: str
    expects_color: bool
    expects_robot_mask: bool


class Inbox:
    """The newest messages; filled by subscriptions, asked by requests in other threads."""

    def __init__(self) -> None:
        """Start empty."""
        self._arrived = threading.Condition()
        self._view: tuple[Any, str, int] | None = None
        self._infos: deque[Any] = deque(maxlen=_KEPT)
        self._colors: deque[Any] = deque(maxlen=_KEPT)
        self._robot_masks: deque[Any] = deque(maxlen=_KEPT)

    def put_view(self, message: Any, topic: str) -> None:
        """Take a cloud or depth image in place of the one before.

        Args:
            message: PointCloud2, Image or CompressedImage.
            topic: it came on.

        Raises:
            CaptureError: its stamp is malformed.
        """
        stamp = stamp_ns(message)
        with self._arrived:
            self._view = message, topic, stamp
            self._arrived.notify_all()

    def put_info(self, message: Any) -> None:
        """Take a CameraInfo.

        Args:
            message: of the depth images.
        """
        self._put(self._infos, message)

    def put_color(self, message: Any) -> None:
        """Take a color image.

        Args:
            message: Image.
        """
        self._put(self._colors, message)

    def put_robot_mask(self, message: Any) -> None:
        """Take a mask of the robot's own arm.

        Args:
            message: Image.
        """
        self._put(self._robot_masks, message)

    @property
    def newest_stamp_ns(self) -> int | None:
        """Of the newest view; None before the first."""
        view = self._view
        return None if view is None else view[2]

    def newest(self) -> RawView | None:
        """The newest view with what lies beside it now; nothing is waited for.

        Returns:
            None where there is none, or a depth image without its CameraInfo.
        """
        with self._arrived:
            if self._view is None:
                return None
            raw = self._beside(*self._view)
            return raw if raw.is_cloud or raw.info is not None else None

    def take(
        self,
        sources: Sources,
        is_fresh: Callable[[int], bool],
        wait_s: float,
        go_on: Callable[[], None],
    ) -> RawView:
        """Wait for a view that is fresh, and for what belongs to it.

        Args:
            sources: of the messages, for the sentence and for what is waited for.
            is_fresh: whether a view of this stamp, ns, may be used.
            wait_s: how long it is waited for, s.
            go_on: called now and then; what it raises ends the wait.

        Returns:
            The view; a color image that does not come in time is done without.

        Raises:
            Failure: NO_VIEW or STALE_VIEW.
        """
        until = time.monotonic() + wait_s
        with self._arrived:
            self._wait(lambda: self._usable(is_fresh), until, go_on)
            if not self._usable(is_fresh):
                raise self._why_none(sources, wait_s)
            view = self._view
            assert view is not None  # told by _usable
            self._wait(lambda: self._complete(view, sources), until, go_on)
            raw = self._beside(*view)
        if sources.expects_robot_mask and raw.robot_mask is None:
            raise Failure(
                Status.STALE_VIEW,
                f"no mask on {sources.robot_mask} within {COLOR_NEAR_NS / 1e9:g} s of the view, "
                "though the topic has a publisher; valid: a mask with every view",
            )
        return raw

    def _put(self, kept: deque[Any], message: Any) -> None:
        with self._arrived:
            kept.append(message)
            self._arrived.notify_all()

    def _wait(self, done: Callable[[], bool], until: float, go_on: Callable[[], None]) -> None:
        while not done() and (left := until - time.monotonic()) > 0:
            self._arrived.wait(min(left, _POLL_S))
            go_on()

    def _usable(self, is_fresh: Callable[[int], bool]) -> bool:
        if self._view is None or not is_fresh(self._view[2]):
            return False
        return _is_cloud(self._view[0]) or bool(self._infos)

    def _complete(self, view: tuple[Any, str, int], sources: Sources) -> bool:
        """Whether nothing nearer in time can still come of what is published beside the view."""
        message, _, stamp = view
        waited = []
        if sources.expects_color and not _is_cloud(message):
            waited.append(self._colors)
        if sources.expects_robot_mask:
            waited.append(self._robot_masks)
        return all(any(_stamp(item) >= stamp for item in kept) for kept in waited)

    def _beside(self, message: Any, topic: str, stamp: int) -> RawView:
        is_cloud = _is_cloud(message)
        return RawView(
            message=message,
            topic=topic,
            info=None if is_cloud else _nearest(self._infos, stamp),
            color=None if is_cloud else nearest_color(tuple(self._colors), message),
            robot_mask=_nearest(self._robot_masks, stamp, COLOR_NEAR_NS),
            stamp_ns=stamp,
        )

    def _why_none(self, sources: Sources, wait_s: float) -> Failure:
        if self._view is None:
            topics = ", ".join(sources.views)
            return Failure(Status.NO_VIEW, f"no view came within {wait_s:g} s on any of {topics}")
        message, topic, stamp = self._view
        if not _is_cloud(message) and not self._infos:
            return Failure(
                Status.NO_VIEW, f"depth comes on {topic}, but no CameraInfo on {sources.info}"
            )
        return Failure(
            Status.STALE_VIEW,
            f"the newest view, on {topic}, is of {stamp / 1e9:.3f} s; valid: not older than the "
            "request's min_stamp and the parameter max_view_age_s allow",
        )


def _is_cloud(message: Any) -> bool:
    """Whether a view is a PointCloud2; the other kinds are images."""
    return hasattr(message, "point_step")


def _nearest(messages: Iterable[T], stamp: int, within_ns: int | None = None) -> T | None:
    """The message nearest in time, the earlier of two as near; None where none is near enough."""
    best, apart = None, within_ns
    for message in messages:
        off = abs(_stamp(message) - stamp)
        if apart is None or off < apart:
            best, apart = message, off
    return best


def _stamp(message: Any) -> int:
    """A stamp, 0 for a malformed one: a ROS 2 time may hold any nanoseconds."""
    try:
        return stamp_ns(message)
    except CaptureError:
        return 0
