"""Grasps hold something: what is between the fingers, and where a target's own surface is."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from boxgrasp import Capture, GraspSelector, Target, load_capture
from boxgrasp.draw.clouds import base_cloud
from boxgrasp.draw.evidence import held_points
from boxgrasp.geometry.plane import Plane as SupportPlane
from boxgrasp.geometry.transforms import make_transform, rotation_z
from boxgrasp.grasps.candidates import FRONT, Candidates
from boxgrasp.grasps.checks import CheckContext
from boxgrasp.grasps.checks.fingers_free import FingersFree
from boxgrasp.grasps.gripper import Gripper, HandBox
from boxgrasp.grasps.held import points_in_hand
from boxgrasp.grasps.refinement import RefinementParams, moved_to_surface, ways_m
from boxgrasp.kernels.held import steady_depths, surfaces_ahead
from boxgrasp.mapping.unseen_space import NO_MAP_OBSTACLES
from boxgrasp.perception.target import find_target
from boxgrasp.result import Refusal, Selection
from boxgrasp.selector import SceneAnalysis
from boxgrasp.simulate import cast
from boxgrasp.simulate.camera import intrinsics_matrix, look_at
from boxgrasp.simulate.noise import add_noise
from boxgrasp.simulate.primitives import Box, Cylinder, Plane, upright

HAND = Gripper()
PALM = Gripper(
    name="palm and fingers", length_m=0.2, width_m=0.18, thickness_m=0.06, max_opening_m=0.08,
    opening_m=0.07, insertion_depth_m=0.02,
    palm=(HandBox((0.0, 0.13), (-0.09, 0.09), (-0.03, 0.03)),),
    finger=(
        HandBox((0.12, 0.2), (0.04, 0.055), (-0.011, 0.011)),
        HandBox((0.12, 0.16), (0.05, 0.07), (-0.02, 0.02)),
    ),
)  # fmt: skip
FAR_BELOW = SupportPlane(np.array([0.0, 0.0, 1.0]), 5.0)
K = intrinsics_matrix()


def in_hand(T: np.ndarray, points: np.ndarray) -> np.ndarray:
    return np.asarray((points - T[:3, 3]) @ T[:3, :3])


@settings(deadline=None, max_examples=50)
@given(st.integers(0, 2**32 - 1), st.sampled_from((HAND, PALM)))
def test_the_kernels_agree_with_plain_geometry(seed: int, hand: Gripper) -> None:
    rng = np.random.default_rng(seed)
    points = rng.uniform(-0.12, 0.12, (int(rng.integers(0, 400)), 3)).astype(np.float32)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    poses = np.array([make_transform(turn, rng.uniform(-0.05, 0.05, 3)) for _ in range(4)])
    ahead = np.empty((4, 3))
    gap, end = hand.fingers_open_m / 2, hand.length_m / 2
    surfaces_ahead(poses, points, ways_m(hand), np.array((gap, 0.01)), (12, 8, 3), ahead)
    for m, T in enumerate(poses):
        x, y, z = in_hand(T, points.astype(np.float64)).T
        between = np.abs(y) <= gap
        off = 0.035 if hand is HAND else 0.02
        tips = between & (np.abs(x) <= end) & (x >= end - hand.insertion_depth_m - 0.005)
        tips &= np.abs(z) <= min(off, 0.01)
        held, in_fingers = points_in_hand(T, points, hand)
        assert held.tolist() == tips.tolist()
        if hand is HAND:
            beside = (np.abs(y) <= 0.085) & (np.abs(z) <= 0.035)
            inside = beside & ~between & (np.abs(x) <= end)
            finger = np.where(beside & ~between, x, np.inf)
            palm = np.where(beside & between, x + 0.045, np.inf)
        else:  # each finger is 5 mm nearer to the middle than at full opening
            side, depth = np.abs(y) + 0.005, x + end
            pad = (side >= 0.04) & (side <= 0.055) & (np.abs(z) <= 0.011)
            root = (side >= 0.05) & (side <= 0.07) & (np.abs(z) <= 0.02)
            body = (np.abs(y) <= 0.09) & (np.abs(z) <= 0.03)
            inside = (pad & (depth >= 0.12) & (depth <= 0.2)) | (
                (root & (depth >= 0.12) & (depth <= 0.16)) | (body & (depth >= 0) & (depth <= 0.13))
            )
            finger = np.minimum(np.where(pad, x, np.inf), np.where(root, x + 0.04, np.inf))
            palm = np.where(body, x + 0.07, np.inf)
        assert in_fingers.tolist() == (inside & ~tips).tolist()
        expected = [np.nan] * 3
        middle = np.sort(x[between & (np.abs(z) <= 0.01)])
        if len(middle) >= 12:
            expected[0] = middle[8]
        for k, met in ((1, finger), (2, palm)):
            if np.count_nonzero(np.isfinite(met)) > 3:
                expected[k] = np.sort(met)[3]
        np.testing.assert_allclose(ahead[m], expected, atol=1e-7)


def test_fingers_stand_where_the_opening_says() -> None:
    np.testing.assert_allclose(PALM.finger_boxes_m[:, :, 1], [
        (0.035, 0.05), (0.045, 0.065), (-0.05, -0.035), (-0.065, -0.045),
    ])  # fmt: skip
    np.testing.assert_allclose(PALM.between_m, [(0.03, -0.035, -0.02), (0.1, 0.035, 0.02)])
    assert PALM.finger_length_m == pytest.approx(0.07)


def one(T: np.ndarray) -> Candidates:
    """A candidate at a pose."""
    number = np.array([1])
    return Candidates(1, number, number, number, T[None], np.array([0.05]), np.array([0]))


def sheet(x: float, y: tuple[float, float], z: tuple[float, float]) -> np.ndarray:
    """(N, 3) points 3 mm apart on an upright sheet that faces x."""
    a, b = np.meshgrid(np.arange(*y, 0.003), np.arange(*z, 0.003))
    return np.column_stack((np.full(a.size, x), a.ravel(), b.ravel())).astype(np.float32)


def tip_of(found: Candidates) -> float:
    return float(found.T_base_gripper[0, 0, 3] + HAND.half_m[0])


@pytest.mark.parametrize("yaw", [0.0, 1.0])
def test_the_fingertips_go_past_the_surface_and_no_farther(yaw: float) -> None:
    at = make_transform(rotation_z(yaw), np.zeros(3))
    pose = make_transform(np.eye(3), (-0.1, 0.0, 0.0))

    def tips(*parts: np.ndarray) -> float:
        points = (np.vstack(parts) @ at[:3, :3].T).astype(np.float32)
        found = moved_to_surface(one(at @ pose), points, HAND, FAR_BELOW)
        turned = replace(found, T_base_gripper=np.linalg.inv(at) @ found.T_base_gripper)
        assert np.allclose(turned.T_base_gripper[0, 1:3, 3], 0.0, atol=1e-9)
        return tip_of(turned)

    face = sheet(0.05, (-0.03, 0.03), (-0.05, 0.05))
    assert tips(face) == pytest.approx(0.06, abs=1e-6)
    # A part that is as wide as a finger's place keeps the finger before it.
    wide = sheet(0.02, (0.06, 0.08), (-0.03, 0.03))
    assert tips(face, wide) == pytest.approx(0.02 - 0.003, abs=1e-6)
    # A part out of the middle meets the palm, 4.5 cm behind the tips.
    overhang = sheet(-0.02, (-0.03, 0.03), (0.015, 0.03))
    assert tips(face, overhang) == pytest.approx(-0.02 + 0.045, abs=1e-6)
    # A few stray points are no surface; without one the box's face is kept.
    stray = sheet(0.05, (-0.003, 0.003), (-0.003, 0.003))
    assert len(stray) < RefinementParams().least_points and tips(stray) == pytest.approx(0.01)


@settings(deadline=None, max_examples=50)
@given(st.integers(0, 2**32 - 1))
def test_steady_depths_are_those_of_a_naive_search(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.uniform(-0.08, 0.08, (int(rng.integers(0, 300)), 3)).astype(np.float32)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    T = make_transform(turn, rng.uniform(-0.03, 0.03, 3))
    surface, growth = rng.uniform(-0.03, 0.03), rng.uniform(0.0, 0.03)
    found = np.empty(1)
    steady_depths(
        T[None], points, np.array((0.06, 0.01)), np.array([surface]), 0.0025, 4, growth, 12, found
    )
    x, y, z = in_hand(T, points.astype(np.float64)).T
    slab = (np.abs(z) <= 0.01) & (np.abs(y) <= 0.06)

    def width_at(depth: float) -> float:
        own = y[slab & (x - surface < depth)]
        return float(np.ptp(own)) if len(own) else -np.inf

    depths = [0.0025 * k for k in range(4, 13)]
    # Where nothing was met yet (inf less inf), there are no sides to be steady.
    steady = [d for d in depths if width_at(d) - width_at(d - 0.005) <= growth]
    assert found[0] == pytest.approx(steady[0] if steady else 0.01)


@pytest.mark.parametrize("radius_m", [0.03, 0.04, 0.05])
def test_a_cylinder_is_taken_where_its_sides_are_steady(radius_m: float) -> None:
    """A centimeter past its front they run apart by 45 degrees and more."""
    T = make_transform(np.eye(3), (-0.1, 0.0, 0.0))
    angle, z = np.meshgrid(np.arange(-1.5, 1.5, 0.003 / radius_m), np.arange(-0.05, 0.05, 0.003))
    side = np.stack((0.1 - radius_m * np.cos(angle), radius_m * np.sin(angle), z), axis=-1)
    points = side.reshape(-1, 3).astype(np.float32)
    tip = tip_of(moved_to_surface(one(T), points, HAND, FAR_BELOW)) - (0.1 - radius_m)
    aslant = np.arcsin(1 - tip / radius_m)  # of the side at the fingertips, to the approach
    assert np.rad2deg(aslant) < 42 and tip < 0.0301
    # From over a lying one the plane is the limit, if that is nearer.
    low = SupportPlane(np.array([-1.0, 0.0, 0.0]), 0.1 - radius_m + 0.02)
    kept = tip_of(moved_to_surface(one(T), points, HAND, low)) - (0.1 - radius_m)
    assert kept == pytest.approx(min(tip, 0.02 - RefinementParams().plane_gap_m), abs=1e-6)


@pytest.mark.parametrize("seed", [None, 0, 1])
def test_a_neck_is_taken_at_the_neck(seed: int | None) -> None:
    """The shoulders below are wider; a neck's own sides are steady."""
    body = Cylinder(upright(0.8, 0.0, 0.06), 0.04, 0.12, object_id=1)
    neck = Cylinder(upright(0.8, 0.0, 0.145), 0.014, 0.05, object_id=1)
    analysis, _ = analysis_of(body, neck, refine="surface", seed=seed)
    candidates = analysis.context.candidates
    top = (candidates.face >= 4) & (candidates.line == 2)
    tips = candidates.T_base_gripper[top] @ (HAND.half_m[0], 0.0, 0.0, 1.0)
    np.testing.assert_allclose(tips[:, 2], 0.17 - HAND.insertion_depth_m, atol=0.006)


