from __future__ import annotations

import math
import pickle
from collections.abc import Sequence
from typing import Any

import numpy as np
import octomap
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from boxgrasp.errors import BoxgraspError, ConfigError, MapError
from boxgrasp.geometry.transforms import make_transform, rotation_z
from boxgrasp.kernels import rays
from boxgrasp.kernels.rays import ray_cells_naive
from boxgrasp.mapping.local_map import (
    FREE,
    OCCUPIED,
    UNSEEN,
    Lattice,
    LocalMap,
    MappingConfig,
    local_map_of,
    log_odds,
)
from boxgrasp.mapping.ray_insertion import build_local_map, insert_scans, lattice_transform, mark

Scans = list[tuple[np.ndarray, np.ndarray]]
QUIET = settings(
    deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
RESOLUTIONS = st.one_of(
    st.sampled_from([0.01, 0.02, 0.03, 0.05, 0.07, 0.1]), st.floats(0.01, 0.1, width=64)
)


def by_octomap(
    scans: Sequence[tuple[np.ndarray, Any]],
    lowest: np.ndarray,
    shape: tuple[int, int, int],
    config: MappingConfig,
) -> tuple[np.ndarray, np.ndarray]:
    tree = octomap.OcTree(config.resolution_m)
    tree.setProbHit(config.prob_hit)
    tree.setProbMiss(config.prob_miss)
    tree.setClampingThresMin(config.clamp_min)
    tree.setClampingThresMax(config.clamp_max)
    for points, origin in scans:
        tree.insertPointCloud(
            np.asarray(points, np.float64),
            np.asarray(origin, np.float64),
            maxrange=-1.0,
            discretize=False,
        )
    values, known = np.zeros(shape, np.float32), np.zeros(shape, bool)
    for index in np.ndindex(shape):
        node = tree.search((np.array(index) + lowest + 0.5) * config.resolution_m)
        try:
            values[index] = node.getLogOdds()
            known[index] = True
        except octomap.NullPointerException:
            pass
    return values, known


def assert_equals_octomap(
    scans: Scans, lowest: Any, shape: tuple[int, int, int], config: MappingConfig
) -> None:
    low = np.asarray(lowest)
    expected, expected_known = by_octomap(scans, low, shape, config)
    for threads in (1, 2):
        values, known = insert_scans(scans, Lattice(low, shape), config, threads=threads)
        np.testing.assert_array_equal(known, expected_known)
        np.testing.assert_array_equal(values, expected)
    assert values.dtype == np.float32


def scan(kind: str, r: np.random.Generator, s: float) -> tuple[np.ndarray, np.ndarray]:
    """Points and origin, float32, of one kind of scene round a grid of some ten cells of edge s."""
    n = int(r.integers(1, 900))
    size = s * r.choice([3.0, 10.0, 40.0])
    points, origin = r.normal(0, size, (n, 3)), r.normal(0, size, 3)
    if kind == "lattice":  # corners, edges and centers: every step is a tie
        q = s / r.choice([1, 2, 4])
        points, origin = np.round(points / q) * q, np.round(origin / q) * q
    elif kind == "axis":
        points[np.arange(n), r.integers(0, 3, n)] = 0.0
        points[np.arange(n), r.integers(0, 3, n)] = 0.0
        points += origin
    elif kind == "diagonal":
        points = origin + r.choice([-1.0, 1.0], (n, 3)) * r.integers(1, 40, (n, 1)) * s / 2
    elif kind == "inside":
        origin = r.uniform(-2 * s, 2 * s, 3)
    elif kind == "misses":
        origin = np.array([30 * s, 0, 0]) + r.normal(0, s, 3)
        points = origin + np.abs(points)
    elif kind == "surface":  # what a camera sees: neighbors end near one another
        origin = np.array([-20.0, 3.0, 15.0]) * s + r.normal(0, s, 3)
        across = r.uniform(-8 * s, 8 * s, (8 * n, 2))
        points = np.stack([across[:, 0], across[:, 1], 2 * s * np.sin(across[:, 0] / s)], 1)
        points[:, 2] += np.where(across[:, 1] > 0, 3 * s, 0) + r.normal(0, 0.03 * s, 8 * n)
    elif kind == "far":
        n = min(n, 15)
        towards = r.normal(0, 1, 3)
        towards /= np.linalg.norm(towards)
        origin = -towards * r.uniform(300, 3000) * s
        points = r.normal(0, 6 * s, (n, 3)) + towards * r.choice([0.0, 2000.0]) * s
    elif kind == "short":  # several rays end in the cell they start in, or in the next
        points = origin + r.normal(0, 0.8 * s, (n, 3))
        points[: n // 2] = points[0]
    return points.astype(np.float32), origin.astype(np.float32)


KINDS = ["cloud", "lattice", "axis", "diagonal", "inside", "misses", "surface", "far", "short"]
SLOW_KINDS = {"lattice": 30, "far": 15, "misses": 40, "cloud": 20, "inside": 25, "surface": 50}


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_ray_equals_octomap(kind: str) -> None:
    @settings(parent=QUIET, max_examples=SLOW_KINDS.get(kind, 80))
    @given(
        seed=st.integers(0, 2**32 - 1),
        s=RESOLUTIONS,
        count=st.integers(1, 5),
        lowest=st.tuples(*[st.integers(-9, 2)] * 3),
        shape=st.tuples(*[st.integers(1, 9)] * 3),
        miss=st.sampled_from([0.3, 0.4, 0.45]),
    )
    def check(
        seed: int,
        s: float,
        count: int,
        lowest: tuple[int, int, int],
        shape: tuple[int, int, int],
        miss: float,
    ) -> None:
        r = np.random.default_rng(seed)
        config = MappingConfig(resolution_m=s, prob_miss=miss)
        assert_equals_octomap([scan(kind, r, s) for _ in range(count)], lowest, shape, config)

    check()


@settings(parent=QUIET, max_examples=300)
@given(seed=st.integers(0, 2**32 - 1), s=RESOLUTIONS, few=st.integers(1, 4))
@example(seed=363, s=0.08923727174964195, few=4)  # steps out of its last cell before its length
@example(seed=269, s=0.01, few=2)  # strays over a border that a bundle's true lines do not reach
def test_rays_that_end_on_corners_of_tiny_grids_equal_octomap(
    seed: int, s: float, few: int
) -> None:
    r = np.random.default_rng(seed)
    q = s / r.choice([1, 1, 2])
    points = (r.integers(-2, 3, (few, 3)) * q).astype(np.float32)
    origin = (r.integers(-60, 61, 3) * q).astype(np.float32)
    shape = (int(r.integers(1, 4)), int(r.integers(1, 4)), int(r.integers(1, 4)))
    config = MappingConfig(resolution_m=s)
    assert_equals_octomap([(points, origin)], r.integers(-3, 2, 3), shape, config)


@settings(parent=QUIET, max_examples=60)
@given(seed=st.integers(0, 2**32 - 1), s=st.sampled_from([1 / 16, 1 / 32, 1 / 64]))
def test_ties_that_only_accumulated_rounding_decides_equal_octomap(seed: int, s: float) -> None:
    """Slopes of 1, 2, 4 and 8 on exact numbers: one axis sums t twice where another sums 2 t."""
    r = np.random.default_rng(seed)
    slopes = r.choice([0, 1, 2, 4, 8], (200, 3)) * r.choice([-1, 1], 3)
    origin = -np.sign(slopes.sum(axis=0)) * r.integers(20, 200, 3) * s / 2
    length = r.integers(1, 100, (200, 1))
    points = (origin + slopes * length * s / 2).astype(np.float32)
    towards = np.argmin(np.abs(points).max(axis=1))
    lowest = np.floor(points[towards] / s).astype(int) - 4
    assert_equals_octomap(
        [(points, origin.astype(np.float32))], lowest, (8, 8, 8), MappingConfig(resolution_m=s)
    )


@settings(parent=QUIET, max_examples=25)
@given(
    seed=st.integers(0, 2**32 - 1),
    s=RESOLUTIONS,
    kinds=st.lists(st.sampled_from(KINDS), min_size=1, max_size=5),
    hit=st.floats(0.51, 0.99),
    miss=st.floats(0.01, 0.49),
    clamp_min=st.floats(0.01, 0.45),
    clamp_max=st.floats(0.55, 0.99),
)
def test_mixed_scans_and_any_sensor_model_equal_octomap(
    seed: int,
    s: float,
    kinds: list[str],
    hit: float,
    miss: float,
    clamp_min: float,
    clamp_max: float,
) -> None:
    r = np.random.default_rng(seed)
    config = MappingConfig(
        resolution_m=s, prob_hit=hit, prob_miss=miss, clamp_min=clamp_min, clamp_max=clamp_max
    )
    shape = (int(r.integers(1, 12)), int(r.integers(1, 12)), int(r.integers(1, 12)))
    scans = [scan(kind, r, s) for kind in kinds]
    assert_equals_octomap(scans * int(r.integers(1, 4)), r.integers(-8, 1, 3), shape, config)


@pytest.mark.parametrize("resolution", [0.03, 0.07])
def test_whole_local_map_of_a_camera_view_equals_octomap(resolution: float) -> None:
    r = np.random.default_rng(7)
    eye = np.array([-0.7, 0.1, 0.6])
    towards = r.normal(0, 0.4, (40_000, 3)) + np.array([0.7, 0.0, -0.6])
    table = np.where(towards[:, 2] < -0.2, (-0.05 - eye[2]) / towards[:, 2], 3.0)
    ends = eye + towards * table[:, None]
    block = (np.abs(ends[:, 0]) < 0.3) & (np.abs(ends[:, 1]) < 0.1)
    ends[block] = (eye + towards * 0.8 * table[:, None])[block]
    config = MappingConfig(resolution_m=resolution)
    T = make_transform(rotation_z(0.4), np.array([0.02, -0.01, 0.013]))
    local = build_local_map([(ends.astype(np.float32), eye)], T, config)
    L = lattice_transform(T, resolution)
    x = ends.astype(np.float32).astype(np.float64)
    moved = np.stack(
        [L[a, 0] * x[:, 0] + L[a, 1] * x[:, 1] + L[a, 2] * x[:, 2] + L[a, 3] for a in range(3)], 1
    ).astype(np.float32)
    start = (L[:3, :3] @ eye + L[:3, 3]).astype(np.float32)
    lowest, shape = config.lattice()
    values, known = by_octomap([(moved, start)], lowest, shape, config)
    np.testing.assert_array_equal(local.known, known)
    np.testing.assert_array_equal(local.log_odds, values)
    assert (np.bincount(local.state.ravel(), minlength=3) >= 5).all()  # all three are compared


@settings(parent=QUIET, max_examples=60)
@given(seed=st.integers(0, 2**32 - 1), kind=st.sampled_from(KINDS[:-2]), s=RESOLUTIONS)
def test_marks_equal_the_plain_walk(seed: int, kind: str, s: float) -> None:
    points, origin = scan(kind, np.random.default_rng(seed), s)
    points = points[:120]
    low, shape = np.array([-6, -5, -4]), (11, 9, 10)
    free, occupied = mark(points, origin, Lattice(low, shape), s, np.eye(4))
    expected_free, expected_occupied = np.zeros(shape, np.uint8), np.zeros(shape, np.uint8)
    for p in points:
        end = tuple(math.floor(float(v) * (1.0 / s)) for v in p)
        for cells, flags in (
            (ray_cells_naive(origin, p, s), expected_free),
            ([end], expected_occupied),
        ):
            for cell in cells:
                index = np.subtract(cell, low)
                if (index >= 0).all() and (index < shape).all():
                    flags[tuple(index)] = 1
    np.testing.assert_array_equal(occupied, expected_occupied)
    # A free cell that is occupied too is dropped later: rays that could only mark such are skipped.
    np.testing.assert_array_equal(free & ~occupied, expected_free & ~expected_occupied)
    assert (free <= expected_free).all()


def test_points_outside_octomaps_cube_and_not_finite_are_left_out(
    capfd: pytest.CaptureFixture[str],
) -> None:
    s = 0.01
    good = np.array([[0.05, 0.0, 0.0], [0.02, 0.03, 0.01]], np.float32)
    far = np.array([[400.0, 0, 0], [0, -400.0, 0], [1e30, 0, 0]], np.float32)
    origin = np.array([-0.2, 0.0, 0.0], np.float32)
    config = MappingConfig(resolution_m=s)
    low, shape = np.array([-10, -10, -10]), (20, 20, 20)
    expected = by_octomap([(np.concatenate([good, far]), origin)], low, shape, config)
    bad = np.array([[np.nan, 0, 0], [0, np.inf, 0], [-np.inf, 0, np.nan]], np.float32)
    got = insert_scans([(np.concatenate([bad, good, far]), origin)], Lattice(low, shape), config)
    np.testing.assert_array_equal(got[0], expected[0])
    np.testing.assert_array_equal(got[1], expected[1])
    # An origin out there gives no free space, as in OctoMap; the end points stay.
    away = np.array([1000.0, 0, 0], np.float32)
    expected = by_octomap([(good, away)], low, shape, config)
    got = insert_scans([(good, away)], Lattice(low, shape), config)
    np.testing.assert_array_equal(got[1], expected[1])
    assert got[1].sum() == 2
    capfd.readouterr()


def test_order_of_points_and_threads_change_nothing() -> None:
    r = np.random.default_rng(3)
    points, origin = scan("surface", r, 0.03)
    points = np.concatenate([points + r.normal(0, 0.001, points.shape) for _ in range(12)])
    points = points.astype(np.float32)
    assert len(points) > 40_000  # else one thread does it all
    maps = [
        build_local_map([(p, origin)], np.eye(4), threads=threads)
        for p in (points, points[::-1], r.permutation(points))
        for threads in (1, 2)
    ]
    for other in maps[1:]:
        assert other.log_odds.tobytes() == maps[0].log_odds.tobytes()
        assert other.known.tobytes() == maps[0].known.tobytes()


def test_without_origin_nothing_becomes_free() -> None:
    points = np.array([[0.1, 0.0, 0.2], [0.1, 0.0, 0.2], [5.0, 0.0, 0.0]], np.float32)
    local = build_local_map([(points, None)], np.eye(4))
    assert local.known.sum() == 1
    assert (local.state == OCCUPIED).sum() == 1
    assert (local.state == FREE).sum() == 0


def test_no_scans_and_no_points_leave_all_unseen() -> None:
    for scans in ([], [(np.zeros((0, 3), np.float32), np.zeros(3))]):
        local = build_local_map(scans, np.eye(4))
        assert not local.known.any()
        assert (local.state == UNSEEN).all()
        assert (local.values_at([[0, 0, 0.1], [9, 9, 9]]) == 0.5).all()


def test_a_cell_seen_occupied_for_long_is_free_after_few_free_scans() -> None:
    config = MappingConfig()
    here = np.array([[0.015, 0.015, 0.0]], np.float32)
    behind = np.array([[0.6, 0.015, 0.0]], np.float32)
    eye = np.array([-0.6, 0.015, 0.0])
    # Down from the upper clamp, in steps of a miss, to the 33 % rule: the same after any time.
    climb = log_odds(config.clamp_max) - log_odds(config.free_below)
    bound = math.ceil(climb / -log_odds(config.prob_miss))
    assert bound == 5
    for times in (10, 1000):
        state = []
        for frees in (bound - 1, bound):
            scans = [(here, eye)] * times + [(behind, eye)] * frees
            local = build_local_map(scans, np.eye(4), config)
            state.append(local.values_at([[0.015, 0.015, 0.0]])[0])
        assert state == [0.5, 0.0]


def test_one_free_view_is_free_by_default_and_not_with_octomaps_miss() -> None:
    behind = np.array([[0.6, 0.015, 0.0]], np.float32)
    eye = np.array([-0.6, 0.015, 0.0])
    for miss, value in ((0.3, 0.0), (0.4, 0.5)):
        local = build_local_map([(behind, eye)], np.eye(4), MappingConfig(prob_miss=miss))
        assert local.values_at([[0.015, 0.015, 0.0]])[0] == value


@pytest.mark.parametrize("s", [0.01, 0.02, 0.03, 0.05, 0.07, 0.1])
def test_lattice_lies_above_the_support_and_covers_the_extent(s: float) -> None:
    config = MappingConfig(resolution_m=s)
    local = build_local_map([], np.eye(4), config)
    top = local.lowest + np.array(local.shape) * s
    assert -0.05 < local.lowest[2] <= -0.05 + s + 0.002
    reach = config.half_width_m
    assert (local.lowest[:2] <= -reach + 1e-9).all() and (top[:2] >= reach - 1e-9).all()
    assert 0.49 - 1e-9 <= top[2] < 0.49 + s
    # Horizontal borders and vertical centers are multiples of the resolution.
    np.testing.assert_allclose(np.round(local.lowest[:2] / s) * s, local.lowest[:2], atol=1e-12)
    center = local.lowest[2] + s / 2
    np.testing.assert_allclose(np.round(center / s) * s, center, atol=1e-12)
    if s == 0.03:
        assert local.shape == (24, 24, 18)


def test_table_points_stay_out_of_the_lowest_layer() -> None:
    r = np.random.default_rng(0)
    table = r.uniform(-0.4, 0.4, (20_000, 3))
    table[:, 2] = -0.05 + r.normal(0, 0.0005, len(table))
    for s in (0.02, 0.03, 0.07):
        local = build_local_map(
            [(table.astype(np.float32), np.array([-0.8, 0.0, 0.8]))],
            np.eye(4),
            MappingConfig(resolution_m=s),
        )
        assert (local.state == OCCUPIED).sum() == 0
        assert (local.state[:, :, 0] == FREE).mean() > 0.8


def test_values_state_cells_and_probability_agree() -> None:
    r = np.random.default_rng(1)
    points, origin = scan("surface", r, 0.03)
    local = build_local_map([(points, origin)], np.eye(4))
    assert local.state.dtype == np.uint8
    for state, value in ((FREE, 0.0), (UNSEEN, 0.5), (OCCUPIED, 1.0)):
        centers = local.cells(state)
        assert len(centers) == (local.state == state).sum() > 0
        assert (local.values_at(centers) == value).all()
    assert (local.values_at(local.centers) == local.state.ravel() / 2).all()
    p = local.probability
    assert (p[~local.known] == 0.5).all()
    np.testing.assert_allclose(np.log(p / (1 - p)), local.log_odds, atol=1e-6)
    assert ((p > 0.66) == (local.state == OCCUPIED)).all()
    assert ((p < 0.33) == (local.state == FREE)).all()
    outside = [[-1.0, 0, 0], [0, 0, -0.046], [0, 0, 0.5], [np.nan, 0, 0], [np.inf, 0, 0]]
    values = local.values_at(outside)
    assert values.dtype == np.float32
    assert (values == 0.5).all()


def test_maps_are_frozen_and_pickle() -> None:
    local = build_local_map([(np.ones((3, 3), np.float32) * 0.1, np.zeros(3))], np.eye(4))
    for array in (local.log_odds, local.known, local.state, local.lowest, local.T_base_map):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1
    with pytest.raises(AttributeError):
        local.resolution_m = 1.0  # type: ignore[misc]
    again: LocalMap = pickle.loads(pickle.dumps(local))
    assert (again.state == local.state).all()


def test_kernels_are_compiled_once_whatever_arrays_are_given() -> None:
    points, T = np.full((5, 3), 0.1, np.float32), np.eye(4)
    for writable in (True, False):
        points.setflags(write=writable)
        T.setflags(write=writable)
        for cloud in (points, points.astype(np.float64), np.asfortranarray(points)):
            build_local_map([(cloud, np.array([-1.0, 0, 1])), (cloud, None)], T)
    for kernel in (rays.classify, rays.bundles, rays.walk_rest):
        assert len(kernel.signatures) == 1  # type: ignore[attr-defined]


def test_moving_the_scene_moves_the_map() -> None:
    r = np.random.default_rng(5)
    points, origin = scan("surface", r, 0.03)
    here = build_local_map([(points, origin)], np.eye(4))
    for T in (
        make_transform(rotation_z(np.pi / 2), np.array([0.5, -0.25, 0.75])),
        make_transform(rotation_z(-np.pi), np.array([-4.0, 2.0, 0.0])),
    ):
        moved = (points.astype(np.float64) @ T[:3, :3].T + T[:3, 3]).astype(np.float32)
        there = build_local_map([(moved, T[:3, :3] @ origin + T[:3, 3])], T)
        # Points on a border may round to its other side.
        assert (there.state != here.state).mean() < 0.002


def test_local_map_of_takes_the_thresholds_of_the_configuration() -> None:
    config = MappingConfig(occupied_above=0.8, free_below=0.2)
    lowest, shape = config.lattice()
    values = np.full(shape, log_odds(0.7), np.float32)
    values[0] = log_odds(0.3)
    local = local_map_of(values, np.ones(shape, bool), np.eye(4), config)
    assert (local.state == UNSEEN).all()


@pytest.mark.parametrize(
    "points",
    [np.zeros((3, 2)), np.zeros(3), np.zeros((2, 3, 3)), np.array([["a", "b", "c"]]), [[1j, 0, 0]]],
)
def test_misshapen_points_are_refused(points: Any) -> None:
    with pytest.raises(MapError, match=r"^scan 0: points have shape .*; valid: \(N, 3\) floats$"):
        build_local_map([(points, np.zeros(3))], np.eye(4))


@pytest.mark.parametrize("origin", [[0, 0], [np.nan, 0, 0], [np.inf, 0, 0], np.zeros((1, 3))])
def test_bad_origins_are_refused(origin: Any) -> None:
    with pytest.raises(MapError, match="^scan 0: origin is .*; valid: 3 finite numbers or None$"):
        build_local_map([(np.zeros((1, 3), np.float32), origin)], np.eye(4))


def test_bad_transforms_and_endless_grids_are_refused() -> None:
    with pytest.raises(BoxgraspError, match="T_base_map"):
        build_local_map([], np.diag([1.0, 1.0, -1.0, 1.0]))
    with pytest.raises(ConfigError, match="cells; valid: at most"):
        MappingConfig(resolution_m=0.005, half_width_m=2.0, height_m=2.0).lattice()
