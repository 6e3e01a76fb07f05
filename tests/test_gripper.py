"""Hands of several boxes: what a file may say, what distances and answers follow from it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import drawn, seen
from hypothesis import given, settings
from hypothesis import strategies as st

from boxgrasp import Capture, GraspSelector, Selection, Target, load_config
from boxgrasp.config import dump_config, gripper_names, load_gripper
from boxgrasp.errors import ConfigError, GripperError
from boxgrasp.geometry import hand_distance
from boxgrasp.geometry.box import Box
from boxgrasp.geometry.transforms import invert, make_transform, rotation_z
from boxgrasp.grasps.candidates import candidates_of
from boxgrasp.grasps.gripper import Gripper, HandBox
from boxgrasp.simulate import Box as SolidBox
from boxgrasp.simulate import candidate_truth, cast
from boxgrasp.simulate.camera import intrinsics_matrix, look_at
from boxgrasp.simulate.primitives import Plane, upright
from boxgrasp.strict import plain, to_yaml

SHEET: dict[str, Any] = {
    "name": "palm and fingers", "length_m": 0.12, "width_m": 0.2, "thickness_m": 0.06,
    "max_opening_m": 0.08, "insertion_depth_m": 0.015,
    "palm": [{"x_m": [0.0, 0.07], "y_m": [-0.1, 0.1], "z_m": [-0.03, 0.03]}],
    "finger": [{"x_m": [0.06, 0.12], "y_m": [0.04, 0.06], "z_m": [-0.01, 0.01]}],
    "T_flange_gripper": [[0, 0, -1, 0], [0, 1, 0, 0], [1, 0, 0, 0.06], [0, 0, 0, 1]],
}  # fmt: skip
K = intrinsics_matrix()


def hand(**other: Any) -> Gripper:
    return load_config({"gripper": {**SHEET, **other}}).gripper


def test_a_tool_point_follows_the_fingertips_unless_it_is_given() -> None:
    """A file without one once kept the default's, beyond the tips of a shorter hand."""
    np.testing.assert_allclose(hand().tcp_pose, make_transform(np.eye(3), (0.06, 0.0, 0.0)))
    assert Gripper(length_m=0.163).tcp_pose[0, 3] == pytest.approx(0.0815)
    given_back = make_transform(rotation_z(0.3), (0.05, 0.0, 0.0))
    np.testing.assert_allclose(hand(T_gripper_tcp=given_back.tolist()).tcp_pose, given_back)
    beyond = make_transform(np.eye(3), (0.0885, 0.0, 0.0)).tolist()
    with pytest.raises(ConfigError, match=r"T_gripper_tcp lies 2\.85 cm beyond the fingertips"):
        hand(T_gripper_tcp=beyond)


@pytest.mark.parametrize(
    ("other", "said"),
    [
        ({"palm": []}, "finger is given and palm is not"),
        ({"finger": []}, "palm is given and finger is not"),
        ({"max_opening_m": 0.09}, "finger starts at y 0.04, between the fingers"),
        ({"opening_m": 0.1}, "opening_m 0.1 exceeds max_opening_m 0.08"),
        ({"opening_m": 0.001}, "opening_m is 0.001, so it cannot hold anything"),
        ({"length_m": 0.22}, "length_m is 0.22, its boxes reach 0.1200"),
        ({"width_m": 0.17}, "width_m is 0.17, its boxes reach 0.2000"),
        ({"thickness_m": 0.07}, "thickness_m is 0.07, its boxes reach 0.0600"),
        ({"insertion_depth_m": 0.05}, "below the fingers' 0.05 m"),
        (
            {"palm": [{"x_m": [0, 0.12], "y_m": [-0.1, 0.1], "z_m": [-0.03, 0.03]}]},
            "below the fingers' 0 m",
        ),
        (
            {"palm": [{"x_m": [-0.1, 0.07], "y_m": [-0.1, 0.1], "z_m": [-0.03, 0.03]}]},
            "starts behind the mounting face",
        ),
        ({"palm": [{"x_m": [0.07, 0.0], "y_m": [0, 1], "z_m": [0, 1]}]}, "valid: rising"),
        ({"palm": [{"x_m": [0, 0.07]}]}, "y_m"),
        ({"palm": [{"x": [0, 1]}]}, "unknown key 'x' in gripper.palm[0]"),
        ({"T_flange_gripper": np.zeros((4, 4)).tolist()}, "T_flange_gripper"),
    ],
)  # fmt: skip
def test_what_contradicts_itself_is_refused_in_one_line(other: dict[str, Any], said: str) -> None:
    with pytest.raises(ConfigError) as caught:
        hand(**other)
    assert said in str(caught.value) and "\n" not in str(caught.value)


