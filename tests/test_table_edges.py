"""Strips of a table's own edge and specks are no objects; things at the edge are."""

from __future__ import annotations

import numpy as np
import pytest

from boxgrasp import Capture
from boxgrasp.errors import SceneError
from boxgrasp.geometry.transforms import make_transform
from boxgrasp.perception.find_scene import find_scene
from boxgrasp.perception.scene import Scene
from boxgrasp.perception.scene_config import SceneConfig
from boxgrasp.perception.segmentation import SEGMENTATIONS
from boxgrasp.simulate import Box, Plane, cast
from boxgrasp.simulate.camera import intrinsics_matrix, look_at
from boxgrasp.simulate.noise import NoiseModel, add_noise

TABLE = (0.55, 1.15, -0.35, 0.35)  # x and y of its rim, m; z = 0 on it
GRAY = (120, 120, 120)


def block(x: tuple[float, float], y: tuple[float, float], z: tuple[float, float]) -> Box:
    """A box from its bounds, m."""
    low, high = np.array([x[0], y[0], z[0]]), np.array([x[1], y[1], z[1]])
    return Box(make_transform(np.eye(3), (low + high) / 2), high - low, GRAY, 0)


CAN = block((0.75, 0.81), (-0.03, 0.03), (0.0, 0.10))


def scene_with(*things: Box, segmentation: str = "split", noisy: bool = True) -> Scene:
    """A table that ends in view, a floor 70 cm below, a can, and more."""
    solids = [Plane(-0.7), block(TABLE[:2], TABLE[2:], (-0.03, 0.0)), CAN, *things]
    T = look_at((0.05, 0.0, 0.65), (0.85, 0.0, 0.0))
    depth = cast(solids, intrinsics_matrix(), T).depth
    if noisy:
        depth = add_noise(depth, np.random.default_rng(3), NoiseModel())
    config = SceneConfig(segmentation=segmentation)
    return find_scene(Capture(depth, intrinsics_matrix(), T), (), config)


def has_object_at(scene: Scene, x: float, y: float) -> bool:
    middles = np.array([item.center_m[:2] for item in scene.objects])
    return bool((np.abs(middles - (x, y)).max(axis=1) < 0.03).any())


# An edge curled up by a centimeter: far, left, and a piece of the right one.
STRIPS = {
    "far": block((1.135, 1.15), (-0.2, 0.1), (0.0, 0.012)),
    "left": block((0.7, 1.0), (0.335, 0.35), (0.0, 0.012)),
    "right": block((0.8, 0.86), (-0.35, -0.33), (0.0, 0.013)),
}


@pytest.mark.parametrize("segmentation", SEGMENTATIONS)
@pytest.mark.parametrize("side", STRIPS)
def test_a_strip_of_the_edge_is_no_object(side: str, segmentation: str) -> None:
    found = scene_with(STRIPS[side], segmentation=segmentation)
    assert [has_object_at(found, 0.78, 0.0), len(found.objects)] == [True, 1]
    assert (found.object_numbers == 0).any()  # it stays an obstacle


@pytest.mark.parametrize(("x", "y"), [((0.80, 1.0), (0.15, 0.165)), ((0.62, 0.80), (-0.2, -0.185))])
def test_a_ruler_on_the_table_is_one(x: tuple[float, float], y: tuple[float, float]) -> None:
    found = scene_with(block(x, y, (0.0, 0.012)))
    assert len(found.objects) == 2 and has_object_at(found, np.mean(x), np.mean(y))


@pytest.mark.parametrize("x", [(1.07, 1.14), (0.95, 1.02)])
@pytest.mark.parametrize("y", [(0.27, 0.34), (-0.34, -0.27)])
def test_a_thing_at_the_edge_is_one(x: tuple[float, float], y: tuple[float, float]) -> None:
    found = scene_with(block(x, y, (0.0, 0.05)))
    assert len(found.objects) == 2 and has_object_at(found, np.mean(x), np.mean(y))