def analysis_of(
    *solids: Box | Cylinder, refine: str, seed: int | None = 0
) -> tuple[SceneAnalysis, GraspSelector]:
    """What is known of target 1 among solids on a table, z = 0."""
    T = look_at((0.1, 0.0, 0.55), (0.8, 0.0, 0.05))
    view = cast([Plane(0.0), *solids], K, T)
    depth = np.array(view.depth)
    if seed is not None:
        depth = add_noise(depth, np.random.default_rng(seed))
    selector = GraspSelector({"candidates": {"refine": refine}})
    return selector.analyze(Capture(depth, K, T), Target(mask=view.object_ids == 1)), selector


def box(x: float, y: float, z: tuple[float, float], size: tuple[float, float]) -> Box:
    at = upright(x, y, (z[0] + z[1]) / 2)
    return Box(at, np.array((*size, z[1] - z[0])), object_id=1)


@pytest.mark.parametrize("seed", [None, 0, 1])
def test_over_a_step_the_box_face_closes_on_air_and_the_surface_is_held(seed: int | None) -> None:
    """A low foot before a post: the upper lines of the box's front face lie 10 cm before it."""
    foot, post = box(0.80, 0.0, (0.0, 0.03), (0.16, 0.06)), box(0.86, 0.0, (0.0, 0.2), (0.04, 0.06))
    for refine, held in (("none", False), ("surface", True)):
        analysis, _ = analysis_of(foot, post, refine=refine, seed=seed)
        candidates, results = analysis.context.candidates, analysis.context.check_results
        upper = (candidates.face == FRONT) & (candidates.line == 3)
        assert results["holds"].passed[upper] == held
        if held:
            tip = candidates.T_base_gripper[upper][0] @ (HAND.half_m[0], 0.0, 0.0, 1.0)
            assert tip[0] == pytest.approx(0.84 + HAND.insertion_depth_m, abs=0.006)


