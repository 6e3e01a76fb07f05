"""The checks' values against exact surfaces, their witnesses, and reasons against values."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from helpers import TABLE_M, drawn, item, laid, seen

from boxgrasp import Capture, GraspSelector, Selection, Target, default_checks
from boxgrasp.errors import BoxgraspError, ConfigError
from boxgrasp.geometry.hand_distance import filled_fraction
from boxgrasp.geometry.transforms import invert, transform
from boxgrasp.grasps.checks import Check, CheckContext, CheckResult
from boxgrasp.perception.find_scene import find_scene
from boxgrasp.perception.scene_config import SceneConfig
from boxgrasp.perception.target import find_target
from boxgrasp.result import Candidate
from boxgrasp.simulate import TableScene, candidate_truth

SEEDS = range(10)
HALF = np.array([0.11, 0.085, 0.035])


@cache
def answer(seed: int, noise: bool = False) -> tuple[TableScene, Capture, Selection]:
    scene = drawn(seed, (2, 4), "random")
    capture = seen(scene, seed if noise else None)
    return scene, capture, GraspSelector().select(capture)


def value_of(candidate: Candidate, check: str = "visible_clearance") -> float:
    return candidate.checks[check].value


def failed(candidate: Candidate) -> set[str]:
    return {name for name, said in candidate.checks.items() if not said.passed}


def poses(found: Selection) -> np.ndarray:
    return np.array([candidate.T_base_gripper for candidate in found.candidates])


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("noise", [False, True])
def test_seen_is_the_distance_to_the_nearest_point_that_is_not_the_targets(
    seed: int, noise: bool
) -> None:
    _, capture, found = answer(seed, noise)
    scene = find_scene(capture, (), SceneConfig())
    others = scene.points[find_target(scene, capture, None).obstacle_mask].astype(np.float64)
    for candidate in found.candidates:
        local = transform(invert(candidate.T_base_gripper), others)
        away = np.linalg.norm(np.maximum(np.abs(local) - HALF, 0), axis=1)
        assert value_of(candidate) == pytest.approx(min(away.min(initial=0.5), 0.5), abs=1e-5)


@pytest.mark.parametrize("seed", SEEDS)
def test_numbers_against_exact_surfaces(seed: int) -> None:
    """Seen is never less than to the exact surfaces, and support is the true height."""
    scene, capture, _ = answer(seed)
    own = Target(mask=scene.view().object_ids == scene.target_id)  # segmentation is not in question
    found = GraspSelector().select(capture, own)
    truth = candidate_truth(scene, poses(found))
    for k, candidate in enumerate(found.candidates):
        # Surfaces hidden from the view may be nearer, seen ones are not farther.
        assert value_of(candidate) >= truth.clearance_m[k] - 0.003
        assert value_of(candidate, "plane_clearance") == pytest.approx(
            min(truth.plane_clearance_m[k], 0.5), abs=0.003
        )
        assert value_of(candidate, "unseen_distance") <= value_of(candidate) + 1e-9


def test_numbers_of_a_lone_neighbor_are_the_true_ones() -> None:
    """A box wall that faces the camera and the gripper: distances within a voxel."""
    scene = laid(item("beans_can", 0.95, 0.0), item("green_cube", 0.83, 0.0))
    found = GraspSelector().select(seen(scene))
    truth = candidate_truth(scene, poses(found))
    near = [k for k, o in enumerate(found.candidates) if o.face >= 4]
    for k in near:
        assert value_of(found.candidates[k]) == pytest.approx(truth.clearance_m[k], abs=0.004)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("noise", [False, True])
def test_checks_pass_by_their_values(seed: int, noise: bool) -> None:
    at_least = {
        "unseen_distance": 0.0,
        "approach_clearance": 0.005,
        "plane_clearance": 0.003,
    }
    scene, _, found = answer(seed, noise)
    for candidate in found.candidates:
        said = candidate.checks
        assert list(said) == [check.name for check in default_checks()]
        for name, limit in at_least.items():
            assert said[name].passed == (said[name].value >= limit)
            assert said[name].limit == limit and said[name].unit == "m"
        assert said["unseen_fraction"].passed == (said["unseen_fraction"].value <= 0.25)
        assert said["unseen_fraction"].unit == "fraction"
        assert said["width"].value == candidate.width_m
        margin_m = 0.12 - said["width"].limit
        assert 0.0009 <= margin_m < 0.012  # three deviations of two sides
        assert said["width"].passed == (candidate.width_m <= 0.12 - margin_m)
        for name in ("visible_clearance", "occluded_clearance"):
            where = said[name].nearest_point_m
            range_m = 0.0 if where is None else np.linalg.norm(where - scene.T_base_camera[:3, 3])
            expected_m = 0.02 + 3 * 0.4 * range_m / scene.intrinsics[0, 0]  # of a pixel's spacing
            assert said[name].limit == pytest.approx(expected_m, abs=1e-6)
            assert said[name].passed == (said[name].value >= said[name].limit)
        for name in ("width_known", "allowed_faces"):
            assert said[name].unit is None and said[name].limit == 1.0
            assert said[name].value == float(said[name].passed)
        assert candidate.passed == (not failed(candidate))
        told = [reason.check for reason in candidate.rejections]
        assert set(told) <= failed(candidate) and bool(told) == bool(failed(candidate))
        for reason in candidate.rejections:
            own = said[reason.check]
            assert (reason.value, reason.limit, reason.unit) == (own.value, own.limit, own.unit)
            assert (reason.object, reason.nearest_point_m) == (own.object, own.nearest_point_m)


def box_to_point(T_base_gripper: np.ndarray, point: Any, back_m: float = 0.0) -> float:
    """Distance of the hand's box, drawn out backwards, from a point, by clipping."""
    local = transform(invert(T_base_gripper), np.array(point, dtype=np.float64)[None])[0]
    low, high = -HALF - (back_m, 0, 0), HALF
    return float(np.linalg.norm(local - np.clip(local, low, high)))


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("noise", [False, True])
def test_witnesses_lie_where_the_values_were_measured(seed: int, noise: bool) -> None:
    _, capture, found = answer(seed, noise)
    scene = GraspSelector().analyze(capture).scene  # over the plane under the target
    points = scene.points.astype(np.float64)
    for candidate in found.candidates:
        T = candidate.T_base_gripper
        for name, back_m in (
            ("visible_clearance", 0.0),
            ("occluded_clearance", 0.0),
            ("approach_clearance", 0.15),
        ):
            said = candidate.checks[name]
            if said.nearest_point_m is None:
                assert said.value == 0.5 and said.object is None
                continue
            assert box_to_point(T, said.nearest_point_m, back_m) == pytest.approx(
                said.value, abs=1e-5
            )
        seen_there = candidate.checks["visible_clearance"]
        if seen_there.nearest_point_m is not None:
            away = np.linalg.norm(points - seen_there.nearest_point_m, axis=1)
            assert away.min() < 1e-5
            assert seen_there.object == scene.object_numbers[int(np.argmin(away))]
        lowest = candidate.checks["plane_clearance"]
        assert lowest.nearest_point_m is not None and lowest.object is None
        height = np.array(lowest.nearest_point_m) @ scene.plane.normal + scene.plane.offset_m
        assert height == pytest.approx(lowest.value, abs=1e-9)
        assert box_to_point(T, lowest.nearest_point_m) < 1e-9
        unseen = candidate.checks["unseen_distance"]
        if unseen.nearest_point_m is not None:  # the center of a cell of 3 cm, or a point
            away_m = box_to_point(T, unseen.nearest_point_m)
            assert unseen.value - 1e-5 <= away_m <= unseen.value + 0.5 * 0.03 * np.sqrt(3) + 1e-5


