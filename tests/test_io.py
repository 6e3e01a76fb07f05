from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest
from capture_files import HEIGHT, WIDTH, pcd_bytes, ply_bytes, view, write_folder, write_npz
from PIL import Image

from boxgrasp import BoxgraspError, load_capture
from boxgrasp.errors import CaptureError, MissingExtraError
from boxgrasp.io.npz import save_npz
from boxgrasp.sensing.capture import Capture

SEEN = view()
BAGS = ("ros1", "ros2_folder", "db3", "mcap")
PCD_ENCODINGS = ("ascii", "binary", "binary_compressed")
PLY_ENCODINGS = ("ascii", "binary_little_endian", "binary_big_endian")


def same(one: Capture, two: Capture, *names: str) -> None:
    for name in names:
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name), err_msg=name)


ALL = ("depth", "intrinsics", "T_base_camera", "rgb", "mask", "target_pixel")


def whole() -> Capture:
    return Capture(
        SEEN.depth,
        SEEN.intrinsics,
        SEEN.T_base_camera,
        SEEN.rgb,
        SEEN.mask,
        target_pixel=SEEN.target_pixel,
    )


def test_npz_gives_back_its_arrays(tmp_path):
    same(load_capture(write_npz(tmp_path / "view.npz", SEEN)), whole(), *ALL)
    np.savez(tmp_path / "bare.NPZ.npz", depth=SEEN.depth, intrinsics=SEEN.intrinsics, other="x")
    bare = load_capture(str(tmp_path / "bare.NPZ.npz"))
    assert bare.rgb is None and bare.mask is None and bare.T_base_camera is None
    fortran = np.asfortranarray(SEEN.depth.astype(np.float64))
    same(
        load_capture(write_npz(tmp_path / "f.npz", SEEN, depth=fortran)),
        whole(),
        "depth",
    )


def test_npz_is_written_as_it_is_read(tmp_path):
    save_npz(whole(), tmp_path / "view.npz", other=np.arange(3))
    same(load_capture(tmp_path / "view.npz"), whole(), *ALL)
    with np.load(tmp_path / "view.npz", allow_pickle=False) as archive:
        assert archive["other"].tolist() == [0, 1, 2]
    with pytest.raises(CaptureError, match="a cloud is not written"):
        save_npz(Capture.from_cloud(np.ones((4, 3))), tmp_path / "cloud.npz")
    assert not (tmp_path / "cloud.npz").exists()


def test_folder_gives_back_its_images(tmp_path):
    loaded = load_capture(write_folder(tmp_path / "view", SEEN))
    same(loaded, whole(), "intrinsics", "T_base_camera", "rgb", "mask", "target_pixel")
    np.testing.assert_allclose(loaded.depth, SEEN.depth, atol=1e-7)
    assert loaded.warnings == ()


def test_folder_takes_the_scale_it_is_told(tmp_path):
    folder = write_folder(tmp_path / "view", SEEN, scale=0.0001)
    raw = np.asarray(Image.open(folder / "depth.png"))
    assert raw.max() > 5000
    np.testing.assert_allclose(load_capture(folder).depth, SEEN.depth, atol=1e-6)


def test_folder_takes_jpeg_masks_with_alpha_and_notes_unknown_keys(tmp_path):
    folder = write_folder(tmp_path / "view", SEEN)
    (folder / "color.png").unlink()
    smooth = np.full_like(SEEN.rgb, (200, 30, 60))
    Image.fromarray(smooth).save(folder / "color.jpg", quality=95)
    rgba = np.zeros((HEIGHT, WIDTH, 4), np.uint8)
    rgba[..., 3] = 255
    rgba[SEEN.mask, 1] = 9
    Image.fromarray(rgba).save(folder / "mask.png")
    Image.fromarray(SEEN.mask).save(folder / "robot_mask.png")
    (folder / "capture.json").write_text('{"T_base_cam": []}')
    loaded = load_capture(folder)
    same(loaded, whole(), "mask")
    np.testing.assert_array_equal(loaded.robot_mask, SEEN.mask)
    np.testing.assert_allclose(loaded.rgb, smooth, atol=4)
    assert loaded.T_base_camera is None
    (warning,) = loaded.warnings
    assert warning.code == "unknown_capture_key" and "'T_base_cam'" in warning.message


def test_folder_takes_zero_distortion(tmp_path):
    folder = write_folder(tmp_path / "view", SEEN)
    camera = json.loads((folder / "intrinsics.json").read_text())
    for zero in ({"k1": 0}, {"D": [0, 0.0]}, {"distortion": {"k1": 0}}, {"distortion_model": "x"}):
        (folder / "intrinsics.json").write_text(json.dumps({**camera, **zero}))
        assert not load_capture(folder).warnings