def test_a_plain_box_keeps_its_poses() -> None:
    """Where the surface is the box's face, it moves by no more than the noise."""
    thing = box(0.8, 0.0, (0.0, 0.12), (0.06, 0.08))
    (plain, _), (moved, _) = (analysis_of(thing, refine=r) for r in ("none", "surface"))
    front = plain.context.candidates.face == FRONT
    off = (
        moved.context.candidates.T_base_gripper[:, :3, 3]
        - plain.context.candidates.T_base_gripper[:, :3, 3]
    )
    assert np.abs(off[front]).max() < 0.006
    assert moved.context.check_results["holds"].passed[front].all()


def test_a_grasp_across_a_wider_part_is_refused() -> None:
    """A post on a slab, and a mask of the post alone: its box is narrow, the slab is not.

    As the slab is higher than the fingertips on the lowest line, they would be in it.
    """
    thing = (box(0.8, 0.0, (0.0, 0.06), (0.06, 0.16)), box(0.8, 0.0, (0.06, 0.25), (0.06, 0.06)))
    analysis, _ = analysis_of(*thing, refine="none")
    context = analysis.context
    narrow = replace(context.candidates, width_m=np.full(len(context.candidates.label), 0.06))
    own = analysis.target_points
    surroundings = CheckContext(
        candidates=narrow, gripper=HAND, box=context.box, box_noise_m=np.zeros(3),
        scene=analysis.scene,
        target_mask=own.target_mask, obstacle_mask=own.obstacle_mask,
        local_map=next(iter(context.local_maps.values())), local_maps=context.local_maps,
        map_obstacles=NO_MAP_OBSTACLES, width_known=(True, True),
    )  # fmt: skip
    found = FingersFree(3e-5).evaluate(surroundings)
    front = narrow.face == FRONT
    assert found.passed[front].tolist() == [False, True, True] and found.unit == "m2"
    # What is known to be too wide is told by its width alone.
    told = context.check_results
    assert told["fingers_free"].passed[front].all() and not told["width"].passed[front].any()


