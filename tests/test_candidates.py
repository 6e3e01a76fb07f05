"""The 5 l candidates and the hand against poses written by hand and the simulator's own truth."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import drawn

from boxgrasp.config import load_config
from boxgrasp.errors import BoxgraspError, ConfigError, GripperError
from boxgrasp.geometry.box import Box
from boxgrasp.geometry.hand_distance import to_points, uprights
from boxgrasp.geometry.transforms import make_transform, rotation_z
from boxgrasp.grasps.candidates import FACES, CandidatesConfig, candidates_of, label_of
from boxgrasp.grasps.gripper import Gripper
from boxgrasp.simulate import true_box, true_candidates

HAND = Gripper()


def a_box(yaw_deg: float = 0.0, center: tuple[float, float, float] = (0.9, 0.1, 0.9)) -> Box:
    return Box(
        make_transform(rotation_z(np.deg2rad(yaw_deg)), center), np.array([0.06, 0.10, 0.21])
    )


@pytest.mark.parametrize("lines", range(1, 8))
def test_five_times_l_candidates_with_labels_in_order(lines: int) -> None:
    candidates = candidates_of(a_box(), HAND, lines)
    assert candidates.lines == lines
    assert candidates.label.tolist() == list(range(1, 5 * lines + 1))
    assert candidates.T_base_gripper.shape == (5 * lines, 4, 4)
    expected = [(face, line) for face in range(1, 6) for line in range(1, lines + 1)]
    assert list(zip(candidates.face.tolist(), candidates.line.tolist(), strict=True)) == expected
    for label, (face, line) in zip(candidates.label.tolist(), expected, strict=True):
        assert label == (face - 1) * lines + line == label_of(face, line, lines)


@pytest.mark.parametrize("lines", range(1, 8))
@pytest.mark.parametrize("seed", range(4))
def test_poses_equal_the_truth_of_the_simulator(lines: int, seed: int) -> None:
    scene = drawn(seed, yaw="random")
    T_base_box, dimensions_m = true_box(scene)
    found = candidates_of(Box(T_base_box, dimensions_m), HAND, lines)
    truth = true_candidates(scene, lines=lines)
    np.testing.assert_allclose(found.T_base_gripper, truth.T_base_gripper, atol=1e-12)
    np.testing.assert_allclose(found.width_m, truth.width_m, atol=1e-12)
    np.testing.assert_array_equal(found.label, truth.label)


def test_poses_by_hand() -> None:
    """Box 6 x 10 x 21 cm unturned at the origin: 10 cm off each face, at the thirds' middles."""
    candidates = candidates_of(a_box(center=(0.0, 0.0, 0.0)), HAND, 3)
    positions = {
        1: (0.0, 0.15, -0.07),
        2: (0.0, 0.15, 0.0),
        3: (0.0, 0.15, 0.07),
        4: (-0.13, 0.0, -0.07),
        6: (-0.13, 0.0, 0.07),
        7: (0.0, -0.15, -0.07),
        9: (0.0, -0.15, 0.07),
        10: (-0.02, 0.0, 0.205),
        11: (0.0, 0.0, 0.205),
        12: (0.02, 0.0, 0.205),
        13: (0.0, -0.1 / 3, 0.205),
        14: (0.0, 0.0, 0.205),
        15: (0.0, 0.1 / 3, 0.205),
    }
    for label, position in positions.items():
        np.testing.assert_allclose(
            candidates.T_base_gripper[label - 1, :3, 3], position, atol=1e-12
        )
    axes = {  # face: approach x, finger opening y
        1: ((0, -1, 0), (1, 0, 0)),
        2: ((1, 0, 0), (0, 1, 0)),
        3: ((0, 1, 0), (-1, 0, 0)),
        4: ((0, 0, -1), (0, 1, 0)),
        5: ((0, 0, -1), (1, 0, 0)),
    }
    widths = {1: 0.06, 2: 0.10, 3: 0.06, 4: 0.10, 5: 0.06}
    for k, face in enumerate(candidates.face.tolist()):
        x, y = axes[face]
        rotation = candidates.T_base_gripper[k, :3, :3]
        np.testing.assert_array_equal(rotation[:, 0], x)
        np.testing.assert_array_equal(rotation[:, 1], y)
        np.testing.assert_array_equal(rotation[:, 2], np.cross(x, y))
        assert candidates.width_m[k] == widths[face]
        assert candidates.width_axis[k] == int(np.argmax(np.abs(y)))


