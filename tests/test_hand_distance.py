"""Distances against naive numpy, the simulator's exact solids and dense samples; the scores."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import drawn, seen
from hypothesis import given, settings
from hypothesis import strategies as st

from boxgrasp.geometry import hand_distance
from boxgrasp.geometry.box import Box
from boxgrasp.geometry.transforms import invert, make_transform, rotation_z
from boxgrasp.grasps import scoring
from boxgrasp.grasps.candidates import candidates_of
from boxgrasp.grasps.gripper import Gripper
from boxgrasp.kernels.raycast import BOX
from boxgrasp.kernels.solids import edge_to_solid
from boxgrasp.perception.find_scene import find_scene
from boxgrasp.perception.scene_config import SceneConfig
from boxgrasp.simulate import Box as SolidBox
from boxgrasp.simulate import box_clearance, candidate_truth, true_candidates
from boxgrasp.simulate.distance import boxes_to_solids

HAND = Gripper()
QUICK = settings(max_examples=40, deadline=None, derandomize=True)
SEEDS = st.integers(0, 2**32 - 1)


def poses(rng: np.random.Generator) -> np.ndarray:
    """(15, 4, 4) candidates of a random box, turned anyhow about z."""
    T = make_transform(rotation_z(rng.uniform(-4, 4)), rng.uniform(-0.1, 0.1, 3))
    return candidates_of(Box(T, rng.uniform(0.02, 0.25, 3)), HAND).T_base_gripper


def naive_points(T_base_gripper: np.ndarray, half: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(M, N) distances of points from gripper boxes, in the gripper's own axes."""
    out = []
    for T in T_base_gripper:
        local = (points.astype(np.float64) - T[:3, 3]) @ T[:3, :3]
        out.append(np.linalg.norm(np.maximum(np.abs(local) - half, 0.0), axis=1))
    return np.array(out)


@QUICK
@given(seed=SEEDS, count=st.integers(0, 300), spread=st.sampled_from([0.1, 0.3, 1.5]))
def test_points_equal_the_naive_distances(seed: int, count: int, spread: float) -> None:
    rng = np.random.default_rng(seed)
    T = poses(rng)
    points = rng.normal(0, spread, (count, 3)).astype(np.float32)
    found, nearest = hand_distance.to_points(hand_distance.uprights(T, HAND.half_m), points)
    every = naive_points(T, HAND.half_m, points)
    least = every.min(axis=1, initial=np.inf)
    np.testing.assert_allclose(found, np.minimum(least, 0.5), atol=1e-7)
    for m in range(len(T)):
        if least[m] >= 0.5 + 1e-6:
            assert nearest[m] == -1
        elif least[m] < 0.5 - 1e-6:
            assert every[m, nearest[m]] == pytest.approx(least[m], abs=1e-7)


@QUICK
@given(seed=SEEDS)
def test_columns_equal_exact_segments(seed: int) -> None:
    """A column is an upright segment: against the simulator's segment and box."""
    rng = np.random.default_rng(seed)
    T = poses(rng)
    low = rng.normal(0, 0.25, (25, 3))
    columns = np.column_stack((low, low[:, 2] + rng.choice([0.0, 0.05, 0.4], 25)))
    columns = columns.astype(np.float32)
    found, nearest = hand_distance.to_columns(hand_distance.uprights(T, HAND.half_m), columns)
    for m, pose in enumerate(T):
        T_gripper_base = invert(pose)
        exact = []
        for x, y, a, b in columns.astype(np.float64):
            ends = np.array([(x, y, a), (x, y, b)]) @ T_gripper_base[:3, :3].T
            ends += T_gripper_base[:3, 3]
            exact.append(edge_to_solid(BOX, HAND.half_m, ends[0].copy(), ends[1].copy()))
        assert found[m] == pytest.approx(min(*exact, 0.5), abs=1e-6)
        if nearest[m] >= 0:
            assert exact[nearest[m]] == pytest.approx(min(exact), abs=1e-6)


