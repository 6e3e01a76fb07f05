"""The node beside a client that publishes what a robot would, each in threads of its own."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from typing import Any

from boxgrasp_msgs.action import SelectGrasp as SelectGraspAction
from boxgrasp_msgs.msg import GraspSelection, Status, Target, View
from boxgrasp_msgs.srv import ListObjects, SelectGrasp
from boxgrasp_ros.grasp_selector import LATCHED, RELIABLE, GraspSelectorNode
from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2
from tf2_msgs.msg import TFMessage
from waiting import call, wait_for, wait_until

NAMES = {
    getattr(Status, name): name for name in dir(type(Status)) if name.isupper() and name[0] != "_"
}
STATIC = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def plain(answer: str) -> dict[str, Any]:
    """An answer's JSON but for what may differ from run to run."""
    return {**json.loads(answer), "timings_ms": None, "capture": None}


class Rig:
    """A node and its client; every view is reliable here, so that none is lost."""

    def __init__(self, make_node: Callable[..., Any], **given: Any) -> None:
        reliable = {
            f"qos_overrides./{topic}.subscription.reliability": "reliable"
            for topic in ("cloud", "depth", "compressed_depth", "camera_info", "color")
        }
        reliable["qos_overrides./robot_mask.subscription.reliability"] = "reliable"
        overrides = [Parameter(name, value=value) for name, value in {**reliable, **given}.items()]
        self.node: GraspSelectorNode = make_node(
            "", lambda _, **options: GraspSelectorNode(**options), parameter_overrides=overrides
        )
        self.client: Node = make_node("client")
        create = self.client.create_publisher
        kinds = {
            "cloud": PointCloud2,
            "depth": Image,
            "compressed_depth": CompressedImage,
            "camera_info": CameraInfo,
            "color": Image,
            "robot_mask": Image,
        }
        self._kinds: dict[str, type] = kinds
        self._publishers: dict[str, Any] = {}
        self._tf = create(TFMessage, "/tf", QoSProfile(depth=100))
        self._tf_static = create(TFMessage, "/tf_static", STATIC)
        self._target = create(Target, "/grasp_selector/target", LATCHED)
        self._select = self.client.create_client(SelectGrasp, "/grasp_selector/select")
        self._objects = self.client.create_client(ListObjects, "/grasp_selector/objects")
        self.action = ActionClient(self.client, SelectGraspAction, "/grasp_selector/select")

    def publish(self, topic: str, message: Any) -> None:
        """Publish a view's message on a topic that the node is known to hear."""
        if topic not in self._publishers:
            kind = self._kinds[topic]
            self._publishers[topic] = self.client.create_publisher(kind, topic, RELIABLE)
        publisher = self._publishers[topic]
        wait_until(publisher.get_subscription_count, what=f"a match on {topic}")
        publisher.publish(message)

    def tell_transform(self, message: TFMessage, static: bool = False) -> None:
        """Publish a transform and wait until the node has it."""
        publisher = self._tf_static if static else self._tf
        wait_until(publisher.get_subscription_count, what="a match on /tf")
        publisher.publish(message)
        stamped = message.transforms[0]
        stamp = stamped.header.stamp.sec * 10**9 + stamped.header.stamp.nanosec
        self.node._transforms.wait(stamped.header.frame_id, stamped.child_frame_id, stamp, 10.0)

    def tell_target(self, target: Target) -> None:
        """Publish the latched target and wait until the node has it."""
        self._target.publish(target)
        wait_until(lambda: self.node._latched_target == target, what="the latched target")

    def select(self, view: View | None = None, target: Target | None = None) -> Any:
        """What the service answers."""
        request = SelectGrasp.Request(view=view or View(), target=target or Target())
        return call(self._select, request)

    def answer(self, view: View | None = None, target: Target | None = None) -> GraspSelection:
        """The selection that the service answers."""
        reply = self.select(view, target)
        assert reply.status.code == Status.SUCCEEDED, reply.status.message
        return reply.selection

    def failure(self, view: View | None = None, target: Target | None = None) -> tuple[str, str]:
        """The name of the status that the service answers, and its sentence."""
        status = self.select(view, target).status
        return NAMES[status.code], status.message

    def objects(self, view: View | None = None) -> Any:
        """What ~/objects answers."""
        return call(self._objects, ListObjects.Request(view=view or View()))

    def goal(
        self, view: View, target: Target, on_feedback: Callable[..., Any] | None = None
    ) -> Any:
        """An accepted goal's handle."""
        assert self.action.wait_for_server(timeout_sec=10)
        goal = SelectGraspAction.Goal(view=view, target=target)
        handle = wait_for(self.action.send_goal_async(goal, feedback_callback=on_feedback))
        assert handle.accepted
        return handle

    def heard(self, kind: type, topic: str, qos: QoSProfile = RELIABLE) -> list[Any]:
        """A list that fills with what comes on a topic."""
        found: list[Any] = []
        self.client.create_subscription(kind, topic, found.append, qos)
        wait_until(lambda: self.client.count_publishers(topic), what=f"a publisher of {topic}")
        time.sleep(0.2)  # the other side of the match
        return found

    def now_ns(self) -> int:
        """The client's clock."""
        return int(self.client.get_clock().now().nanoseconds)
