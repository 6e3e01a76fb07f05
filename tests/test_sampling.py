from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from boxgrasp.errors import ConfigError
from boxgrasp.geometry.transforms import rotation_z
from boxgrasp.grasps.candidates import FRONT, LEFT, RIGHT, TOP_PARALLEL, TOP_PERPENDICULAR
from boxgrasp.mapping.local_map import MappingConfig
from boxgrasp.mapping.ray_insertion import build_local_map
from boxgrasp.ranking.sampling import (
    RESOLUTION_M,
    dense,
    grid,
    portion,
    sampling,
    spiral,
)

SIDES, TOPS = (LEFT, FRONT, RIGHT), (TOP_PARALLEL, TOP_PERPENDICULAR)


def test_counts_of_the_thesis() -> None:
    assert (len(grid(0.07)), len(grid(0.03)), len(dense()), len(spiral())) == (184, 2256, 2256, 184)
    assert [len(portion(grid(), face)) for face in (*SIDES, *TOPS)] == [60, 60, 60, 120, 120]
    assert [len(portion(spiral(), face)) for face in (*SIDES, *TOPS)] == [57, 57, 57, 118, 118]


def test_grid_as_printed_in_the_thesis_has_other_counts() -> None:
    for s, count in ((0.07, 195), (0.03, 2243)):
        across = np.arange(-0.30, 0.30 + 1e-9, s)
        z, y, x = np.meshgrid(np.arange(0, 0.30 + 1e-9, s), across, across, indexing="ij")
        assert (x**2 + y**2 + z**2 <= 0.09 + 1e-12).sum() == count


def test_neighbors_of_the_spiral_are_as_far_as_printed() -> None:
    distance = cKDTree(spiral()).query(spiral(), 2)[0][:, 1]
    assert distance.mean() == pytest.approx(0.0720, abs=5e-5)
    assert distance.min() == pytest.approx(0.0655, abs=5e-5)
    assert distance.max() == pytest.approx(0.0758, abs=5e-5)


def test_spiral_layers_lie_on_their_half_spheres() -> None:
    radii = np.linalg.norm(spiral(), axis=1)
    at = 0
    for radius, count in ((0.075, 6), (0.15, 25), (0.225, 55), (0.30, 98)):
        np.testing.assert_allclose(radii[at : at + count], radius, atol=1e-12)
        at += count
    assert at == len(radii)
    assert (spiral()[:, 2] > 0).all()


@pytest.mark.parametrize("points", [grid(), dense(), spiral()], ids=["grid", "dense", "spiral"])
def test_samples_fill_the_half_sphere_once_and_are_read_only(points: np.ndarray) -> None:
    assert points.dtype == np.float64
    assert (np.linalg.norm(points, axis=1) <= 0.30 + 1e-9).all()
    assert (points[:, 2] >= 0).all()
    assert len(np.unique(points, axis=0)) == len(points)
    with pytest.raises(ValueError, match="read-only"):
        points[0] = 0


@pytest.mark.parametrize("name", ["grid", "dense"])
def test_each_grid_sample_is_the_center_of_its_own_cell(name: str) -> None:
    local = build_local_map([], np.eye(4), MappingConfig(resolution_m=RESOLUTION_M[name]))
    points = sampling(name)
    cells, inside = local.keys(points)
    assert inside.all()
    assert len(np.unique(cells, axis=0)) == len(points)
    np.testing.assert_allclose(local.centers[tuple(cells.T)], points, atol=1e-12)


@settings(deadline=None, derandomize=True)
@given(s=st.floats(0.01, 0.095))
def test_grids_of_any_spacing_are_cell_centers(s: float) -> None:
    # From 9.6 cm on, the layer at z = 0 would hold the support plane too, and is left out.
    config = MappingConfig(resolution_m=s)
    local = build_local_map([], np.eye(4), config)
    cells, inside = local.keys(grid(s))
    assert inside.all()
    np.testing.assert_allclose(local.centers[tuple(cells.T)], grid(s), atol=1e-9)


@pytest.mark.parametrize("points", [grid(), dense(), spiral()], ids=["grid", "dense", "spiral"])
def test_portions_are_one_list_turned_in_the_same_order(points: np.ndarray) -> None:
    for faces, cut_for in ((SIDES, RIGHT), (TOPS, TOP_PERPENDICULAR)):
        base = portion(points, cut_for)
        for face in faces:
            turned = portion(points, face)
            yaw = {LEFT: np.pi, FRONT: -np.pi / 2, TOP_PARALLEL: -np.pi / 2}.get(face, 0.0)
            np.testing.assert_allclose(turned, base @ rotation_z(yaw).T, atol=1e-15)
            np.testing.assert_array_equal(turned[:, 2], base[:, 2])
            assert not turned.flags.writeable
    # In front of the face: left is +y, front is -x, right is -y.
    assert (portion(points, LEFT)[:, 1] > 0).all()
    assert (portion(points, FRONT)[:, 0] < 0).all()
    assert (portion(points, RIGHT)[:, 1] < 0).all()
    assert (np.abs(portion(points, TOP_PERPENDICULAR)[:, 0]) <= 0.15 + 1e-9).all()
    assert (np.abs(portion(points, TOP_PARALLEL)[:, 1]) <= 0.15 + 1e-9).all()


def test_turned_portions_of_a_grid_are_places_of_the_grid() -> None:
    places = {tuple(p) for p in np.round(grid(), 6) + 0.0}
    for face in (*SIDES, *TOPS):
        assert {tuple(p) for p in np.round(portion(grid(), face), 6) + 0.0} <= places


def test_names_of_samplings() -> None:
    assert sampling("grid") is grid()
    assert sampling("spiral") is spiral()
    with pytest.raises(ConfigError, match="^sampling is 'cubes'; valid: grid, spiral, dense$"):
        sampling("cubes")


@pytest.mark.parametrize("value", [0.0, -0.1, float("nan"), float("inf")])
def test_values_that_are_no_lengths_are_refused(value: float) -> None:
    for call in (
        lambda: grid(value),
        lambda: grid(0.07, value),
        lambda: spiral(((value, 5),)),
        lambda: portion(grid(), RIGHT, value),
    ):
        with pytest.raises(ConfigError, match="valid: a positive number of meters"):
            call()


def test_other_faulty_requests_are_refused() -> None:
    for call in (lambda: grid(0.001), lambda: spiral(((0.1, 0),)), lambda: spiral(())):
        with pytest.raises(ConfigError, match="valid: "):
            call()
    for face in (0, 6):
        with pytest.raises(ConfigError, match="valid: 1 to 5"):
            portion(grid(), face)
