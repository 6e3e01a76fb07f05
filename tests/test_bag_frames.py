"""The views of bags with their transforms: one by one, or all of a topic."""

from __future__ import annotations

import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from capture_files import view, write_folder, write_npz
from scipy.spatial.transform import Rotation, Slerp
from test_messages import rvl_of

from boxgrasp import load_capture
from boxgrasp.cli import main
from boxgrasp.errors import CaptureError
from boxgrasp.io.frames import TransformBuffer
from boxgrasp.io.messages import depth_capture

pytest.importorskip("rosbags")

from bag_files import KINDS, BagMaker, depth_bag

from boxgrasp.io import bag
from boxgrasp.io.bag import read_frames

SEEN = view()
OPTICAL = "camera_optical_frame"
STILL = (0.0, 0.0, 0.0, 1.0)
MOUNT_XYZ, MOUNT = (0.1, 0.0, 0.3), Rotation.from_euler("xyz", (-1.8, 0.1, -1.5))
ARM_TIMES = (99.0, 100.4, 101.2, 103.5)
ARM_XYZ = np.array([[0, 0, 0], [0.2, 0, 0.1], [0.4, 0.3, 0.1], [0.4, 0.5, 0.2]])
ARM = Rotation.from_euler("zyx", [[0, 0, 0], [0.4, 0, 0], [0.9, 0.2, 0], [1.6, 0.2, 0.3]])


def moved(xyz: Any, rotation: Rotation) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation.as_matrix(), xyz
    return T


def posed(stamp: float) -> np.ndarray:
    """T_base_camera of `arm_bag`."""
    xyz = [np.interp(stamp, ARM_TIMES, column) for column in ARM_XYZ.T]
    return moved(xyz, Slerp(ARM_TIMES, ARM)(stamp)) @ moved(MOUNT_XYZ, MOUNT)


def arm_bag(kind: str, tf_kind: str = "tf2_msgs/msg/TFMessage") -> BagMaker:
    """`depth_bag` with a camera on an arm that moves; the mount is told long before, once."""
    maker = depth_bag(kind, SEEN)
    mount = ("tool", OPTICAL, 0.0, MOUNT_XYZ, MOUNT.as_quat())
    maker.tf(3.0, mount, static=True, kind=tf_kind)
    for stamp, xyz, q in zip(ARM_TIMES, ARM_XYZ, ARM.as_quat(), strict=True):
        maker.tf(stamp + 0.02, ("base_link", "tool", stamp, xyz, q), kind=tf_kind)
    return maker


def made(maker: BagMaker, folder: Path, name: str) -> Path:
    (folder / name).mkdir()
    return maker.write(folder / name)


def refused(*given: Any, **how: Any) -> str:
    with pytest.raises(CaptureError) as caught:
        load_capture(*given, **how)
    said = str(caught.value)
    assert said.isprintable() and len(said.splitlines()) == 1
    return said


@pytest.mark.parametrize("kind", KINDS)
def test_the_pose_is_that_of_the_images_own_time(kind, tmp_path):
    path = arm_bag(kind).write(tmp_path)
    assert load_capture(path).T_base_camera is None
    for stamp in (100.001, 101.001, 102.001):
        capture = load_capture(path, stamp=stamp, base_frame="base_link")
        np.testing.assert_allclose(capture.T_base_camera, posed(stamp), atol=1e-9)
        assert capture.rgb is not None
    capture = load_capture(path, base_frame="/base_link")
    np.testing.assert_allclose(capture.T_base_camera, posed(100.001), atol=1e-9)


def test_ros_1_may_tell_its_transforms_as_tf(tmp_path):
    path = arm_bag("ros1", "tf/msg/tfMessage").write(tmp_path)
    capture = load_capture(path, base_frame="base_link")
    np.testing.assert_allclose(capture.T_base_camera, posed(100.001), atol=1e-9)


def test_static_transforms_count_whenever_they_were_told(tmp_path):
    maker = depth_bag("mcap", SEEN)
    maker.tf(500.0, ("base", OPTICAL, 500.0, (1, 2, 3), STILL), static=True)
    T = load_capture(maker.write(tmp_path), base_frame="base").T_base_camera
    np.testing.assert_array_equal(T, moved((1, 2, 3), Rotation.identity()))


