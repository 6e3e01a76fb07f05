from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from boxgrasp.errors import BoxgraspError, ConfigError
from boxgrasp.geometry.transforms import rotation_z
from boxgrasp.grasps.candidates import RIGHT, TOP_PERPENDICULAR
from boxgrasp.mapping.local_map import LocalMap, MappingConfig, local_map_of, log_odds
from boxgrasp.mapping.ray_insertion import build_local_map
from boxgrasp.ranking.features import (
    FACE_FEATURE,
    line_features,
    line_schema,
    normalized,
    single_features,
    single_schema,
)
from boxgrasp.ranking.model_set import SampledScenes
from boxgrasp.ranking.sampling import grid, portion, spiral

BOX = (0.06, 0.18, 0.24)
FACES = (1, 2, 3, 4, 5)


def a_map(seed: int, resolution: float) -> LocalMap:
    r = np.random.default_rng(seed)
    config = MappingConfig(resolution_m=resolution)
    _, shape = config.lattice()
    values = r.choice([log_odds(0.3), np.float32(0), log_odds(0.7)], shape).astype(np.float32)
    return local_map_of(values, r.random(shape) < 0.7, np.eye(4), config)


def single(local: LocalMap, dimensions: Any, points: Any, edge: float | None) -> Any:
    """(P + 3,) of one scene."""
    return single_features(local.values_at(points)[None], [dimensions], edge)[0]


def line(local: LocalMap, dimensions: Any, points: Any, face: int, edge: float | None) -> Any:
    """(p + 4,) of one scene on one face."""
    occupancy = local.values_at(portion(points, face))[None]
    return line_features(occupancy, [dimensions], face, edge)[0]


@pytest.mark.parametrize(
    ("points", "resolution", "side", "top"),
    [(grid(), 0.07, 64, 124), (spiral(), 0.03, 61, 122)],
    ids=["grid", "spiral"],
)
def test_lengths_and_values(points: Any, resolution: float, side: int, top: int) -> None:
    local = a_map(1, resolution)
    features = single(local, BOX, points, 0.24)
    assert features.shape == (187,) and features.dtype == np.float32
    np.testing.assert_array_equal(features[:184], local.values_at(points))
    np.testing.assert_allclose(features[184:], [0.25, 0.75, 1.0])
    assert set(features[:184].tolist()) == {0.0, 0.5, 1.0}
    assert len(single_schema(points)) == 187
    for face in FACES:
        features = line(local, BOX, points, face, 0.24)
        assert len(features) == len(line_schema(points, face)) == (side if face <= 3 else top)
        np.testing.assert_array_equal(features[:-4], local.values_at(portion(points, face)))
        np.testing.assert_allclose(features[-4:-1], [0.25, 0.75, 1.0])
        assert features[-1] == FACE_FEATURE[face] == {1: 0, 2: 0.5, 3: 1, 4: 0, 5: 1}[face]


def test_schemas_name_each_feature_once_and_are_shared_between_faces() -> None:
    schemas = [single_schema(grid()), single_schema(spiral())]
    for points in (grid(), spiral()):
        sides, tops = (
            {line_schema(points, f).hash for f in faces} for faces in ((1, 2, 3), (4, 5))
        )
        assert len(sides) == len(tops) == 1
        schemas += [line_schema(points, RIGHT), line_schema(points, TOP_PERPENDICULAR)]
    for schema in schemas:
        assert len(set(schema.names)) == len(schema.names)
        assert len(schema.hash) == 64 and int(schema.hash, 16) >= 0
    assert len({schema.hash for schema in schemas}) == len(schemas) == 6
    assert schemas[0].names[-3:] == ("depth_x", "width_y", "height_z")
    assert schemas[0].names[0] == "occupancy_x-0.1050_y-0.2450_z+0.0000"
    assert schemas[2].names[-1] == "side_face" and schemas[3].names[-1] == "top_face"


def test_schema_hashes_stay_what_stored_models_expect() -> None:
    assert single_schema(grid()).hash[:12] == "c57a52e1dfe2"
    assert single_schema(spiral()).hash[:12] == "177e9e804690"