@pytest.mark.parametrize("seed", SEEDS)
def test_widths_are_the_boxs(seed: int) -> None:
    found = answer(seed)[2]
    x, y, _ = found.box.dimensions_m
    for candidate in found.candidates:
        assert candidate.width_m == (x if candidate.face in (1, 3, 5) else y)


@pytest.mark.parametrize("seed", SEEDS)
def test_distances_are_finite_and_capped(seed: int) -> None:
    for candidate in answer(seed)[2].candidates:
        for value in (
            value_of(candidate),
            value_of(candidate, "unseen_distance"),
            value_of(candidate, "approach_clearance"),
        ):
            assert 0.0 <= value <= 0.5
        assert -0.5 <= value_of(candidate, "plane_clearance") <= 0.5


def test_share_of_unseen_space_does_not_hang_on_rounding() -> None:
    """The default hand grown by 2 cm ends at 10.5 cm, where cells of 3 cm have their centers."""
    steps = (np.arange(-6, 6) + 0.5) * 0.03
    centers = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
    centers = centers[centers[:, 1] > 0]
    hand = np.array([[0.0, 0.0, 1.0, 0.0, 0.11, 0.085, -0.035, 0.035]])
    shares = []
    for off in (-1e-9, 0.0, 1e-9):
        moved = hand + np.array([0.0, off, 0, 0, 0, 0, 0, 0])
        shares.append(filled_fraction(moved, centers, 0.03, 0.02)[0])
    assert max(shares) - min(shares) < 1e-6
    assert shares[1] == pytest.approx(0.5, abs=0.05)


