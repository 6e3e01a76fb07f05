"""Sides of boxes against truth: naive loops, exact solids, symmetry."""

from __future__ import annotations

import math

import numpy as np
import pytest
from helpers import drawn, item, laid, seen
from hypothesis import given, settings
from hypothesis import strategies as st

from boxgrasp import GraspSelector
from boxgrasp.geometry.box import Box
from boxgrasp.geometry.transforms import make_transform, rotation_z
from boxgrasp.kernels.outline import outline_points
from boxgrasp.kernels.side_end import side_end
from boxgrasp.perception.box_sides import PlacedBox, SideParams, place_sides, unplaced
from boxgrasp.perception.scene import REACH_PX, TargetWindow
from boxgrasp.sensing.sensor_model import XTION, SensorModel
from boxgrasp.simulate import TableScene, to_capture, true_box
from boxgrasp.simulate.camera import cast

QUICK = settings(max_examples=30, deadline=None, derandomize=True)
PARAMS = SideParams()
EXACT = SensorModel(noise_floor_m=0.0, noise_growth_per_m=0.0)


def window_of(scene: TableScene, noise_seed: int | None = None) -> TargetWindow:
    """The whole image, with the target's own pixels from the exact view."""
    view = cast(scene.primitives, scene.intrinsics, scene.T_base_camera)
    capture = seen(scene, noise_seed)
    assert capture.depth is not None and capture.intrinsics is not None
    height, width = capture.depth.shape
    v, u = np.mgrid[:height, :width]
    rays = np.stack((u, v, np.ones_like(u)), axis=-1) @ np.linalg.inv(capture.intrinsics).T
    T = scene.T_base_camera
    points = (rays * capture.depth[..., None]) @ T[:3, :3].T + T[:3, 3]
    points[capture.depth == 0] = np.nan
    own = (view.object_ids == scene.target_id) & (capture.depth > 0)
    whole = slice(0, height), slice(0, width)
    return TargetWindow(own, points.astype(np.float32), *whole, (True,) * 4)


def off_box(scene: TableScene, by_m: float = 0.004) -> Box:
    """The true box with each side but the foot too far out by as much as noise pushes it."""
    T, size = true_box(scene)
    grown = size + np.array([2 * by_m, 2 * by_m, by_m])
    return Box(T @ make_transform(np.eye(3), (0.0, 0.0, by_m / 2)), grown)


def placed(scene: TableScene, noise_seed: int | None = None) -> PlacedBox:
    sensor = XTION if noise_seed is not None else EXACT
    window = window_of(scene, noise_seed)
    return place_sides(off_box(scene), window, scene.T_base_camera[:3, 3], sensor)


def naive_outline(
    target: np.ndarray, points: np.ndarray, camera: np.ndarray
) -> list[tuple[float, ...]]:
    """The kernel's rules, pixel by pixel."""
    found = []
    for v, u in zip(*np.nonzero(target), strict=True):
        for dv, du in ((-1, 0), (1, 0), (0, -1), (0, 1)):
            last = points[v, u].astype(float)
            for k in range(1, REACH_PX + 1):
                at = v + k * dv, u + k * du
                inside = 0 <= at[0] < target.shape[0] and 0 <= at[1] < target.shape[1]
                if not inside or target[at]:
                    break
                other = points[at].astype(float)
                if np.isnan(other[2]):
                    continue
                if math.dist(other, last) < PARAMS.same_m:
                    last = other
                    continue
                ray = other - camera
                farther = math.dist(other, camera) > math.dist(last, camera) - PARAMS.nearer_m
                if farther and abs(ray[2]) > 1e-3 * np.linalg.norm(ray):
                    passed = camera + ray * (last[2] - camera[2]) / ray[2]
                    found.append(tuple((last + passed) / 2))
                break
    return found