@pytest.mark.parametrize("encoding", PCD_ENCODINGS)
@pytest.mark.parametrize("rgb_type", ["F", "U"])
def test_pcd_gives_back_its_points(tmp_path, encoding, rgb_type):
    if encoding == "ascii" and rgb_type == "F":
        rgb_type = "U"  # as text a packed float loses nothing, but PCL writes whole numbers
    path = tmp_path / "cloud.pcd"
    path.write_bytes(
        pcd_bytes(SEEN.points, encoding, rgb=SEEN.rgb, rgb_type=rgb_type, organized=True)
    )
    organized = load_capture(path)
    expected = Capture.from_cloud(SEEN.points, colors=SEEN.rgb)
    same(organized, expected, "points", "colors")
    assert organized.shape == (HEIGHT, WIDTH) and organized.cloud_frame == "optical"
    path.write_bytes(pcd_bytes(SEEN.points, encoding, rgb=SEEN.rgb, rgb_type=rgb_type))
    loose = load_capture(path, cloud_frame="base")
    flat = SEEN.points.reshape(-1, 3)
    expected = Capture.from_cloud(flat, colors=SEEN.rgb.reshape(-1, 3), cloud_frame="base")
    same(loose, expected, "points", "colors")
    assert loose.shape is None and not loose.has_camera


def test_pcd_as_text_may_be_untidy(tmp_path):
    points = np.array([[0.1, 0.2, 1.0], [0.3, 0.1, 1.5]], np.float32)
    tidy = pcd_bytes(points, "ascii")
    head, body = tidy.split(b"DATA ascii\n")
    path = tmp_path / "cloud.pcd"
    for text in (body.replace(b" ", b"  "), b"\t" + body, body.replace(b"\n", b" \r\n\n")):
        path.write_bytes(head + b"DATA ascii\n" + text)
        np.testing.assert_array_equal(load_capture(path).points, points)
    path.write_bytes(tidy.replace(b"\n", b"\r\n"))
    np.testing.assert_array_equal(load_capture(path).points, points)


def test_pcd_viewpoint_is_the_cameras_pose_in_the_points_frame(tmp_path):
    from scipy.spatial.transform import Rotation

    T = SEEN.T_base_camera
    x, y, z, w = Rotation.from_matrix(T[:3, :3]).as_quat()
    flat = SEEN.points[np.isfinite(SEEN.points[..., 0])]
    in_base = (flat @ T[:3, :3].T + T[:3, 3]).astype(np.float32)
    pose = " ".join(repr(float(n)) for n in (*T[:3, 3], w, x, y, z))
    path = tmp_path / "cloud.pcd"
    path.write_bytes(pcd_bytes(in_base, "binary", viewpoint=pose))
    capture = load_capture(path)
    assert capture.cloud_frame == "base" and capture.has_camera and capture.warnings == ()
    np.testing.assert_allclose(capture.T_base_camera, T, atol=1e-12)
    same(capture, Capture.from_cloud(in_base, cloud_frame="base"), "points")


@pytest.mark.parametrize("encoding", PLY_ENCODINGS)
def test_ply_gives_back_its_points(tmp_path, encoding):
    flat = SEEN.points[np.isfinite(SEEN.points[..., 0])]
    rgb = SEEN.rgb[np.isfinite(SEEN.points[..., 0])]
    path = tmp_path / "cloud.ply"
    path.write_bytes(ply_bytes(flat, encoding, rgb=rgb))
    same(load_capture(path), Capture.from_cloud(flat, colors=rgb), "points", "colors")
    path.write_bytes(ply_bytes(flat, encoding))
    assert load_capture(path).colors is None


