"""The node `grasp_selector`: messages and parameters in, answers out; the core does the rest."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from copy import copy
from typing import Any, Final

import rclpy
from boxgrasp_msgs import action, srv
from boxgrasp_msgs import msg as own
from boxgrasp_msgs.msg import Status
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseArray, PoseStamped
from rcl_interfaces.msg import SetParametersResult
from rclpy.action import ActionServer, CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup, ReentrantCallbackGroup
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.time import Time
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2
from std_msgs.msg import Float64, Header
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import MarkerArray

from boxgrasp import GraspSelector
from boxgrasp.errors import BoxgraspError
from boxgrasp.io.frames import TransformBuffer
from boxgrasp.result import Selection
from boxgrasp.selector import SceneAnalysis
from boxgrasp_ros import parameters, planning_scene, replies
from boxgrasp_ros.diagnostics import Record, diagnostics
from boxgrasp_ros.failures import Failure, failure_of, status
from boxgrasp_ros.inbox import Inbox, RawView, Sources
from boxgrasp_ros.maps import Maps
from boxgrasp_ros.markers import failed_markers, marker_array
from boxgrasp_ros.views import EarlierViews, SeenView, requested_view, seen_view, target_of

LATCHED: Final = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
RELIABLE: Final = QoSProfile(depth=10)
_TF: Final = QoSProfile(depth=100)
_TF_STATIC: Final = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
_DIAGNOSTICS_S: Final = 1.0
_SPIN_S: Final = 0.5  # how soon an interrupt is seen at the latest
_RESULT_S: Final = 30  # how long a client may take to ask for its goal's result
_POLL_S: Final = 0.05  # how soon a request that waits for its turn sees that it was cancelled
_SPARE_THREADS: Final = 3  # for messages, while as many requests wait as may
_MOST_TOLD: Final = 200  # sentences that are remembered, so that each is logged once

GoOn = Callable[[], None]
RCLError: Final = rclpy_implementation.RCLError
UnknownROSArgsError: Final = rclpy_implementation.UnknownROSArgsError


class GraspSelectorNode(Node):
    """Answers requests with the library; holds what arrived, and what was answered last."""

    def __init__(self, **options: Any) -> None:
        """Declare parameters, compile, and take requests.

        Args:
            options: of rclpy's Node.

        Raises:
            ConfigError: a parameter that is wrong.
            BoxgraspError: as `GraspSelector`.
        """
        super().__init__("grasp_selector", **options)
        config, self._node_config = parameters.declare(self)
        self._selector = GraspSelector(config)
        self._selector.warm_up()
        self._transforms = TransformBuffer()
        self._inbox, self._maps = Inbox(), Maps()
        self._earlier = EarlierViews(self._transforms)
        self._latched_target: own.Target | None = None
        self._record = Record()
        self._turn, self._counting, self._waiting = threading.Lock(), threading.Lock(), 0
        self._told: set[str] = set()
        self._collision_ids: frozenset[str] = frozenset()
        self._after = ThreadPoolExecutor(1, "pictures")
        self._requests = ReentrantCallbackGroup()
        self._subscribe()
        self._publish()
        self._serve()
        self.add_on_set_parameters_callback(self._set_parameters)
        self.get_logger().info(f"ready; answers are in {self._node_config.base_frame}")

    @property
    def threads(self) -> int:
        """How many an executor needs, so that messages arrive while requests wait."""
        return self._node_config.max_waiting + 1 + _SPARE_THREADS

    def destroy_node(self) -> None:
        """Let what is being drawn end, then take everything down."""
        self._after.shutdown(wait=True, cancel_futures=True)
        super().destroy_node()

    # What arrives.

    def _subscribe(self) -> None:
        views, transforms = MutuallyExclusiveCallbackGroup(), MutuallyExclusiveCallbackGroup()

        def listen(
            kind: type, topic: str, put: Callable[[Any, str], None], qos: QoSProfile, group: Any
        ) -> str:
            def take(message: Any) -> None:
                try:
                    put(message, name)
                except BoxgraspError as error:
                    self._tell_once(f"{name}: {error}")
                except Exception as error:  # a malformed message must not end the node
                    self._tell_once(f"{name}: {type(error).__name__}: {error}")

            subscription = self.create_subscription(
                kind,
                topic,
                take,
                copy(qos),  # overrides are written into it
                callback_group=group,
                qos_overriding_options=QoSOverridingOptions.with_default_policies(),
            )
            name: str = subscription.topic_name
            return name

        sensor = qos_profile_sensor_data
        self._view_topics = (
            listen(PointCloud2, "cloud", self._take_view, sensor, views),
            listen(Image, "depth", self._take_view, sensor, views),
            listen(CompressedImage, "compressed_depth", self._take_view, sensor, views),
        )
        inbox = self._inbox
        self._info_topic = listen(
            CameraInfo, "camera_info", lambda m, _: inbox.put_info(m), sensor, views
        )
        self._color_topic = listen(Image, "color", lambda m, _: inbox.put_color(m), sensor, views)
        self._robot_mask_topic = listen(
            Image, "robot_mask", lambda m, _: inbox.put_robot_mask(m), sensor, views
        )
        static = self._transforms.add
        listen(TFMessage, "/tf", lambda m, _: static(m, False), _TF, transforms)
        listen(TFMessage, "/tf_static", lambda m, _: static(m, True), _TF_STATIC, transforms)
        listen(own.Target, "~/target", self._take_target, LATCHED, transforms)
        self._subscribe_maps(listen, transforms)

    def _subscribe_maps(self, listen: Callable[..., str], group: Any) -> None:
        """Maps come where their message packages are installed."""
        try:
            from octomap_msgs.msg import Octomap
        except ImportError:
            if self._node_config.use_octomap:
                self._tell_once("use_octomap is set, but octomap_msgs is not installed")
            return
        listen(
            Octomap, "octomap", lambda m, t: self._maps.put(m, t, self._now_ns()), LATCHED, group
        )
        try:
            from moveit_msgs.msg import PlanningScene
        except ImportError:
            return
        listen(
            PlanningScene,
            "planning_scene",
            lambda m, t: self._maps.put_scene(m, t, self._now_ns()),
            RELIABLE,
            group,
        )

    def _take_view(self, message: Any, topic: str) -> None:
        self._inbox.put_view(message, topic)
        if self._node_config.views and (raw := self._inbox.newest()) is not None:
            self._earlier.offer(raw, self._node_config)

    def _take_target(self, message: own.Target, _: str) -> None:
        self._latched_target = message

    # What is published.

    def _publish(self) -> None:
        self._grasp = self.create_publisher(PoseStamped, "~/grasp", RELIABLE)
        self._grasps = self.create_publisher(PoseArray, "~/grasps", RELIABLE)
        self._selection = self.create_publisher(own.GraspSelection, "~/selection", RELIABLE)
        self._opening = self.create_publisher(Float64, "~/gripper_opening", RELIABLE)
        self._markers = self.create_publisher(MarkerArray, "~/markers", LATCHED)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", RELIABLE)
        self._collisions: Publisher | None = None
        if planning_scene.AVAILABLE:
            from moveit_msgs.msg import CollisionObject

            self._collisions = self.create_publisher(
                CollisionObject, "~/collision_objects", QoSProfile(depth=100)
            )
        self.create_timer(_DIAGNOSTICS_S, self._tell_diagnostics)

    def _tell_diagnostics(self) -> None:
        newest, now = self._inbox.newest_stamp_ns, self.get_clock().now()
        age_s = None if newest is None else (now.nanoseconds - newest) / 1e9
        self._diagnostics.publish(diagnostics(self._record, self.get_name(), now.to_msg(), age_s))

    def _tell_answer(
        self, analysis: SceneAnalysis, selection: Selection, message: own.GraspSelection
    ) -> None:
        """Publish an answer; what is only looked at comes after the reply has left."""
        header = message.header
        self._selection.publish(message)
        self._grasps.publish(replies.poses(selection, header))
        grasp = replies.grasp_pose(selection, header)
        if grasp is not None and selection.grasp is not None:
            self._grasp.publish(grasp)
            self._opening.publish(Float64(data=selection.grasp.opening_m))
        self._later(lambda: self._show_answer(analysis, selection, header))

    def _show_answer(self, analysis: SceneAnalysis, selection: Selection, header: Header) -> None:
        if self._node_config.publish_markers:
            self._markers.publish(marker_array(analysis, selection, header))
        if self._collisions is not None:
            found = planning_scene.collision_objects(
                analysis, selection, header, self._collision_ids
            )
            for item in found:
                self._collisions.publish(item)
            present = {item.id for item in found if item.operation != item.REMOVE}
            self._collision_ids = frozenset(present)

    def _later(self, work: Callable[[], None]) -> None:
        def guarded() -> None:
            try:
                work()
            except Exception as error:  # a picture that fails must not end the node
                if self.context.ok():
                    self._tell_once(f"markers: {type(error).__name__}: {error}")

        try:
            self._after.submit(guarded)
        except RuntimeError:  # the node is going down
            return

    # Requests.

    def _serve(self) -> None:
        group = self._requests
        self.create_service(srv.SelectGrasp, "~/select", self._on_select, callback_group=group)
        self.create_service(srv.ListObjects, "~/objects", self._on_objects, callback_group=group)
        self.create_service(Trigger, "~/clear_views", self._on_clear_views, callback_group=group)
        self._action = ActionServer(
            self,
            action.SelectGrasp,
            "~/select",
            execute_callback=self._on_goal,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
            callback_group=group,
            result_timeout=_RESULT_S,
        )

    def _on_select(
        self, request: srv.SelectGrasp.Request, response: srv.SelectGrasp.Response
    ) -> srv.SelectGrasp.Response:
        self._fill(response, lambda: self._select(request, lambda _: None, self._keep_going))
        return response

    def _on_goal(self, goal: ServerGoalHandle) -> action.SelectGrasp.Result:
        start, result = time.perf_counter(), action.SelectGrasp.Result()

        def go_on() -> None:
            self._keep_going()
            if goal.is_cancel_requested:
                raise Failure(Status.CANCELLED, "the goal was cancelled")

        def on_stage(stage: str) -> None:
            go_on()
            elapsed_ms = (time.perf_counter() - start) * 1e3
            goal.publish_feedback(action.SelectGrasp.Feedback(stage=stage, elapsed_ms=elapsed_ms))

        self._fill(result, lambda: self._select(goal.request, on_stage, go_on))
        # The server keeps the goal beside its result; its images would be megabytes.
        goal.request.view, goal.request.target = own.View(), own.Target()
        if goal.is_cancel_requested and result.status.code == Status.CANCELLED:
            goal.canceled()
        elif result.status.code == Status.SUCCEEDED:
            goal.succeed()
        else:
            goal.abort()
        return result

    def _on_objects(
        self, request: srv.ListObjects.Request, response: srv.ListObjects.Response
    ) -> srv.ListObjects.Response:
        def answer() -> None:
            with self._one_at_a_time(self._keep_going):
                seen = self._view(request.view, self._keep_going)
                found = self._selector.objects(seen.capture)
                response.header = self._header(seen)
                response.objects = replies.object_messages(found)

        response.status = self._ended(answer)
        return response

    def _on_clear_views(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._earlier.clear()
        response.success = True
        return response

    def _fill(self, reply: Any, answer: Callable[[], own.GraspSelection]) -> None:
        """Put an answer, or why there is none, into a reply."""

        def fill() -> None:
            reply.selection = answer()

        reply.status = told = self._ended(fill)
        if told.code in (Status.SUCCEEDED, Status.BUSY) or not self._node_config.publish_markers:
            return
        header = Header(frame_id=self._node_config.base_frame)
        header.stamp = self.get_clock().now().to_msg()
        self._later(lambda: self._markers.publish(failed_markers(header, told.message)))

    def _ended(self, work: Callable[[], None]) -> Status:
        """How a request's work ended."""
        start = time.perf_counter()
        failure: Failure | None = None
        try:
            work()
        except Exception as error:
            failure = failure_of(error)
        told = status(failure, (time.perf_counter() - start) * 1e3)
        if failure is not None:
            self._record = self._record.failed(told)
            if told.code != Status.CANCELLED:
                self._tell_once(told.message)
        return told

    def _select(
        self, request: Any, on_stage: Callable[[str], None], go_on: GoOn
    ) -> own.GraspSelection:
        with self._one_at_a_time(go_on):
            # Parameters may be set meanwhile; this request keeps those it began with.
            selector, node_config = self._selector, self._node_config
            seen = self._view(request.view, go_on)
            message = request.target
            if message.kind == own.Target.NONE:
                if self._latched_target is None:
                    raise Failure(
                        Status.BAD_TARGET, "no target in the request, and none came on ~/target"
                    )
                message = self._latched_target
            target = target_of(message, seen.stamp_ns, self._transforms, node_config)
            octomap = None
            if node_config.use_octomap:
                octomap = self._maps.cells(
                    seen.stamp_ns, self._transforms, selector.config, node_config
                )
            on_stage("view")
            scans = self._earlier.scans(seen, node_config)
            analysis = selector.analyze(seen.capture, target, scans, octomap, on_stage=on_stage)
            selection = selector.choose(analysis)
            answer = replies.selection_message(selection, self._header(seen))
            self._record = self._record.answered(selection.grasp is None, selection.timings_ms)
            self._tell_answer(analysis, selection, answer)
            return answer

    def _view(self, view: own.View, go_on: GoOn) -> SeenView:
        raw = requested_view(view)
        if raw is None:
            raw = self._newest(Time.from_msg(view.min_stamp).nanoseconds, go_on)
        return seen_view(raw, self._transforms, self._node_config)

    def _newest(self, min_stamp_ns: int, go_on: GoOn) -> RawView:
        config = self._node_config
        oldest = round(config.max_view_age_s * 1e9)

        def is_fresh(stamp: int) -> bool:
            return stamp >= min_stamp_ns and self._now_ns() - stamp <= oldest

        sources = Sources(
            self._view_topics,
            self._info_topic,
            self._robot_mask_topic,
            expects_color=self.count_publishers(self._color_topic) > 0,
            expects_robot_mask=self.count_publishers(self._robot_mask_topic) > 0,
        )
        return self._inbox.take(sources, is_fresh, config.wait_for_view_s, go_on)

    @contextmanager
    def _one_at_a_time(self, go_on: GoOn) -> Iterator[None]:
        """One request's turn; the others wait, up to a number."""
        with self._counting:
            if self._waiting > self._node_config.max_waiting:
                raise Failure(
                    Status.BUSY,
                    f"{self._waiting - 1} requests wait already; valid: up to "
                    f"{self._node_config.max_waiting} (max_waiting)",
                )
            self._waiting += 1
        try:
            while not self._turn.acquire(timeout=_POLL_S):
                go_on()
            try:
                go_on()
                yield
            finally:
                self._turn.release()
        finally:
            with self._counting:
                self._waiting -= 1

    def _keep_going(self) -> None:
        if not self.context.ok():
            raise Failure(Status.CANCELLED, "the node is going down")

    def _header(self, seen: SeenView) -> Header:
        header = Header(frame_id=self._node_config.base_frame)
        header.stamp = Time(nanoseconds=seen.stamp_ns).to_msg()
        return header

    # Parameters, time, log.

    def _set_parameters(self, given: list[Parameter]) -> SetParametersResult:
        try:
            before = self._selector.config
            config, node_config = parameters.updated(before, self._node_config, given)
            if config is not before:
                self._selector = GraspSelector(config)
            self._node_config = node_config
        except BoxgraspError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _now_ns(self) -> int:
        now: int = self.get_clock().now().nanoseconds
        return now

    def _tell_once(self, sentence: str) -> None:
        """Log a sentence the first time that it comes."""
        if sentence in self._told:
            return
        if len(self._told) < _MOST_TOLD:
            self._told.add(sentence)
            self.get_logger().warning(sentence)


def main(args: list[str] | None = None) -> int:
    """Run the node until it is interrupted.

    Args:
        args: of ROS; None for those of the process.

    Returns:
        Exit status: 0 after an interrupt, 2 where a parameter or an argument is wrong.
    """
    node: GraspSelectorNode | None = None
    try:
        rclpy.init(args=args)
        node = GraspSelectorNode()
        executor = MultiThreadedExecutor(node.threads)
        executor.add_node(node)
        while rclpy.ok():  # a signal beside a wait without end may not be seen
            executor.spin_once(timeout_sec=_SPIN_S)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except (BoxgraspError, RCLError, UnknownROSArgsError) as error:
        if node is None or rclpy.ok():  # else the signal came between two steps of the executor
            line = " ".join(str(error).split())
            print(f"grasp_selector: {line}", file=sys.stderr)  # noqa: T201
            return 2
    finally:
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