@pytest.mark.parametrize("yaw_deg", [0.0, 31.0, -44.5, 90.0, 200.0])
def test_poses_are_rigid_upright_and_a_standoff_away(yaw_deg: float) -> None:
    box = a_box(yaw_deg)
    candidates = candidates_of(box, HAND, 4)
    for k, face in enumerate(candidates.face.tolist()):
        T = candidates.T_base_gripper[k]
        np.testing.assert_allclose(T[:3, :3].T @ T[:3, :3], np.eye(3), atol=1e-12)
        assert np.linalg.det(T[:3, :3]) == pytest.approx(1.0)
        if face <= 3:
            np.testing.assert_allclose(T[:3, 2], (0, 0, 1), atol=1e-12)  # z up on side faces
        else:
            np.testing.assert_allclose(T[:3, 0], (0, 0, -1), atol=1e-12)
        # Going 10 cm along the approach reaches the box's surface, a hair further its inside.
        for ahead, inside in ((0.10 - 1e-9, False), (0.10 + 1e-9, True)):
            tip = T[:3, 3] + ahead * T[:3, 0]
            local = box.T_base_box[:3, :3].T @ (tip - box.T_base_box[:3, 3])
            assert bool(np.all(np.abs(local) < box.dimensions_m / 2)) is inside


def test_a_turned_box_turns_its_candidates() -> None:
    straight, turned = candidates_of(a_box(), HAND), candidates_of(a_box(40.0), HAND)
    T_turn = a_box(40.0).T_base_box @ np.linalg.inv(a_box().T_base_box)
    np.testing.assert_allclose(turned.T_base_gripper, T_turn @ straight.T_base_gripper, atol=1e-12)


def test_half_a_turn_about_the_approach_is_the_same_grasp() -> None:
    """Checks see a box: turned about x by 180 degrees it measures the same everywhere."""
    candidates = candidates_of(a_box(17.0), HAND)
    half_turn = candidates.T_base_gripper @ np.diag([1.0, -1.0, -1.0, 1.0])
    points = (np.random.default_rng(0).uniform((0.5, -0.3, 0.7), (1.3, 0.5, 1.3), (300, 3))).astype(
        np.float32
    )
    first, _ = to_points(uprights(candidates.T_base_gripper, HAND.half_m), points)
    second, _ = to_points(uprights(half_turn, HAND.half_m), points)
    np.testing.assert_allclose(first, second, atol=1e-7)


def test_candidates_are_read_only() -> None:
    candidates = candidates_of(a_box(), HAND)
    for array in (candidates.label, candidates.face, candidates.T_base_gripper, candidates.width_m):
        assert not array.flags.writeable


def test_default_gripper_is_the_thesis_one() -> None:
    assert (HAND.length_m, HAND.width_m, HAND.thickness_m, HAND.max_opening_m) == (
        0.22,
        0.17,
        0.07,
        0.12,
    )
    assert HAND.standoff_m == pytest.approx(0.10)
    np.testing.assert_allclose(HAND.half_m, (0.11, 0.085, 0.035))


def test_standoff_follows_length_and_insertion() -> None:
    hand = Gripper(length_m=0.16, insertion_depth_m=0.03)
    assert hand.standoff_m == pytest.approx(0.05)
    front = candidates_of(a_box(center=(0, 0, 0)), hand, 1).T_base_gripper[1]
    assert front[0, 3] == pytest.approx(-0.03 - 0.05)


@pytest.mark.parametrize(
    "values",
    [
        {"max_opening_m": 0.0},
        {"max_opening_m": -0.1},
        {"max_opening_m": 0.18},
        {"length_m": 0.0},
        {"width_m": float("nan")},
        {"thickness_m": 1.5},
        {"insertion_depth_m": 0.0},
        {"insertion_depth_m": -0.05},
        {"insertion_depth_m": 0.22},
        {"T_gripper_tcp": ((2, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1))},
        {"T_gripper_tcp": ((-1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1))},
        {"T_gripper_tcp": ((1, 0, 0, float("nan")), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1))},
    ],
)
def test_a_gripper_that_cannot_be_is_refused(values: dict[str, object]) -> None:
    with pytest.raises(GripperError) as caught:
        Gripper(**values)  # type: ignore[arg-type]
    assert "\n" not in str(caught.value) and "valid" in str(caught.value)
    with pytest.raises(BoxgraspError):
        load_config({"gripper": values})


@pytest.mark.parametrize("faces", [(), ("frnt",), ("front", "bottom")])
def test_unknown_faces_are_refused_with_the_known_ones(faces: tuple[str, ...]) -> None:
    with pytest.raises(ConfigError) as caught:
        CandidatesConfig(faces=faces)
    assert all(face in str(caught.value) for face in FACES)
