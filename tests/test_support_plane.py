"""The plane that carries the target, on tables of several levels, small desks and steep views.

Every scene is cast, so that the true plane and the true pixels of each thing are known exactly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from helpers import angle_deg

from boxgrasp import Capture, GraspSelector, Target
from boxgrasp.geometry.transforms import invert, make_transform, transform
from boxgrasp.simulate import Box, CastView, Cylinder, Plane, add_noise, cast
from boxgrasp.simulate.camera import SHAPE, intrinsics_matrix
from boxgrasp.simulate.primitives import Primitive, upright

MOST_DEG, MOST_M = 1.5, 0.015
SEEDS = (0, 1, 2)
FLOOR = Plane(0.0)
SPLIT = {"scene": {"segmentation": "split"}}  # planes are told by the same points whatever it is
GROUND = -1  # the number of all that is no thing: floors, tables, boards
K = intrinsics_matrix()


@dataclass(frozen=True, eq=False)
class Layout:
    """What stands where: all that is no thing has the number GROUND, things count from 0.

    Attributes:
        solids: base frame.
        T_base_camera: (4, 4).
        heights_m: z of what carries each thing, m.
    """

    solids: tuple[Primitive, ...]
    T_base_camera: np.ndarray
    heights_m: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class Look:
    """A layout as it was seen."""

    view: CastView
    capture: Capture

    def shown(self, thing: int) -> np.ndarray:
        """(H, W) where a thing was seen with depth."""
        return (self.view.object_ids == thing) & (np.asarray(self.capture.depth) > 0)

    def pixel(self, thing: int) -> tuple[int, int]:
        """(u, v) amid a thing."""
        v, u = np.nonzero(self.shown(thing))
        k = int(np.argmin((u - np.median(u)) ** 2 + (v - np.median(v)) ** 2))
        return int(u[k]), int(v[k])


def look(layout: Layout, seed: int | None, with_pose: bool) -> Look:
    view = cast(layout.solids, K, layout.T_base_camera, SHAPE)
    depth = view.depth if seed is None else add_noise(view.depth, np.random.default_rng(seed))
    return Look(view, Capture(depth, K, layout.T_base_camera if with_pose else None))


def slab(low: tuple[float, float], high: tuple[float, float], top_m: float, thick_m: float) -> Box:
    """A level slab of the ground from one corner to the other, its top at a height."""
    (x0, y0), (x1, y1) = low, high
    center = upright((x0 + x1) / 2, (y0 + y1) / 2, top_m - thick_m / 2)
    return Box(center, np.array([x1 - x0, y1 - y0, thick_m]), object_id=GROUND)


def block(x: float, y: float, foot_m: float, size: tuple[float, float, float], thing: int) -> Box:
    center = upright(x, y, foot_m + size[2] / 2, 0.3 * thing)
    return Box(center, np.array(size), object_id=thing)


def can(x: float, y: float, foot_m: float, thing: int, height_m: float = 0.11) -> Cylinder:
    center = upright(x, y, foot_m + height_m / 2)
    return Cylinder(center, 0.035, height_m, object_id=thing)


def pitched(position_m: tuple[float, float, float], down_deg: float) -> np.ndarray:
    """T_base_camera of a camera that looks along x, down by an angle, 90 degrees included."""
    down = np.deg2rad(down_deg)
    forward = np.array([np.cos(down), 0.0, -np.sin(down)])
    right = np.array([0.0, -1.0, 0.0])
    return make_transform(np.column_stack((right, np.cross(forward, right), forward)), position_m)


def two_tables(gap_m: float) -> Layout:
    """Two tables side by side, the right one higher, two things on each."""
    left, right = 0.70, 0.70 + gap_m
    solids = (
        FLOOR,
        slab((0.4, 0.01), (1.2, 0.75), left, 0.03),
        slab((0.4, -0.75), (1.2, 0.0), right, 0.03),
        can(0.75, 0.15, left, 0),
        block(0.95, 0.30, left, (0.06, 0.10, 0.05), 1),
        can(0.80, -0.15, right, 2),
        block(0.95, -0.32, right, (0.10, 0.06, 0.08), 3),
    )
    return Layout(solids, pitched((0.1, 0.0, 1.35), 42.0), (left, left, right, right))


def small_desk() -> Layout:
    """A desk of 0.5 by 0.4 m and 0.7 m high over a floor that shows more pixels."""
    top = 0.70
    solids = (
        FLOOR,
        slab((0.75, -0.25), (1.15, 0.25), top, 0.03),
        block(0.95, 0.0, 0.0, (0.05, 0.05, 0.67), GROUND),
        can(0.90, 0.10, top, 0),
        block(1.00, -0.10, top, (0.07, 0.05, 0.15), 1),
        block(0.85, -0.05, top, (0.05, 0.08, 0.04), 2),
    )
    return Layout(solids, pitched((0.2, 0.0, 1.50), 45.0), (top,) * 3)


def seen_at(down_deg: float) -> Layout:
    """A table seen from 0.9 m at an angle, three things on it."""
    top, down = 0.70, np.deg2rad(down_deg)
    away = 0.9 if down_deg > 10 else 0.75
    lift = 0.14 if down_deg < 10 else 0.0  # a level camera sees the near table below its axis
    camera = (1.0 - away * np.cos(down), 0.0, top + 0.03 + lift + away * np.sin(down))
    solids = (
        FLOOR,
        slab((0.45, -0.6), (1.55, 0.6), top, 0.03),
        can(0.95, 0.13, top, 0),
        block(1.05, -0.02, top, (0.06, 0.09, 0.06), 1),
        block(0.97, -0.18, top, (0.07, 0.05, 0.13), 2),
    )
    return Layout(solids, pitched(camera, down_deg), (top,) * 3)


def with_board() -> Layout:
    """A board 3 cm high on the table: two things on it, two beside it."""
    top, board = 0.70, 0.73
    solids = (
        FLOOR,
        slab((0.4, -0.6), (1.3, 0.6), top, 0.03),
        slab((0.70, -0.05), (1.00, 0.35), board, 0.03),
        can(0.80, 0.10, board, 0),
        block(0.90, 0.25, board, (0.06, 0.09, 0.04), 1),
        can(0.85, -0.20, top, 2),
        block(0.70, -0.30, top, (0.06, 0.09, 0.06), 3),
    )
    return Layout(solids, pitched((0.1, 0.0, 1.35), 42.0), (board, board, top, top))


def assert_found(layout: Layout, seen: Look) -> None:
    """Every thing's plane, its segment and box; nothing else is listed."""
    selector = GraspSelector(SPLIT)
    numbers = selector.segment(seen.capture)
    measured = np.asarray(seen.capture.depth) > 0
    for number in range(1, int(numbers.max()) + 1):
        own = numbers == number
        assert np.mean(seen.view.object_ids[own] >= 0) > 0.8, f"object {number} is no thing"
    ground = measured & (seen.view.object_ids == GROUND)
    assert np.count_nonzero(numbers[ground]) < 0.002 * np.count_nonzero(ground)
    for thing, height_m in enumerate(layout.heights_m):
        shown = seen.shown(thing)
        u, v = seen.pixel(thing)
        number = int(np.bincount(numbers[shown]).argmax())
        assert number > 0, f"thing {thing} is not found"
        own = numbers == number
        assert np.count_nonzero(own & shown) > 0.75 * np.count_nonzero(shown), f"thing {thing}"
        assert np.count_nonzero(own & ~shown & measured) < 0.1 * np.count_nonzero(shown)
        for target in (Target(pixel=(u, v)), Target(object=number)):
            scene = selector.analyze(seen.capture, target).scene
            T = scene.T_base_camera
            assert T is not None
            plane = scene.plane.moved(layout.T_base_camera @ invert(T))  # the layout's frame
            assert angle_deg(plane.normal, (0, 0, 1)) < MOST_DEG
            at = np.array([_middle(layout, thing)], dtype=np.float32)
            at[0, 2] = height_m
            assert abs(float(plane.heights(at)[0])) < MOST_M
            if scene.frame == "support":  # the frame is that of the surface under the target
                assert angle_deg(scene.plane.normal, (0, 0, 1)) < 1.0
                at = transform(T @ invert(layout.T_base_camera), at)
                assert abs(float(at[0, 2])) < MOST_M


