"""A map by OctoMap itself, of the node's own view, gives the answer of the node's own map."""

from __future__ import annotations

import array
import json
from collections.abc import Callable
from typing import Any

import numpy as np
import octomap
import pytest
from boxgrasp_msgs.msg import View
from boxgrasp_ros.grasp_selector import LATCHED, RELIABLE
from geometry_msgs.msg import Pose
from moveit_msgs.msg import PlanningScene
from octomap_msgs.msg import Octomap
from rclpy.parameter import Parameter
from rig import Rig
from scenes import BASE, camera_info, color_image, depth_image, pixel_target, table, transform
from waiting import wait_until

from boxgrasp import Capture, GraspSelector
from boxgrasp.geometry.transforms import invert, make_transform
from boxgrasp.mapping.view_rays import view_rays

T0 = 5 * 10**9


def on_lattice() -> Capture:
    """The table in a base frame whose multiples of 3 cm are the borders of the node's own cells.

    An OctoMap's cells lie on multiples of the resolution, the node's own on the target's box.
    """
    capture = table()
    config = GraspSelector().config.mapping
    box = GraspSelector().analyze(capture).context.box
    lattice = make_transform(np.eye(3), (0.0, 0.0, -config.resolution_m / 2))
    T_base_lattice = box.T_base_map(config.center_above_support_m) @ lattice
    T = invert(T_base_lattice) @ capture.T_base_camera
    return Capture(
        capture.depth, capture.intrinsics, T, capture.rgb, target_pixel=capture.target_pixel
    )


def tree_of(capture: Capture) -> Any:
    """OctoMap's tree of the rays that the node inserts, with its hit, miss and clamping."""
    selector = GraspSelector()
    config = selector.config.mapping
    tree = octomap.OcTree(config.resolution_m)
    tree.setProbHit(config.prob_hit)
    tree.setProbMiss(config.prob_miss)
    tree.setClampingThresMin(config.clamp_min)
    tree.setClampingThresMax(config.clamp_max)
    scene = selector.scene(capture)
    T = scene.T_base_source
    for points, origin in view_rays(scene.views, config.stride):
        ends = points.astype(np.float64) @ T[:3, :3].T + T[:3, 3]
        start = T[:3, :3] @ np.asarray(origin, np.float64) + T[:3, 3]
        tree.insertPointCloud(ends, start, maxrange=-1.0, discretize=False)
    tree.updateInnerOccupancy()
    return tree


def message_of(tree: Any, *, binary: bool) -> Octomap:
    """As octomap_server makes it: the tree's stream without its header."""
    data = tree.writeBinary() if binary else tree.write()
    body = data[data.index(b"\ndata\n") + 6 :]
    message = Octomap(binary=binary, id="OcTree", resolution=tree.getResolution())
    message.header.frame_id = BASE
    message.header.stamp.sec = 5
    message.data = array.array("b", body)
    return message


def same(found: dict[str, Any], known: dict[str, Any]) -> None:
    """The same candidates, in the same order, with the same results of every check."""
    assert found["passing"] == known["passing"] and found["grasp"] == known["grasp"]
    assert len(found["candidates"]) == len(known["candidates"]) == 15
    for one, other in zip(found["candidates"], known["candidates"], strict=True):
        for name in ("label", "rank", "passed", "T_base_gripper", "width_m", "rejections"):
            assert one[name] == other[name], (one["label"], name)
        assert one["checks"] == other["checks"], one["label"]


@pytest.mark.parametrize("binary", [False, True])
def test_octomaps_own_map_gives_the_same_answer(
    make_node: Callable[..., Any], binary: bool
) -> None:
    capture = on_lattice()
    rig = Rig(make_node, use_octomap=True, max_octomap_age_s=60.0)
    rig.tell_transform(transform(capture.T_base_camera, T0), static=True)
    view = View(
        depth=depth_image(capture, T0),
        camera_info=camera_info(capture, T0),
        color=color_image(capture, T0),
    )
    publisher = rig.client.create_publisher(Octomap, "octomap", LATCHED)
    publisher.publish(message_of(tree_of(capture), binary=binary))
    wait_until(lambda: rig.node._maps._held is not None)
    with_map = json.loads(rig.answer(view, pixel_target(capture)).json)
    (done,) = rig.node.set_parameters([Parameter("use_octomap", value=False)])
    assert done.successful
    known = json.loads(rig.answer(view, pixel_target(capture)).json)
    same(with_map, known)
    assert any(c["checks"]["unseen_fraction"]["value"] > 0 for c in known["candidates"])


def test_a_map_out_of_moveits_planning_scene(make_node: Callable[..., Any]) -> None:
    capture = on_lattice()
    rig = Rig(make_node, use_octomap=True, max_octomap_age_s=60.0)
    rig.tell_transform(transform(capture.T_base_camera, T0), static=True)
    view = View(depth=depth_image(capture, T0), camera_info=camera_info(capture, T0))
    scene = PlanningScene(is_diff=True)
    scene.world.octomap.octomap = message_of(tree_of(capture), binary=False)
    scene.world.octomap.octomap.header.frame_id = ""  # MoveIt tells it beside the map alone
    scene.world.octomap.header.frame_id = BASE
    scene.world.octomap.origin = Pose()
    publisher = rig.client.create_publisher(PlanningScene, "planning_scene", RELIABLE)
    wait_until(publisher.get_subscription_count)
    publisher.publish(PlanningScene(is_diff=True))  # one without a map leaves none
    publisher.publish(scene)
    wait_until(lambda: rig.node._maps._held is not None)
    assert rig.answer(view, pixel_target(capture)).status == "grasp"
    scene.world.octomap.origin.position.x = 0.2
    publisher.publish(scene)
    wait_until(lambda: rig.node._maps._held.origin.position.x == 0.2)
    name, sentence = rig.failure(view, pixel_target(capture))
    assert name == "BAD_MAP" and "base frame" in sentence
