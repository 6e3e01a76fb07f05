"""What every other test here rests on: real middleware, alone in its domain, with our messages."""

from __future__ import annotations

import math
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import moveit_msgs.msg
import octomap_msgs.msg
import pytest
import rclpy
import setup_env
import tf2_msgs.msg
from action_msgs.msg import GoalStatus
from boxgrasp_msgs.action import SelectGrasp as SelectGraspAction
from boxgrasp_msgs.msg import (
    CheckResult,
    GraspCandidate,
    GraspSelection,
    Status,
    Target,
)
from boxgrasp_msgs.srv import SelectGrasp
from geometry_msgs.msg import Point, TransformStamped
from rclpy.action import ActionClient, ActionServer, CancelResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import String
from waiting import call, wait_for, wait_until

MakeNode = Callable[..., Any]
LATCHED = QoSProfile(
    depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL, reliability=ReliabilityPolicy.RELIABLE
)


def a_selection() -> GraspSelection:
    """A selection with something in every kind of field."""
    check = CheckResult(name="visible_clearance", value=0.031, limit=0.02, unit="m", passed=True)
    check.object, check.has_nearest_point, check.nearest_point = 4, True, Point(x=0.5, y=-0.25)
    candidate = GraspCandidate(label=7, face=4, face_name="top-parallel", line=1, rank=1)
    candidate.width_m, candidate.passed, candidate.checks = 0.04, True, [check]
    selection = GraspSelection(status="grasp", ranker="clearance", label=7, passing=[7, 3])
    selection.header.frame_id = "base_link"
    selection.pose.position.z = 0.125
    selection.candidates = [candidate] * 15
    selection.probability_clear = math.nan
    selection.box_dimensions_at_most_m.x = math.inf
    selection.timing_stages, selection.timings_ms = ["scene", "box"], [12.5, 0.5]
    selection.json = '{"schema": 2, "name": "Gefäß"}'
    return selection


def test_a_selection_arrives_as_it_was_sent(make_node: MakeNode) -> None:
    got: list[GraspSelection] = []
    make_node("listener").create_subscription(GraspSelection, "selection", got.append, 10)
    publisher = make_node("talker").create_publisher(GraspSelection, "selection", 10)
    wait_until(lambda: publisher.get_subscription_count() == 1, what="discovery")
    sent = a_selection()
    publisher.publish(sent)
    wait_until(lambda: got, what="the message")
    assert math.isnan(got[0].probability_clear)
    got[0].probability_clear = sent.probability_clear = 0.0  # NaN equals nothing
    assert got[0] == sent


def test_a_latched_message_waits_for_who_comes_late(make_node: MakeNode) -> None:
    talker = make_node("talker")
    publisher = talker.create_publisher(GraspSelection, "selection", LATCHED)
    publisher.publish(GraspSelection(status="ask"))
    publisher.publish(GraspSelection(status="grasp"))
    latched: list[GraspSelection] = []
    volatile: list[GraspSelection] = []
    listener = make_node("listener")
    listener.create_subscription(GraspSelection, "selection", volatile.append, 10)
    listener.create_subscription(GraspSelection, "selection", latched.append, LATCHED)
    wait_until(lambda: latched, what="the latched message")
    wait_until(lambda: publisher.get_subscription_count() == 2, what="discovery")
    assert [message.status for message in latched] == ["grasp"], "the last alone is kept"
    assert volatile == [], "who does not ask for it gets nothing old"


def test_a_service_answers(make_node: MakeNode) -> None:
    def answer(request: SelectGrasp.Request, response: SelectGrasp.Response) -> Any:
        response.selection = a_selection()
        response.selection.label = request.target.u + request.target.v
        response.status.code = Status.SUCCEEDED
        return response

    make_node("server").create_service(SelectGrasp, "select", answer)
    client = make_node("client").create_client(SelectGrasp, "select")
    request = SelectGrasp.Request(target=Target(kind=Target.PIXEL, u=322, v=247))
    request.view.depth.data = b"\1\0" * 100
    response = call(client, request)
    assert response.status.code == Status.SUCCEEDED
    assert response.selection.label == 569 and len(response.selection.candidates) == 15


class Worker:
    """An action server that tells stages until it is cancelled, or until it told them all."""

    def __init__(self, node: Node, stages: list[str]) -> None:
        self.stages = stages
        self.go_on = threading.Event()
        ActionServer(
            node,
            SelectGraspAction,
            "select",
            self.work,
            callback_group=ReentrantCallbackGroup(),
            cancel_callback=lambda goal: CancelResponse.ACCEPT,
        )

    def work(self, goal: Any) -> SelectGraspAction.Result:
        result = SelectGraspAction.Result()
        for stage in self.stages:
            goal.publish_feedback(SelectGraspAction.Feedback(stage=stage, elapsed_ms=1.0))
            until = time.monotonic() + 20
            while not self.go_on.is_set() and time.monotonic() < until:
                if goal.is_cancel_requested:
                    goal.canceled()
                    result.status.code = Status.CANCELLED
                    return result
                time.sleep(0.01)
        goal.succeed()
        result.selection = a_selection()
        return result


def test_an_action_tells_its_stages_and_succeeds(make_node: MakeNode) -> None:
    worker = Worker(make_node("server"), ["scene", "box", "answer"])
    client = ActionClient(make_node("client"), SelectGraspAction, "select")
    assert client.wait_for_server(timeout_sec=20)
    told: list[str] = []
    goal = wait_for(
        client.send_goal_async(
            SelectGraspAction.Goal(target=Target(kind=Target.OBJECT, object=4)),
            feedback_callback=lambda message: told.append(message.feedback.stage),
        )
    )
    assert goal.accepted
    wait_until(lambda: told == ["scene"], what="the first stage")
    worker.go_on.set()
    done = wait_for(goal.get_result_async())
    assert done.status == GoalStatus.STATUS_SUCCEEDED and done.result.selection.label == 7
    wait_until(lambda: told == worker.stages, what="the last stage")


