"""What MoveIt is told of the scene holds the things that were seen."""

from __future__ import annotations

import importlib
import sys
from typing import Any

import numpy as np
import pytest
from answers import (
    HEADER,
    answer,
    answer_to,
    cast,
    checked_fields,
    matrix,
    real_answer,
    sent,
    told,
)
from boxgrasp_ros import planning_scene
from boxgrasp_ros.planning_scene import AVAILABLE, collision_objects
from boxgrasp_ros.replies import pose_message
from boxgrasp_ros.seen import surfaces, target_number, things

from boxgrasp.geometry.transforms import invert, transform
from boxgrasp.selector import SceneAnalysis

KINDS = ("grasp", "ask")
ADD, REMOVE = b"\x00", b"\x01"
STRAYS = 0.01  # of a thing's points at most may lie outside its box
SLACK_M = 0.02  # nor far

requires_moveit = pytest.mark.skipif(not AVAILABLE, reason="no moveit_msgs")


def boxes(found: list[Any]) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Pose and size of each box by its id."""
    held = {}
    for item in found:
        item = sent(item)
        assert item.operation == ADD and item.header == HEADER and item.id not in held
        (solid,), (pose,) = item.primitives, item.primitive_poses
        assert solid.type == solid.BOX and len(solid.dimensions) == 3
        assert min(solid.dimensions) > 0 and told(pose) == told(pose_message(np.eye(4)))
        held[item.id] = matrix(item.pose), np.array(solid.dimensions)
    return held


def check_scene(analysis: SceneAnalysis, found: dict[str, Any]) -> None:
    target = target_number(analysis)
    expected = {f"boxgrasp_object_{item.number}" for item in analysis.scene.objects}
    expected -= {f"boxgrasp_object_{target}"}
    assert set(found) == {"boxgrasp_table", "boxgrasp_target", *expected}
    for thing in things(analysis):
        if thing.number in (0, target):
            continue
        T, size = found[f"boxgrasp_object_{thing.number}"]
        over = np.abs(transform(invert(T), thing.points.astype(np.float64))) - size / 2
        assert np.mean(over.max(axis=1) > 1e-6) < STRAYS and over.max() < SLACK_M
        np.testing.assert_allclose(T[:3, 2], (0, 0, 1), atol=1e-9)  # upright
        foot = T[:3, 3] - (0.0, 0.0, size[2] / 2)
        assert abs(float(analysis.scene.plane.heights(foot[None].astype(np.float32))[0])) < 1e-4
    T, size = found["boxgrasp_table"]
    top = T[:3, 3] + T[:3, 2] * size[2] / 2
    assert abs(float(analysis.scene.plane.heights(top[None].astype(np.float32))[0])) < 1e-5
    np.testing.assert_allclose(T[:3, 2], analysis.scene.plane.normal, atol=1e-9)
    rim = transform(invert(T), surfaces(analysis)[0].outline_base_m)
    np.testing.assert_allclose(np.abs(rim[:, :2]).max(axis=0), size[:2] / 2, atol=1e-9)


@requires_moveit
@pytest.mark.parametrize("kind", KINDS)
def test_boxes_hold_what_was_seen(kind: str) -> None:
    analysis, selection = answer(kind)
    with checked_fields():
        found = boxes(collision_objects(analysis, selection, HEADER))
    check_scene(analysis, found)
    T, size = found["boxgrasp_target"]
    np.testing.assert_allclose(T, selection.box.T_base_box, atol=1e-12)
    np.testing.assert_array_equal(size, selection.box.dimensions_m)


@requires_moveit
def test_what_is_gone_is_removed() -> None:
    first = [item.id for item in collision_objects(*answer("ask"), HEADER)]
    found = collision_objects(*answer("grasp"), HEADER, first)
    removed = [item for item in found if item.operation == REMOVE]
    present = {item.id for item in found if item.operation == ADD}
    assert {item.id for item in removed} == set(first) - present
    assert removed and len(found) == len(present) + len(removed)
    for item in removed:
        assert item.header == HEADER and not item.primitives and not item.primitive_poses
    again = collision_objects(*answer("grasp"), HEADER, sorted(present))
    assert {item.id for item in again} == present and all(item.operation == ADD for item in again)


@requires_moveit
def test_of_a_real_capture_too() -> None:
    analysis, selection = real_answer("uois_00", 7)
    check_scene(analysis, boxes(collision_objects(analysis, selection, HEADER)))


def test_without_moveit_the_module_still_imports(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "moveit_msgs.msg", None)
    try:
        assert not importlib.reload(planning_scene).AVAILABLE
    finally:
        monkeypatch.undo()
        assert importlib.reload(planning_scene).AVAILABLE == AVAILABLE


@requires_moveit
def test_a_lone_target_stands_on_its_table() -> None:
    analysis, selection = answer_to(cast(("green_cube", 0.85, 0.0, 0.0)))
    found = boxes(collision_objects(analysis, selection, HEADER))
    assert set(found) == {"boxgrasp_table", "boxgrasp_target"}
