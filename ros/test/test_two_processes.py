"""The console script as a user starts it, and a client in this process, on a real capture."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from boxgrasp_msgs.action import SelectGrasp as SelectGraspAction
from boxgrasp_msgs.msg import Target, View
from boxgrasp_msgs.srv import SelectGrasp
from rcl_interfaces.srv import SetParameters
from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import serialize_message
from rosbags.rosbag2 import Writer
from rosbags.typesys import Stores, get_typestore
from scenes import BASE, camera_info, cloud, color_image, depth_image, transform
from sensor_msgs.msg import CameraInfo, Image, PointCloud2
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import MarkerArray
from waiting import call, result_of, wait_for, wait_until

from boxgrasp import GraspSelector, load_capture
from boxgrasp import Target as LibraryTarget
from boxgrasp.io.messages import cloud_capture

SHARED = Path(os.environ.get("BOXGRASP_SHARED", Path(__file__).parents[3] / "shared"))
NAME = "uois_05"
STATIC = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
RELIABLE = QoSProfile(depth=5)
T0 = 5 * 10**9


@pytest.fixture
def start(ros_env: dict[str, str]) -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Start the console script; it is ended after the test."""
    started = []

    def run(*arguments: str) -> subprocess.Popen[str]:
        script = Path(sys.prefix, "lib", "boxgrasp_ros", "grasp_selector")
        process = subprocess.Popen(
            [str(script), "--ros-args", *arguments],
            env=ros_env,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        started.append(process)
        return process

    yield run
    for process in started:
        process.kill()
        process.communicate()


def real_capture() -> Any:
    place = SHARED / "captures" / NAME
    if not place.exists():
        pytest.skip(f"no real captures at {place.parent}")
    return load_capture(place)


@cache
def asked() -> tuple[Any, np.ndarray, tuple[int, int]]:
    """A real capture, the camera's pose over its table, and a pixel on a thing to be had."""
    capture, selector = real_capture(), GraspSelector()
    for item in selector.objects(capture):
        answer = selector.select(capture, LibraryTarget(pixel=item.pixel))
        seen = cloud_capture(cloud(capture, T0), "optical", answer.T_base_camera)
        if answer.grasp is not None and item.pixel is not None:
            if selector.select(seen, LibraryTarget(pixel=item.pixel)).grasp is not None:
                return capture, np.asarray(answer.T_base_camera), item.pixel
    raise AssertionError("nothing in the capture is answered with a grasp")


def command_line(place: Path, *options: str) -> dict[str, Any]:
    """What `boxgrasp select --json` answers."""
    done = subprocess.run(
        [sys.executable, "-m", "boxgrasp", "select", str(place), "--json", *options],
        capture_output=True,
        text=True,
        check=True,
    )
    answer: dict[str, Any] = json.loads(done.stdout)
    return answer


def saved(capture: Any, path: Path) -> Path:
    """The capture with the pose that the node gets by TF."""
    held = {"depth": capture.depth, "intrinsics": capture.intrinsics, "rgb": capture.rgb}
    np.savez(path, T_base_camera=asked()[1], **held)
    return path


def assert_same_grasp(selection: Any, answer: dict[str, Any]) -> None:
    assert selection.status == answer["status"] == "grasp"
    found = json.loads(selection.json)
    for name in ("T_base_gripper", "T_base_tcp", "T_base_pregrasp"):
        np.testing.assert_allclose(found["grasp"][name], answer["grasp"][name], atol=1e-6)
    assert found["passing"] == answer["passing"]
    at, known = selection.pose, answer["grasp"]
    np.testing.assert_allclose(
        (at.position.x, at.position.y, at.position.z), known["position_m"], atol=1e-6
    )
    turn = (at.orientation.x, at.orientation.y, at.orientation.z, at.orientation.w)
    np.testing.assert_allclose(turn, known["quaternion_xyzw"], atol=1e-6)


def test_a_real_capture_in_two_processes(
    start: Callable[..., subprocess.Popen[str]], make_node: Callable[..., Node], tmp_path: Path
) -> None:
    capture, T_base_camera, (u, v) = asked()
    offline = command_line(saved(capture, tmp_path / "view.npz"), "--pixel", str(u), str(v))
    process = start(
        "-r", "__node:=chooser", "-r", "cloud:=/camera/points", "-r", "depth:=/camera/depth",
        "-r", "camera_info:=/camera/camera_info", "-r", "color:=/camera/color",
        "-p", f"base_frame:={BASE}", "-p", "max_view_age_s:=60.0", "-p", "wait_for_view_s:=20.0",
        *(
            word
            for topic in ("points", "depth", "camera_info", "color")  # each is sent once here
            for word in ("-p", f"qos_overrides./camera/{topic}.subscription.reliability:=reliable")
        ),
    )  # fmt: skip
    client = make_node("client")
    select = client.create_client(SelectGrasp, "/chooser/select")
    assert select.wait_for_service(timeout_sec=90), process.poll()
    transforms = client.create_publisher(TFMessage, "/tf_static", STATIC)
    transforms.publish(transform(T_base_camera, 0))
    target = Target(kind=Target.PIXEL, u=u, v=v)
    publish_reliably(client, "/camera/points", cloud(capture, now_ns(client)))
    by_cloud = call(select, SelectGrasp.Request(target=target), 60)
    assert by_cloud.status.code == 0, by_cloud.status.message
    of_cloud = command_line(
        recorded_cloud(capture, tmp_path / "bag"),
        *("--base-frame", BASE, "--topic", "/camera/points", "--pixel", str(u), str(v)),
    )
    assert_same_grasp(by_cloud.selection, of_cloud)

    publish_reliably(client, "/camera/camera_info", camera_info(capture, now_ns(client)))
    stamp = now_ns(client)
    publish_reliably(client, "/camera/color", color_image(capture, stamp))
    image = depth_image(capture, stamp)
    publish_reliably(client, "/camera/depth", image)
    view = View(min_stamp=image.header.stamp)
    action = ActionClient(client, SelectGraspAction, "/chooser/select")
    assert action.wait_for_server(timeout_sec=20)
    stages: list[str] = []
    goal = SelectGraspAction.Goal(view=view, target=target)
    handle = wait_for(
        action.send_goal_async(goal, feedback_callback=lambda m: stages.append(m.feedback.stage))
    )
    found = result_of(handle)
    assert found.status.code == 0, found.status.message
    assert_same_grasp(found.selection, offline)
    assert stages[:2] == ["view", "scene"]  # the last may come after the news of the goal's end

    markers: list[Any] = []
    client.create_subscription(MarkerArray, "/chooser/markers", markers.append, STATIC)
    wait_until(lambda: markers and len(markers[-1].markers) > 20)

    view.min_stamp.sec += 3600  # a view that does not come
    handle = wait_for(action.send_goal_async(SelectGraspAction.Goal(view=view, target=target)))
    wait_for(handle.cancel_goal_async())
    assert result_of(handle).status.code == 9

    change = client.create_client(SetParameters, "/chooser/set_parameters")
    request = SetParameters.Request()
    wanted = Parameter("candidates.faces", value=["top-parallel", "top-perpendicular"])
    request.parameters = [wanted.to_parameter_msg()]
    assert call(change, request).results[0].successful
    above = call(select, SelectGrasp.Request(target=target)).selection
    assert above.status == "ask" or above.face_name.startswith("top")

    process.send_signal(signal.SIGINT)
    assert process.wait(timeout=2.0) == 0
    told = process.stdout.read() if process.stdout else ""
    assert "Traceback" not in told, told


def recorded_cloud(capture: Any, path: Path) -> Path:
    """A bag with the cloud and the transform that the node gets by TF."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    with Writer(path, version=9) as writer:
        for topic, message in (
            ("/tf_static", transform(asked()[1], T0)),
            ("/camera/points", cloud(capture, T0)),
        ):
            package, name = type(message).__module__.split(".")[0], type(message).__name__
            link = writer.add_connection(topic, f"{package}/msg/{name}", typestore=store)
            writer.write(link, T0, serialize_message(message))
    return path


def now_ns(node: Node) -> int:
    return int(node.get_clock().now().nanoseconds)


def publish_reliably(node: Node, topic: str, message: Any) -> None:
    kinds = {"points": PointCloud2, "depth": Image, "color": Image, "camera_info": CameraInfo}
    publisher = node.create_publisher(kinds[topic.rsplit("/", 1)[1]], topic, RELIABLE)
    wait_until(publisher.get_subscription_count, what=f"a match on {topic}")
    publisher.publish(message)
    publisher.wait_for_all_acked()


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("checks.visible_clearance_m:=-3.0", "visible_clearance_m"),
        ("checks.visible_clearence_m:=0.02", "did you mean visible_clearance_m"),
        ("ranker:=nobody", "nobody"),
        ("base_frame:=''", "base_frame"),
        ("mapping.resolution_m:=often", "a number"),
    ],
)
def test_a_wrong_parameter_ends_the_start_in_one_line(
    start: Callable[..., subprocess.Popen[str]], given: str, said: str
) -> None:
    process = start("-p", given)
    told, _ = process.communicate(timeout=60)
    assert process.returncode == 2
    assert "Traceback" not in told and said in told
    assert len([line for line in told.splitlines() if line.startswith("grasp_selector:")]) == 1


def test_a_file_or_argument_that_ros_refuses_ends_the_start_in_one_line(
    start: Callable[..., subprocess.Popen[str]], tmp_path: Path
) -> None:
    broken = tmp_path / "broken.yaml"
    broken.write_text("grasp_selector: {ros__parameters: {views: [1, two, [3]]}}")
    for given in (("--params-file", str(broken)), ("--no-such-argument",)):
        process = start(*given)
        told, _ = process.communicate(timeout=60)
        assert process.returncode == 2, told
        assert "Traceback" not in told
        lines = [line for line in told.splitlines() if line.startswith("grasp_selector:")]
        assert len(lines) == 1


def test_an_interrupt_while_it_waits_ends_it_at_once(
    start: Callable[..., subprocess.Popen[str]], make_node: Callable[..., Node]
) -> None:
    process = start("-p", "wait_for_view_s:=50.0")
    client = make_node("client")
    select = client.create_client(SelectGrasp, "/grasp_selector/select")
    assert select.wait_for_service(timeout_sec=90)
    future = select.call_async(SelectGrasp.Request())
    with pytest.raises(AssertionError):
        wait_for(future, 1.0)
    process.send_signal(signal.SIGINT)
    assert process.wait(timeout=2.0) == 0