def gap_m(points: np.ndarray, others: np.ndarray) -> np.ndarray:
    """(N,) distance from each point to the nearest of others, m."""
    off = points[:, None].astype(np.float64) - others[None]
    return np.asarray(np.sqrt((off**2).sum(axis=2)).min(axis=1))


def shown_as(answer: Selection, label: int) -> Selection:
    """The same answer, with another candidate in its picture."""
    refusal = Refusal("no_candidate_passes", "", label, ())
    return replace(answer, grasp=None, refusal=refusal)


@pytest.mark.parametrize("seed", [None, 0])
def test_pictures_show_the_targets_own_points_between_the_fingertips(seed: int | None) -> None:
    """Its pixels are known and are projected here; a thing 1 cm beside it is never shown."""
    T = look_at((0.1, 0.0, 0.55), (0.8, 0.0, 0.05))
    thing = box(0.8, 0.0, (0.0, 0.12), (0.06, 0.08))
    beside = Box(upright(0.8, 0.08, 0.06), np.array((0.06, 0.06, 0.12)), object_id=2)
    view = cast([Plane(0.0), thing, beside], K, T)
    depth = np.array(view.depth)
    if seed is not None:
        depth = add_noise(depth, np.random.default_rng(seed))
    capture = Capture(depth, K, T)
    answer = GraspSelector().select(capture, Target(mask=view.object_ids == 1))
    v, u = np.nonzero((view.object_ids == 1) & (depth > 0))
    rays = np.column_stack((u, v, np.ones(len(u)))) @ np.linalg.inv(K).T
    own = (rays * depth[v, u, None]) @ T[:3, :3].T + T[:3, 3]
    cloud = base_cloud(capture, T).points
    some = 0
    for candidate in answer.candidates:
        x, y, z = in_hand(candidate.T_base_gripper, own).T
        tips = (x >= HAND.half_m[0] - 0.015) & (x <= HAND.half_m[0])
        expected = own[tips & (np.abs(y) <= HAND.max_opening_m / 2) & (np.abs(z) <= 0.01)]
        shown = held_points(shown_as(answer, candidate.label), cloud)
        assert len(shown) <= len(expected) and len(shown) >= 0.95 * len(expected) - 2
        if len(shown):
            some += 1
            assert gap_m(shown, expected).max() < 1e-5
    assert some >= 6