def test_a_wide_target_asks_and_says_so() -> None:
    """A cereal box seen end on is 20 cm across and 15 cm deep: no way round it."""
    found = GraspSelector({"gripper": {"max_opening_m": 0.03}}).select(
        seen(laid(item("green_cube", 0.85, 0.0)), 0)
    )
    assert found.status == "ask"
    assert all("width" in failed(o) for o in found.candidates)
    assert found.refusal is not None
    assert "width" in [reason.check for reason in found.refusal.violations]


def test_a_gripper_at_the_table_is_refused_there() -> None:
    """A 2 cm pack: from the side the 7 cm thick hand would lie in the table."""
    found = GraspSelector().select(seen(laid(item("cigarettes", 0.85, 0.0)), 0))
    for candidate in found.candidates:
        if candidate.face <= 3:
            assert value_of(candidate, "plane_clearance") < 0
            assert "plane_clearance" in failed(candidate)
        else:
            assert value_of(candidate, "plane_clearance") == pytest.approx(0.02 - 0.01, abs=0.004)
    assert found.grasp is not None and found.grasp.face in (4, 5)


def test_a_cube_before_a_tube_blocks_its_foot_alone() -> None:
    """The hand from the front would sit in the cube low down, and pass over it at the top."""
    scene = laid(item("crisps_tube", 0.95, 0.0), item("green_cube", 0.84, 0.0))
    found = GraspSelector().select(seen(scene, 0))
    foot, top = found.candidate(4), found.candidate(6)
    assert value_of(foot) == 0.0 and value_of(foot, "approach_clearance") == 0.0
    assert foot.checks["visible_clearance"].object == 1
    assert {"visible_clearance", "occluded_clearance", "approach_clearance"} <= failed(foot)
    assert [reason.check for reason in foot.rejections].count("visible_clearance") == 1
    truth = candidate_truth(scene, poses(found))
    assert value_of(top) == pytest.approx(truth.clearance_m[5], abs=0.004)
    assert value_of(top) > 0.05 and value_of(top, "approach_clearance") > 0.05
    assert found.grasp is None or found.grasp.label != 4


def test_a_floating_lamp_blocks_the_way_down_and_is_named() -> None:
    scene = laid(item("green_cube", 0.85, 0.0), item("lamp_wide", 0.85, 0.02, 0.0, 0.30))
    capture = seen(scene, 0)
    found = GraspSelector().select(capture)
    truth = candidate_truth(scene, poses(found))
    top = [k for k, o in enumerate(found.candidates) if o.face >= 4]
    assert (truth.approach_clearance_m[top] == 0).all()
    for k in top:
        assert not found.candidates[k].passed
        assert value_of(found.candidates[k], "approach_clearance") <= 0.02
    assert TABLE_M < 1.0


def test_thresholds_are_the_configured_ones() -> None:
    capture = answer(3, True)[1]
    strict = GraspSelector({"checks": {"visible_clearance_m": 0.2, "noise_gain": 0.0}}).select(
        capture
    )
    loose = GraspSelector({"checks": {"visible_clearance_m": 0.0, "noise_gain": 0.0}}).select(
        capture
    )
    assert len(strict.passing) <= len(loose.passing)
    for a, b in zip(strict.candidates, loose.candidates, strict=True):
        assert value_of(a) == value_of(b)
        assert a.checks["visible_clearance"].limit == 0.2
        assert a.checks["visible_clearance"].passed == (value_of(a) >= 0.2)
        assert b.checks["visible_clearance"].passed


def test_a_target_cut_by_the_border_warns() -> None:
    scene = laid(item("cereal_y", 0.85, 0.0))
    view = scene.view()
    v, u = np.nonzero(view.object_ids == 2)
    left = int(np.median(u))
    K = np.array(scene.intrinsics)
    K[0, 2] -= left
    cut = Capture(
        view.depth[:, left:], K, scene.T_base_camera, target_pixel=(20, int(np.median(v)))
    )
    found = GraspSelector().select(cut)
    assert {"target_cut", "width_y_lower_bound"} <= {warning.code for warning in found.warnings}
    across_y = [o for o in found.candidates if o.face in (2, 4)]
    assert across_y and all("width_known" in failed(o) for o in across_y)
    assert np.isinf(found.box.dimensions_at_most_m[1])
    assert found.box.dimensions_at_most_m[2] == found.box.dimensions_m[2]
    whole = GraspSelector().select(seen(scene))
    assert not whole.warnings
    np.testing.assert_array_equal(whole.box.dimensions_at_most_m, whole.box.dimensions_m)


def test_a_hidden_edge_is_a_lower_bound() -> None:
    """A tall box before the left half of a wide one hides where it ends."""
    scene = laid(item("cereal_y", 0.95, 0.0), item("cereal_x", 0.72, 0.13, 1.5708))
    found = GraspSelector().select(seen(scene))
    truth = 0.20
    if found.box.dimensions_m[1] < truth - 0.01:
        assert "width_y_lower_bound" in {warning.code for warning in found.warnings}
        assert all("width_known" in failed(o) for o in found.candidates if o.face in (2, 4))


