"""What goes wrong on a robot: a status code and a sentence, never a pose, a crash or a leak."""

from __future__ import annotations

import array
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from boxgrasp_msgs.msg import Target, View
from geometry_msgs.msg import PointStamped
from octomap_msgs.msg import Octomap
from rig import Rig
from scenes import (
    BASE,
    CAMERA,
    camera_info,
    cloud,
    depth_image,
    mask_image,
    pixel_target,
    table,
    transform,
)
from waiting import wait_for, wait_until

T0 = 5 * 10**9  # ns, a stamp long ago


@pytest.fixture
def rig(make_node: Callable[..., Any]) -> Rig:
    """A node that waits little, with the camera's pose at T0 and for 1 s after."""
    rig = Rig(make_node, wait_for_view_s=0.2, wait_for_transform_s=0.1)
    for stamp in (T0, T0 + 10**9):
        rig.tell_transform(transform(table().T_base_camera, stamp))
    return rig


def view(stamp_ns: int = T0, frame: str = CAMERA) -> View:
    capture = table()
    return View(
        depth=depth_image(capture, stamp_ns, frame), camera_info=camera_info(capture, stamp_ns)
    )


def asked(change: Callable[[View], None]) -> View:
    """A sound view, but for one thing."""
    found = view()
    change(found)
    return found


def _set(at: str, value: Any) -> Callable[[View], None]:
    def change(message: Any) -> None:
        *path, last = at.split(".")
        for name in path:
            message = getattr(message, name)
        setattr(message, last, value)

    return change


def both(message: View) -> None:
    message.cloud = cloud(table(), T0)


def distorted(message: View) -> None:
    message.camera_info.d = [-1.0, 0.0, 0.0, 0.0, 0.0]  # no small one


BAD_VIEWS = {
    "cloud and depth": both,
    "another encoding": _set("depth.encoding", "bgr8"),
    "no encoding": _set("depth.encoding", ""),
    "truncated": _set("depth.data", array.array("B", bytes(1000))),
    "all missing": _set("depth.data", array.array("B", bytes(4 * 480 * 640))),
    "distorted": distorted,
    "camera of another size": _set("camera_info.width", 320),
    "no camera": _set("camera_info.k", [0.0] * 9),
    "camera of NaN": _set("camera_info.k", [float("nan")] * 9),
}


@pytest.mark.parametrize("case", BAD_VIEWS)
def test_bad_views(rig: Rig, case: str) -> None:
    name, sentence = rig.failure(asked(BAD_VIEWS[case]), pixel_target(table()))
    assert name == "BAD_VIEW" and sentence and "\n" not in sentence


def test_empty_clouds(rig: Rig) -> None:
    empty = cloud(table(), T0)
    empty.data = array.array("B", bytes(len(empty.data)))  # every point 0, 0, 0: missing
    name, sentence = rig.failure(View(cloud=empty), pixel_target(table()))
    assert name == "BAD_VIEW" and "valid" in sentence
    empty = cloud(table(), T0)
    empty.width = empty.row_step = 0
    assert rig.failure(View(cloud=empty), pixel_target(table()))[0] == "BAD_VIEW"


@pytest.mark.parametrize(
    ("stamp_ns", "frame", "name", "said"),
    [
        (T0, "no_such_frame", "NO_TRANSFORM", "no_such_frame"),
        (T0, "", "NO_TRANSFORM", "frame_id"),
        (T0 - 10**9, CAMERA, "TRANSFORM_TOO_OLD", CAMERA),
        (T0 + 9 * 10**9, CAMERA, "TRANSFORM_TOO_OLD", CAMERA),
    ],
)
def test_no_transform(rig: Rig, stamp_ns: int, frame: str, name: str, said: str) -> None:
    found, sentence = rig.failure(view(stamp_ns, frame), pixel_target(table()))
    assert found == name and said in sentence


def test_frames_that_are_not_connected(rig: Rig) -> None:
    rig.tell_transform(transform(np.eye(4), T0, "map", "lost_camera"))
    name, sentence = rig.failure(view(T0, "lost_camera"), pixel_target(table()))
    assert name == "NO_TRANSFORM" and BASE in sentence and "lost_camera" in sentence


