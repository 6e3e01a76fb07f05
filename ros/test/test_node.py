"""The node with real messages: the same answers as the library's, on every way in and out."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from boxgrasp_msgs.msg import GraspSelection, Status, Target, View
from boxgrasp_ros.grasp_selector import LATCHED
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PointStamped, PoseArray, PoseStamped
from moveit_msgs.msg import CollisionObject
from rclpy.parameter import Parameter
from rig import Rig, plain
from scenes import (
    BASE,
    CAMERA,
    camera_info,
    cloud,
    color_image,
    depth_image,
    mask_image,
    pixel_target,
    table,
    table_from,
    transform,
)
from sensor_msgs.msg import RegionOfInterest
from std_msgs.msg import Float64
from visualization_msgs.msg import MarkerArray
from waiting import wait_for, wait_until

from boxgrasp import Capture, GraspSelector
from boxgrasp import Target as LibraryTarget
from boxgrasp.io.frames import TransformBuffer
from boxgrasp.io.messages import cloud_capture, depth_capture

T0 = 5 * 10**9  # ns, a stamp long ago


@pytest.fixture
def rig(make_node: Callable[..., Any]) -> Rig:
    return Rig(make_node, base_frame=BASE, max_view_age_s=60.0)


def pose(capture: Capture) -> np.ndarray:
    """The camera's pose as it comes through a transform message: its quaternion rounds."""
    buffer = TransformBuffer()
    buffer.add(transform(np.asarray(capture.T_base_camera), T0), True)
    return buffer.lookup(BASE, CAMERA, T0)


def depth_view(capture: Capture, stamp_ns: int = T0, color: bool = True) -> View:
    view = View(depth=depth_image(capture, stamp_ns), camera_info=camera_info(capture, stamp_ns))
    if color:
        view.color = color_image(capture, stamp_ns)
    return view


def expected(capture: Capture, target: LibraryTarget | None = None, **config: Any) -> dict:
    return plain(GraspSelector(config).select(capture, target).to_json())


def of_depth(view: View, capture: Capture) -> Capture:
    return depth_capture(
        view.depth, view.camera_info, color=view.color, T_base_camera=pose(capture)
    )


def test_a_view_in_the_request_is_answered_as_by_the_library(rig: Rig) -> None:
    capture = table()
    rig.tell_transform(transform(capture.T_base_camera, T0), static=True)
    u, v = capture.target_pixel
    pixel = LibraryTarget(pixel=(u, v))
    view = depth_view(capture)
    answer = rig.answer(view, pixel_target(capture))
    assert plain(answer.json) == expected(of_depth(view, capture), pixel)
    assert answer.header.frame_id == BASE and answer.header.stamp.sec == 5
    points = cloud(capture, T0)
    answer = rig.answer(View(cloud=points), pixel_target(capture))
    assert plain(answer.json) == expected(cloud_capture(points, "optical", pose(capture)), pixel)


def test_the_newest_view_of_the_topics_is_answered(rig: Rig) -> None:
    capture, now = table(), rig.now_ns()
    rig.tell_transform(transform(capture.T_base_camera, T0), static=True)
    for topic, message in (
        ("camera_info", camera_info(capture, now)),
        ("color", color_image(capture, now)),
        ("depth", depth_image(capture, now)),
    ):
        rig.publish(topic, message)
    view = depth_view(capture)
    whole = of_depth(view, capture)
    answer = rig.answer(
        View(min_stamp=depth_image(capture, now).header.stamp), pixel_target(capture)
    )
    u, v = capture.target_pixel
    assert plain(answer.json) == expected(whole, LibraryTarget(pixel=(u, v)))
    other = table_from(0.2, 0.5, 1.4)
    rig.tell_transform(transform(other.T_base_camera, now, child="moved"))
    rig.publish("cloud", cloud(other, now, "moved"))
    wait_until(lambda: rig.node._inbox.newest().is_cloud)
    u, v = other.target_pixel
    answer = rig.answer(View(), pixel_target(other))
    points = cloud_capture(cloud(other, now), "optical", pose(other))
    found = plain(answer.json)
    codes = [item["code"] for item in found.pop("warnings")]
    known = expected(points, LibraryTarget(pixel=(u, v)))
    assert codes == ["frame_taken_as_optical", *(w["code"] for w in known.pop("warnings"))]
    np.testing.assert_allclose(  # through a quaternion
        found["grasp"]["T_base_gripper"], known["grasp"]["T_base_gripper"], atol=1e-6
    )


