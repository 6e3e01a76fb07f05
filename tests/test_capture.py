from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from capture_files import HEIGHT, WIDTH, view
from hypothesis import given, settings
from hypothesis import strategies as st

from boxgrasp.errors import CaptureError
from boxgrasp.kernels.backproject import backproject_naive
from boxgrasp.sensing.capture import Capture

SEEN = view()


def depth_capture(**changes):
    values = {"depth": SEEN.depth, "intrinsics": SEEN.intrinsics, **changes}
    return Capture(**values)


def test_keeps_what_it_is_given_read_only_and_apart_from_the_caller():
    depth = SEEN.depth.copy()
    capture = Capture(
        depth,
        SEEN.intrinsics,
        SEEN.T_base_camera,
        SEEN.rgb,
        SEEN.mask,
        target_pixel=SEEN.target_pixel,
    )
    assert capture.shape == (HEIGHT, WIDTH)
    assert capture.has_camera and capture.warnings == () and capture.target_pixel == (13, 10)
    np.testing.assert_array_equal(capture.depth, SEEN.depth)
    np.testing.assert_array_equal(capture.T_base_camera, SEEN.T_base_camera)
    np.testing.assert_array_equal(capture.rgb, SEEN.rgb)
    np.testing.assert_array_equal(capture.mask, SEEN.mask)
    depth[:] = 9
    assert capture.depth.max() < 1
    for array in (capture.depth, capture.intrinsics, capture.rgb, capture.mask):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


