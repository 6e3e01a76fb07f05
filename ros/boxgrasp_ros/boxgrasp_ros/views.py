"""From the messages of a view to a capture with its pose; earlier views of the same scene."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from boxgrasp_msgs.msg import Status
from boxgrasp_msgs.msg import Target as TargetMessage
from boxgrasp_msgs.msg import View as ViewMessage

from boxgrasp.arrays import Floats
from boxgrasp.errors import CaptureError, TransformError
from boxgrasp.io.fields import stamp_ns
from boxgrasp.io.frames import TransformBuffer
from boxgrasp.io.messages import cloud_capture, depth_capture, read_mask
from boxgrasp.perception.target import Target
from boxgrasp.sensing.capture import Capture
from boxgrasp_ros.failures import Failure
from boxgrasp_ros.inbox import RawView
from boxgrasp_ros.settings import NodeConfig


@dataclass(frozen=True, eq=False)
class SeenView:
    """A view ready for the library.

    Attributes:
        capture: with its pose in the base frame, or in the base frame itself.
        stamp_ns: of the view.
    """

    capture: Capture
    stamp_ns: int


def requested_view(view: ViewMessage) -> RawView | None:
    """The view that a request carries.

    Args:
        view: of the request.

    Returns:
        It, or None where the newest one of the topics is meant.

    Raises:
        Failure: BAD_VIEW where it carries a cloud and depth.
        CaptureError: its stamp is malformed.
    """
    has_cloud = bool(view.cloud.width or view.cloud.height or len(view.cloud.data))
    has_depth = bool(view.depth.width or view.depth.height or len(view.depth.data))
    if has_cloud and has_depth:
        raise Failure(Status.BAD_VIEW, "the request has a cloud and depth; valid: one of them")
    if not (has_cloud or has_depth):
        return None
    message = view.cloud if has_cloud else view.depth
    return RawView(
        message=message,
        topic="",
        info=None if has_cloud else view.camera_info,
        color=view.color if has_depth and len(view.color.data) else None,
        robot_mask=view.robot_mask if len(view.robot_mask.data) else None,
        stamp_ns=stamp_ns(message),
    )


def seen_view(raw: RawView, transforms: TransformBuffer, config: NodeConfig) -> SeenView:
    """The capture of a view, with its pose at its own time.

    Args:
        raw: its messages.
        transforms: of /tf and /tf_static.
        config: frames, and how long to wait for a transform.

    Returns:
        It.

    Raises:
        Failure: the view names no frame.
        CaptureError: it cannot be converted.
        TransformError: the camera's pose is not known at that time.
    """
    frame = str(raw.message.header.frame_id)
    if not frame:
        raise Failure(Status.NO_TRANSFORM, "the view's header has no frame_id; valid: a frame")

    def lookup(target: str, source: str) -> Floats:
        return transforms.wait(target, source, raw.stamp_ns, config.wait_for_transform_s)

    robot_mask = None if raw.robot_mask is None else read_mask(raw.robot_mask)
    with np.errstate(all="ignore"):  # odd floats of a message are judged, not warned about
        if not raw.is_cloud:
            return SeenView(
                depth_capture(
                    raw.message,
                    raw.info,
                    topic=raw.topic,
                    color=raw.color,
                    T_base_camera=lookup(config.base_frame, frame),
                    robot_mask=robot_mask,
                ),
                raw.stamp_ns,
            )
        camera = config.camera_frame or frame
        if camera == config.base_frame:
            capture = cloud_capture(raw.message, "base", robot_mask=robot_mask)
            return SeenView(capture, raw.stamp_ns)
        capture = cloud_capture(
            raw.message,
            "optical",
            lookup(config.base_frame, camera),
            robot_mask=robot_mask,
            T_camera_cloud=None if camera == frame else lookup(camera, frame),
        )
        return SeenView(capture, raw.stamp_ns)


def target_of(
    message: TargetMessage, stamp: int, transforms: TransformBuffer, config: NodeConfig
) -> Target:
    """The library's target of a message.

    Args:
        message: whose kind says which field counts.
        stamp: of the view, ns, at which a point's frame is looked up.
        transforms: of /tf and /tf_static.
        config: the base frame, and how long to wait for a transform.

    Returns:
        It.

    Raises:
        Failure: BAD_TARGET for an unknown kind, or a mask of another encoding.
        TransformError: the point's frame is not known at that time.
    """
    kind = message.kind
    if kind == TargetMessage.PIXEL:
        return Target(pixel=(message.u, message.v))
    if kind == TargetMessage.POINT:
        place = message.point.point
        point = np.array([place.x, place.y, place.z, 1.0])
        frame = str(message.point.header.frame_id)
        if frame and frame != config.base_frame:
            at = stamp_ns(message.point) or stamp
            wait_s = config.wait_for_transform_s
            point = transforms.wait(config.base_frame, frame, at, wait_s) @ point
        x, y, z = point[:3].tolist()
        return Target(point=(x, y, z))
    if kind == TargetMessage.MASK:
        try:
            return Target(mask=read_mask(message.mask))
        except CaptureError as error:
            raise Failure(Status.BAD_TARGET, f"target's mask: {error}") from None
    if kind == TargetMessage.BOX:
        box = message.box
        u, v = box.x_offset, box.y_offset
        return Target(box=(u, v, u + box.width - 1, v + box.height - 1))
    if kind == TargetMessage.OBJECT:
        return Target(object=message.object)
    raise Failure(Status.BAD_TARGET, f"target's kind is {kind}; valid: 1 to 5, or 0 for ~/target")


class EarlierViews:
    """Views kept while the camera moves, to be fused into the map of a later one."""

    def __init__(self, transforms: TransformBuffer) -> None:
        """Start empty.

        Args:
            transforms: of /tf and /tf_static.
        """
        self._transforms = transforms
        self._kept: deque[SeenView] = deque()
        self._waiting: RawView | None = None

    def offer(self, raw: RawView, config: NodeConfig) -> None:
        """Keep the view before this one, where the camera stood elsewhere than for those kept.

        The one before, since transforms come a little later than views.

        Args:
            raw: the newest view.
            config: how many are kept, and how far apart.

        Raises:
            BoxgraspError: the view before cannot be converted.
        """
        before, self._waiting = self._waiting, raw
        if before is None or config.views == 0:
            return
        try:
            # The pose tells whether the view is kept; only then it is converted.
            frame = config.camera_frame or str(before.message.header.frame_id)
            at = self._transforms.lookup(config.base_frame, frame, before.stamp_ns)[:3, 3]
        except TransformError:
            return
        for view in self._kept:
            T = view.capture.T_base_camera
            if T is None or np.linalg.norm(T[:3, 3] - at) < config.views_min_move_m:
                return
        self._kept.append(seen_view(before, self._transforms, config))
        while len(self._kept) > config.views:
            self._kept.popleft()

    def scans(self, seen: SeenView, config: NodeConfig) -> list[Capture]:
        """The kept views that may be fused with one.

        Args:
            seen: the view that is answered.
            config: how many, and how old they may be.

        Returns:
            Captures with their poses, oldest first; none of the view itself.
        """
        oldest = seen.stamp_ns - round(config.views_max_age_s * 1e9)
        kept = [v for v in tuple(self._kept) if oldest <= v.stamp_ns < seen.stamp_ns]
        return [view.capture for view in kept[len(kept) - config.views :]] if config.views else []

    def clear(self) -> None:
        """Forget all of them: the scene has changed."""
        self._kept.clear()
        self._waiting = None
