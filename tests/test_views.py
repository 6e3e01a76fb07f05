"""Which pixel shows which point of a scene, and what the views hand to the local map."""

from __future__ import annotations

import sys
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from helpers import item, laid, seen
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from boxgrasp import Capture
from boxgrasp.errors import ConfigError, SceneError
from boxgrasp.geometry.transforms import invert, make_transform, rotation_z, transform
from boxgrasp.mapping.view_rays import view_rays
from boxgrasp.perception.find_scene import find_scene
from boxgrasp.perception.scene import MISSING, TABLE, Scene
from boxgrasp.perception.scene_config import SceneConfig
from boxgrasp.perception.segmentation import SEGMENTATIONS
from boxgrasp.perception.segmentation.clusters import rows_by_cluster
from boxgrasp.perception.segmentation.protocol import SeenPoints, Segments
from boxgrasp.perception.view import View, rows_of, scan_views, seen_points
from boxgrasp.sensing.sensor_model import XTION
from boxgrasp.simulate import to_capture

LAID = laid(
    item("green_cube", 0.85, 0.0), item("crisps_tube", 0.95, 0.22), item("beans_can", 0.75, -0.2)
)
OBJECT_IDS = LAID.view().object_ids
HEIGHT, WIDTH = OBJECT_IDS.shape
EVERY = np.arange(HEIGHT * WIDTH)
VOXEL_M = SceneConfig().voxel_m


@cache
def captured(kind: str = "depth") -> Capture:
    """The view as depth with holes and an arm, or as one of the two kinds of cloud."""
    plain = seen(LAID, 0)
    assert plain.depth is not None
    depth = np.array(plain.depth)
    depth[100:110, 200:260] = 0
    arm = np.zeros(depth.shape, bool)
    arm[:40] = True
    if kind == "depth":
        return Capture(depth, plain.intrinsics, plain.T_base_camera, robot_mask=arm)
    points = np.full((HEIGHT * WIDTH, 3), np.nan, np.float32)
    found, pixels = Capture(depth, plain.intrinsics).valid_points()
    points[pixels] = found
    T = plain.T_base_camera
    if kind == "organized":
        image = points.reshape(HEIGHT, WIDTH, 3)
        return Capture.from_cloud(image, T_base_camera=T, robot_mask=arm)
    return Capture.from_cloud(points, T_base_camera=T, robot_mask=arm.reshape(-1))


@cache
def scene(kind: str = "depth") -> Scene:
    return find_scene(captured(kind), (), SceneConfig(segmentation="split"))


def shown_points() -> np.ndarray:
    """(H * W, 3) what each pixel shows, base frame, NaN where it is missing or the arm."""
    points, pixels = captured().valid_points()
    whole = np.full((HEIGHT * WIDTH, 3), np.nan, np.float32)
    T = captured().T_base_camera
    assert T is not None
    whole[pixels] = transform(T, points)
    return whole


# Pixels


def test_a_pixel_shows_the_point_whose_voxel_it_fell_into() -> None:
    rows, shown = scene().rows_at(EVERY), shown_points()
    np.testing.assert_array_equal(rows == MISSING, np.isnan(shown[:, 0]))
    assert np.count_nonzero(rows >= 0) > 5000 and np.count_nonzero(rows == TABLE) > 5000
    on = rows >= 0
    off = np.linalg.norm(shown[on] - scene().points[rows[on]], axis=1)
    assert off.max() <= VOXEL_M * np.sqrt(3) + 1e-4
    assert set(rows[on].tolist()) == set(range(len(scene().points)))
    np.testing.assert_array_equal(scene().rows_at(EVERY[[[7, 9], [3, 3]]]), rows[[[7, 9], [3, 3]]])


def test_heights_at_pixels_are_those_of_their_own_points() -> None:
    shown = shown_points()
    pixels = np.flatnonzero(~np.isnan(shown[:, 0]))[::997]
    expected = scene().plane.heights(shown[pixels])
    found = [scene().height_at(int(pixel)) for pixel in pixels]
    np.testing.assert_allclose(found, expected, atol=1e-6)


@settings(max_examples=20, deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**32 - 1), share=st.sampled_from([0.02, 0.4, 0.6, 0.98]))
def test_points_under_a_mask_are_those_it_mostly_covers(seed: int, share: float) -> None:
    mask = np.random.default_rng(seed).random((HEIGHT, WIDTH)) < share
    rows = scene().rows_at(EVERY)
    inside = np.bincount(rows[(rows >= 0) & mask.reshape(-1)], minlength=len(scene().points))
    every = np.bincount(rows[rows >= 0], minlength=len(scene().points))
    np.testing.assert_array_equal(scene().points_under(mask), inside > every / 2)