def test_pictures_of_real_captures_show_what_is_counted(captures_dir: Path) -> None:
    selector, counted = GraspSelector(), 0
    for name, number in itertools.product(("uois_00", "6dofgn_cheezit", "posecnn_02"), (1, 2)):
        capture = load_capture(captures_dir / name)
        if number > len(selector.objects(capture)):
            continue
        analysis = selector.analyze(capture, Target(object=number))
        answer = selector.select(capture, Target(object=number))
        cloud = base_cloud(capture, answer.T_base_camera).points
        own = analysis.scene.points[analysis.target_points.target_mask]
        for candidate in answer.passing:
            held = own[points_in_hand(candidate.T_base_gripper, own, HAND)[0]]
            shown = held_points(shown_as(answer, candidate.label), cloud)
            assert np.count_nonzero(gap_m(held, shown) > 0.005) <= 0.02 * len(held)
            assert np.count_nonzero(gap_m(shown, held) > 0.005) <= 0.05 * len(shown)
            counted += 1
    assert counted >= 5


@pytest.mark.parametrize("spacing_m", [0.003, 0.007])
def test_a_sparse_cloud_is_counted_by_its_spacing(spacing_m: float) -> None:
    """A surface of 20 cm2 is one, whether it was seen by many points or by a few."""
    analysis, _ = analysis_of(box(0.8, 0.0, (0.0, 0.12), (0.06, 0.08)), refine="none")
    y, z = np.meshgrid(np.arange(0.0, 0.05, spacing_m), np.arange(0.0, 0.04, spacing_m))
    points = np.column_stack((np.full(y.size, 0.6), y.ravel(), z.ravel())).astype(np.float32)
    area_m2 = len(points) * analysis.scene.point_area_m2(points)
    assert area_m2 == pytest.approx(20e-4, rel=0.25)
    assert analysis.scene.point_area_m2(points[:1]) >= 9e-6


@pytest.mark.parametrize("moved", ["shrunk", "shifted"])
def test_what_a_ragged_mask_leaves_out_is_no_obstacle(moved: str) -> None:
    """Three pixels of a top that is seen aslant from 1.2 m are 2 cm of it."""
    T = look_at((-0.3, 0.0, 0.5), (0.8, 0.0, 0.1))
    view = cast([Plane(0.0), box(0.8, 0.0, (0.0, 0.10), (0.12, 0.10))], K, T)
    capture = Capture(np.array(view.depth), K, T)
    true = np.asarray(view.object_ids == 1)
    mask = true.copy()
    for axis, by in ((0, 3), (0, -3), (1, 3), (1, -3)):
        mask &= np.roll(true, by, axis)
    if moved == "shifted":
        mask = np.roll(true, (3, 2), (0, 1))
    scene = GraspSelector().scene(capture)
    whole = find_target(scene, capture, Target(mask=true)).target_mask
    found = find_target(scene, capture, Target(mask=mask))
    left = whole & ~found.target_mask
    assert np.count_nonzero(left) > 50
    assert np.count_nonzero(left & found.obstacle_mask) <= 0.02 * np.count_nonzero(left)