def test_what_lies_before_a_hidden_piece_of_table_is_no_edge() -> None:
    """A flat thing beside a tall one: the table beyond is hidden, not absent."""
    tall = block((0.9, 0.95), (0.1, 0.3), (0.0, 0.3))
    flat = block((0.80, 0.89), (0.18, 0.22), (0.0, 0.013))
    assert has_object_at(scene_with(tall, flat), 0.845, 0.20)


@pytest.mark.parametrize("segmentation", ["split", "euclidean"])
def test_a_speck_is_no_object(segmentation: str) -> None:
    speck = block((0.9, 0.904), (0.2, 0.218), (0.05, 0.07))
    cube = block((0.9, 0.93), (0.2, 0.23), (0.0, 0.03))
    assert len(scene_with(speck, segmentation=segmentation, noisy=False).objects) == 1
    assert len(scene_with(cube, segmentation=segmentation, noisy=False).objects) == 2


def test_a_table_with_an_edge_alone_holds_nothing() -> None:
    solids = [Plane(-0.7), block(TABLE[:2], TABLE[2:], (-0.03, 0.0)), *STRIPS.values()]
    T = look_at((0.05, 0.0, 0.65), (0.85, 0.0, 0.0))
    depth = cast(solids, intrinsics_matrix(), T).depth
    with pytest.raises(SceneError):
        find_scene(Capture(depth, intrinsics_matrix(), T), (), SceneConfig())


# Behind the far edge at x = 1.15 m: a screen, a chair's back, and a post beside the table.
BEHIND = {
    "screen": block((1.25, 1.29), (-0.15, 0.15), (-0.3, 0.25)),
    "chair": block((1.25, 1.28), (0.05, 0.20), (0.04, 0.20)),
    "beside": block((0.85, 0.90), (0.42, 0.47), (-0.7, 0.15)),
}


@pytest.mark.parametrize("segmentation", SEGMENTATIONS)
@pytest.mark.parametrize("place", BEHIND)
def test_what_stands_behind_the_table_is_no_object(place: str, segmentation: str) -> None:
    found = scene_with(BEHIND[place], segmentation=segmentation)
    assert [has_object_at(found, 0.78, 0.0), len(found.objects)] == [True, 1]
    assert (found.points[found.object_numbers == 0, 2] > 0.1).any()  # it stays an obstacle


@pytest.mark.parametrize("segmentation", SEGMENTATIONS)
def test_what_stands_on_the_table_behind_a_taller_thing_is_one(segmentation: str) -> None:
    """The tall one hides the foot of the other, and the table behind."""
    tall = block((0.9, 0.95), (-0.22, 0.0), (0.0, 0.15))
    hidden = block((1.02, 1.09), (-0.2, -0.1), (0.0, 0.22))
    found = scene_with(tall, hidden, segmentation=segmentation)
    assert len(found.objects) == 3 and has_object_at(found, 1.06, -0.15)


@pytest.mark.parametrize("segmentation", SEGMENTATIONS)
def test_a_thing_whose_foot_has_no_depth_is_one(segmentation: str) -> None:
    """On black cloth nothing is measured, but the table was seen round it."""
    solids = [Plane(-0.7), block(TABLE[:2], TABLE[2:], (-0.03, 0.0)), CAN]
    T = look_at((0.05, 0.0, 0.65), (0.85, 0.0, 0.0))
    view = cast(solids, intrinsics_matrix(), T)
    depth = view.depth.copy()
    v, u = np.mgrid[: depth.shape[0], : depth.shape[1]]
    x = (u - intrinsics_matrix()[0, 2]) / intrinsics_matrix()[0, 0] * depth
    y = (v - intrinsics_matrix()[1, 2]) / intrinsics_matrix()[1, 1] * depth
    base = np.stack((x, y, depth), -1) @ T[:3, :3].T + T[:3, 3]
    cloth = (np.abs(base[..., 2]) < 0.002) & (np.abs(base[..., :2] - (0.78, 0.0)).max(-1) < 0.09)
    depth[cloth] = 0
    found = find_scene(
        Capture(depth, intrinsics_matrix(), T), (), SceneConfig(segmentation=segmentation)
    )
    assert len(found.objects) == 1 and has_object_at(found, 0.78, 0.0)
