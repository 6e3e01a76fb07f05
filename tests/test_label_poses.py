"""A pose that an operator reached becomes the label of the nearest candidate."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import drawn, halved, seen
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from boxgrasp import GraspSelector, Selection
from boxgrasp.errors import BoxgraspError, CaptureError
from boxgrasp.io.npz import save_npz
from boxgrasp.io.pose import gripper_pose

pytest.importorskip("sqlalchemy", reason="needs boxgrasp[label]")

from boxgrasp.execution import Store
from boxgrasp.labeling.captures import CaptureStore
from boxgrasp.labeling.poses import PARAMS, PoseOf, label_from_pose, nearest_candidate
from boxgrasp.labeling.record import Record

SEEN = halved(seen(drawn(7), 7))
ANSWER = GraspSelector().select(SEEN)


def moved(
    T: np.ndarray, offset_m: Any = (0.0, 0.0, 0.0), turn: Any = (0.0, 0.0, 0.0)
) -> np.ndarray:
    """A pose beside another: moved in the base frame, turned in its own."""
    other = np.array(T)
    other[:3, :3] = T[:3, :3] @ Rotation.from_rotvec(turn).as_matrix()
    other[:3, 3] += offset_m
    return other


def naive(answer: Selection, T: np.ndarray) -> list[tuple[float, int, float, float]]:
    """Cost, label, distance and angle of every candidate, one after the other, by SciPy."""
    rows = []
    for candidate in answer.candidates:
        C = candidate.T_base_gripper
        distance = math.dist(C[:3, 3], T[:3, 3])
        turn = Rotation.from_matrix(C[:3, :3]).inv() * Rotation.from_matrix(T[:3, :3])
        half = Rotation.from_rotvec((math.pi, 0.0, 0.0)).inv() * turn
        angle = min(turn.magnitude(), half.magnitude())
        rows.append((distance + 0.11 * angle, candidate.label, distance, angle))
    return sorted(rows)


@settings(max_examples=80, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.01, 0.1, 1.0]))
def test_the_nearest_is_that_of_a_loop(seed: int, spread: float) -> None:
    rng = np.random.default_rng(seed)
    start = ANSWER.candidates[rng.integers(len(ANSWER.candidates))].T_base_gripper
    T = moved(start, rng.normal(0, spread, 3), rng.normal(0, 2 * spread, 3))
    found = nearest_candidate(ANSWER.candidates, T)
    first, second = naive(ANSWER, T)[:2]
    if second[0] - first[0] > 1e-9:
        assert found.label == first[1]
    assert found.distance_m == pytest.approx(first[2], abs=1e-9)
    assert found.angle_rad == pytest.approx(first[3], abs=1e-7)
    assert found.cost_m() == pytest.approx(first[0], abs=1e-7)


@pytest.mark.parametrize("k", range(15))
def test_a_candidates_own_pose_is_that_candidate_also_after_half_a_turn(k: int) -> None:
    T = ANSWER.candidates[k].T_base_gripper
    for turn in ((0.0, 0.0, 0.0), (math.pi, 0.0, 0.0), (-math.pi, 0.0, 0.0)):
        found = nearest_candidate(ANSWER.candidates, moved(T, turn=turn))
        assert found.label == k + 1
        assert (found.distance_m, found.angle_rad) == pytest.approx((0.0, 0.0), abs=1e-7)
    # Half a turn about another axis is another grasp: the hand comes from behind.
    behind = moved(T, turn=(0.0, math.pi, 0.0))
    assert nearest_candidate(ANSWER.candidates[k : k + 1], behind).angle_rad > 3.1


def test_what_is_no_pose_is_refused() -> None:
    for T in (np.eye(3), np.full((4, 4), np.nan), np.diag([1.0, 1.0, -1.0, 1.0])):
        with pytest.raises(BoxgraspError, match="T_base_gripper"):
            nearest_candidate(ANSWER.candidates, T)
    with pytest.raises(BoxgraspError, match="no candidates"):
        nearest_candidate((), np.eye(4))


def seven(T: np.ndarray) -> str:
    return " ".join(map(repr, [*T[:3, 3].tolist(), *Rotation.from_matrix(T[:3, :3]).as_quat()]))


def test_a_pose_is_read_from_words_and_files(tmp_path: Path) -> None:
    T = ANSWER.candidates[3].T_base_gripper
    words = seven(T).replace("np.float64(", "").replace(")", "")
    np.testing.assert_allclose(gripper_pose(words), T, atol=1e-12)
    np.testing.assert_allclose(gripper_pose(words.replace(" ", ", ")), T, atol=1e-12)
    path = tmp_path / "pose.json"
    for told in (T.tolist(), {"T_base_gripper": T.tolist()}):
        path.write_text(json.dumps(told))
        np.testing.assert_allclose(gripper_pose(str(path)), T, atol=1e-12)


@pytest.mark.parametrize(
    "text,message",
    [
        ("1 2 3", "valid: 4 rows of 4"),
        ("0 0 0 0 0 0 2", "quaternion of length 2"),
        ("0 0 nan 0 0 0 1", "NaN"),
        ("100 0 500 0 0 0 1", "looks like millimeters"),
        ("nowhere.json", "No such file"),
        ("nowhere", "suffix ''"),
        ("", "suffix ''"),
    ],
)
def test_a_faulty_pose_is_refused(text: str, message: str) -> None:
    with pytest.raises(CaptureError) as refused:
        gripper_pose(text)
    assert message in str(refused.value) and "\n" not in str(refused.value)


class Place:
    """A record, its captures, and one capture beside them."""

    def __init__(self, folder: Path) -> None:
        self.record = Record.open(str(folder / "labels.db"))
        self.captures = CaptureStore(Store(folder))
        self.source = str(folder / "table.npz")
        save_npz(SEEN, self.source)

    def label(self, T: np.ndarray, **more: Any) -> Any:
        text = seven(T).replace("np.float64(", "").replace(")", "")
        return label_from_pose(self.source, PoseOf(text, "Ada"), self.record, self.captures, **more)


@pytest.fixture
def place(tmp_path: Path) -> Any:
    found = Place(tmp_path)
    yield found
    found.record.close()


def test_a_pose_is_kept_as_the_label_of_its_candidate(place: Place) -> None:
    failing = next(item for item in ANSWER.candidates if not item.passed)
    T = moved(failing.T_base_gripper, (0.003, 0.0, 0.004), (0.0, 0.02, 0.0))
    label = place.label(T)
    assert (label.verdict, label.label, label.origin) == ("candidate", failing.label, "pose")
    assert label.pose_distance_m == pytest.approx(0.005, abs=1e-9)
    assert label.pose_angle_rad == pytest.approx(0.02, abs=1e-7)
    np.testing.assert_allclose(label.T_base_gripper, T, atol=1e-12)
    failed = {name for name, said in failing.checks.items() if not said.passed}
    assert {item["check"] for item in label.overridden} == failed
    assert ANSWER.grasp is not None and label.proposed == ANSWER.grasp.label
    assert (label.operator, label.seconds) == ("Ada", None)
    assert place.record.standing() == [label]
    assert [scene.key for scene in place.record.scenes()] == [label.scene_key]


@pytest.mark.parametrize("offset_m,turn", [((0.0, 0.0, 0.5), (0, 0, 0)), ((0, 0, 0), (0, 0, 0.9))])
def test_a_pose_at_no_candidate_is_refused_and_nothing_is_kept(
    place: Place, offset_m: Any, turn: Any
) -> None:
    # About the approach, the faces' lines are 90 degrees apart and a half turn is none.
    candidate = ANSWER.candidates[4]
    T = moved(candidate.T_base_gripper, offset_m, turn)
    with pytest.raises(BoxgraspError, match="from the nearest candidate.*valid: within 10 cm"):
        place.label(T)
    assert place.record.standing() == [] and place.record.scenes() == []


def test_of_several_things_the_one_with_the_nearest_candidate_is_meant(place: Place) -> None:
    from dataclasses import replace

    from boxgrasp import Target
    from boxgrasp.labeling.sources import load_scene

    save_npz(replace(SEEN, target_pixel=None), place.source)
    others = [GraspSelector().select(SEEN, Target(object=number)) for number in (1, 2)]
    for other in others:
        label = place.label(other.candidates[10].T_base_gripper)
        loaded = load_scene(place.record.scene(label.scene_key), place.captures)
        shown = GraspSelector().select(loaded.capture, loaded.target)
        np.testing.assert_array_equal(shown.box.T_base_box, other.box.T_base_box)
        assert label.label == 11


def test_a_pose_between_two_things_is_refused() -> None:
    from boxgrasp.labeling.poses import Nearest, _Fit, _nearest_fit
    from boxgrasp.labeling.words import LabelScene

    def fit(name: str, distance_m: float) -> _Fit:
        scene = LabelScene(name, "capture", name, "yaw", 3, "0" * 64, {"mask": True})
        return _Fit(scene, ANSWER, Nearest(1, distance_m, 0.0))

    with pytest.raises(BoxgraspError, match="as near to one and two"):
        _nearest_fit([fit("one", 0.02), fit("two", 0.02 + PARAMS.lead_m / 2)], "table")
    assert _nearest_fit([fit("one", 0.02), fit("two", 0.04)], "table").scene.name == "one"


def test_several_captures_are_refused(place: Place, tmp_path: Path) -> None:
    folder = tmp_path / "captures"
    folder.mkdir()
    for seed in (3, 7):
        save_npz(seen(drawn(seed), seed), folder / f"{seed}.npz")
    place.source = str(folder)
    with pytest.raises(BoxgraspError, match="valid: one capture"):
        place.label(ANSWER.candidates[0].T_base_gripper)