def test_an_action_tells_its_stages_and_gives_the_same_answer(rig: Rig) -> None:
    capture = table()
    rig.tell_transform(transform(capture.T_base_camera, T0), static=True)
    view, target = depth_view(capture), pixel_target(capture)
    told: list[Any] = []
    first = rig.goal(view, Target(kind=99))  # until then feedback may not find its way
    assert wait_for(first.get_result_async()).result.status.code == Status.BAD_TARGET
    handle = rig.goal(view, target, lambda message: told.append(message.feedback))
    result = wait_for(handle.get_result_async()).result
    assert plain(result.selection.json) == plain(rig.answer(view, target).json)
    # What comes after the news that the goal has ended, the client leaves out.
    stages = [item.stage for item in told]
    every = ["view", "scene", "box", "mapping", "checks", "rank", "answer"]
    assert len(stages) >= 4 and stages == every[: len(stages)]
    elapsed = [item.elapsed_ms for item in told]
    assert elapsed == sorted(elapsed) and elapsed[0] > 0


def test_a_cancelled_goal_ends_while_it_waits_for_a_view(make_node: Callable[..., Any]) -> None:
    rig = Rig(make_node, wait_for_view_s=30.0)
    handle = rig.goal(View(), pixel_target(table()))
    reply = wait_for(handle.cancel_goal_async())
    assert len(reply.goals_canceling) == 1
    found = wait_for(handle.get_result_async(), 5.0)
    assert found.status == 5 and found.result.status.code == 9  # both: canceled
    assert "cancelled" in found.result.status.message
    assert rig.node._waiting == 0


def test_targets_of_every_kind_mean_the_same_object(rig: Rig) -> None:
    capture = table()
    T = pose(capture)
    rig.tell_transform(transform(capture.T_base_camera, T0), static=True)
    view, target = depth_view(capture), pixel_target(capture)
    by_pixel = plain(rig.answer(view, target).json)
    library = GraspSelector()
    image = library.segment(of_depth(view, capture))
    u, v = capture.target_pixel
    number = int(image[v, u])
    listed = rig.objects(view)
    assert [item.number for item in listed.objects] == [*range(1, image.max() + 1)]
    for item in listed.objects:
        assert item.has_pixel and image[item.v, item.u] == item.number
    assert plain(rig.answer(view, Target(kind=Target.OBJECT, object=number)).json) == by_pixel
    z = float(capture.depth[v, u])
    K = capture.intrinsics
    point = PointStamped()
    point.point.x, point.point.y = (
        float((u - K[0, 2]) / K[0, 0] * z),
        float((v - K[1, 2]) / K[1, 1] * z),
    )
    point.point.z, point.header.frame_id = z, CAMERA
    assert plain(rig.answer(view, Target(kind=Target.POINT, point=point)).json) == by_pixel
    in_base = PointStamped()
    x, y, z = (T @ (point.point.x, point.point.y, point.point.z, 1.0))[:3].tolist()
    in_base.point.x, in_base.point.y, in_base.point.z = x, y, z
    for frame in ("", BASE):
        in_base.header.frame_id = frame
        assert plain(rig.answer(view, Target(kind=Target.POINT, point=in_base)).json) == by_pixel
    rows, columns = np.nonzero(image == number)
    box = RegionOfInterest(
        x_offset=int(columns.min()),
        y_offset=int(rows.min()),
        width=int(np.ptp(columns)) + 1,
        height=int(np.ptp(rows)) + 1,
    )
    assert plain(rig.answer(view, Target(kind=Target.BOX, box=box)).json) == by_pixel
    mask = image == number
    by_mask = rig.answer(view, Target(kind=Target.MASK, mask=mask_image(mask, T0)))
    known = expected(of_depth(view, capture), LibraryTarget(mask=mask))
    assert plain(by_mask.json) == known
    rig.tell_target(target)
    assert plain(rig.answer(view).json) == by_pixel


