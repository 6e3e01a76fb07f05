"""The check's numbers against exact surfaces, and its reasons against its numbers."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from helpers import TABLE_M, drawn, item, laid, seen

from boxgrasp import Capture, GraspSelector, Selection, Target
from boxgrasp.errors import GripperError
from boxgrasp.geometry.transforms import invert, transform
from boxgrasp.kernels.uprights import filled_shares
from boxgrasp.perception.scene import SceneConfig, find_scene
from boxgrasp.perception.target import find_target
from boxgrasp.simulate import TableScene, candidate_truth

SEEDS = range(10)
HALF = np.array([0.11, 0.085, 0.035])


@cache
def answer(seed: int, noise: bool = False) -> tuple[TableScene, Capture, Selection]:
    scene = drawn(seed, (2, 4), "random")
    capture = seen(scene, seed if noise else None)
    return scene, capture, GraspSelector().select(capture)


def poses(found: Selection) -> np.ndarray:
    return np.array([candidate.T_base_gripper for candidate in found.candidates])


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("noise", [False, True])
def test_seen_is_the_distance_to_the_nearest_point_that_is_not_the_targets(
    seed: int, noise: bool
) -> None:
    _, capture, found = answer(seed, noise)
    scene = find_scene(capture, (), SceneConfig())
    others = scene.points[find_target(scene, capture, None).others].astype(np.float64)
    for candidate in found.candidates:
        local = transform(invert(candidate.T_base_gripper), others)
        away = np.linalg.norm(np.maximum(np.abs(local) - HALF, 0), axis=1)
        assert candidate.visible_clearance_m == pytest.approx(
            min(away.min(initial=0.5), 0.5), abs=1e-5
        )


@pytest.mark.parametrize("seed", SEEDS)
def test_numbers_against_exact_surfaces(seed: int) -> None:
    """Seen is never less than to the exact surfaces, and support is the true height."""
    scene, capture, _ = answer(seed)
    own = Target(mask=scene.view().labels == scene.target_label)  # segmentation is not in question
    found = GraspSelector().select(capture, own)
    truth = candidate_truth(scene, poses(found))
    for k, candidate in enumerate(found.candidates):
        # Surfaces hidden from the view may be nearer, seen ones are not farther.
        assert candidate.visible_clearance_m >= truth.clearance_m[k] - 0.003
        assert candidate.plane_clearance_m == pytest.approx(
            min(truth.plane_clearance_m[k], 0.5), abs=0.003
        )
        assert candidate.unseen_distance_m <= candidate.visible_clearance_m + 1e-9


def test_numbers_of_a_lone_neighbor_are_the_true_ones() -> None:
    """A box wall that faces the camera and the gripper: distances within a voxel."""
    scene = laid(item("beans_can", 0.95, 0.0), item("green_cube", 0.83, 0.0))
    found = GraspSelector().select(seen(scene))
    truth = candidate_truth(scene, poses(found))
    near = [k for k, o in enumerate(found.candidates) if o.face >= 4]
    for k in near:
        assert found.candidates[k].visible_clearance_m == pytest.approx(
            truth.clearance_m[k], abs=0.004
        )


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("noise", [False, True])
def test_reasons_follow_the_numbers(seed: int, noise: bool) -> None:
    for candidate in answer(seed, noise)[2].candidates:
        told = candidate.rejected or ""
        assert candidate.rejected is None or told.strip()
        assert "\n" not in told
        assert ("support plane" in told) == (candidate.plane_clearance_m < 0.003)
        assert ("needs 2.3 cm" in told) == (candidate.visible_clearance_m < 0.023)
        assert ("approach:" in told) == (candidate.approach_clearance_m < 0.005)
        wide = candidate.width_m > 0.12 - 0.003
        assert ("wide, opening 12.0 cm" in told) == wide
        assert candidate.fits == (not wide and "width unknown" not in told)
        if candidate.rejected is None:
            assert candidate.fits and candidate.visible_clearance_m >= 0.023
            assert candidate.plane_clearance_m >= 0.003 and candidate.approach_clearance_m >= 0.005


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
            candidate.visible_clearance_m,
            candidate.unseen_distance_m,
            candidate.approach_clearance_m,
        ):
            assert 0.0 <= value <= 0.5
        assert -0.5 <= candidate.plane_clearance_m <= 0.5


def test_share_of_unseen_space_does_not_hang_on_rounding() -> None:
    """The default hand grown by 2 cm ends at 10.5 cm, where cells of 3 cm have their centers."""
    steps = (np.arange(-6, 6) + 0.5) * 0.03
    centers = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
    centers = centers[centers[:, 1] > 0]
    hand = np.array([[0.0, 0.0, 1.0, 0.0, 0.11, 0.085, -0.035, 0.035]])
    shares = []
    for off in (-1e-9, 0.0, 1e-9):
        moved = hand + np.array([0.0, off, 0, 0, 0, 0, 0, 0])
        shares.append(filled_shares(moved, centers, 0.03, 0.02)[0])
    assert max(shares) - min(shares) < 1e-6
    assert shares[1] == pytest.approx(0.5, abs=0.05)


def test_a_wide_target_asks_and_says_so() -> None:
    """A cereal box seen end on is 20 cm across and 15 cm deep: no way round it."""
    found = GraspSelector({"gripper": {"max_opening_m": 0.03}}).select(
        seen(laid(item("green_cube", 0.85, 0.0)), 0)
    )
    assert found.status == "ask"
    assert all("wide, opening 3.0 cm" in (o.rejected or "") for o in found.candidates)
    assert "wide" in str(found.blocking)


def test_a_gripper_at_the_table_is_refused_there() -> None:
    """A 2 cm pack: from the side the 7 cm thick hand would lie in the table."""
    found = GraspSelector().select(seen(laid(item("cigarettes", 0.85, 0.0)), 0))
    for candidate in found.candidates:
        if candidate.face <= 3:
            assert candidate.plane_clearance_m < 0 and "support plane" in str(candidate.rejected)
        else:
            assert candidate.plane_clearance_m == pytest.approx(0.02 - 0.01, abs=0.004)
    assert found.face in (4, 5)


def test_a_cube_before_a_tube_blocks_its_foot_alone() -> None:
    """The hand from the front would sit in the cube low down, and pass over it at the top."""
    scene = laid(item("crisps_tube", 0.95, 0.0), item("green_cube", 0.84, 0.0))
    found = GraspSelector().select(seen(scene, 0))
    foot, top = found.candidate(4), found.candidate(6)
    assert foot.visible_clearance_m == 0.0 and foot.approach_clearance_m == 0.0
    assert "object 1 0.0 cm" in str(foot.rejected) and "approach" in str(foot.rejected)
    truth = candidate_truth(scene, poses(found))
    assert top.visible_clearance_m == pytest.approx(truth.clearance_m[5], abs=0.004)
    assert top.visible_clearance_m > 0.05 and top.approach_clearance_m > 0.05
    assert found.label != 4


def test_a_floating_lamp_blocks_the_way_down_and_is_named() -> None:
    scene = laid(item("green_cube", 0.85, 0.0), item("lamp_wide", 0.85, 0.02, 0.0, 0.30))
    capture = seen(scene, 0)
    found = GraspSelector().select(capture)
    truth = candidate_truth(scene, poses(found))
    top = [k for k, o in enumerate(found.candidates) if o.face >= 4]
    assert (truth.approach_clearance_m[top] == 0).all()
    for k in top:
        assert found.candidates[k].rejected is not None
        assert found.candidates[k].approach_clearance_m <= 0.02
    assert TABLE_M < 1.0


def test_thresholds_are_the_configured_ones() -> None:
    capture = answer(3, True)[1]
    strict = GraspSelector({"checks": {"clearance_m": 0.2}}).select(capture)
    loose = GraspSelector({"checks": {"clearance_m": 0.0, "noise_m": 0.0}}).select(capture)
    assert sum(o.rejected is None for o in strict.candidates) <= sum(
        o.rejected is None for o in loose.candidates
    )
    for a, b in zip(strict.candidates, loose.candidates, strict=True):
        assert a.visible_clearance_m == b.visible_clearance_m
        assert ("needs 20.3 cm" in str(a.rejected)) == (a.visible_clearance_m < 0.203)
        assert "needs 0.0 cm" not in str(b.rejected) or b.visible_clearance_m == 0


def test_fingers_that_cannot_open_past_the_margin_are_refused() -> None:
    selector = GraspSelector({"gripper": {"max_opening_m": 0.01}, "checks": {"width_m": 0.02}})
    with pytest.raises(GripperError, match="max_opening_m") as caught:
        selector.select(answer(0)[1])
    assert "\n" not in str(caught.value)


def test_a_target_cut_by_the_border_warns() -> None:
    scene = laid(item("cereal_y", 0.85, 0.0))
    view = scene.view()
    v, u = np.nonzero(view.labels == 2)
    left = int(np.median(u))
    K = np.array(scene.intrinsics)
    K[0, 2] -= left
    cut = Capture(
        view.depth[:, left:], K, scene.T_base_camera, target_pixel=(20, int(np.median(v)))
    )
    found = GraspSelector().select(cut)
    assert any("border" in warning for warning in found.warnings)
    assert any("lower bound" in warning for warning in found.warnings)
    across_y = [o for o in found.candidates if o.face in (2, 4)]
    assert not any(o.fits for o in across_y)
    assert all("width unknown" in str(o.rejected) for o in across_y if o.width_m < 0.117)
    whole = GraspSelector().select(seen(scene))
    assert not any("border" in w or "lower bound" in w for w in whole.warnings)


def test_a_hidden_edge_is_a_lower_bound() -> None:
    """A tall box before the left half of a wide one hides where it ends."""
    scene = laid(item("cereal_y", 0.95, 0.0), item("cereal_x", 0.72, 0.13, 1.5708))
    found = GraspSelector().select(seen(scene))
    truth = 0.20
    if found.box.dimensions_m[1] < truth - 0.01:
        assert any("lower bound" in warning for warning in found.warnings)
        assert not any(o.fits for o in found.candidates if o.face in (2, 4))