@pytest.mark.parametrize("kind", ["ros1", "mcap"])
def test_without_a_transform_there_is_no_capture(kind, tmp_path):
    bare = made(depth_bag(kind, SEEN), tmp_path, "bare")
    assert "frame 'base' is unknown; known: none" in refused(bare, base_frame="base")
    arm = made(arm_bag(kind), tmp_path, "arm")
    said = refused(arm, base_frame="bse_link")
    assert "'bse_link' is unknown; known: camera_optical_frame, tool" in said
    assert "valid: a base frame with z up" in refused(arm, base_frame=OPTICAL)
    assert "base_frame is '/'" in refused(arm, base_frame="/")
    # What was recorded more than 2 s away is not looked at, and nothing is extrapolated.
    late = depth_bag(kind, SEEN)
    for stamp in (101.5, 105.0):
        late.tf(stamp, ("base", OPTICAL, stamp, (0, 0, 1), STILL))
    path = made(late, tmp_path, "late")
    said = refused(path, base_frame="base", topic="/camera/depth/image_raw", stamp=100.0)
    assert "frame 'camera_optical_frame' is kept from 101.500000000 s on" in said
    apart = depth_bag(kind, SEEN)
    apart.tf(100.0, ("base", "tool", 0, (0, 0, 1), STILL), static=True)
    apart.tf(100.0, ("mast", OPTICAL, 0, (0, 0, 1), STILL), static=True)
    said = refused(made(apart, tmp_path, "apart"), base_frame="base")
    assert "nothing connects the two frames" in said


def test_the_first_view_with_a_transform_is_the_first_that_can_be_used(tmp_path):
    maker = depth_bag("db3", SEEN)
    for stamp in (100.5, 102.5):
        maker.tf(stamp, ("base", OPTICAL, stamp, (stamp - 100, 0, 1), STILL))
    capture = load_capture(maker.write(tmp_path), base_frame="base")
    assert capture.T_base_camera[0, 3] == pytest.approx(1.001)


def test_malformed_transforms_leave_the_others(tmp_path):
    maker = depth_bag("mcap", SEEN)
    bad = ("base", "other", 0.0, (np.nan, 0, 0), STILL)
    maker.tf(1.0, bad, ("base", OPTICAL, 0.0, (1, 2, 3), STILL), static=True)
    assert load_capture(maker.write(tmp_path), base_frame="base").T_base_camera[2, 3] == 3


def test_clouds_get_their_pose_or_are_base_clouds(tmp_path):
    maker = arm_bag("mcap")
    flat = SEEN.points.reshape(1, -1, 3)
    in_base = flat @ posed(102.2)[:3, :3].T + posed(102.2)[:3, 3]
    maker.cloud("/seen", 102.2, SEEN.points)
    maker.cloud("/merged", 102.2, in_base, frame_id="base_link")
    path = maker.write(tmp_path)
    seen = load_capture(path, topic="/seen", base_frame="base_link")
    assert seen.cloud_frame == "optical" and seen.warnings == ()
    np.testing.assert_allclose(seen.T_base_camera, posed(102.2), atol=1e-9)
    merged = load_capture(path, topic="/merged", base_frame="base_link")
    assert merged.cloud_frame == "base" and merged.T_base_camera is None
    assert merged.warnings == ()
    said = refused(path, topic="/seen", base_frame="base_link", cloud_frame="base")
    assert "in frame 'camera_optical_frame'; valid for cloud frame 'base': 'base_link'" in said


def test_a_base_frame_is_for_bags_alone(tmp_path):
    for path in (write_npz(tmp_path / "a.npz", SEEN), write_folder(tmp_path / "view", SEEN)):
        assert "this is no bag" in refused(path, base_frame="base")


def test_the_command_line_takes_a_base_frame(tmp_path, capsys):
    path = str(made(arm_bag("mcap"), tmp_path, "arm"))
    assert main(["objects", path, "--base-frame", "nowhere"]) == 2
    assert "frame 'nowhere' is unknown" in capsys.readouterr().err


@pytest.mark.parametrize("kind", KINDS)
def test_rvl_in_a_bag(kind, tmp_path):
    millimeters = np.round(SEEN.depth * 1000).astype(np.uint16)
    maker = BagMaker(kind).info("/camera_info", 1.0, SEEN.intrinsics)
    maker.compressed_depth("/d/compressedDepth", 1.0, millimeters, rvl_of(millimeters))
    maker.image("/color", 1.05, SEEN.rgb, "rgb8")
    capture = load_capture(maker.write(tmp_path))
    np.testing.assert_allclose(capture.depth, SEEN.depth, atol=1e-7)
    np.testing.assert_array_equal(capture.rgb, SEEN.rgb)