@QUICK
@given(seed=st.integers(0, 10_000))
def test_outline_is_that_of_a_naive_loop(seed: int) -> None:
    rng = np.random.default_rng(seed)
    shape = (14, 17)
    camera = np.array([0.0, 0.0, 1.0])
    points = rng.uniform(-0.02, 0.02, (*shape, 3)).astype(np.float32)
    points[rng.random(shape) < 0.3] = np.nan
    target = (rng.random(shape) < 0.5) & ~np.isnan(points[..., 2])
    found = np.empty((4 * max(int(target.sum()), 1), 3))
    count = outline_points(target, points, camera, REACH_PX, PARAMS.same_m, PARAMS.nearer_m, found)
    expected = naive_outline(target, points, camera)
    assert count == len(expected)
    np.testing.assert_allclose(
        sorted(map(tuple, found[:count])), sorted(expected) or np.empty((0, 3)), atol=1e-12
    )


def test_outline_of_a_box_lies_on_its_rim() -> None:
    """Half way between the last pixel and the first beyond: on the top's rim to half a pixel."""
    scene = laid(item("green_cube", 0.85, 0.0))
    window = window_of(scene)
    found = np.empty((4 * int(window.target_mask.sum()), 3))
    camera = np.ascontiguousarray(scene.T_base_camera[:3, 3])
    count = outline_points(
        window.target_mask, window.points_m, camera, REACH_PX, PARAMS.same_m, PARAMS.nearer_m, found
    )
    T, size = true_box(scene)
    local = found[:count] - T[:3, 3]
    top = local[local[:, 2] > size[2] / 2 - 0.002]
    far = top[(top[:, 0] > size[0] / 2 - 0.01) & (np.abs(top[:, 1]) < size[1] / 3)]
    pixel_m = np.linalg.norm(camera - T[:3, 3]) / scene.intrinsics[0, 0]
    assert len(far) > 20
    assert np.abs(far[:, 0] - size[0] / 2).max() < 2 * pixel_m
    assert np.abs(np.mean(far[:, 0]) - size[0] / 2) < 1.1 * pixel_m


@pytest.mark.parametrize("noise_m", [0.0008, 0.002, 0.003])
@pytest.mark.parametrize("kind", ["face", "edge", "face and edge", "arc"])
def test_side_end_is_unbiased(kind: str, noise_m: float) -> None:
    """A face, an edge where a surface stops, both, and the front of a cylinder of 4 cm."""
    rng = np.random.default_rng(5)
    offs = []
    for _ in range(30):
        true_m = rng.uniform(-0.001, 0.001)
        depth_m = np.concatenate(
            [
                np.zeros(250 if "face" in kind else 0),
                rng.uniform(0, 0.03, 250 if "edge" in kind else 0),
                0.04 * (1 - np.cos(np.arcsin(rng.uniform(-0.9, 0.9, 400 if kind == "arc" else 0)))),
            ]
        )
        values = true_m - depth_m + rng.normal(0, noise_m, len(depth_m))
        about_m = float(np.sort(values)[-3])  # where all points end: too far out
        end_m = side_end(values, about_m, 0.009, 0.005, 0.015, noise_m)
        offs.append(end_m - true_m)
    assert (
        abs(np.median(offs)) < 0.0003 + 0.25 * noise_m
    )  # all points end at 2 or 3 times the noise
    assert np.percentile(np.abs(offs), 90) < 0.0005 + noise_m


def test_side_end_takes_the_likeliest_of_all_places() -> None:
    """The coarse search finds what a search of every place and every mixture finds."""
    rng = np.random.default_rng(8)
    for _ in range(12):
        noise_m = rng.uniform(0.0006, 0.003)
        values = np.concatenate([
            rng.normal(0, noise_m, rng.integers(0, 200)), -rng.uniform(0, 0.02, 150),
        ])  # fmt: skip
        about_m = float(values.max())
        found = side_end(values, about_m, 0.009, 0.005, 0.015, noise_m)
        places = about_m - 0.009 + 0.00025 * np.arange(57)
        likely = [naive_likelihood(values, about_m, place, noise_m) for place in places]
        chosen = likely[int(np.argmin(np.abs(places - found)))]
        assert chosen > max(likely) - 0.5
    assert math.isnan(side_end(np.array([1.0]), 0.0, 0.009, 0.005, 0.015, 0.001))