def test_no_view_and_no_camera_info(rig: Rig) -> None:
    name, sentence = rig.failure(View(), pixel_target(table()))
    assert name == "NO_VIEW" and "/cloud" in sentence and "/depth" in sentence
    rig.publish("depth", depth_image(table(), rig.now_ns()))
    wait_until(lambda: rig.node._inbox._view is not None)
    name, sentence = rig.failure(View(), pixel_target(table()))
    assert name == "NO_VIEW" and "/camera_info" in sentence


def test_a_stale_view_is_not_used(rig: Rig) -> None:
    rig.publish("cloud", cloud(table(), T0))
    wait_until(lambda: rig.node._inbox.newest() is not None)
    name, sentence = rig.failure(View(), pixel_target(table()))
    assert name == "STALE_VIEW" and "max_view_age_s" in sentence
    later = View()
    later.min_stamp = rig.client.get_clock().now().to_msg()
    assert rig.failure(later, pixel_target(table()))[0] == "STALE_VIEW"


def lost(frame: str) -> Target:
    point = PointStamped()
    point.header.frame_id = frame
    return Target(kind=Target.POINT, point=point)


WRONG_TARGETS = {
    "none": (Target(), "BAD_TARGET"),
    "unknown kind": (Target(kind=99), "BAD_TARGET"),
    "on the floor": (Target(kind=Target.PIXEL, u=2, v=2), "BAD_TARGET"),
    "outside": (Target(kind=Target.PIXEL, u=9999, v=2), "BAD_TARGET"),
    "point far away": (lost(BASE), "BAD_TARGET"),
    "point in an unknown frame": (lost("nowhere"), "NO_TRANSFORM"),
    "no such object": (Target(kind=Target.OBJECT, object=77), "BAD_TARGET"),
    "an empty box": (Target(kind=Target.BOX), "BAD_TARGET"),
    "mask of another size": (
        Target(kind=Target.MASK, mask=mask_image(np.ones((4, 4), bool), T0)),
        "BAD_TARGET",
    ),
    "mask of nothing": (
        Target(kind=Target.MASK, mask=mask_image(np.zeros((480, 640), bool), T0)),
        "BAD_TARGET",
    ),
    "no mask": (Target(kind=Target.MASK), "BAD_TARGET"),
}


@pytest.mark.parametrize("case", WRONG_TARGETS)
def test_wrong_targets(rig: Rig, case: str) -> None:
    target, name = WRONG_TARGETS[case]
    found, sentence = rig.failure(view(), target)
    assert found == name and sentence and "\n" not in sentence