def test_a_hand_is_named_or_a_file(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(to_yaml({k: v for k, v in SHEET.items() if k != "name"}))
    assert load_gripper(path).name == "mine"
    assert load_config({"gripper": str(path)}).gripper == load_gripper(path)
    assert load_gripper("thesis") == Gripper() and gripper_names()[0] == "thesis"
    with pytest.raises(GripperError, match="unknown gripper: robotic; valid: thesis"):
        load_gripper("robotic")
    config = load_config({"gripper": SHEET})
    path.write_text(dump_config(config))
    assert load_config(path) == config


def test_swinging_fingers_need_more_room_over_the_plane() -> None:
    """Of a grasp from above; from the side they swing level."""
    capture, mask = view_of()
    results = []
    for advance_m in (0.0, 0.02):
        selector = GraspSelector(
            {"gripper": plain(hand(closing_advance_m=advance_m)), "candidates": {"refine": "none"}}
        )
        context = selector.analyze(capture, Target(mask=mask)).context
        results.append(context.check_results["plane_clearance"].value)
    less, above = results[0] - results[1], context.candidates.face >= 4
    np.testing.assert_allclose(less[~above], 0.0, atol=1e-6)
    width = context.candidates.width_m[above]
    np.testing.assert_allclose(less[above], 0.02 * np.sqrt(1 - (width / 0.08) ** 2), atol=1e-6)
    # A link of 57 mm that swings from 41 mm to its side is never farther than this says.
    swung = hand(closing_advance_m=0.057 - float(np.sqrt(0.057**2 - 0.041**2)), max_opening_m=0.08)
    for share in np.linspace(0.0, 1.0, 21):
        true = np.sqrt(0.057**2 - (share * 0.041) ** 2) - np.sqrt(0.057**2 - 0.041**2)
        assert swung.advance_m(np.array([share * 0.08]))[0] >= true - 1e-9
    assert hand(closing_advance_m=0.02, opening_m=0.04).advance_m(np.array([0.04]))[0] == 0.0


def test_a_deep_hand_goes_less_deep_into_what_is_low() -> None:
    """Down to 6 mm over the plane, and a centimeter past the face at least."""
    T = look_at((0.1, 0.0, 0.75), (0.8, 0.0, 0.05))
    for high, tip in ((0.025, 0.006), (0.013, 0.003), (0.08, 0.04)):
        low = SolidBox(upright(0.8, 0.0, high / 2), np.array((0.06, 0.04, high)), object_id=1)
        view = cast([Plane(0.0), low], K, T)
        selector = GraspSelector({"gripper": plain(hand(insertion_depth_m=0.04))})
        capture, mask = Capture(view.depth, K, T), view.object_ids == 1
        found = selector.analyze(capture, Target(mask=mask)).context.candidates
        tips = found.T_base_gripper[found.face >= 4] @ (0.06, 0.0, 0.0, 1.0)
        np.testing.assert_allclose(tips[:, 2], tip, atol=2e-3)


def random_hand(rng: np.random.Generator) -> Gripper:
    """Any hand that may be: one to three palm boxes, one or two a finger."""
    front, tip, gap = rng.uniform(0.03, 0.1), rng.uniform(0.14, 0.2), rng.uniform(0.02, 0.06)
    palm = [
        ((0.0, front * rng.uniform(0.3, 1.0)), sorted(rng.uniform(-0.1, 0.1, 2)), (-0.03, 0.02))
        for _ in range(int(rng.integers(1, 4)))
    ]
    out = gap + rng.uniform(0.005, 0.03)
    finger = [((front / 2, tip), (gap, out), (-0.012, 0.01))]
    if rng.random() < 0.5:
        finger.append(((front / 3, front), (gap + 0.001, out + 0.02), (-0.02, 0.02)))
    boxes = [HandBox(*(tuple(map(float, ends)) for ends in box)) for box in palm]  # type: ignore[misc]
    both = [HandBox(*(tuple(map(float, ends)) for ends in box)) for box in finger]  # type: ignore[misc]
    whole = (*boxes, *both)
    return Gripper(
        name="any", length_m=tip, max_opening_m=2 * gap, opening_m=2 * gap * rng.uniform(0.4, 1.0),
        insertion_depth_m=0.01, palm=tuple(boxes), finger=tuple(both),
        width_m=2 * max(max(abs(y) for y in box.y_m) for box in whole),
        thickness_m=2 * max(max(abs(z) for z in box.z_m) for box in whole),
    )  # fmt: skip


def plain_boxes(hand: Gripper) -> list[np.ndarray]:
    """(3, 2) ranges of every box where it stands, hand's axes: from the sheet alone."""
    closer = (hand.max_opening_m - hand.fingers_open_m) / 2
    found = [np.array((box.x_m, box.y_m, box.z_m)) for box in hand.palm]
    for box in hand.finger:
        y = np.array(box.y_m) - closer
        found += [np.array((box.x_m, y, box.z_m)), np.array((box.x_m, -y[::-1], box.z_m))]
    return found


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), back=st.sampled_from((0.0, 0.15)))
def test_distances_are_those_of_the_nearest_box(seed: int, back: float) -> None:
    rng = np.random.default_rng(seed)
    own = random_hand(rng)
    T = make_transform(rotation_z(rng.uniform(-4, 4)), rng.uniform(-0.1, 0.1, 3))
    poses = candidates_of(Box(T, rng.uniform(0.02, 0.25, 3)), own).T_base_gripper
    points = rng.normal(0, 0.2, (int(rng.integers(1, 200)), 3)).astype(np.float32)
    hands = hand_distance.hand_uprights(poses, own.boxes_m, back)
    found, nearest = hand_distance.to_points(hands, points)
    normal = np.array((0.0, 0.0, 1.0))
    low = hand_distance.to_plane(hands, normal, 0.1)
    centers, edge = rng.uniform(-0.3, 0.3, (30, 3)), 0.05
    cells, _ = hand_distance.to_cells(hands, centers, np.full(30, edge), 0.0)
    for m, pose in enumerate(poses):
        local = (points.astype(np.float64) - pose[:3, 3]) @ pose[:3, :3] + (own.length_m / 2, 0, 0)
        gaps, lowest, alone = [], [], []
        for box in plain_boxes(own):
            box[0, 0] -= back
            off = np.maximum(np.maximum(box[:, 0] - local, local - box[:, 1]), 0.0)
            gaps.append(np.linalg.norm(off, axis=1))
            corners = np.stack(np.meshgrid(*box, indexing="ij"), axis=-1).reshape(-1, 3)
            corners = (corners - (own.length_m / 2, 0, 0)) @ pose[:3, :3].T + pose[:3, 3]
            lowest.append(corners[:, 2].min())
            middle = box.mean(axis=1) - (own.length_m / 2, 0, 0)
            moved = make_transform(pose[:3, :3], pose[:3, :3] @ middle + pose[:3, 3])
            single = hand_distance.uprights(moved[None], (box[:, 1] - box[:, 0]) / 2)
            alone.append(hand_distance.to_cells(single, centers, np.full(30, edge), 0.0)[0][0])
        every = np.min(gaps, axis=0)
        assert found[m] == pytest.approx(min(every.min(), 0.5), abs=1e-6)
        assert nearest[m] < 0 or every[nearest[m]] == pytest.approx(every.min(), abs=1e-6)
        assert low[m] == pytest.approx(np.clip(min(lowest) + 0.1, -0.5, 0.5), abs=1e-9)
        assert cells[m] == pytest.approx(min(alone), abs=1e-9)