def test_what_the_map_does_not_know_is_a_half() -> None:
    nothing = build_local_map([], np.eye(4), MappingConfig(resolution_m=0.07))
    assert (single(nothing, BOX, grid(), 0.24)[:184] == 0.5).all()
    # Samples outside the grid, too.
    config = MappingConfig(resolution_m=0.07, half_width_m=0.14, height_m=0.2)
    lowest, shape = config.lattice()
    small = local_map_of(np.full(shape, 3.0, np.float32), np.ones(shape, bool), np.eye(4), config)
    values = single(small, BOX, grid(), 0.24)[:184]
    _, inside = small.keys(grid())
    assert 0 < inside.sum() < 184
    np.testing.assert_array_equal(values, np.where(inside, 1.0, 0.5))


@settings(deadline=None, derandomize=True)
@given(
    dimensions=st.tuples(*[st.floats(1e-3, 2.0)] * 3),
    edge=st.one_of(st.none(), st.floats(1e-3, 2.0)),
    seed=st.integers(0, 1000),
    face=st.sampled_from(FACES),
)
def test_all_features_lie_between_0_and_1(
    dimensions: tuple[float, float, float], edge: float | None, seed: int, face: int
) -> None:
    local = a_map(seed, 0.07)
    for features in (
        single(local, dimensions, grid(), edge),
        line(local, dimensions, spiral(), face, edge),
    ):
        assert np.isfinite(features).all()
        assert ((features >= 0) & (features <= 1)).all()


def test_a_scene_turned_with_the_face_gives_the_same_line_features() -> None:
    """Obstacles seen from the left face and from the right one are one example to the model."""
    r = np.random.default_rng(2)
    points = np.round(r.uniform(-0.4, 0.4, (300, 3)) / 0.07) * 0.07 + 0.02
    for faces in ((1, 2, 3), (4, 5)):
        seen = []
        for face in faces:
            yaw = {1: np.pi, 2: -np.pi / 2, 4: -np.pi / 2}.get(face, 0.0)
            turned = (points @ rotation_z(yaw).T).astype(np.float32)
            local = build_local_map([(turned, None)], np.eye(4), MappingConfig(resolution_m=0.07))
            seen.append(line(local, BOX, grid(), face, 0.24)[:-1])
        assert (seen[0] == 1).any()
        for other in seen[1:]:
            np.testing.assert_array_equal(other, seen[0])


def test_own_edge_loses_the_scale_and_the_training_sets_edge_keeps_it() -> None:
    small, large = np.array(BOX) / 2, np.array(BOX)
    own = normalized([small, large], None)
    np.testing.assert_array_equal(own[0], own[1])
    first, second = normalized([small, large], 0.24)
    assert (first < second).all()
    assert normalized([[0.5, 0.1, 0.12]], 0.24)[0, 0] == 1.0


def test_many_scenes_at_once_have_the_features_of_each_alone() -> None:
    maps = [a_map(seed, 0.07) for seed in range(3)]
    sizes = np.array([BOX, (0.1, 0.1, 0.1), (0.2, 0.05, 0.3)])
    one = [SampledScenes.of_map(m, size, "grid") for m, size in zip(maps, sizes, strict=True)]
    for edge in (0.24, None):
        whole = single_features(np.concatenate([s.whole for s in one]), sizes, edge)
        alone = [single(m, size, grid(), edge) for m, size in zip(maps, sizes, strict=True)]
        np.testing.assert_array_equal(whole, alone)
        for face in FACES:
            every = line_features(
                np.concatenate([s.portions[face] for s in one]), sizes, face, edge
            )
            alone = [line(m, size, grid(), face, edge) for m, size in zip(maps, sizes, strict=True)]
            np.testing.assert_array_equal(every, alone)


@pytest.mark.parametrize("bad", [(0.1, 0.1), (0.1, 0.1, 0.0), (0.1, -1, 0.1), (np.nan, 1, 1)])
def test_bad_dimensions_are_refused(bad: tuple[float, ...]) -> None:
    with pytest.raises(BoxgraspError, match="valid: three positive meters"):
        normalized([bad], 0.24)


@pytest.mark.parametrize("edge", [0.0, -1.0, float("nan"), float("inf")])
def test_bad_edges_are_refused(edge: float) -> None:
    with pytest.raises(ConfigError, match="largest edge"):
        normalized([BOX], edge)