def test_points_under_a_mask_are_alike_in_every_kind_of_view() -> None:
    mask = OBJECT_IDS == 3
    points = [
        view.points[view.points_under(beside)]
        for view, beside in (
            (scene(), mask),
            (scene("organized"), mask),
            (scene("unorganized"), _beside_cloud(mask)),
        )
    ]
    assert len(points[0]) > 200
    np.testing.assert_array_equal(points[0], points[1])
    # The same points in another order give another sample, so another plane and other voxels.
    assert len(points[2]) == pytest.approx(len(points[0]), rel=0.01)
    assert cKDTree(points[0]).query(points[2])[0].max() < 2 * VOXEL_M


def _beside_cloud(mask: np.ndarray) -> np.ndarray:
    """The mask's values beside the points of the unorganized cloud, which are sorted."""
    capture = captured("unorganized")
    assert capture.points is not None
    organized = captured("organized").points
    assert organized is not None
    marked = {tuple(row) for row in organized[mask.reshape(-1)].tolist()}
    return np.array([tuple(row) in marked for row in capture.points.tolist()])


@pytest.mark.parametrize("kind", ["depth", "organized"])
def test_the_object_image_shows_the_objects(kind: str) -> None:
    image = scene(kind).object_image()
    assert image.shape == OBJECT_IDS.shape and image.dtype == np.int32
    numbers = scene(kind).object_numbers
    rows = scene(kind).rows_at(EVERY)
    expected = np.where(rows >= 0, numbers[np.maximum(rows, 0)], 0)
    np.testing.assert_array_equal(image.reshape(-1), expected)
    for wanted in (2, 3, 4):
        found = image[(OBJECT_IDS == wanted) & (image > 0)]
        assert np.mean(found == np.bincount(found).argmax()) > 0.98


def test_an_unorganized_cloud_has_no_image() -> None:
    cloud = scene("unorganized")
    with pytest.raises(SceneError, match="no pixels"):
        cloud.object_image()
    assert cloud.target_window(np.ones(len(cloud.points), bool), 3) is None
    assert cloud.objects_with_pixels() == cloud.objects
    assert len(cloud.at_border) == 0


@pytest.mark.parametrize("margin_px", [0, 6])
def test_the_window_round_a_target_holds_its_pixels(margin_px: int) -> None:
    target_mask = scene().object_numbers == 2
    window = scene().target_window(target_mask, margin_px)
    assert window is not None
    rows = scene().rows_at(EVERY)
    whole = ((rows >= 0) & target_mask[np.maximum(rows, 0)]).reshape(HEIGHT, WIDTH)
    np.testing.assert_array_equal(window.target_mask, whole[window.rows, window.columns])
    assert window.target_mask.sum() == whole.sum() > 100
    v, u = np.nonzero(whole)
    assert (window.rows.start, window.rows.stop) == (v.min() - margin_px, v.max() + margin_px + 1)
    assert (window.columns.start, window.columns.stop) == (
        u.min() - margin_px,
        u.max() + margin_px + 1,
    )
    image = shown_points().reshape(HEIGHT, WIDTH, 3)[window.rows, window.columns]
    np.testing.assert_array_equal(window.points_m, image)
    assert window.open_sides == (False,) * 4


def test_the_window_ends_with_the_image() -> None:
    window = scene().target_window(np.ones(len(scene().points), bool), WIDTH)
    assert window is not None
    assert window.target_mask.shape == (HEIGHT, WIDTH) and window.open_sides == (True,) * 4
    nothing = np.zeros(len(scene().points), bool)
    assert scene().target_window(nothing, 3) is None


def test_listed_objects_keep_all_but_their_pixels() -> None:
    for item_, bare in zip(scene().objects_with_pixels(), scene().objects, strict=True):
        assert bare.pixel is None and item_.pixel is not None
        assert item_.number == bare.number and item_.distance_m == bare.distance_m
        u, v = item_.pixel
        assert scene().object_image()[v, u] == item_.number


@settings(max_examples=50, deadline=None)
@given(
    st.sets(st.integers(0, 60), max_size=20).map(sorted),
    st.lists(st.integers(-2, 70), max_size=10),
)
def test_rows_of_values_are_where_they_stand(among: list[int], values: list[int]) -> None:
    found = rows_of(np.array(values, np.int64), np.array(among, np.int32))
    assert found.tolist() == [among.index(v) if v in among else -1 for v in values]


# Views and their rays