def view_of(*others: SolidBox) -> tuple[Capture, np.ndarray]:
    """An upright target, 4 cm wide, 15 cm high, with what stands round it; and its mask."""
    T = look_at((0.1, 0.0, 0.75), (0.8, 0.0, 0.05))
    target = SolidBox(upright(0.8, 0.0, 0.075), np.array((0.06, 0.04, 0.15)), object_id=1)
    view = cast([Plane(0.0), target, *others], K, T)
    return Capture(view.depth, K, T), view.object_ids == 1


def visible(own: Gripper, *others: SolidBox) -> dict[str, np.ndarray]:
    """The clearance that every candidate shows, and the exact one."""
    capture, mask = view_of(*others)
    context = GraspSelector({"gripper": plain(own)}).analyze(capture, Target(mask=mask)).context
    return {c: context.check_results[c].value for c in ("visible_clearance", "occluded_clearance")}


def post(x: float, y: float, high: float = 0.16) -> SolidBox:
    """A thin post, 8 mm square."""
    return SolidBox(upright(x, y, high / 2), np.array((0.008, 0.008, high)), object_id=2)


def test_between_the_fingers_only_the_target_may_be() -> None:
    """Top-parallel opens along the base's y there: a post beside the target is in the gap."""
    palm = [{"x_m": [0.0, 0.07], "y_m": [-0.1, 0.1], "z_m": [-0.04, 0.04]}]
    own = hand(thickness_m=0.08, palm=palm)
    label = 10  # label 11, top-parallel, the middle line
    free = visible(own)["visible_clearance"][label]
    assert free == pytest.approx(0.5)
    between = visible(own, post(0.8, 0.03))
    assert between["visible_clearance"][label] == 0.0 == between["occluded_clearance"][label]
    # Nearer to the camera and lower than the palm: close to the one box round the hand alone.
    beside = visible(own, post(0.8 - 0.058, 0.07))["visible_clearance"][label]
    as_box = replace(own, palm=(), finger=())
    boxed = visible(as_box, post(0.8 - 0.058, 0.07))["visible_clearance"][label]
    assert 0.02 < beside and boxed < 0.02


