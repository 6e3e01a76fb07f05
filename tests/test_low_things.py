"""Hollow and flat things, holes in the depth and the image's border, against cast truth."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from boxgrasp import Capture, GraspSelector, Target
from boxgrasp.errors import TargetError
from boxgrasp.perception.scene import Scene
from boxgrasp.perception.target import find_target
from boxgrasp.simulate import cast
from boxgrasp.simulate.camera import intrinsics_matrix, look_at
from boxgrasp.simulate.noise import add_noise
from boxgrasp.simulate.primitives import Box, Cylinder, Plane, upright

TABLE_M = 0.80
TABLE_ID = 1
WALL_M = 0.004
Solids = list[Box | Cylinder]
TABLE = (
    Plane(0.0),
    Box(upright(0.9, 0.0, TABLE_M / 2), np.array((1.2, 1.6, TABLE_M)), object_id=TABLE_ID),
)


def block(number: int, at: Sequence[float], size: Sequence[float], yaw: float = 0.0) -> Solids:
    """A box on the table: x, y and perhaps the height of its foot over the table."""
    x, y, z = (*at, 0.0)[:3]
    pose = upright(x, y, TABLE_M + z + size[2] / 2, yaw)
    return [Box(pose, np.array(size), object_id=number)]


def hollow(
    number: int, at: Sequence[float], radius_m: float, height_m: float, floor_m: float = 0.004
) -> Solids:
    """A round thing open to the top: a ring of thin boxes on a disc."""
    parts = 32
    disc = upright(at[0], at[1], TABLE_M + floor_m / 2)
    solids: Solids = [Cylinder(disc, radius_m - WALL_M / 2, floor_m, object_id=number)]
    across = 2.1 * np.pi * radius_m / parts
    for angle in np.arange(parts) * 2 * np.pi / parts:
        foot = (at[0] + radius_m * np.cos(angle), at[1] + radius_m * np.sin(angle))
        solids += block(number, foot, (WALL_M, across, height_m), float(angle))
    return solids


def handle(
    number: int, at: Sequence[float], radius_m: float, height_m: float, angle: float
) -> Solids:
    """The handle of a mug, 4 cm out to one side: two bars and an upright one."""
    out = 0.04
    solids: Solids = []
    for away, low_m, size in (
        (radius_m + out / 2, 0.12 * height_m, (out, 0.01, 0.008)),
        (radius_m + out / 2, 0.85 * height_m, (out, 0.01, 0.008)),
        (radius_m + out, 0.12 * height_m, (0.008, 0.01, 0.8 * height_m)),
    ):
        foot = (at[0] + away * np.cos(angle), at[1] + away * np.sin(angle), low_m)
        solids += block(number, foot, size, angle)
    return solids


def exact_places(solids: Solids, capture: Capture) -> np.ndarray:
    """(H, W, 3) what each pixel of a view truly shows, base frame, m."""
    assert capture.T_base_camera is not None and capture.intrinsics is not None
    depth = cast([*TABLE, *solids], capture.intrinsics, capture.T_base_camera).depth
    v, u = np.indices(depth.shape)
    rays = np.stack((u, v, np.ones_like(u)), axis=-1) @ np.linalg.inv(capture.intrinsics).T
    T = capture.T_base_camera
    return np.asarray(rays * depth[..., None] @ T[:3, :3].T + T[:3, 3])


def viewed(
    solids: Solids, seed: int | None, away_m: float = 0.8, pitch_deg: float = 45.0
) -> tuple[Capture, np.ndarray]:
    """A view of the table round its point (0.85, 0), and (H, W) the object that a pixel shows."""
    pitch = np.deg2rad(pitch_deg)
    place = (0.85 - away_m * np.cos(pitch), 0.0, TABLE_M + away_m * np.sin(pitch))
    T = look_at(place, (0.85, 0.0, TABLE_M))
    K = intrinsics_matrix()
    view = cast([*TABLE, *solids], K, T)
    depth = np.array(view.depth)
    if seed is not None:
        depth = add_noise(depth, np.random.default_rng(seed))
    return Capture(depth, K, T), np.asarray(view.object_ids)


def scene_of(capture: Capture, segmentation: str = "split") -> Scene:
    return GraspSelector({"scene": {"segmentation": segmentation}}).scene(capture)


def named(scene: Scene, capture: Capture, pixel: tuple[int, int]) -> int:
    """Number of the object that a pixel means."""
    own = find_target(scene, capture, Target(pixel=pixel)).target_mask
    numbers = np.unique(scene.object_numbers[own])
    assert len(numbers) == 1
    return int(numbers[0])


def drawn_from(mask: np.ndarray, count: int, seed: int = 0) -> list[tuple[int, int]]:
    """Pixels (u, v) of a mask."""
    v, u = np.nonzero(mask)
    some = np.random.default_rng(seed).choice(len(v), min(count, len(v)), replace=False)
    return [(int(u[k]), int(v[k])) for k in some]


MUGS = {"mug": (0.04, 0.095, 0.004), "bowl": (0.075, 0.06, 0.003), "pot": (0.10, 0.11, 0.006)}


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("kind", MUGS)
@pytest.mark.parametrize("pitch_deg", [40.0, 60.0, 75.0])
def test_a_pixel_in_a_hollow_thing_means_it(kind: str, pitch_deg: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    at = (0.85 + rng.uniform(-0.1, 0.1), rng.uniform(-0.1, 0.1))
    other = block(3, (0.85, at[1] + 0.25), (0.06, 0.08, 0.10), rng.uniform(0, 1.5))
    solids = hollow(2, at, *MUGS[kind]) + other
    capture, truth = viewed(solids, seed, rng.uniform(0.6, 0.9), pitch_deg)
    scene = scene_of(capture)
    assert len(scene.objects) == 2
    numbers = scene.object_image()
    mine = np.bincount(numbers[(truth == 2) & (numbers > 0)]).argmax()
    places = exact_places(solids, capture)
    # The foot of its outside vanishes in the table's noise, its inside does not.
    in_it = np.hypot(places[..., 0] - at[0], places[..., 1] - at[1]) < MUGS[kind][0]
    assert capture.depth is not None
    told = (truth == 2) & (in_it | (places[..., 2] > TABLE_M + 0.015)) & (capture.depth > 0)
    for pixel in drawn_from(told, 60, seed):
        assert named(scene, capture, pixel) == mine
    assert np.count_nonzero(numbers[told] == mine) > 0.95 * np.count_nonzero(told)


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("angle_deg", [-90.0, 90.0, 60.0])
def test_the_table_through_a_handle_is_refused(angle_deg: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    at, size = (0.85, rng.uniform(-0.1, 0.1)), MUGS["mug"][:2]
    solids = hollow(2, at, *MUGS["mug"]) + handle(2, at, *size, np.deg2rad(angle_deg))
    capture, truth = viewed(solids, seed, 0.6)
    scene = scene_of(capture)
    through = enclosed_table(truth)
    assert np.count_nonzero(through) > 100
    assert (scene.object_image()[through] == 0).all()
    for pixel in drawn_from(through, 20):
        with pytest.raises(TargetError, match="on the table"):
            named(scene, capture, pixel)


def enclosed_table(truth: np.ndarray) -> np.ndarray:
    """(H, W) table pixels that pixels of objects enclose, 4 px off them."""
    open_ = np.zeros(truth.shape, dtype=bool)
    open_[0] = open_[-1] = True
    open_[:, 0] = open_[:, -1] = True
    table = truth <= TABLE_ID
    for _ in range(2000):
        wide = open_.copy()
        for axis, by in ((0, 1), (0, -1), (1, 1), (1, -1)):
            wide |= np.roll(open_, by, axis) & table
        if (wide == open_).all():
            break
        open_ = wide
    inside = table & ~open_
    for _ in range(4):
        inside = inside & np.all([np.roll(inside, b, a) for a in (0, 1) for b in (1, -1)], axis=0)
    return np.asarray(inside)