def test_ply_reads_what_another_library_writes(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    flat = SEEN.points[np.isfinite(SEEN.points[..., 0])]
    rgb = SEEN.rgb[np.isfinite(SEEN.points[..., 0])]
    cloud = trimesh.PointCloud(flat, colors=rgb)
    for encoding in ("ascii", "binary"):
        path = tmp_path / f"{encoding}.ply"
        path.write_bytes(trimesh.exchange.ply.export_ply(cloud, encoding=encoding))
        loaded = load_capture(path)
        expected = Capture.from_cloud(flat, colors=rgb)
        # as text trimesh writes eight decimals
        np.testing.assert_allclose(loaded.points, expected.points, atol=1e-6)
        same(loaded, expected, "colors")


def test_pcd_reads_what_another_library_writes(tmp_path):
    pypcd4 = pytest.importorskip("pypcd4")
    flat = SEEN.points[np.isfinite(SEEN.points[..., 0])]
    rgb = SEEN.rgb[np.isfinite(SEEN.points[..., 0])]
    packed = pypcd4.PointCloud.encode_rgb(rgb)
    cloud = pypcd4.PointCloud.from_xyzrgb_points(np.hstack([flat, packed.reshape(-1, 1)]))
    for encoding in pypcd4.Encoding:
        path = tmp_path / f"{encoding.value}.pcd"
        cloud.save(path, encoding)
        if encoding.value == "binaryscompressed":
            continue  # a name of its own for compressed data
        expected = Capture.from_cloud(flat, colors=rgb)
        same(load_capture(path), expected, "points", *["colors"][: encoding.value != "ascii"])


def test_folder_may_hold_a_cloud(tmp_path):
    (tmp_path / "cloud.pcd").write_bytes(pcd_bytes(SEEN.points, "binary", organized=True))
    same(load_capture(tmp_path), Capture.from_cloud(SEEN.points), "points")


@pytest.fixture(params=BAGS)
def bag_kind(request):
    pytest.importorskip("rosbags")
    return request.param


def test_bag_gives_its_first_depth_image_with_camera_and_color(tmp_path, bag_kind):
    from bag_files import depth_bag

    capture = load_capture(depth_bag(bag_kind, SEEN).write(tmp_path))
    same(capture, whole(), "intrinsics", "rgb")
    np.testing.assert_allclose(capture.depth, SEEN.depth, atol=1e-7)
    assert capture.T_base_camera is None


def test_bag_gives_the_message_nearest_to_a_stamp(tmp_path, bag_kind):
    from bag_files import depth_bag

    path = depth_bag(bag_kind, SEEN).write(tmp_path)
    valid = SEEN.depth > 0
    for stamp, moved in ((99.5, 0.0), (101.2, 0.1), (101.9, 0.2)):
        capture = load_capture(path, stamp=stamp)
        np.testing.assert_allclose(capture.depth[valid], SEEN.depth[valid] + moved, atol=1e-6)
        assert capture.intrinsics[0, 0] == SEEN.intrinsics[0, 0] + round(moved * 10)
    for stamp in (90.0, 104.0, float("nan")):
        with pytest.raises(CaptureError, match="stamp"):
            load_capture(path, stamp=stamp)


def test_bag_gives_the_topic_asked_for(tmp_path, bag_kind):
    from bag_files import depth_bag

    maker = depth_bag(bag_kind, SEEN)
    maker.cloud("/points", 103.0, SEEN.points, rgb=SEEN.rgb, padding=4)
    maker.cloud("/robot/points", 103.1, SEEN.points.reshape(1, -1, 3), frame_id="base_link")
    path = maker.write(tmp_path)
    cloud = load_capture(path, topic="/points")
    same(cloud, Capture.from_cloud(SEEN.points, colors=SEEN.rgb), "points", "colors")
    assert cloud.warnings == () and cloud.shape == (HEIGHT, WIDTH)
    loose = load_capture(path, topic="/robot/points")
    same(loose, Capture.from_cloud(SEEN.points.reshape(-1, 3)), "points")
    (warning,) = loose.warnings
    assert warning.code == "frame_taken_as_optical" and "'base_link'" in warning.message
    base = load_capture(path, topic="/robot/points", cloud_frame="base")
    assert base.warnings == () and not base.has_camera
    with pytest.raises(CaptureError, match="/nowhere.*valid: .*/camera/depth/image_raw"):
        load_capture(path, topic="/nowhere")
    with pytest.raises(CaptureError, match="rgb8.*valid: 16UC1"):
        load_capture(path, topic="/camera/color/image_raw")


def test_bag_reads_meters_big_endian_and_compressed_depth(tmp_path, bag_kind):
    from bag_files import BagMaker

    millimeters = np.round(SEEN.depth * 1000).astype(np.uint16)
    meters = np.where(SEEN.depth > 0, SEEN.depth, np.nan).astype(np.float32)
    maker = BagMaker(bag_kind)
    maker.info("/camera_info", 1.0, SEEN.intrinsics)
    maker.image("/meters", 1.0, meters, "32FC1")
    maker.image("/big", 1.0, millimeters, "16UC1", big=True)
    maker.compressed_depth("/packed/compressedDepth", 1.0, millimeters)
    path = maker.write(tmp_path)
    same(load_capture(path, topic="/meters"), whole(), "depth")
    for topic in ("/big", "/packed/compressedDepth"):
        np.testing.assert_allclose(load_capture(path, topic=topic).depth, SEEN.depth, atol=1e-7)


def test_bag_refuses_strong_distortion_but_takes_a_rectified_topic(tmp_path, bag_kind):
    from bag_files import BagMaker

    maker = BagMaker(bag_kind)
    maker.info("/d/camera_info", 1.0, SEEN.intrinsics, D=(-9.0, 0, 0, 0, 0))
    maker.image("/d/image_raw", 1.0, SEEN.depth, "32FC1")
    (tmp_path / "raw").mkdir()
    with pytest.raises(BoxgraspError, match="distortion.*rectified"):
        load_capture(maker.write(tmp_path / "raw"))
    maker.image("/d/image_rect_raw", 2.0, SEEN.depth, "32FC1")
    capture = load_capture(maker.write(tmp_path))
    same(capture, whole(), "depth", "intrinsics")


def test_bag_takes_a_camera_info_told_once_and_no_far_color(tmp_path, bag_kind):
    from bag_files import BagMaker

    maker = BagMaker(bag_kind)
    maker.info("/camera_info", 1.0, SEEN.intrinsics)
    maker.image("/color", 99.0, SEEN.rgb, "bgr8")
    maker.image("/other", 100.0, SEEN.rgb, "rgb8", frame_id="color_optical_frame")
    maker.image("/depth", 100.0, SEEN.depth, "32FC1")
    capture = load_capture(maker.write(tmp_path))
    same(capture, whole(), "depth", "intrinsics")
    assert capture.rgb is None
    (tmp_path / "near").mkdir()
    maker.image("/color", 100.05, SEEN.rgb[..., ::-1], "bgr8")
    same(load_capture(maker.write(tmp_path / "near")), whole(), "rgb")


def test_bag_says_what_is_missing(tmp_path, bag_kind):
    from bag_files import BagMaker

    cases = {
        "no message to use": BagMaker(bag_kind).info("/camera_info", 1.0, SEEN.intrinsics),
        "no CameraInfo": BagMaker(bag_kind).image("/depth", 1.0, SEEN.depth, "32FC1"),
        "is for 31 x 24": BagMaker(bag_kind)
        .info("/camera_info", 1.0, SEEN.intrinsics, size=(31, HEIGHT))
        .image("/depth", 1.0, SEEN.depth, "32FC1"),
    }
    for i, (message, maker) in enumerate(cases.items()):
        (tmp_path / str(i)).mkdir()
        with pytest.raises(CaptureError, match=message):
            load_capture(maker.write(tmp_path / str(i)))


def test_bag_without_rosbags_names_the_extra(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rosbags.rosbag1", None)
    (tmp_path / "view.bag").write_bytes(b"#ROSBAG V2.0\n")
    with pytest.raises(
        MissingExtraError, match=r"view.bag: .* rosbags; .* pip install 'boxgrasp\[io\]'"
    ):
        load_capture(tmp_path / "view.bag")


@pytest.mark.parametrize("bag_kind", ["ros1", "db3"], indirect=True)
def test_a_bags_own_definitions_are_not_used(tmp_path, bag_kind):
    """rosbags compiles definitions to Python code, so a stranger's must not get there."""
    from bag_files import depth_bag

    path = depth_bag(bag_kind, SEEN).write(tmp_path)
    data = path.read_bytes()
    assert b"string encoding" in data
    path.write_bytes(data.replace(b"string encoding", b"import encoding"))
    np.testing.assert_allclose(load_capture(path).depth, SEEN.depth, atol=1e-7)


def test_real_captures_load(captures_dir):
    for name in sorted(p.name for p in captures_dir.iterdir() if p.is_dir()):
        capture = load_capture(captures_dir / name)
        points, _ = capture.valid_points()
        assert len(points) > 20_000 and np.isfinite(points).all(), name
    assert load_capture(captures_dir / "6dofgn_cheezit").mask.sum() > 1000
    haf = load_capture(captures_dir / "haf_table1" / "cloud.pcd", cloud_frame="base")
    assert len(haf.points) == 102_876 and not haf.has_camera and haf.colors is None
    indus = load_capture(captures_dir / "indus_table" / "cloud.ply", cloud_frame="base")
    assert len(indus.points) == 23_239 and indus.colors.std() > 1


def test_simulated_captures_load(captures_dir):
    for i in (1, 2, 3):
        path = captures_dir / f"simulated_{i}.npz"
        capture = load_capture(path)
        with np.load(path) as arrays:
            assert len(capture.valid_points()[0]) == np.count_nonzero(
                (arrays["depth"] > 0) & (arrays["depth"] <= 65.535)
            )
        assert capture.target_pixel is not None and capture.T_base_camera is not None
        codes = ["depth_negative", "depth_beyond_range"] if i == 3 else []
        assert [warning.code for warning in capture.warnings] == codes
    assert "175 negative" in capture.warnings[0].message


def test_readers_import_only_what_the_format_needs(tmp_path):
    path = write_npz(tmp_path / "view.npz", SEEN)
    code = (
        "import sys; from boxgrasp import load_capture; load_capture(sys.argv[1]);"
        "heavy = {'rosbags', 'pypcd4', 'PIL', 'pydantic', 'scipy'} & set(sys.modules);"
        "sys.exit(str(heavy) if heavy else 0)"
    )
    subprocess.run([sys.executable, "-c", code, str(path)], check=True, timeout=60)