def test_points_equal_the_naive_ones_and_project_back_to_their_pixels():
    robot = np.zeros((HEIGHT, WIDTH), bool)
    robot[:5] = True
    capture = depth_capture(robot_mask=robot)
    points, pixels = capture.valid_points()
    naive_points, naive_pixels = backproject_naive(SEEN.depth, SEEN.intrinsics, robot)
    np.testing.assert_allclose(points, naive_points, rtol=1e-6)
    np.testing.assert_array_equal(pixels, naive_pixels)
    projected = points @ SEEN.intrinsics.T
    np.testing.assert_allclose(projected[:, 0] / projected[:, 2], pixels % WIDTH, atol=1e-4)
    np.testing.assert_allclose(projected[:, 1] / projected[:, 2], pixels // WIDTH, atol=1e-4)
    assert points.dtype == np.float32 and pixels.dtype == np.int32
    assert pixels.min() >= 5 * WIDTH


def test_all_ways_of_saying_missing_are_one():
    depth = SEEN.depth.copy()
    depth[0, :4] = (np.nan, 0.0, 70.0, 65.6)
    clean = depth_capture(depth=depth.astype(np.float64)).depth
    np.testing.assert_array_equal(clean[0, :4], 0)
    np.testing.assert_array_equal(clean[1:], SEEN.depth[1:])


MISSING = (0.0, -0.0, np.nan, np.inf, -np.inf)  # REP 117: invalid, nothing in range, too near


@settings(max_examples=100, deadline=None)
@given(st.lists(st.sampled_from((None, *MISSING)), min_size=40, max_size=40), st.booleans())
def test_any_share_of_missing_depth_is_missing(pattern, double):
    """However it is said, and however much of it there is, as long as something is measured."""
    depth = np.linspace(0.5, 1.5, 40).reshape(5, 8)
    gone = np.array([said is not None for said in pattern]).reshape(5, 8)
    depth[gone] = [said for said in pattern if said is not None]
    if not double:
        depth = depth.astype(np.float32)
    intrinsics = [[9, 0, 4], [0, 9, 2], [0, 0, 1]]
    if gone.all():
        with pytest.raises(CaptureError, match="missing at every pixel"):
            Capture(depth, intrinsics)
        return
    capture, plain = Capture(depth, intrinsics), Capture(np.where(gone, 0, depth), intrinsics)
    assert capture.warnings == ()
    np.testing.assert_array_equal(capture.depth, plain.depth)
    np.testing.assert_array_equal(capture.depth == 0, gone)
    for one, other in zip(capture.valid_points(), plain.valid_points(), strict=True):
        np.testing.assert_array_equal(one, other)


@settings(max_examples=100, deadline=None)
@given(
    st.lists(st.sampled_from((None, *MISSING[2:])), min_size=20, max_size=20),
    st.integers(0, 2),
    st.sampled_from(("optical", "base")),
)
def test_any_share_of_missing_points_is_missing(pattern, axis, frame):
    """A coordinate that is not finite makes a point missing, in both kinds of cloud."""
    points = np.random.default_rng(0).uniform(0.5, 1.5, (20, 3)).astype(np.float32)
    gone = np.array([said is not None for said in pattern])
    points[gone, axis] = [said for said in pattern if said is not None]
    if gone.all():
        with pytest.raises(CaptureError, match="no valid point"):
            Capture.from_cloud(points, cloud_frame=frame)
        return
    plain = np.where(gone[:, None], 0, points)
    for shape in ((20, 3), (4, 5, 3)):
        one, other = (
            Capture.from_cloud(cloud.reshape(shape), cloud_frame=frame) for cloud in (points, plain)
        )
        assert one.warnings == ()
        np.testing.assert_array_equal(one.points, other.points)
        assert len(one.valid_points()[0]) == np.count_nonzero(~gone)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_few_negative_depths_are_noted_and_many_refused(dtype):
    depth = np.full((100, 100), 0.9, dtype)
    depth[0, :10] = -0.5
    depth[50:] = -np.inf  # too near, as much as there is
    capture = Capture(depth, [[90, 0, 50], [0, 90, 50], [0, 0, 1]])
    assert len(capture.valid_points()[0]) == 4990
    (warning,) = capture.warnings
    assert warning.code == "depth_negative"
    assert warning.message == "10 negative depths of 10000 taken as missing"
    depth[0, 10] = -0.5
    with pytest.raises(CaptureError, match="negative at 11 of 10000 pixels"):
        Capture(depth, [[90, 0, 50], [0, 90, 50], [0, 0, 1]])


def test_few_points_behind_the_camera_are_noted_and_many_refused():
    points = np.random.default_rng(0).uniform(0.5, 1.5, (4000, 3))
    points[:4, 2] = -1.0
    points[1000:2000] = np.inf
    capture = Capture.from_cloud(points)
    assert len(capture.points) == 2996
    assert [warning.code for warning in capture.warnings] == ["points_behind_camera"]
    points[4, 2] = -1.0
    with pytest.raises(CaptureError, match="5 of 4000 points behind the camera"):
        Capture.from_cloud(points)


def test_organized_cloud_gives_the_points_and_pixels_of_its_depth_image():
    from_depth = depth_capture()
    cloud = Capture.from_cloud(SEEN.points, colors=SEEN.rgb, mask=SEEN.mask, target_pixel=(13, 10))
    assert cloud.shape == (HEIGHT, WIDTH) and cloud.has_camera and cloud.depth is None
    points, pixels = cloud.valid_points()
    np.testing.assert_array_equal(pixels, from_depth.valid_points()[1])
    np.testing.assert_allclose(points, from_depth.valid_points()[0], rtol=1e-6)
    np.testing.assert_array_equal(cloud.colors, SEEN.rgb.reshape(-1, 3))
    robot = np.zeros((HEIGHT, WIDTH), bool)
    robot[:5] = True
    _, kept = Capture.from_cloud(SEEN.points, robot_mask=robot).valid_points()
    np.testing.assert_array_equal(kept, pixels[pixels >= 5 * WIDTH])


coordinate = st.sampled_from([-0.5, -0.0, 0.0, 0.25, 0.5, float("nan")])


@settings(max_examples=200, deadline=None)
@given(
    st.lists(st.tuples(coordinate, coordinate, coordinate), min_size=1, max_size=12),
    st.randoms(use_true_random=False),
)
def test_order_of_a_clouds_points_does_not_matter(rows, random):
    points = np.array([*rows, (0.1, 0.2, 0.3)], np.float32)
    colors = np.array([[random.randrange(3)] * 3 for _ in points], np.uint8)
    mask = np.array([True] + [random.random() < 0.5 for _ in points[1:]])
    mask[-1] = True
    one = Capture.from_cloud(points, cloud_frame="base", colors=colors, mask=mask)
    order = list(range(len(points)))
    random.shuffle(order)
    two = Capture.from_cloud(
        points[order], cloud_frame="base", colors=colors[order], mask=mask[order]
    )
    for name in ("points", "colors", "mask"):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))
        assert getattr(one, name).tobytes() == getattr(two, name).tobytes()
    keys = [tuple(row) for row in one.points.tolist()]
    assert all(a <= b for a, b in pairwise(keys))
    kept = [r for r in points.tolist() if np.isfinite(r).all() and any(r)]
    assert sorted(map(tuple, kept)) == keys
    assert (one.valid_points()[1] == -1).all()


