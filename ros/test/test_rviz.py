"""The view that ships for RViz shows the node's topics, each with the display of its type."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml
from boxgrasp_ros.interfaces import HEARD, TOLD
from boxgrasp_ros.markers import NAMESPACES

FILE = Path(__file__).resolve().parents[1] / "boxgrasp_ros" / "rviz" / "boxgrasp.rviz"
# RViz2's display of a message.
DISPLAYS = {
    "sensor_msgs/PointCloud2": "PointCloud2",
    "sensor_msgs/Image": "Image",
    "visualization_msgs/MarkerArray": "MarkerArray",
    "geometry_msgs/PoseStamped": "Pose",
    "geometry_msgs/PoseArray": "PoseArray",
}
WANTED = ("cloud", "color", "~/markers", "~/grasp", "~/grasps")


def view() -> dict[str, Any]:
    found: dict[str, Any] = yaml.safe_load(FILE.read_text())["Visualization Manager"]
    return found


def test_every_topic_is_the_nodes_with_the_display_of_its_type() -> None:
    shown = {item["Topic"]["Value"]: item for item in view()["Displays"] if "Topic" in item}
    interfaces = {item.name: item for item in (*HEARD, *TOLD) if item.name in WANTED}
    assert set(shown) == {name.replace("~", "/grasp_selector") for name in WANTED}
    for name, interface in interfaces.items():
        item = shown[name.replace("~", "/grasp_selector")]
        assert item["Class"] == f"rviz_default_plugins/{DISPLAYS[interface.type]}", name
        durability = item["Topic"]["Durability Policy"]
        assert durability == ("Transient Local" if "latched" in interface.qos else "Volatile"), name
        # A reliable display would never meet a camera's best-effort topic.
        reliable = item["Topic"]["Reliability Policy"]
        assert reliable == ("Reliable" if "reliable" in interface.qos else "Best Effort"), name


def test_displays_are_those_a_person_needs() -> None:
    displays = {item["Class"].rpartition("/")[2]: item for item in view()["Displays"]}
    assert {"Grid", "TF"} <= set(displays)
    names = [item["Name"] for item in view()["Displays"]]
    assert len(set(names)) == len(names)
    assert all(item["Enabled"] is item["Value"] for item in view()["Displays"])
    assert displays["MarkerArray"]["Namespaces"] == dict.fromkeys(NAMESPACES, True)


def test_the_view_looks_from_behind_the_robot_at_its_table() -> None:
    assert view()["Global Options"]["Fixed Frame"] == "base_link"
    orbit = view()["Views"]["Current"]
    assert orbit["Class"] == "rviz_default_plugins/Orbit"
    assert 0.3 < orbit["Pitch"] < 1.2 and 3.14 - 0.8 < orbit["Yaw"] < 3.14 + 0.8
    assert 0.4 < orbit["Focal Point"]["X"] < 1.0 and 1.0 < orbit["Distance"] < 3.0