@cache
def cast_answer(name: str, seed: int) -> tuple[Any, Gripper]:
    own = {"thesis": Gripper(), "sheet": hand()}[name]
    return GraspSelector({"gripper": plain(own)}).select(seen(drawn(seed))), own


def test_answers_keep_clear_by_the_hands_own_boxes() -> None:
    grasps = 0
    for seed in range(6):
        found, own = cast_answer("sheet", seed)
        if found.grasp is None:  # 8 cm are too narrow for some
            continue
        grasps += 1
        truth = candidate_truth(drawn(seed), found.grasp.T_base_gripper[None], gripper=own)
        assert truth.valid[0] and truth.clearance_m[0] >= 0.018
        assert found.grasp.clearance_m >= truth.clearance_m[0] - 1e-6
    assert grasps >= 3


def test_the_truth_of_several_boxes_is_the_least_of_each() -> None:
    scene, own = drawn(3), hand()
    poses = GraspSelector({"gripper": plain(own)}).select(seen(scene)).candidates
    T = np.array([candidate.T_base_gripper for candidate in poses])
    truth = candidate_truth(scene, T, gripper=own)
    least = np.full(len(T), np.inf)
    for box in plain_boxes(own):
        size = (box[:, 1] - box[:, 0]).tolist()
        alone = Gripper(
            length_m=size[0], width_m=max(size[1], 0.01), thickness_m=size[2], max_opening_m=0.01,
            insertion_depth_m=size[0] / 2,
        )  # fmt: skip
        moved = T.copy()
        moved[:, :3, 3] += T[:, :3, :3] @ (box.mean(axis=1) - (own.length_m / 2, 0, 0))
        least = np.minimum(least, candidate_truth(scene, moved, gripper=alone).clearance_m)
    between = truth.clearance_m < least - 1e-9
    np.testing.assert_allclose(truth.clearance_m[~between], least[~between])
    assert (truth.clearance_m[between] == 0.0).all()


def test_the_answer_carries_hand_and_flange() -> None:
    found, own = next(cast_answer("sheet", s) for s in range(6) if cast_answer("sheet", s)[0].grasp)
    assert found.gripper == own
    T = found.grasp.T_base_flange
    np.testing.assert_allclose(T @ np.array(SHEET["T_flange_gripper"]), found.grasp.T_base_gripper)
    np.testing.assert_allclose(T[:3, 2], found.grasp.T_base_gripper[:3, 0])  # z is the approach
    tips = found.grasp.T_base_gripper @ make_transform(np.eye(3), (0.06, 0, 0))
    np.testing.assert_allclose(found.grasp.T_base_tcp, tips)
    np.testing.assert_allclose((invert(T) @ found.grasp.T_base_tcp)[2, 3], 0.12)
    again = Selection.from_json(found.to_json())
    assert again.gripper == own and again.to_json() == found.to_json()
    plain_hand, _ = cast_answer("thesis", 0)
    assert plain_hand.grasp is None or plain_hand.grasp.T_base_flange is None


def test_an_answer_from_before_hands_had_boxes_still_reads() -> None:
    found, _ = cast_answer("thesis", 0)
    data = found.to_dict()
    old = ("length_m", "width_m", "thickness_m", "max_opening_m", "insertion_depth_m")
    data["gripper"] = {name: data["gripper"][name] for name in old}
    data["gripper"]["T_gripper_tcp"] = make_transform(np.eye(3), (0.11, 0, 0)).tolist()
    from json import dumps

    read = Selection.from_json(dumps(data))
    assert replace(read.gripper, T_gripper_tcp=None) == Gripper()
