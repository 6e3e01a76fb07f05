"""The tables of the documents are the node's own interface."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from boxgrasp_ros.interfaces import ANSWERED, HEARD, TOLD, Interface
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from readme_tables import README, refreshed
from rig import Rig

OWN = "/grasp_selector"
ROS = {"/rosout", "/parameter_events"}


def whole(name: str) -> str:
    return name if name.startswith("/") else name.replace("~", OWN) if "~" in name else f"/{name}"


def in_words(qos: QoSProfile) -> str:
    reliable = qos.reliability == ReliabilityPolicy.RELIABLE
    latched = qos.durability == DurabilityPolicy.TRANSIENT_LOCAL
    words = ["reliable" if reliable else "best effort", *(["latched"] if latched else [])]
    return ", ".join((*words, str(qos.depth)))


def kind_of(message: type) -> str:
    return f"{message.__module__.split('.')[0]}/{message.__name__}"


def told(interfaces: tuple[Interface, ...]) -> dict[str, tuple[str, str]]:
    return {whole(item.name): (item.type, item.qos) for item in interfaces}


def test_topics_are_those_of_the_tables(make_node: Callable[..., Any]) -> None:
    from boxgrasp_ros.grasp_selector import GraspSelectorNode

    node = make_node("", lambda _, **options: GraspSelectorNode(**options))
    heard = {
        item.topic_name: (kind_of(item.msg_type), in_words(item.qos_profile))
        for item in node.subscriptions
    }
    assert heard == told(HEARD)
    published = {
        item.topic_name: (kind_of(item.msg_type), in_words(item.qos_profile))
        for item in node.publishers
        if item.topic_name not in ROS
    }
    assert published == told(TOLD)


def test_a_topics_qos_is_overridden_alone(make_node: Callable[..., Any]) -> None:
    from boxgrasp_ros.grasp_selector import GraspSelectorNode

    given = [Parameter("qos_overrides./depth.subscription.reliability", value="reliable")]
    node = make_node(
        "", lambda _, **options: GraspSelectorNode(**options), parameter_overrides=given
    )
    found = {item.topic_name: in_words(item.qos_profile) for item in node.subscriptions}
    assert found["/depth"] == "reliable, 5"
    assert found["/cloud"] == found["/color"] == "best effort, 5"


def test_services_and_the_action_are_those_of_the_table(make_node: Callable[..., Any]) -> None:
    rig = Rig(make_node)
    services = dict(rig.node.get_service_names_and_types_by_node("grasp_selector", "/"))
    actions = rig.client.get_service_names_and_types_by_node("grasp_selector", "/")
    assert actions
    for item in ANSWERED:
        if "/action/" not in item.type:
            assert services[whole(item.name)] == [item.type]
    own = {
        name for name in services
        if name.startswith(OWN) and "parameter" not in name and "_action" not in name
        and "type_description" not in name
    }  # fmt: skip
    assert own == {whole(item.name) for item in ANSWERED if "/srv/" in item.type}
    assert f"{OWN}/select/_action/send_goal" in services


def test_the_readme_has_the_tables() -> None:
    told = README.read_text("utf-8")
    assert refreshed(told) == told, "python ros/test/readme_tables.py"
