"""What the node hears, tells and answers: the tables of the documents, which tests hold to it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True)
class Interface:
    """One topic, service or action.

    Attributes:
        name: as the node has it; without a leading ~ or / it is relative.
        type: package/Name of the message, service or action.
        qos: in words; empty for a service or action.
        meaning: one sentence.
    """

    name: str
    type: str
    qos: str
    meaning: str


_SENSOR, _RELIABLE, _LATCHED = "best effort, 5", "reliable, 10", "reliable, latched, 1"

HEARD = (
    Interface("cloud", "sensor_msgs/PointCloud2", _SENSOR, "a view: organized or not, any layout"),
    Interface("depth", "sensor_msgs/Image", _SENSOR, "a view: 16UC1 in mm, 32FC1 in m, rectified"),
    Interface(
        "compressed_depth",
        "sensor_msgs/CompressedImage",
        _SENSOR,
        "a view: compressedDepth as PNG or RVL, of 16UC1 or 32FC1",
    ),
    Interface("camera_info", "sensor_msgs/CameraInfo", _SENSOR, "the camera of depth images"),
    Interface(
        "color",
        "sensor_msgs/Image",
        _SENSOR,
        "colors beside depth, of its size and frame, within 0.1 s; waited for where published",
    ),
    Interface(
        "robot_mask",
        "sensor_msgs/Image",
        _SENSOR,
        "mono8, not 0 on the robot's own arm, within 0.1 s of the view; needed where published",
    ),
    Interface("/tf", "tf2_msgs/TFMessage", "reliable, 100", "transforms"),
    Interface("/tf_static", "tf2_msgs/TFMessage", "reliable, latched, 100", "fixed transforms"),
    Interface(
        "~/target", "boxgrasp_msgs/Target", _LATCHED, "the target of requests that name none"
    ),
    Interface(
        "octomap",
        "octomap_msgs/Octomap",
        _LATCHED,
        "a map, binary or full, in the base frame; used where use_octomap is set",
    ),
    Interface(
        "planning_scene",
        "moveit_msgs/PlanningScene",
        _RELIABLE,
        "MoveIt's scene with an OctoMap in it, in place of octomap",
    ),
)
TOLD = (
    Interface("~/grasp", "geometry_msgs/PoseStamped", _RELIABLE, "the gripper's box of a grasp"),
    Interface(
        "~/grasps",
        "geometry_msgs/PoseArray",
        _RELIABLE,
        "every passing candidate, best first; empty where a person is asked",
    ),
    Interface(
        "~/selection",
        "boxgrasp_msgs/GraspSelection",
        _RELIABLE,
        "the whole answer: candidates, checks, reasons, warnings, timings",
    ),
    Interface("~/gripper_opening", "std_msgs/Float64", _RELIABLE, "how far the fingers open, m"),
    Interface(
        "~/markers", "visualization_msgs/MarkerArray", _LATCHED, "every stage of an answer, drawn"
    ),
    Interface(
        "~/collision_objects",
        "moveit_msgs/CollisionObject",
        "reliable, 100",
        "table, objects and the target as boxes for MoveIt's scene, where moveit_msgs is",
    ),
    Interface(
        "/diagnostics", "diagnostic_msgs/DiagnosticArray", _RELIABLE, "counts and timings, 1 Hz"
    ),
)
ANSWERED = (
    Interface("~/select", "boxgrasp_msgs/srv/SelectGrasp", "", "a grasp, or a request for help"),
    Interface(
        "~/select",
        "boxgrasp_msgs/action/SelectGrasp",
        "",
        "the same, with feedback by stage; can be cancelled",
    ),
    Interface("~/objects", "boxgrasp_msgs/srv/ListObjects", "", "the objects with their numbers"),
    Interface("~/clear_views", "std_srvs/srv/Trigger", "", "forgets earlier views"),
)


def markdown_table(interfaces: Iterable[Interface]) -> str:
    """A table for the documents.

    Args:
        interfaces: in their order.

    Returns:
        Markdown.
    """
    listed = tuple(interfaces)
    has_qos = any(item.qos for item in listed)
    head = ("name", "type", "QoS", "what it is") if has_qos else ("name", "type", "what it is")
    lines = [" | ".join(head), " | ".join("---" for _ in head)]
    for item in listed:
        told = (f"`{item.name}`", item.type, *((item.qos,) if has_qos else ()), item.meaning)
        lines.append(" | ".join(told))
    return "".join(f"| {line} |\n" for line in lines)