def test_camera_is_unknown_only_for_a_base_cloud_without_its_pose():
    points = SEEN.points.reshape(-1, 3)
    assert Capture.from_cloud(points).has_camera
    assert not Capture.from_cloud(points, cloud_frame="base").has_camera
    T = np.eye(4)
    placed = Capture.from_cloud(points, cloud_frame="base", T_base_camera=T)
    assert placed.has_camera and placed.warnings == ()
    turned = Capture.from_cloud(points, cloud_frame="base", T_base_camera=np.diag([1, -1, -1, 1]))
    assert [warning.code for warning in turned.warnings] == ["camera_looks_away"]


K = SEEN.intrinsics


def changed(matrix, place, value):
    out = np.array(matrix, float)
    out[place] = value
    return out


BAD_VIEWS = {
    "one dimension": (dict(depth=SEEN.depth[0]), r"shape \(32,\)"),
    "three dimensions": (dict(depth=SEEN.depth[..., None]), "shape"),
    "no pixels": (dict(depth=np.zeros((0, 4), np.float32)), "shape"),
    "millimeters as uint16": (dict(depth=(SEEN.depth * 1000).astype(np.uint16)), "divide"),
    "millimeters as float": (dict(depth=SEEN.depth * 1000), "millimeters"),
    "objects": (dict(depth=np.array([[None]])), "holds object"),
    "text": (dict(depth="depth"), "depth holds"),
    "ragged": (dict(depth=[[1.0], [1.0, 2.0]]), "not an array"),
    "complex": (dict(depth=SEEN.depth.astype(complex)), "complex"),
    "none": (dict(depth=None), "holds object"),
    "all zero": (dict(depth=SEEN.depth * 0), "every pixel"),
    "all NaN": (dict(depth=SEEN.depth * np.nan), "every pixel"),
    "all far": (dict(depth=SEEN.depth * 0 + 100), "millimeters"),
    "negative": (dict(depth=-SEEN.depth), "negative at"),
    "infinite": (dict(depth=np.full_like(SEEN.depth, np.inf)), "every pixel"),
    "too near": (dict(depth=np.full_like(SEEN.depth, -np.inf)), "every pixel"),
    "no intrinsics": (dict(intrinsics=None), "intrinsics are missing"),
    "intrinsics 3 x 4": (dict(intrinsics=np.eye(3, 4)), "shape"),
    "intrinsics NaN": (dict(intrinsics=changed(K, (0, 0), np.nan)), "NaN"),
    "intrinsics infinite": (dict(intrinsics=changed(K, (0, 2), np.inf)), "NaN or inf"),
    "focal length 0": (dict(intrinsics=changed(K, (0, 0), 0)), "fx = 0"),
    "focal length negative": (dict(intrinsics=changed(K, (1, 1), -30)), "fy = -30"),
    "focal length of a unit image": (dict(intrinsics=changed(K, (0, 0), 0.5)), "fx = 0.5"),
    "principal point far out": (dict(intrinsics=changed(K, (1, 2), 500)), "cy = 500"),
    "skew": (dict(intrinsics=changed(K, (0, 1), 1)), "skew"),
    "transposed": (dict(intrinsics=K.T), "intrinsics are not"),
    "identity": (dict(depth=np.ones((100, 100)), intrinsics=np.eye(3)), "fx = 1"),
    "pose of 3 rows": (dict(T_base_camera=np.eye(3, 4)), r"T_base_camera has shape"),
    "pose NaN": (dict(T_base_camera=changed(np.eye(4), (0, 3), np.nan)), "NaN"),
    "pose mirrored": (dict(T_base_camera=np.diag([1, 1, -1, 1])), "mirrored"),
    "pose scaled": (dict(T_base_camera=np.diag([2.0, 2, 2, 1])), "not a rotation"),
    "pose sheared": (dict(T_base_camera=changed(np.eye(4), (0, 1), 0.3)), "not a rotation"),
    "pose last row": (dict(T_base_camera=changed(np.eye(4), (3, 0), 1)), "last row"),
    "pose text": (dict(T_base_camera="pose"), "not numeric"),
    "rgb smaller": (dict(rgb=SEEN.rgb[:-1]), "rgb has shape"),
    "rgb gray": (dict(rgb=SEEN.rgb[..., 0]), "rgb has shape"),
    "rgb float": (dict(rgb=SEEN.rgb / 255.0), "rgb holds float64"),
    "mask smaller": (dict(mask=SEEN.mask[:, 1:]), "mask has shape"),
    "mask empty": (dict(mask=SEEN.mask & False), "mask is empty"),
    "mask of floats": (dict(mask=SEEN.mask * 1.0), "mask holds float64"),
    "robot everywhere": (dict(robot_mask=SEEN.mask | True), "robot_mask covers"),
    "pixel outside": (dict(target_pixel=(32, 3)), "outside"),
    "pixel negative": (dict(target_pixel=(3, -1)), "outside"),
    "pixel of three": (dict(target_pixel=(1, 2, 3)), "target_pixel is"),
    "pixel NaN": (dict(target_pixel=(np.nan, 1)), "target_pixel is"),
    "pixel text": (dict(target_pixel="ab"), "target_pixel"),
}


