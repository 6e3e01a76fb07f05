"""Frames that do not fit the view are noticed and named, right ones never; on cast tables."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from boxgrasp import Capture, GraspSelector, Target
from boxgrasp.errors import CaptureError, FramesError, SceneError, TargetError
from boxgrasp.geometry.plane import Plane
from boxgrasp.geometry.transforms import invert, make_transform, transform
from boxgrasp.perception.frame_doubts import FrameCheck
from boxgrasp.perception.support_plane import find_support_plane
from boxgrasp.sensing.sensor_model import XTION
from boxgrasp.simulate import add_noise, cast, draw_scene, to_capture
from boxgrasp.simulate.camera import intrinsics_matrix, look_at
from boxgrasp.simulate.scenes import FLOOR_ID, TABLE_ID

SELECTOR = GraspSelector({"scene": {"segmentation": "split"}})
# Columns: a link's x (forward), y (left) and z (up), and a viewer's x, y (up), z (backward), each
# in the optical frame.
LINK = np.array([[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1.0]])
VIEWER = np.diag([1.0, -1.0, -1.0, 1.0])
Change = Callable[[np.ndarray], np.ndarray]


@pytest.fixture(scope="module", params=(3, 4))
def view(request: pytest.FixtureRequest) -> Capture:
    """A cast table, 0.8 m over the robot's base, with noise."""
    rng = np.random.default_rng((77, request.param))
    return to_capture(draw_scene(rng), rng)[0]


def pose(view: Capture) -> np.ndarray:
    assert view.T_base_camera is not None
    return np.array(view.T_base_camera)


def turned(T: np.ndarray, degrees: float, about: str = "x") -> np.ndarray:
    """The pose turned about a horizontal axis of the base through the camera."""
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    R = {"x": [[1, 0, 0], [0, c, -s], [0, s, c]], "y": [[c, 0, s], [0, 1, 0], [-s, 0, c]]}[about]
    return make_transform(np.array(R) @ T[:3, :3], T[:3, 3])


def points_of(view: Capture, T: np.ndarray) -> np.ndarray:
    """(N, 3) the view's points in another frame."""
    points, _ = view.valid_points()
    return np.asarray(transform(T, points))


@pytest.mark.parametrize(
    ("change", "reading", "words"),
    [
        (invert, "inverse", "its inverse would make it level"),
        (lambda T: T @ LINK, "camera_link", "camera_link (x forward, y left, z up)"),
        (lambda T: T @ VIEWER, "opengl", "y up and z backward"),
    ],
    ids=["inverted", "camera_link", "opengl"],
)
def test_a_pose_of_another_kind_is_refused_and_named(
    view: Capture, change: Change, reading: str, words: str
) -> None:
    with pytest.raises(FramesError) as caught:
        SELECTOR.select(view.with_pose(change(pose(view))))
    error, said = caught.value, str(caught.value)
    assert error.code == "no_level_plane" and reading in error.fits
    up, wrong = pose(view)[2, :3], change(pose(view))[2, :3]  # the table's true normal is up
    tilt = np.arctan2(np.linalg.norm(np.cross(up, wrong)), up @ wrong)
    assert error.tilt_rad == pytest.approx(tilt, abs=np.deg2rad(1.0))
    assert f"tilted by {np.rad2deg(error.tilt_rad):.1f} degrees" in said
    assert "suspect T_base_camera" in said and words in said and "\n" not in said


@pytest.mark.parametrize("about", ["x", "y"])
def test_a_pose_13_degrees_off_is_refused_with_its_tilt(view: Capture, about: str) -> None:
    with pytest.raises(FramesError, match="neither its inverse nor the axes") as caught:
        SELECTOR.scene(view.with_pose(turned(pose(view), 13.0, about)))
    assert caught.value.fits == ()
    assert caught.value.tilt_rad == pytest.approx(np.deg2rad(13.0), abs=np.deg2rad(0.5))


def test_a_pose_8_degrees_off_is_answered_with_a_warning(view: Capture) -> None:
    off = view.with_pose(turned(pose(view), 8.0))
    scene = SELECTOR.scene(off)
    assert scene.frame_doubt is not None and scene.frame_doubt.tilt_rad is not None
    assert np.rad2deg(scene.frame_doubt.tilt_rad) == pytest.approx(8.0, abs=0.5)
    (said,) = (w for w in SELECTOR.select(off).warnings if w.code == "support_plane_tilted")
    assert "8." in said.message or "7.9" in said.message
    # Where no target is found, the frames may be why.
    with pytest.raises(TargetError, match="suspect T_base_camera"):
        SELECTOR.select(off, Target(point=(0.0, 0.0, 5.0)))


def test_right_frames_are_not_doubted(view: Capture) -> None:
    for about in ("x", "y"):  # a calibration a little off
        assert SELECTOR.scene(view.with_pose(turned(pose(view), 2.5, about))).frame_doubt is None
    for T in (pose(view), None):
        assert SELECTOR.scene(view.with_pose(T)).frame_doubt is None
        cloud = Capture.from_cloud(points_of(view, np.eye(4)), T_base_camera=T)
        assert SELECTOR.scene(cloud).frame_doubt is None
    base = Capture.from_cloud(points_of(view, pose(view)), cloud_frame="base")
    assert SELECTOR.scene(base).frame_doubt is None