class Ceiling(Check):
    """The hand's middle stays under a height; not among the checks that ship."""

    name = "ceiling"

    def __init__(self, height_m: float) -> None:
        self.height_m = height_m

    def evaluate(self, context: CheckContext) -> CheckResult:
        return CheckResult.at_most(context.candidates.T_base_gripper[:, 2, 3], self.height_m)


class Duck:
    """A check by its shape alone."""

    name = "duck"

    def __init__(self, result: Any) -> None:
        self.result = result

    def evaluate(self, context: CheckContext) -> Any:
        return self.result


@pytest.mark.parametrize("seed", range(4))
def test_a_check_of_ones_own_is_judged_told_and_written_like_the_shipped(seed: int) -> None:
    capture, before = answer(seed)[1:]
    heights = sorted(candidate.T_base_gripper[2, 3] for candidate in before.candidates)
    ceiling_m = float(heights[7])
    found = GraspSelector(checks=[*default_checks(), Ceiling(ceiling_m)]).select(capture)
    for own, old in zip(found.candidates, before.candidates, strict=True):
        low = own.T_base_gripper[2, 3] <= ceiling_m
        assert own.checks["ceiling"].passed == low and own.passed == (old.passed and low)
        assert [c for c in own.checks if c != "ceiling"] == list(old.checks)
        reasons = [reason.sentence for reason in own.rejections if reason.check == "ceiling"]
        height = 100 * own.T_base_gripper[2, 3]
        said = f"ceiling: {height:.1f} cm, at most {100 * ceiling_m:.1f} cm"
        assert reasons == ([] if low else [said])
    assert '"ceiling"' in found.to_json()
    assert Selection.from_json(found.to_json()).to_json() == found.to_json()


def test_checks_can_be_left_out() -> None:
    capture, before = answer(1)[1:]
    few = [check for check in default_checks() if check.name != "unseen_fraction"]
    found = GraspSelector({"ranker": "top-down"}, checks=few).select(capture)
    for own, old in zip(found.candidates, before.candidates, strict=True):
        assert list(own.checks) == [name for name in old.checks if name != "unseen_fraction"]
        assert own.passed == (failed(old) <= {"unseen_fraction"})


def test_a_ranker_that_reads_a_check_which_is_not_there_says_so() -> None:
    with pytest.raises(ConfigError, match="reads the check visible_clearance") as caught:
        GraspSelector(checks=[Ceiling(2.0)]).select(answer(1)[1])
    assert "\n" not in str(caught.value)


def test_two_checks_of_one_name_are_refused() -> None:
    with pytest.raises(ConfigError, match="valid: each name once"):
        GraspSelector(checks=[*default_checks(), Ceiling(1.0), Ceiling(2.0)])


@pytest.mark.parametrize(
    ("result", "said"),
    [
        (None, "answered NoneType; valid: a CheckResult"),
        (True, "answered bool; valid: a CheckResult"),
        (CheckResult.yes_no(np.ones(3)), "value has shape \\(3,\\); valid: \\(15,\\)"),
        (CheckResult.at_least(np.full(15, np.nan), 0.0), "value is not finite"),
        (CheckResult.at_least(np.ones(15), np.inf), "limit is not finite"),
    ],
)
def test_a_result_that_does_not_fit_is_refused(result: Any, said: str) -> None:
    selector = GraspSelector(checks=[*default_checks(), Duck(result)])
    with pytest.raises(BoxgraspError, match=f"check duck:? {said}") as caught:
        selector.select(answer(0)[1])
    assert "\n" not in str(caught.value)


def test_a_check_gets_the_local_maps_that_it_needs() -> None:
    found: list[float] = []

    class Coarse(Duck):
        map_resolutions_m = (0.05,)

        def evaluate(self, context: CheckContext) -> CheckResult:
            found.extend(context.local_maps)
            assert context.local_maps[0.05].resolution_m == 0.05
            return CheckResult.yes_no(np.ones(len(context.candidates.label)))

    GraspSelector(checks=[*default_checks(), Coarse(None)]).select(answer(0)[1])
    assert found == [0.03, 0.05]


def test_violations_are_shares_of_the_limits() -> None:
    said = CheckResult.at_least(np.array([0.01, 0.02, 0.05]), 0.04)
    np.testing.assert_allclose(said.violation, [0.75, 0.5, 0.0])
    np.testing.assert_allclose(CheckResult.at_most(np.array([0.5, 0.2]), 0.25).violation, [1, 0])
    np.testing.assert_allclose(CheckResult.at_least(np.array([-0.5, 0]), 0.0).violation, [1, 0])
    np.testing.assert_allclose(CheckResult.yes_no(np.array([True, False])).violation, [0, 1])