@QUICK
@given(seed=SEEDS, yaw=st.floats(-4, 4), equal=st.booleans())
def test_cells_equal_exact_solids(seed: int, yaw: float, equal: bool) -> None:
    rng = np.random.default_rng(seed)
    T = poses(rng)
    centers = rng.normal(0, 0.25, (12, 3))
    sizes = np.full(12, 0.03) if equal else rng.choice([0.03, 0.07, 0.24], 12)
    boxes = hand_distance.uprights(T, HAND.half_m)
    found, _ = hand_distance.to_cells(boxes, centers, sizes, yaw)
    solids = [
        SolidBox(make_transform(rotation_z(yaw), center), np.full(3, size))
        for center, size in zip(centers, sizes, strict=True)
    ]
    exact = boxes_to_solids(T, 2 * HAND.half_m, solids)
    np.testing.assert_allclose(found, np.minimum(exact, 0.5), atol=1e-6)


def test_cells_bound_their_dense_samples() -> None:
    """No point of a cell is nearer than the cell, and one 2 mm sample is about as near."""
    rng = np.random.default_rng(5)
    T = poses(rng)
    boxes = hand_distance.uprights(T, HAND.half_m)
    steps = np.linspace(-0.035, 0.035, 36)
    grid = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
    for _ in range(8):
        center, yaw = rng.normal(0, 0.2, 3), rng.uniform(-2, 2)
        samples = grid @ rotation_z(yaw).T + center
        sampled, _ = hand_distance.to_points(boxes, samples.astype(np.float32))
        found, _ = hand_distance.to_cells(boxes, center[None], np.array([0.07]), yaw)
        assert (found <= sampled + 1e-6).all()
        assert (sampled <= found + 0.002).all()


@QUICK
@given(seed=SEEDS)
def test_plane_equals_the_lowest_corner(seed: int) -> None:
    rng = np.random.default_rng(seed)
    T = poses(rng)
    normal = rng.normal(0, 0.2, 3) + (0, 0, 1)
    normal /= np.linalg.norm(normal)
    offset = rng.uniform(-0.3, 0.3)
    found = hand_distance.to_plane(hand_distance.uprights(T, HAND.half_m), normal, offset)
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    for m, pose in enumerate(T):
        corners = signs * HAND.half_m @ pose[:3, :3].T + pose[:3, 3]
        lowest = (corners @ normal + offset).min()
        assert found[m] == pytest.approx(np.clip(lowest, -0.5, 0.5), abs=1e-9)


def test_plane_is_signed_and_capped() -> None:
    T = poses(np.random.default_rng(0))
    boxes = hand_distance.uprights(T, HAND.half_m)
    up = np.array([0.0, 0.0, 1.0])
    assert (hand_distance.to_plane(boxes, up, 3.0) == 0.5).all()
    assert (hand_distance.to_plane(boxes, up, -3.0) == -0.5).all()


def test_swept_box_is_the_whole_way_in() -> None:
    rng = np.random.default_rng(1)
    T = poses(rng)
    points = rng.normal(0, 0.3, (40, 3)).astype(np.float32)
    swept = hand_distance.uprights(T, HAND.half_m, 0.15)
    for k in range(len(points)):
        found, _ = hand_distance.to_points(swept, points[k : k + 1])
        ways = []
        for back in np.linspace(0.0, 0.15, 31):
            moved = T.copy()
            moved[:, :3, 3] -= back * T[:, :3, 0]
            ways.append(naive_points(moved, HAND.half_m, points[k : k + 1])[:, 0])
        least = np.min(ways, axis=0)
        assert (found <= np.minimum(least, 0.5) + 1e-7).all()
        assert (np.minimum(least, 0.5) <= found + 0.0026).all()  # ways are 5 mm apart


def test_inside_is_nought_and_nothing_is_the_cap() -> None:
    T = poses(np.random.default_rng(2))
    boxes = hand_distance.uprights(T, HAND.half_m)
    inside, nearest = hand_distance.to_points(boxes, T[:, :3, 3].astype(np.float32))
    assert (inside == 0).all() and (nearest >= 0).all()
    none, nearest = hand_distance.to_points(boxes, np.empty((0, 3), np.float32))
    assert (none == 0.5).all() and (nearest == -1).all()
    none, nearest = hand_distance.to_cells(boxes, np.empty((0, 3)), np.empty(0), 0.3)
    assert (none == 0.5).all() and (nearest == -1).all()
    far = np.array([[0.0, 0.0, 9.0]])
    assert (hand_distance.to_points(boxes, far.astype(np.float32))[0] == 0.5).all()
    assert (hand_distance.to_cells(boxes, far, np.array([0.1]), 0.3)[0] == 0.5).all()
    # A cell that holds the whole gripper: no corner of one lies in the other's border.
    assert (hand_distance.to_cells(boxes, np.zeros((1, 3)), np.array([4.0]), 0.7)[0] == 0).all()