def test_an_empty_table_is_not_laid_to_the_pose() -> None:
    scene = draw_scene(np.random.default_rng((77, 0)))
    table = [solid for solid in scene.primitives if solid.object_id in (TABLE_ID, FLOOR_ID)]
    T = look_at((0.1, 0.0, 1.4), (0.8, 0.0, 0.8))
    seen = cast(table, intrinsics_matrix(), T)
    depth = add_noise(seen.depth, np.random.default_rng(0))
    with pytest.raises(SceneError, match="^nothing stands on the support plane; valid"):
        SELECTOR.scene(Capture(depth, intrinsics_matrix(), T))


def test_a_tilted_plane_larger_than_the_level_one_is_told(view: Capture) -> None:
    wrong = view.with_pose(invert(pose(view)))
    check = FrameCheck(wrong, wrong.valid_points()[0], 1.6, XTION)
    up = np.asarray(wrong.T_base_camera)[2, :3]
    found = check.with_plane(Plane(up, -float(np.median(check.points @ up))))
    assert found is not None and found.code == "larger_plane_tilted" and "inverse" in found.fits


def test_a_surface_seen_from_below_supports_nothing() -> None:
    rng = np.random.default_rng(0)
    ceiling = np.column_stack((rng.uniform(-1, 1, (5000, 2)), rng.normal(1.0, 0.001, 5000)))
    points, up = ceiling.astype(np.float32), np.array([0.0, 0.0, 1.0])
    assert find_support_plane(points, up, None, 5.0).offset_m == pytest.approx(-1.0, abs=0.01)
    find_support_plane(points, up, np.array([0.0, 0.0, 2.0]), 5.0)
    with pytest.raises(SceneError, match="no support plane"):
        find_support_plane(points, up, np.zeros(3), 5.0)


def doubted(cloud: Capture) -> str:
    """The code of what speaks against a cloud's frame."""
    try:
        doubt = SELECTOR.scene(cloud).frame_doubt
    except FramesError as error:
        return error.code
    return "" if doubt is None else doubt.code


def test_a_base_cloud_taken_as_optical_is_noticed(view: Capture) -> None:
    points = points_of(view, pose(view))
    with pytest.raises(CaptureError, match="behind the camera.*--cloud-frame base"):
        Capture.from_cloud(points)  # the floor lies around z = 0
    cropped = points[points[:, 2] > 0.7]
    low = cropped - np.float32((0.0, 0.0, 0.75))  # a robot that stands 5 cm under its table
    assert doubted(Capture.from_cloud(cropped)) == "cloud_in_base_frame"
    assert doubted(Capture.from_cloud(low[low[:, 2] > 0])) == "cloud_in_base_frame"


def test_a_camera_that_looks_straight_down_sees_no_base_cloud() -> None:
    scene = draw_scene(np.random.default_rng((77, 1)))
    T = look_at((0.78, 0.0, 1.7), (0.8, 0.0, 0.8))
    seen = cast(scene.primitives, scene.intrinsics, T)
    depth = add_noise(seen.depth, np.random.default_rng(0))
    down = Capture(depth, scene.intrinsics, T)
    cloud = Capture.from_cloud(points_of(down, np.eye(4)))
    check = FrameCheck(cloud, cloud.valid_points()[0], 1.6, XTION)
    assert check.without_plane() is None and check.without_objects() is None
    assert doubted(cloud) == doubted(down) == ""


def test_poses_that_are_none_are_refused_by_name(view: Capture) -> None:
    T = pose(view)
    millimeters = make_transform(T[:3, :3], 1000 * T[:3, 3])
    for wrong, words in (
        (T @ np.diag([1.0, -1.0, 1.0, 1.0]), "left-handed"),
        (millimeters, "looks like millimeters"),
        (T.T, "transposed"),
        (make_transform(2 * T[:3, :3], T[:3, 3]), "not a rotation"),
    ):
        with pytest.raises(CaptureError, match=words):
            view.with_pose(wrong)
    view.with_pose(make_transform(T[:3, :3], (500.0, -300.0, 1.3)))  # a map's origin may be far


def test_another_pose_is_told_and_the_same_is_not(view: Capture) -> None:
    T = pose(view)
    assert view.with_pose(T.astype(np.float32).astype(float)).warnings == view.warnings
    moved = view.with_pose(make_transform(turned(T, 3.0)[:3, :3], T[:3, 3] + (0.0, 0.03, 0.04)))
    (warning,) = moved.warnings
    assert warning.code == "pose_replaced" and "5.0 cm and 3.0 degrees" in warning.message
    assert moved.depth is view.depth and moved.target_pixel == view.target_pixel
    bare = view.with_pose(None)
    assert bare.T_base_camera is None and bare.warnings == ()
    assert bare.with_pose(T).warnings == ()
    np.testing.assert_array_equal(bare.with_pose(T).T_base_camera, T)


def test_a_base_cloud_is_told_where_its_camera_looks_away(view: Capture) -> None:
    T = pose(view)
    cloud = Capture.from_cloud(points_of(view, T), cloud_frame="base")
    away = cloud.with_pose(T @ np.diag([-1.0, 1.0, -1.0, 1.0]))
    assert [w.code for w in away.warnings] == ["camera_looks_away"]
    assert [w.code for w in away.with_pose(T).warnings] == ["pose_replaced"]
    assert cloud.with_pose(T).has_camera and not cloud.has_camera