@settings(max_examples=60, deadline=None)
@given(
    width=st.integers(1, 9),
    height=st.integers(1, 9),
    step=st.integers(1, 4),
    seed=st.integers(0, 2**32 - 1),
)
def test_thinned_views_keep_every_stepth_row_and_column(
    width: int, height: int, step: int, seed: int
) -> None:
    r = np.random.default_rng(seed)
    pixels = np.flatnonzero(r.random(width * height) < 0.7).astype(np.int32)
    points = r.random((len(pixels), 3)).astype(np.float32)
    for array in (points, pixels):
        array.setflags(write=False)
    v, u = np.divmod(pixels, width)
    expected = points[(v % step == 0) & (u % step == 0)]
    view = View(points, pixels, (height, width), np.eye(4), None)
    np.testing.assert_array_equal(view.thinned(step), expected)
    loose = View(points, pixels, None, np.eye(4), None)
    assert loose.thinned(step) is points


@pytest.mark.parametrize("stride", [None, 1, 3])
def test_rays_lie_in_the_first_views_frame(stride: int | None) -> None:
    first, second = captured(), to_capture(LAID, np.random.default_rng(1))[0]
    assert first.T_base_camera is not None and second.T_base_camera is not None
    T = make_transform(rotation_z(0.3), (0.1, -0.2, 0.05)) @ second.T_base_camera
    moved = Capture(second.depth, second.intrinsics, T)
    base = Capture.from_cloud(np.array([[0.5, 0.1, 0.9], [0.6, 0.1, 0.9]]), cloud_frame="base")
    views = (*scan_views((first,), XTION), *scan_views((moved, base), XTION))
    rays = view_rays(views, stride)
    T_first_base = invert(first.T_base_camera)
    expected = [seen_points(of, XTION)[:2] for of in (first, moved, base)]
    places = (np.eye(4), T_first_base @ T, T_first_base)
    for (points, _), (every, pixels), place in zip(rays, expected, places, strict=True):
        if stride is None and len(every) > 2:  # a dense image: every second row and column
            v, u = np.divmod(pixels, WIDTH)
            every = every[(v % 2 == 0) & (u % 2 == 0)]
        np.testing.assert_allclose(points, transform(place, every[::stride]), atol=1e-5)
    cameras = [camera for _, camera in rays]
    np.testing.assert_allclose(cameras[0], np.zeros(3), atol=1e-9)
    np.testing.assert_allclose(cameras[1], (T_first_base @ T)[:3, 3], atol=1e-9)
    assert cameras[2] is None


def test_other_scans_change_the_views_alone() -> None:
    other = seen(LAID, 2)
    more = scene().with_scans((other,), XTION)
    assert len(scene().views) == 1 and len(more.views) == 2
    assert more.views[0] is scene().views[0] and more.points is scene().points
    np.testing.assert_array_equal(more.at_border, scene().at_border)
    assert len(more.with_scans((), XTION).views) == 1
    with pytest.raises(SceneError, match="T_base_camera"):
        scene().with_scans((Capture(other.depth, other.intrinsics),), XTION)


# Segmentation


@settings(max_examples=60, deadline=None)
@given(st.lists(st.integers(-1, 6), max_size=40), st.sampled_from([0, 40_000]))
def test_rows_by_cluster_are_the_rows_of_each_id(ids: list[int], shift: int) -> None:
    clusters = np.array(ids, np.int64)
    clusters[clusters >= 0] += shift  # ids beyond 16 bits
    found = list(rows_by_cluster(clusters))
    assert len(found) == max(clusters.tolist(), default=-1) + 1
    for k in {*range(min(len(found), 8)), *(c for c in clusters.tolist() if c >= 0)}:
        assert found[k].tolist() == np.flatnonzero(clusters == k).tolist()


def test_an_unknown_segmentation_is_refused_with_the_names_there_are() -> None:
    with pytest.raises(
        ConfigError, match=r"scene.segmentation is 'sam'; valid: split, euclidean, network$"
    ):
        SceneConfig(segmentation="sam")


def everything_is_one(seen_points: SeenPoints, _: object) -> Segments:
    return Segments.all_objects(np.zeros(len(seen_points.points), dtype=np.int64))


def nothing_is_an_object(seen_points: SeenPoints, _: object) -> Segments:
    clusters = np.arange(len(seen_points.points)) % 2
    return Segments(clusters, np.array([False, True]))


def test_another_segmentation_is_a_function_and_a_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "own", SimpleNamespace(function=everything_is_one))
    monkeypatch.setitem(SEGMENTATIONS, "one", "own:function")
    found = find_scene(captured(), (), SceneConfig(segmentation="one"))
    assert len(found.objects) == 1 and (found.object_numbers == 1).all()
    assert found.objects[0].points == len(found.points) > len(scene().points) - 10


def test_clusters_that_are_no_objects_stay_obstacles(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "own", SimpleNamespace(function=nothing_is_an_object))
    monkeypatch.setitem(SEGMENTATIONS, "half", "own:function")
    found = find_scene(captured(), (), SceneConfig(segmentation="half"))
    assert len(found.objects) == 1 and set(found.clusters.tolist()) == {0, 1}
    np.testing.assert_array_equal(found.object_numbers, found.clusters)