def naive_likelihood(values: np.ndarray, about_m: float, place_m: float, noise_m: float) -> float:
    """Log-likelihood of the best mixture that scipy finds, of the shapes as they are defined."""
    from scipy.optimize import nnls
    from scipy.special import ndtr

    edges = about_m - 0.015 + 0.0005 * np.arange(46)
    counts, _ = np.histogram(values, bins=edges)
    off = (edges[:-1] + edges[1:]) / 2 - place_m
    face_m = np.hypot(noise_m, 0.0005 / np.sqrt(12))
    nodes = np.linspace(-3, 3, 13)
    weights = np.exp(-0.5 * nodes**2) / np.exp(-0.5 * nodes**2).sum()
    inside = -off[:, None] - nodes * noise_m
    arc = np.where(inside > 0, 1 / np.sqrt(np.maximum(inside, 0.00025)), 0.0) @ weights
    face = np.exp(-0.5 * (off / face_m) ** 2) / face_m / np.sqrt(2 * np.pi)
    shapes = np.column_stack((face, ndtr(-off / noise_m), arc))
    root = 1 / np.sqrt(counts + 1.0)
    scale = np.linalg.norm(shapes * root[:, None], axis=0)
    shares, _ = nnls(shapes * root[:, None] / np.maximum(scale, 1e-12), counts * root)
    expected = np.maximum(shapes @ (shares / np.maximum(scale, 1e-12)), 0.02)
    return float((counts * np.log(expected) - expected).sum())


@pytest.mark.parametrize("noise_seed", [None, 1, 2])
@pytest.mark.parametrize("name", ["green_cube", "cereal_y", "beans_can", "crisps_tube"])
def test_sides_are_the_thing_s_own(name: str, noise_seed: int | None) -> None:
    scene = laid(item(name, 0.85, 0.0, yaw=0.0))
    box = placed(scene, noise_seed).box
    T, size = true_box(scene)
    np.testing.assert_allclose(box.dimensions_m, size, atol=0.003)
    np.testing.assert_allclose(box.T_base_box[:3, 3], T[:3, 3], atol=0.002)
    assert abs(box.dimensions_m[2] - size[2]) < 0.0006
    np.testing.assert_array_equal(box.T_base_box[:3, :3], T[:3, :3])


def test_a_turned_square_is_not_taken_for_round() -> None:
    """Some turns of a square have the same width at every quarter of a right angle."""
    for turn_deg in np.arange(0.0, 90.0, 7.5):
        scene = laid(item("green_cube", 0.85, 0.0, yaw=float(np.deg2rad(turn_deg))))
        box = placed(scene, 3).box
        np.testing.assert_allclose(box.dimensions_m[:2], true_box(scene)[1][:2], atol=0.004)


def test_noise_tells_how_far_dimensions_are_off() -> None:
    """Of many drawn tables, errors are what the stated deviations say, and most within 3 mm."""
    shares, errors = [], []
    for seed in range(24):
        scene = drawn(seed + 900, (0, 0), "random")
        found = placed(scene, seed)
        off_m = found.box.dimensions_m - true_box(scene)[1]
        errors.append(off_m)
        shares.append(off_m / found.noise_m)
    assert np.mean(np.abs(errors) <= 0.003) > 0.95
    assert np.abs(np.median(errors, axis=0)).max() < 0.0006
    assert np.mean(np.abs(shares) < 3) > 0.97
    assert 0.2 < np.std(shares) < 2.0


