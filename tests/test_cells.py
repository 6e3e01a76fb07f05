"""Cells of points against scipy's k-d tree and naive loops: clusters, centroids, neighbors."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import drawn, seen
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from boxgrasp.kernels.cells import euclidean_clusters, mean_neighbor_distance, voxel_centroids
from boxgrasp.kernels.nearest import nearest, nearest_counted, nearest_naive

RULE_M = 0.015
QUICK = settings(max_examples=60, deadline=None, derandomize=True)
SEEDS = st.integers(0, 2**32 - 1)


def components(points: np.ndarray, radius_m: float) -> np.ndarray:
    """Connected components of all pairs within the radius, numbered as they are met."""
    pairs = cKDTree(points.astype(np.float64)).query_pairs(radius_m, output_type="ndarray")
    n = len(points)
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    clusters = connected_components(graph, directed=False)[1]
    _, first, inverse = np.unique(clusters, return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first))[inverse]


def same_parts(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether two sets of cluster ids part the points in the same way."""
    pairs = np.unique(np.column_stack((a, b)), axis=0)
    return len(pairs) == len(np.unique(a)) == len(np.unique(b))


@QUICK
@given(
    seed=SEEDS,
    count=st.integers(1, 500),
    spread=st.sampled_from([0.02, 0.06, 0.1, 1.0]),
    radius=st.sampled_from([0.004, RULE_M, 0.05]),
)
def test_clusters_are_the_components_of_the_exact_rule(
    seed: int, count: int, spread: float, radius: float
) -> None:
    points = np.random.default_rng(seed).normal(0, spread, (count, 3)).astype(np.float32)
    np.testing.assert_array_equal(euclidean_clusters(points, radius), components(points, radius))


@pytest.mark.parametrize("seed", range(4))
def test_clusters_of_a_cast_scene_are_exact(seed: int) -> None:
    scene = drawn(seed, (3, 4))
    points, _ = seen(scene, noise_seed=seed).valid_points()
    T = scene.T_base_camera
    base = points @ T[:3, :3].T.astype(np.float32) + T[:3, 3].astype(np.float32)
    over, _ = voxel_centroids(np.ascontiguousarray(base[base[:, 2] > 0.808]), 0.003)
    assert len(over) > 1000
    np.testing.assert_array_equal(euclidean_clusters(over, RULE_M), components(over, RULE_M))


@pytest.mark.parametrize("direction", [(1, 0, 0), (0, 0, 1), (1, 1, 0), (1, -1, 1), (-3, 2, 1)])
def test_the_rule_is_kept_within_a_fraction_of_two_millimeters(
    direction: tuple[int, int, int],
) -> None:
    """Two plates at a gap: one cluster under 1.5 cm, two over it, wherever the cells lie."""
    way = np.array(direction) / np.linalg.norm(direction)
    plate = np.array([(0, x, y) for x in np.arange(6) * 0.004 for y in np.arange(6) * 0.004])
    other = np.cross(way, (0.3, 0.5, 0.8))
    basis = np.column_stack((way, other / np.linalg.norm(other), np.zeros(3)))
    basis[:, 2] = np.cross(basis[:, 0], basis[:, 1])
    plate = plate @ basis.T
    for shift in np.linspace(-0.5, 0.5, 41):
        for gap, clusters in ((RULE_M - 1e-5, 1), (RULE_M + 1e-5, 2)):
            points = np.vstack((plate, plate + gap * way)) + shift * np.array((1.0, 0.7, -0.4))
            assert euclidean_clusters(points.astype(np.float32), RULE_M).max() + 1 == clusters