@pytest.mark.parametrize("seed", range(6))
def test_seen_points_are_never_nearer_than_the_true_surfaces(seed: int) -> None:
    """Exact view: distances to its points bound the exact ones, and meet them where all is seen."""
    scene = drawn(seed, (2, 4))
    found = find_scene(seen(scene), (), SceneConfig())
    candidates = true_candidates(scene)
    T_own = scene.target[0].T_base_solid
    local = (found.points - T_own[:3, 3]) @ T_own[:3, :3]
    own = np.all(np.abs(local) < scene.target[0].half_size + 0.004, axis=1)
    boxes = hand_distance.uprights(candidates.T_base_gripper, HAND.half_m)
    measured, _ = hand_distance.to_points(boxes, np.ascontiguousarray(found.points[~own]))
    truth = candidate_truth(scene, candidates.T_base_gripper).clearance_m
    # 3 mm voxels draw a corner in by up to half their diagonal.
    assert (measured >= truth - 0.003).all()
    assert np.median(np.abs(measured - truth)) < 0.02


def test_uprights_stand_for_the_gripper_boxes() -> None:
    """The split into plan and height loses nothing against oriented boxes in space."""
    rng = np.random.default_rng(3)
    T = poses(rng)
    solids = [
        SolidBox(make_transform(rotation_z(rng.uniform(-2, 2)), rng.normal(0, 0.3, 3)), size)
        for size in rng.uniform(0.02, 0.2, (6, 3))
    ]
    plain = box_clearance(T, 2 * HAND.half_m, solids)
    again = []
    for x, y, c, s, along, across, low, high in hand_distance.uprights(T, HAND.half_m):
        R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
        size = np.array([2 * along, 2 * across, high - low])
        pose = make_transform(R, (x, y, (low + high) / 2))
        again.append(box_clearance(pose[None], size, solids)[0])
    np.testing.assert_allclose(again, plain, atol=1e-7)


@pytest.mark.parametrize(
    ("clearance_m", "best_m", "expected"),
    [
        (0.083, 0.083, 1.0),
        (0.028, 0.083, 0.04),
        (0.0, 0.083, 0.0),
        (0.0199, 0.083, 0.0),
        (0.02, 0.083, 0.0),
        (0.04, 0.083, 0.25),
        (0.06, 0.083, 1.0),
        (0.03, 0.03, 1.0),
        (0.025, 0.03, 0.25),
        (0.02, 0.02, 1.0),
        (0.01, 0.01, 0.0),
        (0.0, 0.0, 0.0),
    ],
)
def test_score_of_section_3_4(clearance_m: float, best_m: float, expected: float) -> None:
    assert scoring.THESIS_SCORE([clearance_m], [best_m]) == pytest.approx([expected], abs=1e-12)


def naive_score(d: float, best: float) -> float:
    """The thesis's words, one grasp at a time, in meters."""
    u = min(0.06, best)
    if d < 0.02 or best < 0.02:
        return 0.0
    return 1.0 if d >= u else ((d - 0.02) / (u - 0.02)) ** 2


@QUICK
@given(pairs=st.lists(st.tuples(st.floats(0, 0.5), st.floats(0, 0.5)), min_size=1, max_size=9))
def test_scores_equal_the_naive_reading_and_rise(pairs: list[tuple[float, float]]) -> None:
    d = np.array([min(pair) for pair in pairs])
    best = np.array([max(pair) for pair in pairs])
    found = scoring.THESIS_SCORE(d, best)
    assert found == pytest.approx([naive_score(*pair) for pair in zip(d, best, strict=True)])
    assert ((found >= 0.0) & (found <= 1.0)).all()
    assert (found <= scoring.THESIS_SCORE(np.minimum(d + 0.01, best), best) + 1e-12).all()
    assert scoring.THESIS_SCORE(best, best).tolist() == (best >= 0.02).astype(float).tolist()


def test_categories() -> None:
    pairs = ((0.0, "red"), (0.0199, "red"), (0.02, "yellow"), (0.0599, "yellow"), (0.06, "green"))
    assert [scoring.category(d) for d, _ in pairs] == [name for _, name in pairs]
    assert list(dict.fromkeys(name for _, name in pairs)) == list(scoring.CATEGORIES)