def _middle(layout: Layout, thing: int) -> np.ndarray:
    solid = next(s for s in layout.solids if s.object_id == thing)
    return np.asarray(solid.T_base_solid[:3, 3])


@pytest.mark.parametrize("with_pose", [True, False])
@pytest.mark.parametrize("gap_m", [0.02, 0.03])
@pytest.mark.parametrize("seed", SEEDS)
def test_two_tables_side_by_side(gap_m: float, with_pose: bool, seed: int) -> None:
    layout = two_tables(gap_m)
    assert_found(layout, look(layout, seed, with_pose))


@pytest.mark.parametrize("with_pose", [True, False])
@pytest.mark.parametrize("seed", SEEDS)
def test_small_desk_over_a_larger_floor(with_pose: bool, seed: int) -> None:
    layout = small_desk()
    assert_found(layout, look(layout, seed, with_pose))


@pytest.mark.parametrize("down_deg", [5.0, 15.0, 45.0, 75.0, 90.0])
@pytest.mark.parametrize("seed", SEEDS)
def test_a_camera_without_pose_looks_down_by_any_angle(down_deg: float, seed: int) -> None:
    layout = seen_at(down_deg)
    assert_found(layout, look(layout, seed, with_pose=False))


@pytest.mark.parametrize("with_pose", [True, False])
@pytest.mark.parametrize("seed", SEEDS)
def test_a_board_on_the_table(with_pose: bool, seed: int) -> None:
    layout = with_board()
    assert_found(layout, look(layout, seed, with_pose))


@pytest.mark.parametrize("seed", SEEDS)
def test_a_thing_on_the_board_stands_on_it_and_is_grasped(seed: int) -> None:
    """Its box ends on the board, which is no obstacle; the board is one for what stands beside."""
    layout = with_board()
    seen = look(layout, seed, with_pose=True)
    selector = GraspSelector(SPLIT)
    for thing, height_m in enumerate(layout.heights_m):
        target = Target(pixel=seen.pixel(thing))
        context = selector.analyze(seen.capture, target)
        box = context.context.box
        foot_m = box.T_base_box[2, 3] - box.dimensions_m[2] / 2
        assert foot_m == pytest.approx(height_m, abs=0.005)
        obstacles = context.scene.points[context.target_points.obstacle_mask]
        assert obstacles[:, 2].min() > height_m
        off = np.abs(obstacles[:, :2] - (0.80, 0.20))  # amid the board, where nothing stands
        bare = obstacles[np.all(off < 0.04, axis=1)]
        assert (len(bare) > 5) == (height_m < 0.72)
        np.testing.assert_allclose(bare[:, 2], 0.73, atol=0.012)
    selection = selector.select(seen.capture, Target(pixel=seen.pixel(0)))
    assert selection.status == "grasp"
    assert "second_support" in [warning.code for warning in selection.warnings]


def test_a_plain_table_has_no_second_support() -> None:
    for seed in SEEDS:
        seen = look(seen_at(45.0), seed, with_pose=True)
        assert not GraspSelector(SPLIT).scene(seen.capture).warnings