def test_a_damaged_color_image_is_passed_over(tmp_path):
    maker = BagMaker("mcap").info("/camera_info", 1.0, SEEN.intrinsics)
    maker.image("/depth", 1.0, SEEN.depth, "32FC1")
    maker.image("/color", 1.0, SEEN.rgb, "rgb8")
    maker.messages[-1][3].step = 3
    capture = load_capture(made(maker, tmp_path, "damaged"))
    assert capture.rgb is None
    maker.image("/color", 1.05, SEEN.rgb, "rgb8")
    np.testing.assert_array_equal(load_capture(made(maker, tmp_path, "two")).rgb, SEEN.rgb)


# All views of a topic.


@pytest.mark.parametrize("kind", KINDS)
def test_every_view_is_the_one_that_load_capture_gives(kind, tmp_path):
    path = arm_bag(kind).write(tmp_path)
    topic = "/camera/depth/image_raw"
    buffer, count = TransformBuffer(), 0
    for frame in read_frames(path, topic):
        for message, static in frame.transforms:
            buffer.add(message, static)
        T = buffer.lookup("base_link", OPTICAL, frame.stamp_ns)
        found = depth_capture(
            frame.message, frame.info, topic=frame.topic, color=frame.color, T_base_camera=T
        )
        same = load_capture(path, topic=topic, stamp=frame.stamp_ns * 1e-9, base_frame="base_link")
        for name in ("depth", "intrinsics", "rgb", "T_base_camera"):
            np.testing.assert_array_equal(getattr(found, name), getattr(same, name))
        assert not frame.is_cloud and frame.stamp_ns == round((100.001 + count) * 1e9)
        count += 1
    assert count == 3


def test_transforms_come_once_in_order_with_the_static_ones_first_told(tmp_path):
    path = arm_bag("mcap").write(tmp_path)
    told = []
    for frame in read_frames(path, "/camera/depth/image_raw"):
        ones = [(message.transforms[0], static) for message, static in frame.transforms]
        told.append([(one.child_frame_id, one.header.stamp.sec, static) for one, static in ones])
    moving = [("tool", int(stamp), False) for stamp in ARM_TIMES]
    # Each view is given once 2 s more are read.
    assert told == [[*moving[:3], (OPTICAL, 0, True)], [], [*moving[3:]]]


def test_clouds_and_views_without_camera_info_are_given_too(tmp_path):
    maker = (
        BagMaker("mcap").cloud("/points", 1.0, SEEN.points).image("/d", 1.0, SEEN.depth, "32FC1")
    )
    path = maker.write(tmp_path)
    (cloud,) = read_frames(path, "/points")
    assert cloud.is_cloud and cloud.info is None and cloud.color is None
    (depth,) = read_frames(str(path), "/d")
    assert not depth.is_cloud and depth.info is None and depth.transforms == ()


def test_without_a_topic_the_one_of_load_capture_is_read(tmp_path):
    path = depth_bag("mcap", SEEN).write(tmp_path)  # its first image is a color image
    frames = list(read_frames(path))
    assert [frame.topic for frame in frames] == ["/camera/depth/image_raw"] * 3
    (tmp_path / "none").mkdir()
    empty = BagMaker("mcap").image("/color", 1.0, SEEN.rgb, "rgb8").write(tmp_path / "none")
    with pytest.raises(CaptureError, match="/color: "):
        next(read_frames(empty))


def test_what_is_no_bag_is_refused(tmp_path):
    path = depth_bag("mcap", SEEN).write(tmp_path)
    with pytest.raises(CaptureError, match="/nowhere.*valid: /camera"):
        next(read_frames(path, "/nowhere"))
    with pytest.raises(CaptureError, match="no such file"):
        next(read_frames(tmp_path / "gone.mcap", "/d"))
    noise = tmp_path / "noise.mcap"
    noise.write_bytes(path.read_bytes()[:999])
    with pytest.raises(CaptureError, match=r"noise.mcap: damaged"):
        next(read_frames(noise, "/d"))


def test_a_long_bag_is_streamed(tmp_path, monkeypatch):
    monkeypatch.setattr(bag, "_WINDOW_NS", 200_000_000)
    depth = np.full((120, 160), 900, np.uint16)  # 38 kB, twice: it is an Image too
    maker = BagMaker("db3").info("/camera_info", 0.5, SEEN.intrinsics, size=(160, 120))
    for i in range(300):
        maker.image("/d", 1 + 0.1 * i, depth, "16UC1")
        maker.tf(1 + 0.1 * i, ("base", OPTICAL, 1 + 0.1 * i, (0, 0, 1), STILL))
    path = maker.write(tmp_path)
    del maker
    next(read_frames(path, "/d"))  # imports what reads
    tracemalloc.start()
    assert sum(1 for _ in read_frames(path, "/d")) == 300
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2e6, peak  # the bag has 11.6 MB