def test_an_action_can_be_cancelled(make_node: MakeNode) -> None:
    Worker(make_node("server"), ["scene"])
    client = ActionClient(make_node("client"), SelectGraspAction, "select")
    assert client.wait_for_server(timeout_sec=20)
    goal = wait_for(client.send_goal_async(SelectGraspAction.Goal()))
    response = wait_for(goal.cancel_goal_async())
    assert len(response.goals_canceling) == 1
    done = wait_for(goal.get_result_async())
    assert done.status == GoalStatus.STATUS_CANCELED
    assert done.result.status.code == Status.CANCELLED


TALKER = """
import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String
rclpy.init()
node = rclpy.create_node("elsewhere")
latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
publisher = node.create_publisher(String, "word", latched)
publisher.publish(String(data="from elsewhere"))
print("ready", node.context.get_domain_id(), flush=True)
input()
"""


def test_another_process_is_met_in_the_same_domain_and_in_no_other(
    make_node: MakeNode, other_domain_id: int, ros_env: dict[str, str]
) -> None:
    got: list[String] = []
    make_node("listener").create_subscription(String, "word", got.append, LATCHED)
    other = {**ros_env, "ROS_DOMAIN_ID": str(other_domain_id)}
    for env, met in ((other, False), (ros_env, True)):
        with subprocess.Popen(
            [sys.executable, "-c", TALKER], env=env, text=True, stdin=-1, stdout=-1
        ) as talker:
            assert talker.stdout and talker.stdout.readline().split() == [
                "ready",
                env["ROS_DOMAIN_ID"],
            ]
            if met:
                wait_until(lambda: got, what="the word")
            else:
                time.sleep(1.0)
                assert got == []
            talker.communicate("\n", timeout=20)
        assert talker.returncode == 0


def test_tests_keep_to_this_machine_and_to_their_domain(
    context: rclpy.Context, domain_id: int, ros_env: dict[str, str], log_folder: Path
) -> None:
    assert context.get_domain_id() == domain_id
    assert 1 <= domain_id <= 101
    assert ros_env["ROS_DOMAIN_ID"] == str(domain_id)
    assert ros_env["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"
    assert ros_env["ROS_LOG_DIR"] == str(log_folder)
    assert not {"ROS_LOCALHOST_ONLY", "ROS_STATIC_PEERS"} & set(os.environ)


def own_ports() -> set[int]:
    """The UDP ports that this process has open."""
    links = [path.readlink() for path in Path("/proc/self/fd").iterdir() if path.is_symlink()]
    rows = [line.split() for line in Path("/proc/net/udp").read_text().splitlines()[1:]]
    sockets = {f"socket:[{row[9]}]": int(row[1].split(":")[1], 16) for row in rows}
    return {sockets[str(link)] for link in links if str(link) in sockets}


def test_discovery_listens_for_no_multicast(make_node: MakeNode, domain_id: int) -> None:
    make_node("quiet")
    first = 7400 + 250 * domain_id  # of a domain's ports: the one for multicast discovery
    ports = own_ports()
    assert ports & set(range(first + 10, first + 250)), "a node's own ports are seen this way"
    assert first not in ports


def test_the_library_imports_no_ros() -> None:
    code = (
        "import sys, boxgrasp, boxgrasp.io.messages\n"
        "ros = ('rclpy', 'ament', 'rosidl', 'std_msgs', 'sensor_msgs', 'boxgrasp_msgs')\n"
        "print([name for name in sys.modules if name.startswith(ros)])"
    )
    done = subprocess.run([sys.executable, "-c", code], text=True, capture_output=True)
    assert done.stdout == "[]\n", done.stderr


def test_the_stand_ins_have_the_fields_that_are_used() -> None:
    transforms = tf2_msgs.msg.TFMessage(transforms=[TransformStamped(child_frame_id="camera")])
    assert transforms.transforms[0].child_frame_id == "camera"
    types = octomap_msgs.msg.Octomap.get_fields_and_field_types()
    assert (types["resolution"], types["data"]) == ("double", "sequence<int8>")
    scene = moveit_msgs.msg.PlanningScene(is_diff=True)
    thing = moveit_msgs.msg.CollisionObject(operation=moveit_msgs.msg.CollisionObject.REMOVE)
    scene.world.collision_objects = [thing]
    scene.world.octomap.octomap.id = "OcTree"
    assert scene.world.collision_objects[0].operation == b"\x01"


def test_a_change_of_any_file_of_a_package_makes_it_stale(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(setup_env, "ROOT", tmp_path)
    monkeypatch.setattr(setup_env, "GROUPS", {"nodes": [tmp_path / "nodes"]})
    keys = [setup_env.group_key("nodes")]

    def note() -> None:
        keys.append(setup_env.group_key("nodes"))

    file = tmp_path / "nodes" / "inner" / "node.py"
    file.parent.mkdir(parents=True)
    file.write_text("a")
    note()
    file.write_text("b")
    note()
    file.chmod(0o755)
    note()
    file.rename(file.with_name("other.py"))
    note()
    assert len(set(keys)) == len(keys)
    (tmp_path / "nodes" / "__pycache__").mkdir()
    (tmp_path / "nodes" / "__pycache__" / "node.pyc").write_text("")
    note()
    assert keys[-1] == keys[-2], "what Python leaves beside them does not count"
