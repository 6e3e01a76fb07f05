"""The answer as messages says what its JSON says."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from answers import HEADER, answer, checked_fields, matrix, real_answer, sent, told, xyz
from boxgrasp_ros.replies import (
    grasp_pose,
    object_messages,
    pose_message,
    poses,
    selection_message,
)

from boxgrasp import Selection
from boxgrasp.geometry.transforms import make_transform
from boxgrasp.perception.numbering import SceneObject

KINDS = ("grasp", "ask")


def mirrored(message: Any) -> dict[str, Any]:
    """What the JSON should say, by the message alone; as close as poses and doubles get."""
    number = {"nan": None, math.inf: None}
    grasp = None
    if message.status == "grasp":
        names = ("label", "face", "face_name", "line", "opening_m", "width_m", "clearance_m",
                 "clearance_at_least_m", "probability_clear", "confidence")  # fmt: skip
        grasp = {name: told(getattr(message, name)) for name in names}
        grasp = {name: number.get(value, value) for name, value in grasp.items()}
        q = message.pose.orientation
        grasp |= {
            "T_base_gripper": matrix(message.pose),
            "T_base_tcp": matrix(message.tcp_pose),
            "T_base_pregrasp": matrix(message.pregrasp_pose),
            "T_base_flange": matrix(message.flange_pose) if message.has_flange_pose else None,
            "position_m": xyz(message.pose.position),
            "quaternion_xyzw": [q.x, q.y, q.z, q.w],
        }
    return {
        "status": message.status,
        "ranker": message.ranker,
        "T_base_camera": matrix(message.camera_pose) if message.has_camera_pose else None,
        "grasp": grasp,
        "passing": list(message.passing),
        "box": {
            "T_base_box": matrix(message.box_pose),
            **{
                name: [number.get(value, value) for value in xyz(getattr(message, f"box_{name}"))]
                for name in ("dimensions_m", "dimensions_at_least_m", "dimensions_at_most_m")
            },
        },
        "candidates": [candidate(item) for item in message.candidates],
        "warnings": [
            {"code": code, "message": text}
            for code, text in zip(message.warning_codes, message.warning_messages, strict=True)
        ],
        "config_hash": message.config_hash,
        "timings_ms": dict(zip(message.timing_stages, message.timings_ms, strict=True)),
        "version": message.version,
    }


def candidate(item: Any) -> dict[str, Any]:
    names = ("label", "face", "face_name", "line", "rank", "width_m", "passed")
    checks = {
        said.name: {
            "value": said.value,
            "limit": said.limit,
            "unit": said.unit or None,
            "passed": said.passed,
            "object": None if said.object == -1 else said.object,
            "nearest_point_m": list(xyz(said.nearest_point)) if said.has_nearest_point else None,
        }
        for said in item.checks
    }
    own = {name: getattr(item, name) for name in names}
    return own | {
        "T_base_gripper": matrix(item.pose),
        "checks": checks,
        "rejections": list(item.rejections),
    }


def assert_alike(found: Any, expected: Any, where: str = "") -> None:
    if isinstance(expected, dict):
        assert set(found) == set(expected), where
        for name in expected:
            assert_alike(found[name], expected[name], f"{where}.{name}")
    elif isinstance(found, np.ndarray):
        np.testing.assert_allclose(found, expected, atol=1e-12, err_msg=where)
    elif isinstance(expected, list) and len(expected) == len(found):
        for k, (one, other) in enumerate(zip(found, expected, strict=True)):
            assert_alike(one, other, f"{where}[{k}]")
    elif isinstance(expected, float):
        assert found == pytest.approx(expected, abs=1e-12), where
    else:
        assert found == expected, where


def check_mirror(selection: Selection) -> None:
    with checked_fields():
        message = selection_message(selection, HEADER)
    message = sent(message)
    plain = selection.to_dict()
    refusal = selection.refusal
    said = mirrored(message)
    # In the JSON alone: its own bookkeeping, and the hand, which the node's parameters tell.
    alone = {"schema", "capture", "frame", "refusal", "gripper", "risk"}
    assert_alike(said, {name: value for name, value in plain.items() if name not in alone})
    if refusal is None:
        assert (message.refusal_code, message.refusal_message, message.nearest_label) == ("", "", 0)
        assert list(message.violations) == []
    else:
        assert message.refusal_code == refusal.code
        assert message.refusal_message == refusal.message
        assert message.nearest_label == refusal.nearest_label
        assert list(message.violations) == [item.sentence for item in refusal.violations]
    assert Selection.from_json(message.json).to_dict() == plain
    assert message.header == HEADER


@pytest.mark.parametrize("kind", KINDS)
def test_every_field_is_the_jsons(kind: str) -> None:
    _, selection = answer(kind)
    assert selection.status == kind
    check_mirror(selection)


def test_of_a_real_capture_too() -> None:
    check_mirror(real_answer("uois_00", 7)[1])


def test_what_is_unknown_is_nan_and_what_nothing_bounds_infinite() -> None:
    _, selection = answer("grasp")
    assert selection.grasp is not None
    bare = dataclasses.replace(
        selection,
        grasp=dataclasses.replace(selection.grasp, clearance_m=None, confidence=None),
        box=dataclasses.replace(
            selection.box, dimensions_at_most_m=np.array([np.inf, 0.1, np.inf])
        ),
        T_base_camera=None,
    )
    message = sent(selection_message(bare, HEADER))
    assert math.isnan(message.clearance_m) and math.isnan(message.confidence)
    assert math.isnan(message.clearance_at_least_m) and math.isnan(message.probability_clear)
    assert told(message.box_dimensions_at_most_m) == {"x": math.inf, "y": 0.1, "z": math.inf}
    assert not message.has_camera_pose and not message.has_flange_pose
    check_mirror(bare)


def test_a_flange_is_told_where_the_hand_has_one() -> None:
    _, selection = answer("grasp")
    assert selection.grasp is not None
    T = selection.grasp.T_base_gripper @ make_transform(np.eye(3), (-0.2, 0.0, 0.0))
    grasp = dataclasses.replace(selection.grasp, T_base_flange=T)
    check_mirror(dataclasses.replace(selection, grasp=grasp))


def test_an_ask_has_no_numbers_of_a_grasp() -> None:
    message = selection_message(answer("ask")[1], HEADER)
    for name in ("opening_m", "width_m", "clearance_m", "confidence", "probability_clear"):
        assert math.isnan(getattr(message, name))
    assert (message.label, message.face, message.line, message.face_name) == (0, 0, 0, "")
    assert told(message.pose) == told(pose_message(np.eye(4)))
    assert list(message.passing) == []


@pytest.mark.parametrize("kind", KINDS)
def test_poses_are_the_passing_candidates_best_first(kind: str) -> None:
    _, selection = answer(kind)
    with checked_fields():
        array, best = poses(selection, HEADER), grasp_pose(selection, HEADER)
    assert array.header == HEADER and len(array.poses) == len(selection.passing)
    for pose, passing in zip(sent(array).poses, selection.passing, strict=True):
        np.testing.assert_allclose(matrix(pose), passing.T_base_gripper, atol=1e-12)
    if selection.grasp is None:
        assert best is None and array.poses == []
    else:
        assert best is not None and best.header == HEADER and best.pose == array.poses[0]
        np.testing.assert_allclose(matrix(best.pose), selection.grasp.T_base_gripper, atol=1e-12)


def test_poses_of_turns_of_every_kind() -> None:
    rng = np.random.default_rng(0)
    for _ in range(200):
        R, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        T = make_transform(R * np.linalg.det(R), rng.normal(size=3))
        np.testing.assert_allclose(matrix(pose_message(T)), T, atol=1e-12)


def test_objects_are_told() -> None:
    scene = answer("grasp")[0].scene
    found = scene.objects_with_pixels()
    with checked_fields():
        messages = [sent(item) for item in object_messages(found)]
    assert [item.number for item in messages] == [1, 2]
    for item, said in zip(found, messages, strict=True):
        np.testing.assert_array_equal(xyz(said.center), item.center_m)
        np.testing.assert_array_equal(xyz(said.size_m), item.size_m)
        assert (said.distance_m, said.points) == (item.distance_m, item.points)
        assert said.has_pixel and (said.u, said.v) == item.pixel
    hidden = SceneObject(3, np.zeros(3), np.ones(3), 1.5, 20, None)
    (said,) = object_messages([hidden])
    assert (said.has_pixel, said.u, said.v) == (False, 0, 0)
