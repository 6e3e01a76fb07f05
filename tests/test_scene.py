"""Support plane and objects against cast truth and the references of real captures."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from helpers import CAMERA, TABLE_M, angle_deg, drawn, item, laid, seen
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from boxgrasp import Capture, GraspSelector, load_capture
from boxgrasp.errors import SceneError
from boxgrasp.geometry.transforms import invert, make_transform, transform
from boxgrasp.perception.box_fit import BoxConfig, fit_box
from boxgrasp.perception.find_scene import find_scene
from boxgrasp.perception.over_plane import downsampled
from boxgrasp.perception.scene import Scene
from boxgrasp.perception.scene_config import SceneConfig
from boxgrasp.perception.target import Target, find_target
from boxgrasp.simulate import Plane, TableScene, build_scene, cast, draw_scene, to_capture

SPREAD = (
    item("green_cube", 0.85, 0.0),
    item("crisps_tube", 0.95, 0.22),
    item("cereal_y", 0.70, -0.22, 0.4),
    item("beans_can", 0.75, 0.20),
    item("cigarettes", 0.60, 0.0, 0.7),
)


def scene_of(scene: TableScene, noise_seed: int | None = None, **config: object) -> Scene:
    return find_scene(seen(scene, noise_seed), (), SceneConfig(**config))  # type: ignore[arg-type]


def height_errors(scene: Scene) -> np.ndarray:
    """(5,) heights that the plane gives to points of the true table."""
    at = [(0.85, 0, TABLE_M), *((x, y, TABLE_M) for x in (0.5, 1.2) for y in (-0.5, 0.5))]
    return np.abs(scene.plane.heights(np.array(at, dtype=np.float32)))


# The support plane


@pytest.mark.parametrize("seed", range(12))
def test_plane_of_cast_scenes(seed: int) -> None:
    """Exact depth within 0.05 degrees and 0.5 mm everywhere on the table, noisy within 1 mm."""
    for noise, tilt, height in ((None, 0.05, 0.0005), (seed, 0.1, 0.001)):
        found = scene_of(drawn(seed), noise)
        assert np.linalg.norm(found.plane.normal) == pytest.approx(1.0)
        assert angle_deg(found.plane.normal, (0, 0, 1)) < tilt
        assert height_errors(found).max() < height


@pytest.mark.parametrize("noisy", [False, True])
def test_plane_without_a_transform_is_the_same_plane(noisy: bool) -> None:
    wrong = []
    for seed in range(40):
        scene = drawn(seed)
        given = seen(scene, seed if noisy else None)
        found = find_scene(Capture(given.depth, given.intrinsics), (), SceneConfig())
        assert found.frame == "support"
        assert found.T_base_camera is not None
        # Origin below the camera; x is the optical axis laid on the plane.
        np.testing.assert_allclose(found.T_base_camera[:2, 3], 0, atol=1e-9)
        assert found.T_base_camera[1, 2] == pytest.approx(0, abs=1e-9)
        assert found.T_base_camera[0, 2] > 0
        assert abs(found.plane.offset_m) < 1e-9
        T = scene.T_base_camera
        tilt = angle_deg(found.T_base_camera[2, :3], T[2, :3])
        if tilt > 0.1 or abs(found.T_base_camera[2, 3] - T[2, 3] + TABLE_M) > 0.002:
            wrong.append((seed, round(tilt, 2)))
    assert not wrong


@pytest.mark.parametrize("noise", [None, 0, 1])
def test_the_floor_does_not_carry_the_table(noise: int | None) -> None:
    """A 2 cm pack alone, seen from 1.2 m at a slant with the floor around the table."""
    low = {"position": [-0.3, 0.0, 1.40], "gaze": [0.85, 0.0, 0.85]}
    pack = item("cigarettes", 0.85, 0.05, 0.3)
    found = scene_of(build_scene({"target": pack, "obstacles": [], "camera": low}), noise)
    assert height_errors(found).max() < 0.003
    assert len(found.objects) == 1


def test_a_larger_floor_is_not_the_support() -> None:
    """A camera that sees more floor than table takes the table, which carries the objects."""
    scene = laid(item("green_cube", 0.65, 0.0), item("beans_can", 0.8, 0.15))
    T = make_transform(
        scene.T_base_camera[:3, :3], scene.T_base_camera[:3, 3] + (-0.4, -0.25, 0.25)
    )
    view = cast(scene.primitives, scene.intrinsics, T)
    near = (view.depth > 0) & (view.depth < 5)
    assert np.count_nonzero((view.object_ids == 0) & near) > np.count_nonzero(view.object_ids == 1)
    capture = Capture(np.where(near, view.depth, 0), scene.intrinsics, T)
    found = find_scene(capture, (), SceneConfig(max_range_m=2.5))
    assert height_errors(found).max() < 0.002
    assert len(found.objects) >= 2


@pytest.mark.parametrize(
    "name",
    [
        "uois_00",
        "uois_02",
        "uois_05",
        "uois_08",
        "posecnn_02",
        "posecnn_03",
        "pcl_milk_clorox",
        "6dofgn_cheezit",
    ],
)
def test_plane_of_real_captures(captures_dir: Path, name: str) -> None:
    """Within 1.5 degrees and 1.5 cm of an independent estimate, where the floor is larger too."""
    folder = captures_dir / name
    if not folder.is_dir():
        pytest.skip(f"no capture {folder}")
    reference = json.loads((folder / "reference.json").read_text())
    found = find_scene(load_capture(folder), (), SceneConfig(min_range_m=0.2, max_range_m=2.5))
    assert found.T_base_camera is not None
    plane = found.plane.moved(invert(found.T_base_camera))
    assert angle_deg(plane.normal, reference["table_normal_camera"]) < 1.5
    assert plane.offset_m == pytest.approx(reference["table_distance_m"], abs=0.015)


# Objects


@pytest.mark.parametrize("segmentation", ["split", "euclidean"])
@pytest.mark.parametrize("noise", [None, 0, 1])
def test_every_object_is_found_once(segmentation: str, noise: int | None) -> None:
    scene = laid(*SPREAD)
    found = scene_of(scene, noise, segmentation=segmentation)
    assert len(found.objects) == len(SPREAD)
    assert [o.number for o in found.objects] == [1, 2, 3, 4, 5]
    distances = [o.distance_m for o in found.objects]
    assert distances == sorted(distances)
    eye = scene.T_base_camera[:3, 3]
    for seen_object in found.objects:
        own = found.points[found.object_numbers == seen_object.number]
        assert len(own) == seen_object.points
        assert seen_object.distance_m == pytest.approx(
            float(np.linalg.norm(own.mean(axis=0) - eye)), abs=1e-4
        )
        np.testing.assert_allclose(seen_object.size_m, np.ptp(own, axis=0), atol=1e-6)
        off = [np.hypot(o["x"] - seen_object.center_m[0], o["y"] - seen_object.center_m[1])
               for o in SPREAD]  # fmt: skip
        assert min(off) < 0.05


def test_listed_pixels_lie_on_their_objects() -> None:
    scene = laid(*SPREAD)
    object_ids = scene.view().object_ids
    listed = GraspSelector().objects(seen(scene, 0))
    true = [int(object_ids[o.pixel[1], o.pixel[0]]) for o in listed if o.pixel is not None]
    assert sorted(true) == [2, 3, 4, 5, 6]
    capture = seen(scene, 0)
    found = find_scene(capture, (), SceneConfig())
    for seen_object in listed:
        by_pixel = find_target(found, capture, Target(pixel=seen_object.pixel)).target_mask
        by_number = find_target(found, capture, Target(object=seen_object.number)).target_mask
        np.testing.assert_array_equal(by_pixel, by_number)


@pytest.mark.parametrize("seed", range(6))
def test_euclidean_keeps_the_clusters(seed: int) -> None:
    """Each object is one component of all pairs of voxels within 1.5 cm, and whole."""
    found = scene_of(drawn(seed, (3, 4)), seed, segmentation="euclidean")
    pairs = cKDTree(found.points.astype(np.float64)).query_pairs(0.015, output_type="ndarray")
    n = len(found.points)
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    part = connected_components(graph, directed=False)[1]
    for number in range(1, len(found.objects) + 1):
        (own,) = np.unique(part[found.object_numbers == number])
        assert set(found.object_numbers[part == own].tolist()) == {number}


@pytest.mark.parametrize(
    ("back_m", "noise"),
    [
        (0.0, None),
        (0.0, 0),
        (0.2, 0),
        (0.2, None),
        (0.4, None),
        (0.4, 0),
    ],
)
def test_split_keeps_a_lone_thing_whole(back_m: float, noise: int | None) -> None:
    """From 0.9 to 1.2 m, where a pixel's step over a level top grows past the plan's cells."""
    place = {"position": [0.1 - back_m, 0.0, 1.40], "gaze": [0.85, 0.0, 0.85]}
    for name in ("beans_can", "cereal_x", "cereal_y"):
        spec = {"target": item(name, 0.85, 0.05, 0.3), "obstacles": [], "camera": place}
        found = scene_of(build_scene(spec), noise, segmentation="split")
        assert len(found.objects) == 1, name


def test_split_only_parts_what_euclidean_joins() -> None:
    for seed in range(6):
        split = scene_of(drawn(seed, (3, 4)), seed, segmentation="split")
        whole = scene_of(drawn(seed, (3, 4)), seed, segmentation="euclidean")
        np.testing.assert_array_equal(split.points, whole.points)
        assert len(split.objects) >= len(whole.objects)


def wrong_boxes(segmentation: str, seeds: range) -> list[int]:
    """Seeds of tight scenes where the target's box differs by over 1.5 cm from its own points'."""
    wrong = []
    for seed in seeds:
        scene = draw_scene(np.random.default_rng(seed), obstacles=4, area_m=0.32)
        capture, object_ids = to_capture(scene, np.random.default_rng(seed))
        found = find_scene(capture, (), SceneConfig(segmentation=segmentation))
        assert capture.target_pixel is not None
        truth = Target(mask=object_ids == scene.target_id)
        sizes = [
            fit_box(found.points[find_target(found, capture, target).target_mask], found.plane, 0.0,
                    BoxConfig(fit="aligned")).dimensions_m
            for target in (None, truth)
        ]  # fmt: skip
        if np.abs(sizes[0] - sizes[1]).max() > 0.015:
            wrong.append(seed)
    return wrong


def test_split_has_fewer_wrong_boxes_than_euclidean() -> None:
    """Tight scenes: Euclidean clusters join the target to a neighbor in a good part of them."""
    seeds = range(5000, 5036)
    split, euclidean = wrong_boxes("split", seeds), wrong_boxes("euclidean", seeds)
    assert len(euclidean) >= 4  # else the scenes show nothing
    assert len(split) <= 0.5 * len(euclidean), (split, euclidean)


def test_near_and_far_bound_the_objects_but_not_the_obstacles() -> None:
    scene = laid(*SPREAD)
    every = scene_of(scene)
    distances = [o.distance_m for o in every.objects]
    limit = (distances[2] + distances[3]) / 2
    near, far = scene_of(scene, max_range_m=limit), scene_of(scene, min_range_m=limit)
    assert [o.distance_m for o in near.objects] == pytest.approx(distances[:3], abs=0.002)
    assert [o.distance_m for o in far.objects] == pytest.approx(distances[3:], abs=0.002)
    for bounded in (near, far):
        assert len(bounded.points) == pytest.approx(len(every.points), rel=0.01)
        unnumbered = (np.count_nonzero(s.object_numbers == 0) for s in (bounded, every))
        assert next(unnumbered) > 300 + next(unnumbered)


def test_workspace_bounds_the_objects_but_not_the_obstacles() -> None:
    scene = laid(*SPREAD)
    every = scene_of(scene)
    box = ((2.0, 0.1, 0.0), (0.0, -0.1, 2.0))  # two opposite corners, whichever
    inside = scene_of(scene, workspace_m=box)
    assert len(inside.objects) == 2  # the cube and the cigarettes
    assert all(abs(o.center_m[1]) < 0.1 for o in inside.objects)
    np.testing.assert_array_equal(inside.points, every.points)
    with pytest.raises(SceneError):
        scene_of(scene, workspace_m=((5.0, 5.0, 5.0), (6.0, 6.0, 6.0)))


def test_robot_mask_takes_the_arm_out() -> None:
    scene = laid(*SPREAD)
    view = scene.view()
    arm = view.object_ids == 3
    bare = seen(scene)
    capture = Capture(view.depth, scene.intrinsics, scene.T_base_camera, robot_mask=arm)
    found, every = (find_scene(c, (), SceneConfig()) for c in (capture, bare))
    assert len(found.objects) == len(every.objects) - 1
    tube = np.array([0.95, 0.22])
    assert np.linalg.norm(found.points[:, :2] - tube, axis=1).min() > 0.05
    assert np.linalg.norm(every.points[:, :2] - tube, axis=1).min() < 0.04


def test_points_are_three_millimeter_voxels_over_the_plane() -> None:
    found = scene_of(laid(*SPREAD), 0)
    assert (found.points[:, 2] > TABLE_M + 0.002).all()
    table = transform(invert(found.T_base_table), found.points)
    cells = np.floor(table.astype(np.float64) / 0.003)
    on_edge = np.abs(table / 0.003 - np.round(table / 0.003)).min(axis=1) < 1e-3
    assert len(np.unique(cells[~on_edge], axis=0)) == np.count_nonzero(~on_edge)


def test_noise_all_over_has_few_voxels() -> None:
    """Points in every voxel of a cubic meter: the work is bounded by coarser voxels."""
    points = np.random.default_rng(0).random((300_000, 3), dtype=np.float32)
    voxels = downsampled(points, 0.003)
    assert 20_000 < len(voxels.centroids) <= 80_000
    assert voxels.edge_m > 0.015 and voxels.voxel_of.max() == len(voxels.centroids) - 1
    off = np.abs(voxels.centroids[voxels.voxel_of] - points)
    assert off.max() <= 2 * voxels.edge_m  # a voxel of voxels


def test_further_scans_show_what_the_first_does_not() -> None:
    """A cube behind a tall box, seen from the other side of the table."""
    tall, cube = item("cereal_y", 0.75, 0.0), item("green_cube", 0.93, 0.0)
    scene = laid(tall, cube)
    across = {"position": [1.75, 0.0, 1.35], "gaze": [0.85, 0.0, 0.85]}
    other = build_scene({"target": tall, "obstacles": [cube], "camera": across})
    first, second = seen(scene, 0), to_capture(other, np.random.default_rng(1))[0]
    assert CAMERA["position"][0] < 0.5
    alone = find_scene(first, (), SceneConfig())
    both = find_scene(first, (second,), SceneConfig())
    deep = [np.ptp(s.points[np.abs(s.points[:, 0] - 0.93) < 0.05], axis=0) for s in (alone, both)]
    assert deep[1][2] > deep[0][2] + 0.02 or deep[1][0] > deep[0][0] + 0.02
    assert len(both.points) > 1.3 * len(alone.points)
    np.testing.assert_array_equal(both.T_base_table, alone.T_base_table)


def test_a_scan_without_its_place_is_refused() -> None:
    first = seen(laid(*SPREAD))
    with pytest.raises(SceneError, match="T_base_camera"):
        find_scene(first, (Capture(first.depth, first.intrinsics),), SceneConfig())


def test_floating_things_are_obstacles() -> None:
    """A lamp over the table is seen and kept, whatever number it has."""
    scene = laid(item("green_cube", 0.85, 0.0), item("lamp_wide", 0.95, 0.15, 0.0, 0.28))
    found = scene_of(scene, 0)
    assert (found.points[:, 2] > TABLE_M + 0.25).any()
    assert any(isinstance(p, Plane) for p in scene.primitives)
