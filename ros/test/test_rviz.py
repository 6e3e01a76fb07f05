"""The view that ships for RViz shows the node's topics, each with the display of its type."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml
from boxgrasp_ros.markers import NAMESPACES

FILE = Path(__file__).resolve().parents[1] / "boxgrasp_ros" / "rviz" / "boxgrasp.rviz"
# Topic: RViz2's display of its type, and whether it is latched.
TOPICS = {
    "cloud": ("rviz_default_plugins/PointCloud2", False),
    "color": ("rviz_default_plugins/Image", False),
    "/grasp_selector/markers": ("rviz_default_plugins/MarkerArray", True),
    "/grasp_selector/grasp": ("rviz_default_plugins/Pose", True),
    "/grasp_selector/grasps": ("rviz_default_plugins/PoseArray", True),
}


def view() -> dict[str, Any]:
    found: dict[str, Any] = yaml.safe_load(FILE.read_text())["Visualization Manager"]
    return found


def test_every_topic_is_the_nodes_with_the_display_of_its_type() -> None:
    shown = {item["Topic"]["Value"]: item for item in view()["Displays"] if "Topic" in item}
    assert set(shown) == set(TOPICS)
    for topic, (display, latched) in TOPICS.items():
        item = shown[topic]
        assert item["Class"] == display, topic
        durability = item["Topic"]["Durability Policy"]
        assert durability == ("Transient Local" if latched else "Volatile"), topic
        # A reliable display would never meet a camera's best-effort topic.
        reliable = item["Topic"]["Reliability Policy"]
        assert reliable == ("Reliable" if latched else "Best Effort"), topic


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