def test_the_robots_own_arm_is_left_out(rig: Rig) -> None:
    capture, now = table(), rig.now_ns()
    rig.tell_transform(transform(capture.T_base_camera, T0), static=True)
    view = depth_view(capture)
    arm = np.zeros(capture.depth.shape, bool)
    arm[300:, :200] = True
    view.robot_mask = mask_image(arm, T0)
    seen = depth_capture(
        view.depth, view.camera_info, color=view.color, T_base_camera=pose(capture), robot_mask=arm
    )
    u, v = capture.target_pixel
    known = expected(seen, LibraryTarget(pixel=(u, v)))
    assert plain(rig.answer(view, pixel_target(capture)).json) == known
    assert known != expected(of_depth(view, capture), LibraryTarget(pixel=(u, v)))
    # By the topic: where it has a publisher, no view goes without its mask.
    for topic, message in (
        ("robot_mask", mask_image(arm, now - 10**9)),
        ("camera_info", camera_info(capture, now)),
        ("depth", depth_image(capture, now)),
    ):
        rig.publish(topic, message)
    wait_until(lambda: rig.node._inbox.newest() is not None)
    name, sentence = rig.failure(View(), pixel_target(capture))
    assert name == "STALE_VIEW" and "/robot_mask" in sentence
    rig.publish("robot_mask", mask_image(arm, now))
    rig.publish("depth", depth_image(capture, now))
    answer = rig.answer(View(), pixel_target(capture))
    seen = depth_capture(view.depth, view.camera_info, T_base_camera=pose(capture), robot_mask=arm)
    assert plain(answer.json) == expected(seen, LibraryTarget(pixel=(u, v)))


def test_an_answer_is_told_on_every_topic(rig: Rig) -> None:
    capture = table()
    rig.tell_transform(transform(capture.T_base_camera, T0), static=True)
    grasps, grasp = (
        rig.heard(PoseArray, "/grasp_selector/grasps"),
        rig.heard(PoseStamped, "/grasp_selector/grasp"),
    )
    opening = rig.heard(Float64, "/grasp_selector/gripper_opening")
    selections = rig.heard(GraspSelection, "/grasp_selector/selection")
    boxes = rig.heard(CollisionObject, "/grasp_selector/collision_objects")
    answer = rig.answer(depth_view(capture), pixel_target(capture))
    assert answer.status == "grasp"
    wait_until(lambda: "boxgrasp_target" in {item.id for item in boxes})
    assert "boxgrasp_table" in {item.id for item in boxes}
    assert {item.header.frame_id for item in boxes} == {BASE}
    wait_until(lambda: grasps and grasp and opening and selections)
    assert selections[0].json == answer.json
    assert grasp[0].pose == answer.pose and grasp[0].header == answer.header
    by_label = {candidate.label: candidate for candidate in answer.candidates}
    assert grasps[0].poses == [by_label[label].pose for label in answer.passing]
    assert grasps[0].poses[0] == answer.pose
    assert opening[0].data == answer.opening_m
    # The markers are latched: who comes late sees them too.
    markers = rig.heard(MarkerArray, "/grasp_selector/markers", LATCHED)
    wait_until(lambda: markers)
    names = {marker.ns for marker in markers[-1].markers if marker.action == marker.ADD}
    stages = {"table", "objects", "target_box", "lines", "samples", "candidates", "gripper"}
    assert stages <= names
    told = rig.heard(DiagnosticArray, "/diagnostics")
    wait_until(lambda: told)
    values = {item.key: item.value for item in told[-1].status[0].values}
    assert values["answers"] == "1" and float(values["total, ms"]) > 0