@pytest.mark.parametrize("turn_deg", [0.0, 90.0, 33.0])
def test_moved_and_turned_scenes_have_the_same_box(turn_deg: float) -> None:
    scene = laid(item("cereal_y", 0.85, 0.1, yaw=0.3))
    window, box = window_of(scene, 4), off_box(scene)
    camera = scene.T_base_camera[:3, 3]
    here = place_sides(box, window, camera, XTION)
    T = make_transform(rotation_z(np.deg2rad(turn_deg)), (0.4, -0.2, 0.0))
    moved = TargetWindow(
        window.target_mask, (window.points_m @ T[:3, :3].T + T[:3, 3]).astype(np.float32),
        window.rows, window.columns, window.open_sides,
    )  # fmt: skip
    there = place_sides(
        Box(T @ box.T_base_box, box.dimensions_m), moved, T[:3, :3] @ camera + T[:3, 3], XTION
    )
    np.testing.assert_allclose(there.box.dimensions_m, here.box.dimensions_m, atol=0.0006)
    np.testing.assert_allclose(there.box.T_base_box, T @ here.box.T_base_box, atol=0.0006)


def test_a_side_without_evidence_stays() -> None:
    """Too few pixels tell nothing: the box of all points is kept, and its noise says so."""
    scene = laid(item("green_cube", 0.85, 0.0))
    window, box = window_of(scene), off_box(scene)
    few = np.zeros_like(window.target_mask)
    rows, columns = np.nonzero(window.target_mask)
    few[rows[:8], columns[:8]] = True
    alone = TargetWindow(few, np.where(few[..., None], window.points_m, np.float32("nan")),
                         window.rows, window.columns, window.open_sides)  # fmt: skip
    kept = place_sides(box, alone, scene.T_base_camera[:3, 3], XTION)
    np.testing.assert_allclose(kept.box.dimensions_m, box.dimensions_m)
    np.testing.assert_allclose(kept.noise_m[:2], PARAMS.unplaced_m)
    assert unplaced(box).noise_m.tolist() == [PARAMS.unplaced_m] * 3


@pytest.mark.parametrize("yaw_deg", [10.0, 35.0, -25.0])
@pytest.mark.parametrize("noise_seed", [1, 2, 3])
def test_a_turned_box_a_little_narrower_than_the_opening_is_answered(
    yaw_deg: float, noise_seed: int
) -> None:
    """11.5 cm of 12: noise of its sides takes less than what is left."""
    from boxgrasp.simulate.objects import Part, SimulatedObject
    from boxgrasp.simulate.scenes import draw_scene

    size = (0.115, 0.18, 0.14)
    wide = SimulatedObject(
        "wide", "known", (200, 60, 50), (Part("box", size, (0.0, 0.0, size[2] / 2), None),)
    )
    rng = np.random.default_rng(int(yaw_deg) + 100)
    scene = draw_scene(rng, "wide", 0, yaw="random", objects={"wide": wide})
    capture, _ = to_capture(scene, np.random.default_rng(noise_seed))
    selection = GraspSelector().select(capture)
    assert selection.status == "grasp"
    assert abs(min(selection.box.dimensions_m[:2]) - 0.115) < 0.004


def test_the_thesis_s_box_is_left_alone() -> None:
    """`aligned` is round all points, as in section 2-1."""
    scene = laid(item("green_cube", 0.85, 0.0))
    capture = seen(scene, 1)
    found = [
        GraspSelector({"box": {"fit": fit}}).select(capture).box.dimensions_m
        for fit in ("aligned", "yaw")
    ]
    assert found[0][2] - found[1][2] > 0.002  # noise over its top


def test_widths_ask_for_their_own_noise() -> None:
    """The width's limit is the opening less three deviations of that very width."""
    scene = laid(item("cereal_y", 0.85, 0.0))
    analysis = GraspSelector().analyze(seen(scene, 1))
    limits = analysis.context.check_results["width"].limit
    axes = analysis.context.candidates.width_axis
    for axis in (0, 1):
        margin_m = 0.12 - limits[axes == axis]
        assert np.ptp(margin_m) == 0 and 0.0005 < margin_m[0] < 0.006
    for gain in (0.0, 6.0):
        other = GraspSelector({"checks": {"noise_gain": gain}}).analyze(seen(scene, 1))
        np.testing.assert_allclose(
            0.12 - other.context.check_results["width"].limit,
            (0.12 - limits) * gain / 3, atol=1e-12,
        )  # fmt: skip