@QUICK
@given(seed=SEEDS)
def test_clusters_do_not_depend_on_the_order_of_points(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.normal(0, 0.06, (300, 3)).astype(np.float32)
    order = rng.permutation(len(points))
    straight = euclidean_clusters(points, RULE_M)
    shuffled = euclidean_clusters(np.ascontiguousarray(points[order]), RULE_M)
    assert same_parts(straight[order], shuffled)


def test_equal_points_and_one_point() -> None:
    assert euclidean_clusters(np.zeros((1, 3), np.float32), RULE_M).tolist() == [0]
    assert euclidean_clusters(np.ones((500, 3), np.float32), RULE_M).tolist() == [0] * 500
    assert len(euclidean_clusters(np.empty((0, 3), np.float32), RULE_M)) == 0


@QUICK
@given(seed=SEEDS, count=st.integers(1, 2000), voxel=st.sampled_from([0.001, 0.003, 0.02]))
def test_voxel_centroids_are_the_means(seed: int, count: int, voxel: float) -> None:
    points = np.random.default_rng(seed).normal(0, 0.02, (count, 3)).astype(np.float32)
    centroids, member = voxel_centroids(points, voxel)
    cells: dict[tuple[int, ...], list[int]] = {}
    for i, key in enumerate(np.floor(points.astype(np.float64) / voxel).astype(int).tolist()):
        cells.setdefault(tuple(key), []).append(i)
    assert len(centroids) == len(cells)
    for number, rows in enumerate(cells.values()):  # in the order in which they are met
        assert set(member[rows].tolist()) == {number}
        mean = points[rows].astype(np.float64).mean(axis=0)
        np.testing.assert_allclose(centroids[number], mean, atol=1e-7)


@QUICK
@given(seed=SEEDS)
def test_voxels_do_not_depend_on_the_order_of_points(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.normal(0, 0.02, (800, 3)).astype(np.float32)
    order = rng.permutation(len(points))
    straight, _ = voxel_centroids(points, 0.003)
    shuffled, member = voxel_centroids(np.ascontiguousarray(points[order]), 0.003)

    def rows(a: np.ndarray) -> np.ndarray:
        return a[np.lexsort(np.round(a.T, 6))]

    np.testing.assert_allclose(rows(straight), rows(shuffled), atol=1e-6)
    assert (np.abs(shuffled[member] - points[order]) <= 0.003 + 1e-6).all()


@QUICK
@given(
    seed=SEEDS,
    count=st.integers(1, 600),
    neighbors=st.sampled_from([1, 8, 30]),
    reach=st.sampled_from([0.007, 0.03, 0.5]),
)
def test_neighbor_distances_equal_the_tree(
    seed: int, count: int, neighbors: int, reach: float
) -> None:
    points = np.random.default_rng(seed).normal(0, 0.03, (count, 3)).astype(np.float32)
    found = mean_neighbor_distance(points, neighbors, reach)
    tree = cKDTree(points.astype(np.float64))
    away = tree.query(points, k=neighbors + 1, distance_upper_bound=10.0)[0]
    # The first is the point itself; what is farther than the reach, or missing, counts as it.
    expected = np.minimum(away[:, 1:], reach).mean(axis=1)
    np.testing.assert_allclose(found, expected, atol=2e-7)


def test_neighbor_distances_are_the_same_from_one_thread_or_two() -> None:
    """Above 2,000 points a chunk the work is shared."""
    points = np.random.default_rng(0).normal(0, 0.05, (6000, 3)).astype(np.float32)
    tree = cKDTree(points.astype(np.float64))
    expected = np.minimum(tree.query(points, k=9)[0][:, 1:], 0.01).mean(axis=1)
    np.testing.assert_allclose(mean_neighbor_distance(points, 8, 0.01), expected, atol=2e-7)


@QUICK
@given(
    seed=SEEDS,
    count=st.integers(1, 300),
    others=st.integers(1, 300),
    lattice_m=st.sampled_from([0.0, 0.01, 0.1]),
)
def test_the_nearest_is_the_first_of_the_nearest_of_all(
    seed: int, count: int, others: int, lattice_m: float
) -> None:
    """On a lattice many are equally near, and many coordinates are the same."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(0, 0.3, (count + others, 3)).astype(np.float32)
    if lattice_m:
        points = np.round(points / lattice_m).astype(np.float32) * np.float32(lattice_m)
    a, b = np.ascontiguousarray(points[:count]), np.ascontiguousarray(points[count:])
    np.testing.assert_array_equal(nearest(a, b), nearest_naive(a, b))


@pytest.mark.parametrize("apart_m", [0.0, 0.05, 1.0])
def test_few_distances_are_measured_wherever_the_points_lie(apart_m: float) -> None:
    """Among the others, beside them and far from them, a wall among them."""
    rng = np.random.default_rng(0)
    others = rng.uniform(0, 0.3, (20_000, 3)).astype(np.float32)
    others[:10_000, 0] = 0.0
    points = rng.uniform(0, 0.3, (2_000, 3)).astype(np.float32) + np.float32(apart_m)
    found, measured = nearest_counted(points, others)
    assert measured < 150 * len(points)
    np.testing.assert_array_equal(found, nearest_naive(points, others))