def test_after_a_failure_no_old_pose_is_shown(rig: Rig) -> None:
    capture = table()
    rig.tell_transform(transform(capture.T_base_camera, T0), static=True)
    markers = rig.heard(MarkerArray, "/grasp_selector/markers", LATCHED)
    grasp = rig.heard(PoseStamped, "/grasp_selector/grasp")
    rig.answer(depth_view(capture), pixel_target(capture))
    wait_until(lambda: len(markers) == 1 and grasp)
    name, sentence = rig.failure(depth_view(capture), Target(kind=Target.PIXEL, u=1, v=1))
    assert name == "BAD_TARGET"
    wait_until(lambda: len(markers) == 2)
    assert markers[1].markers[0].action == 3  # delete all
    (shown,) = markers[1].markers[1:]
    assert shown.type == shown.TEXT_VIEW_FACING and " ".join(shown.text.split()) == sentence
    assert len(grasp) == 1


def test_parameters_change_while_the_node_runs(rig: Rig) -> None:
    capture = table()
    rig.tell_transform(transform(capture.T_base_camera, T0), static=True)
    view, target = depth_view(capture), pixel_target(capture)
    u, v = capture.target_pixel
    set_now = rig.node.set_parameters
    (done,) = set_now([Parameter("candidates.faces", value=["top-parallel"])])
    assert done.successful
    known = expected(
        of_depth(view, capture),
        LibraryTarget(pixel=(u, v)),
        candidates={"faces": ["top-parallel"]},
    )
    assert plain(rig.answer(view, target).json) == known
    for name, value, reason in (
        ("candidates.faces", ["above"], "above"),
        ("gripper.length_m", 0.3, "restart"),
        ("base_frame", "odom", "restart"),
        ("ranker", "nobody", "nobody"),
        ("max_waiting", 0, ""),
    ):
        (done,) = set_now([Parameter(name, value=value)])
        assert not done.successful and reason in done.reason, name
    done = rig.node.set_parameters_atomically(
        [Parameter("ranker", value="cascade-grid"), Parameter("models", value="/no/such/folder")]
    )
    assert not done.successful and "/no/such/folder" in done.reason
    assert plain(rig.answer(view, target).json) == known


def test_earlier_views_are_fused_at_their_own_poses(make_node: Callable[..., Any]) -> None:
    rig = Rig(make_node, views=2, views_min_move_m=0.05, max_view_age_s=60.0)
    first, second = table(), table_from(0.2, 0.5, 1.4)
    now = rig.now_ns()
    frames = [(first, now - 4 * 10**8), (second, now - 2 * 10**8), (second, now)]
    for capture, stamp in frames:
        rig.tell_transform(transform(capture.T_base_camera, stamp))
    for capture, stamp in frames:
        rig.publish("camera_info", camera_info(capture, stamp))
        wait_until(lambda: rig.node._inbox._infos)
        rig.publish("depth", depth_image(capture, stamp))
        wait_until(lambda stamp=stamp: (n := rig.node._inbox.newest()) and n.stamp_ns == stamp)
    wait_until(lambda: len(rig.node._earlier._kept) == 2)
    answer = plain(rig.answer(View(), pixel_target(second)).json)

    def capture_of(capture: Capture, stamp: int) -> Capture:
        T = rig.node._transforms.lookup(BASE, CAMERA, stamp)
        return depth_capture(
            depth_image(capture, stamp), camera_info(capture, stamp), T_base_camera=T
        )

    seen = [capture_of(*frame) for frame in frames]
    u, v = second.target_pixel
    target = LibraryTarget(pixel=(u, v))
    assert answer == plain(GraspSelector().select(seen[2], target, seen[:2]).to_json())
    assert answer != plain(GraspSelector().select(seen[2], target).to_json())