def test_nothing_on_the_table(rig: Rig) -> None:
    v, u = np.mgrid[:480, :640]
    K, T = table().intrinsics, table().T_base_camera
    rays = np.stack(((u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones(u.shape)), -1)
    down = (rays @ T[:3, :3].T)[..., 2]
    with np.errstate(divide="ignore"):
        depth = np.where(down < -0.05, (0.8 - T[2, 3]) / down, 0.0).astype("<f4")
    bare = view()
    bare.depth.data = array.array("B", depth.tobytes())
    name, sentence = rig.failure(bare, pixel_target(table()))
    assert name in ("BAD_SCENE", "BAD_TARGET") and sentence
    assert rig.objects(bare).status.code != 0


def test_maps_that_do_not_fit(make_node: Callable[..., Any]) -> None:
    rig = Rig(make_node, use_octomap=True, wait_for_transform_s=0.1, max_octomap_age_s=2.0)
    rig.tell_transform(transform(table().T_base_camera, T0), static=True)
    rig.tell_transform(transform(np.eye(4), T0, BASE, "same"), static=True)
    moved = np.eye(4)
    moved[0, 3] = 0.5
    rig.tell_transform(transform(moved, T0, BASE, "odom"), static=True)
    target = pixel_target(table())
    name, sentence = rig.failure(view(), target)
    assert name == "BAD_MAP" and "no map" in sentence

    def octomap(**change: Any) -> Octomap:
        message = Octomap(binary=True, id="OcTree", resolution=0.03)
        message.header.frame_id = BASE
        message.header.stamp = view().depth.header.stamp
        for name, value in change.items():
            if name == "frame":
                message.header.frame_id = value
            elif name == "sec":
                message.header.stamp.sec = value
            else:
                setattr(message, name, value)
        return message

    cases = {
        "cells of 0.05 m": octomap(resolution=0.05),
        "cells of nan m": octomap(resolution=float("nan")),
        "'odom'": octomap(frame="odom"),
        "frame_id": octomap(frame=""),
        "older": octomap(sec=1),
        "truncated": octomap(data=array.array("b", b"\x05")),
        "tree is a": octomap(id="SomethingElse", data=array.array("b", b"\x00\x00")),
    }
    for said, message in cases.items():
        rig.node._maps.put(message, "/octomap", T0)
        name, sentence = rig.failure(view(), target)
        assert name == "BAD_MAP", (said, sentence)
        assert said in sentence or said == "truncated", (said, sentence)
    rig.node._maps.put(octomap(frame="nowhere"), "/octomap", T0)
    assert rig.failure(view(), target)[0] == "NO_TRANSFORM"
    rig.node._maps.put(octomap(frame="same"), "/octomap", T0)
    rig.answer(view(), target)


def test_two_goals_at_once_are_both_answered_and_a_crowd_is_told(
    make_node: Callable[..., Any],
) -> None:
    rig = Rig(make_node, max_waiting=1, wait_for_view_s=30.0)
    rig.tell_transform(transform(table().T_base_camera, T0), static=True)
    first = rig.goal(View(), pixel_target(table()))  # waits for a view
    wait_until(lambda: rig.node._waiting == 1)
    second = rig.goal(view(), pixel_target(table()))  # waits for its turn
    wait_until(lambda: rig.node._waiting == 2)
    name, sentence = rig.failure(view(), pixel_target(table()))
    assert name == "BUSY" and "max_waiting" in sentence
    rig.publish("cloud", cloud(table(), rig.now_ns()))
    for goal in (first, second):
        found = wait_for(goal.get_result_async())
        assert found.result.status.code == 0, found.result.status.message
        assert found.result.selection.status == "grasp"
    assert rig.node._waiting == 0


def test_a_goal_that_waits_for_its_turn_is_cancelled(make_node: Callable[..., Any]) -> None:
    rig = Rig(make_node, wait_for_view_s=30.0)
    first = rig.goal(View(), pixel_target(table()))
    wait_until(lambda: rig.node._waiting == 1)
    second = rig.goal(View(), pixel_target(table()))
    wait_until(lambda: rig.node._waiting == 2)
    for goal in (second, first):
        wait_for(goal.cancel_goal_async())
        assert wait_for(goal.get_result_async(), 5.0).result.status.code == 9
    wait_until(lambda: rig.node._waiting == 0)


def test_a_client_that_dies_leaves_nothing(make_node: Callable[..., Any]) -> None:
    rig = Rig(make_node, wait_for_view_s=0.5)
    handle = rig.goal(View(), pixel_target(table()))
    del handle
    rig.action.destroy()
    wait_until(lambda: rig.node._record.failures == 1)
    wait_until(lambda: rig.node._waiting == 0)
    assert rig.failure(View(), pixel_target(table()))[0] == "NO_VIEW"


def test_each_sentence_is_logged_once(rig: Rig, capfd: pytest.CaptureFixture[str]) -> None:
    for _ in range(3):
        rig.failure(view(T0, "no_such_frame"), pixel_target(table()))
    lines = [line for line in capfd.readouterr().err.splitlines() if "no_such_frame" in line]
    assert len(lines) == 1


def test_strings_of_strangers_are_no_commands(rig: Rig) -> None:
    found = view()
    found.depth.encoding = "\x1b[2J\n" * 500
    name, sentence = rig.failure(found, pixel_target(table()))
    assert name == "BAD_VIEW" and len(sentence) <= 400 and sentence.isprintable()