@pytest.mark.parametrize("name", BAD_VIEWS)
@pytest.mark.filterwarnings("error")
def test_bad_views_are_refused_in_one_line(name):
    changes, message = BAD_VIEWS[name]
    with pytest.raises(CaptureError, match=message) as caught:
        depth_capture(**changes)
    assert "\n" not in str(caught.value)


P = SEEN.points.reshape(-1, 3)
FEW = np.array([[0.1, 0, 1], [0, 0.1, 1]], np.float32)
BAD_CLOUDS = {
    "empty": (dict(points=np.zeros((0, 3), np.float32)), "empty"),
    "no columns": (dict(points=np.zeros((4, 2), np.float32)), "shape"),
    "one number": (dict(points=np.float32(3)), "shape"),
    "whole numbers": (dict(points=np.ones((4, 3), int)), "float meters"),
    "objects": (dict(points=[[None] * 3]), "object"),
    "all NaN": (dict(points=P * np.nan), "no valid point"),
    "all zero": (dict(points=P[:5] * 0), "no valid point"),
    "behind": (dict(points=FEW * (1, 1, -1)), "behind the camera"),
    "infinite": (dict(points=np.full((2, 3), np.inf), cloud_frame="base"), "no valid point"),
    "millimeters": (dict(points=FEW * 1000), "millimeters"),
    "millimeters, base": (
        dict(points=np.random.default_rng(0).random((50, 3)) * 900, cloud_frame="base"),
        "millimeters",
    ),
    "frame": (dict(points=FEW, cloud_frame="world"), "valid: optical, base"),
    "colors": (dict(points=FEW, colors=np.zeros((3, 3), np.uint8)), "colors has shape"),
    "mask": (dict(points=FEW, mask=np.ones(3, bool)), "mask has shape"),
    "mask on nothing": (
        dict(points=[[0.1, 0, 1.0], [np.nan] * 3], mask=np.array([False, True])),
        "mask marks no valid",
    ),
    "pixel": (dict(points=FEW, target_pixel=(0, 0)), "without an image"),
    "pose": (dict(points=FEW, T_base_camera=np.diag([1, 1, -1, 1])), "mirrored"),
    "robot": (dict(points=FEW, robot_mask=np.ones(2, bool)), "robot_mask covers"),
}


@pytest.mark.parametrize("name", BAD_CLOUDS)
@pytest.mark.filterwarnings("error")
def test_bad_clouds_are_refused_in_one_line(name):
    changes, message = BAD_CLOUDS[name]
    changes = dict(changes)
    points = changes.pop("points")
    with pytest.raises(CaptureError, match=message) as caught:
        Capture.from_cloud(points, **changes)
    assert "\n" not in str(caught.value)


@settings(max_examples=300, deadline=None)
@given(
    st.integers(1, 6).flatmap(
        lambda w: st.lists(
            st.lists(st.floats(width=32), min_size=w, max_size=w), min_size=1, max_size=6
        )
    ),
    st.lists(st.floats(), min_size=9, max_size=9),
)
def test_any_floats_give_a_capture_or_one_error(rows, nine):
    try:
        capture = Capture(np.array(rows, np.float32), np.array(nine).reshape(3, 3))
    except CaptureError as error:
        assert "\n" not in str(error)
        return
    points, pixels = capture.valid_points()
    assert np.isfinite(points).all() and (points[:, 2] > 0).all() and len(points) == len(pixels)
