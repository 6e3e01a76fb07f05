"""ROS messages as captures; messages are plain objects, so that no ROS and no rosbags is needed."""

from __future__ import annotations

import io
import struct
from array import array
from types import SimpleNamespace as Message
from typing import Any

import numpy as np
import pytest
from capture_files import HEIGHT, WIDTH, view
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from boxgrasp.errors import CaptureError
from boxgrasp.io.messages import (
    cloud_capture,
    depth_capture,
    is_color,
    nearest_color,
    read_cloud,
    read_color,
    read_compressed_depth,
    read_depth,
    read_intrinsics,
    read_lens,
    read_mask,
    stamp_ns,
)
from boxgrasp.kernels import rvl
from boxgrasp.sensing.capture import Capture

SEEN = view()
HOLDERS = {
    "bytes": bytes,
    "array": lambda data: array("B", data),
    "numpy": lambda data: np.frombuffer(data, np.uint8),
    "memoryview": memoryview,
}
MILLIMETERS = np.round(SEEN.depth * 1000).astype(np.uint16)
DATATYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
quick = settings(max_examples=60, deadline=None)
seeds = st.integers(0, 2**32 - 1)
holders = st.sampled_from(sorted(HOLDERS))


def order_of(big: bool) -> str:
    return ">" if big else "<"


def rows_of(pixels: np.ndarray, padding: int) -> list[bytes]:
    return [np.ascontiguousarray(row).tobytes() + b"\xa5" * padding for row in pixels]


def image_message(
    pixels: np.ndarray, encoding: str, *, big: bool = False, padding: int = 0, holder: str = "bytes"
) -> Message:
    rows = rows_of(pixels.astype(pixels.dtype.newbyteorder(order_of(big))), padding)
    return Message(
        header=header(),
        height=pixels.shape[0],
        width=pixels.shape[1],
        encoding=encoding,
        is_bigendian=int(big),
        step=len(rows[0]),
        data=HOLDERS[holder](b"".join(rows)),
    )


def compressed_message(
    told: str, data: bytes, holder: str = "bytes", head: bytes = bytes(12)
) -> Message:
    return Message(header=header(), format=told, data=HOLDERS[holder](head + data))


def header(stamp: int = 0, frame_id: str = "camera_optical_frame") -> Message:
    seconds, nanoseconds = divmod(stamp, 1_000_000_000)
    return Message(frame_id=frame_id, stamp=Message(sec=seconds, nanosec=nanoseconds))


def png_of(millimeters: np.ndarray) -> bytes:
    held = io.BytesIO()
    Image.fromarray(millimeters).save(held, "PNG")
    return held.getvalue()


def nibbles_of(number: int) -> list[int]:
    """Three bits a nibble, lowest first; 8 is added where more follow."""
    found = []
    while number > 7:
        found.append(8 + number % 8)
        number //= 8
    return [*found, number]


def rvl_stream(pixels: list[int]) -> bytes:
    """As the paper has it: runs of zeros and of others, the others as differences folded to 0, 1,
    2, ... for 0, -1, 1, ...; nibbles from the high end of little-endian words of 32 bits."""
    nibbles, at, before = [], 0, 0
    while at < len(pixels):
        start = at
        while at < len(pixels) and pixels[at] == 0:
            at += 1
        nibbles += nibbles_of(at - start)
        start = at
        while at < len(pixels) and pixels[at] != 0:
            at += 1
        nibbles += nibbles_of(at - start)
        for value in pixels[start:at]:
            change = value - before
            nibbles += nibbles_of(2 * change if change >= 0 else -2 * change - 1)
            before = value
    nibbles += [0] * (-len(nibbles) % 8)
    text = "".join(f"{nibble:x}" for nibble in nibbles)
    return b"".join(bytes.fromhex(text[i : i + 8])[::-1] for i in range(0, len(text), 8))


def rvl_of(millimeters: np.ndarray) -> bytes:
    height, width = millimeters.shape
    return struct.pack("<II", width, height) + rvl_stream(millimeters.ravel().tolist())


CODINGS = {"png": png_of, "rvl": rvl_of}


def unpack_naive(words: list[int], count: int) -> list[int] | None:
    """Pixels of a stream, or None for a broken one: the twin of the kernel, written to be read."""
    nibbles = iter([int(digit, 16) for word in words for digit in f"{word:08x}"])

    def number() -> int:
        digits = [next(nibbles)]
        while digits[-1] >= 8:
            digits.append(next(nibbles))
        if len(digits) > 10:
            raise ValueError("longer than any image")
        return sum((digit % 8) * 8**k for k, digit in enumerate(digits))

    pixels: list[int] = []
    value = 0
    try:
        while len(pixels) < count:
            zeros = number()
            if zeros > count - len(pixels):
                return None
            pixels += [0] * zeros
            others = number() if len(pixels) < count else 0
            if others > count - len(pixels):
                return None
            for _ in range(others):
                folded = number()
                value += folded // 2 if folded % 2 == 0 else -(folded + 1) // 2
                if not 0 <= value < 65536:
                    return None
                pixels.append(value)
    except (StopIteration, ValueError):
        return None
    return pixels


def info_message(upper: bool = False, **changes: Any) -> Message:
    fields = {
        "k": SEEN.intrinsics.reshape(9),
        "d": np.zeros(5),
        "p": np.hstack([SEEN.intrinsics + np.diag([1, 1, 0]), np.ones((3, 1))]).reshape(12),
    }
    fields.update({name: value for name, value in changes.items() if name in fields})
    size = {"width": WIDTH, "height": HEIGHT}
    size.update({name: value for name, value in changes.items() if name in size})
    model = changes.get("distortion_model", "plumb_bob")
    return Message(
        **size,
        distortion_model=model,
        **{n.upper() if upper else n: value for n, value in fields.items()},
    )


def cloud_message(
    columns: dict[str, tuple[np.ndarray, int]],
    point_step: int,
    *,
    big: bool = False,
    padding: int = 0,
    holder: str = "bytes",
) -> Message:
    """Columns are (H, W) arrays with offsets, written value by value."""
    height, width = next(iter(columns.values()))[0].shape
    cells = np.full((height, width, point_step), 0xA5, np.uint8)
    fields = []
    for name, (values, offset) in columns.items():
        ordered = values.astype(values.dtype.newbyteorder(order_of(big)))
        size = ordered.dtype.itemsize
        cells[..., offset : offset + size] = np.frombuffer(ordered.tobytes(), np.uint8).reshape(
            height, width, size
        )
        (datatype,) = (n for n, kind in DATATYPES.items() if values.dtype == np.dtype(kind))
        fields.append(Message(name=name, offset=offset, datatype=datatype, count=1))
    rows = rows_of(cells, padding)
    return Message(
        header=header(),
        height=height,
        width=width,
        fields=fields,
        is_bigendian=big,
        point_step=point_step,
        row_step=len(rows[0]),
        data=HOLDERS[holder](b"".join(rows)),
    )


def plain_cloud(**changes: Any) -> Message:
    columns = {axis: (SEEN.points[..., i], 4 * i) for i, axis in enumerate("xyz")}
    message = cloud_message(columns, 16)
    message.__dict__.update(changes)
    return message


# What messages say is what is read.


@quick
@given(
    seed=seeds,
    height=st.integers(1, 7),
    width=st.integers(1, 7),
    encoding=st.sampled_from(["16UC1", "mono16", "32FC1"]),
    big=st.booleans(),
    padding=st.integers(0, 9),
    holder=holders,
)
def test_depth_images_give_their_meters(seed, height, width, encoding, big, padding, holder):
    rng = np.random.default_rng(seed)
    if encoding == "32FC1":
        pixels = rng.uniform(0.1, 5, (height, width)).astype(np.float32)
        pixels[rng.random(pixels.shape) < 0.3] = rng.choice([np.nan, np.inf, -np.inf, 0])
        expected = pixels
    else:
        pixels = rng.integers(0, 65536, (height, width)).astype(np.uint16)
        expected = (pixels / 1000).astype(np.float32)
    message = image_message(pixels, encoding, big=big, padding=padding, holder=holder)
    depth = read_depth(message)
    assert depth.dtype == np.float32 and depth.dtype.isnative and not depth.flags.writeable
    np.testing.assert_allclose(depth, expected, rtol=1e-6)


@quick
@given(
    seed=seeds,
    encoding=st.sampled_from(["rgb8", "bgr8", "rgba8", "bgra8"]),
    padding=st.integers(0, 9),
    holder=holders,
)
def test_color_images_give_red_green_blue(seed, encoding, padding, holder):
    rgb = np.random.default_rng(seed).integers(0, 256, (3, 5, 3)).astype(np.uint8)
    pixels = rgb[..., ::-1] if encoding.startswith("bgr") else rgb
    if "a" in encoding:
        pixels = np.concatenate([pixels, np.full((3, 5, 1), 7, np.uint8)], axis=-1)
    message = image_message(pixels, encoding, padding=padding, holder=holder)
    assert is_color(message) and not is_color(image_message(rgb, "mono8"))
    np.testing.assert_array_equal(read_color(message), rgb)


@pytest.mark.parametrize("holder", HOLDERS)
@pytest.mark.parametrize("coding", CODINGS)
def test_compressed_depth_gives_its_meters(coding, holder):
    data = CODINGS[coding](MILLIMETERS)
    message = compressed_message(f"16UC1; compressedDepth {coding}", data, holder)
    depth = read_compressed_depth(message)
    assert depth.dtype == np.float32 and not depth.flags.writeable
    np.testing.assert_allclose(depth, SEEN.depth, atol=1e-7)


def test_compressed_depth_of_unnamed_coding_is_a_png():
    for told in ("16UC1", "16UC1; compressedDepth"):
        depth = read_compressed_depth(compressed_message(told, png_of(MILLIMETERS)))
        np.testing.assert_allclose(depth, SEEN.depth, atol=1e-7)


@quick
@given(
    seed=seeds,
    height=st.integers(1, 9),
    width=st.integers(1, 40),
    missing=st.sampled_from([0.0, 0.1, 0.9, 1.0]),
    farthest=st.sampled_from([2, 900, 65536]),
)
def test_rvl_gives_back_what_was_packed(seed, height, width, missing, farthest):
    rng = np.random.default_rng(seed)
    pixels = rng.integers(1, farthest, (height, width)).astype(np.uint16)
    pixels[rng.random(pixels.shape) < missing] = 0
    depth = read_compressed_depth(compressed_message("16UC1; compressedDepth rvl", rvl_of(pixels)))
    np.testing.assert_array_equal(depth, (pixels * 0.001).astype(np.float32))


def inverse_depth(
    meters: np.ndarray, farthest_m: float = 10.0, finest: float = 100.0
) -> tuple[np.ndarray, bytes]:
    """(H, W) uint16 and the header, as compressed_depth_image_transport's page on 32FC1 has it."""
    a = np.float32(finest * (finest + 1))
    b = np.float32(1 - a / farthest_m)
    values = np.zeros(meters.shape, np.uint16)
    held = meters < farthest_m  # not NaN
    values[held] = np.minimum(a / meters[held] + b, 65535).astype(np.uint16)
    return values, struct.pack("<iff", 0, a, b)


@pytest.mark.parametrize("coding", CODINGS)
@quick
@given(seed=seeds, farthest_m=st.sampled_from([3.0, 10.0, 40.0]), holder=holders)
def test_compressed_meters_come_back_as_finely_as_they_were_sent(coding, seed, farthest_m, holder):
    rng = np.random.default_rng(seed)
    meters = rng.uniform(0.3, 1.2 * farthest_m, (5, 7)).astype(np.float32)
    meters[rng.random(meters.shape) < 0.2] = np.nan
    values, head = inverse_depth(meters, farthest_m)
    told = f"32FC1; compressedDepth {coding}"
    depth = read_compressed_depth(compressed_message(told, CODINGS[coding](values), holder, head))
    assert depth.dtype == np.float32 and not depth.flags.writeable
    held = meters < farthest_m
    np.testing.assert_array_equal(np.isfinite(depth), held)
    step_m = meters[held] ** 2 / 10100 * 1.05 + 1e-5  # of one whole number
    assert (depth[held] >= meters[held] - 1e-4).all()
    assert (depth[held] - meters[held] <= step_m).all()


def test_inverse_depth_is_as_worked_out_by_hand():
    values = np.array([[0, 1, 2, 11, 65535]], np.uint16)
    for a, b, expected in (
        (10.0, 1.0, [np.nan, np.nan, 10, 1, 10 / 65534]),  # 1 is B: nothing within range
        (10.0, -9.0, [np.nan, 1, 10 / 11, 0.5, 10 / 65544]),
    ):
        message = compressed_message(
            "32FC1; compressedDepth", png_of(values), head=struct.pack("<iff", -1, a, b)
        )
        np.testing.assert_allclose(read_compressed_depth(message)[0], expected, rtol=1e-6)


@pytest.mark.parametrize(
    "a, b", [(0, 1), (-1, 0), (np.nan, 0), (np.inf, 0), (1, np.nan), (1, -np.inf), (1, 1.5)]
)
def test_inverse_depth_of_other_numbers_is_refused(a, b):
    head = struct.pack("<iff", 0, a, b)
    message = compressed_message("32FC1; compressedDepth png", png_of(MILLIMETERS), head=head)
    assert "valid: A above 0, B at most 1, finite" in refused(read_compressed_depth, message)


@pytest.mark.parametrize("encoding", ["mono8", "8UC1"])
def test_masks_are_true_where_they_are_not_black(encoding):
    pixels = np.array([[0, 1, 0], [255, 0, 7]], np.uint8)
    mask = read_mask(image_message(pixels, encoding, padding=3, holder="array"))
    assert mask.dtype == np.bool_ and not mask.flags.writeable
    np.testing.assert_array_equal(mask, pixels != 0)
    assert "valid: mono8, 8UC1" in refused(read_mask, image_message(SEEN.rgb, "rgb8"))


def test_stamps_are_of_either_ros():
    assert stamp_ns(Message(header=header(1_700_000_000_000_000_123))) == 1_700_000_000_000_000_123
    ros1 = Message(header=Message(stamp=Message(secs=3, nsecs=4)))
    assert stamp_ns(ros1) == 3_000_000_004
    for stamp in (
        Message(sec=1, nanosec=1_000_000_000),
        Message(sec=-1, nanosec=0),
        Message(sec=1, nanosec=-1),
        Message(sec=1 << 32, nanosec=0),
        Message(sec=1.5, nanosec=0),
        Message(sec=1),
        None,
    ):
        refused(stamp_ns, Message(header=Message(stamp=stamp)))


def test_rvl_of_the_smallest_images_is_as_worked_out_by_hand():
    # No zeros, 2 others: 5 (folded 10: 2 more, 1) and 4 (folded 1).
    words = np.array([0x02A11000], np.uint32)
    pixels = np.zeros(2, np.uint16)
    assert rvl.unpack(words, pixels) == 2 and pixels.tolist() == [5, 4]
    # 9 zeros (1 more, 1), with and without the 0 others that follow.
    for word in (0x91000000, 0x91FFFFFF):
        nine = np.ones(9, np.uint16)
        assert rvl.unpack(np.array([word], np.uint32), nine) == 9 and not nine.any()


@settings(max_examples=300, deadline=None)
@given(
    words=st.lists(st.integers(0, 2**32 - 1) | st.sampled_from([0, 0x01010101, 2**32 - 1])),
    count=st.integers(1, 60),
)
def test_rvl_equals_its_naive_twin_on_any_words(words, count):
    guarded = np.full(count + 2, 7, np.uint16)
    filled = rvl.unpack(np.array(words, np.uint32), guarded[1:-1])
    naive = unpack_naive(words, count)
    assert (filled < 0) == (naive is None)
    if naive is not None:
        assert filled == count and guarded[1:-1].tolist() == naive
    assert guarded[0] == guarded[-1] == 7


@pytest.mark.parametrize("upper", [False, True], ids=["ros2", "ros1"])
def test_camera_info_gives_k_and_p_where_rectified(upper):
    size = (WIDTH, HEIGHT)
    K = read_intrinsics(info_message(upper), "/camera_info", "/depth/image_raw", size)
    np.testing.assert_array_equal(K, SEEN.intrinsics)
    bent = info_message(upper, d=array("d", [0.1, 0, 0, 0, 0]))
    rectified = read_intrinsics(bent, "/camera_info", "/depth/image_rect", size)
    np.testing.assert_array_equal(rectified, SEEN.intrinsics + np.diag([1, 1, 0]))
    assert read_lens(bent, "/camera_info", "/depth/image_rect") is None
    lens = read_lens(bent, "/camera_info", "/depth/image_raw")
    assert lens is not None and lens.coefficients == (0.1, 0, 0, 0, 0)
    none = info_message(upper, d=[])
    np.testing.assert_array_equal(read_intrinsics(none, "i", "/depth/image_raw", size), K)


@st.composite
def clouds(draw: Any) -> tuple[dict[str, tuple[np.ndarray, int]], int]:
    """Columns at offsets that do not overlap, in any order, and the bytes of a point."""
    rng = np.random.default_rng(draw(seeds))
    shape = draw(st.integers(1, 4)), draw(st.integers(1, 4))
    floats = st.sampled_from(["f4", "f8"])
    kinds = {axis: draw(floats) for axis in "xyz"}
    kinds |= draw(st.sampled_from([{}, {"rgb": "f4"}, {"rgba": "u4"}, {"rgb": "u4"}]))
    others = st.dictionaries(st.sampled_from("abc"), st.sampled_from(sorted(DATATYPES.values())))
    kinds |= draw(others)
    columns, offset = {}, 0
    for name in draw(st.permutations(sorted(kinds))):
        kind = np.dtype(kinds[name])
        offset += draw(st.integers(0, 3))
        if name in "xyz":
            values = rng.uniform(0.1, 3, shape).astype(kind)
            values[rng.random(shape) < 0.2] = np.nan
        else:
            values = np.frombuffer(rng.bytes(kind.itemsize * shape[0] * shape[1]), kind)
            values = values.reshape(shape)
        columns[name] = (values, offset)
        offset += kind.itemsize
    return columns, offset + draw(st.integers(0, 5))


@quick
@given(cloud=clouds(), big=st.booleans(), padding=st.integers(0, 9), holder=holders)
def test_clouds_of_any_layout_give_their_points_and_colors(cloud, big, padding, holder):
    columns, point_step = cloud
    message = cloud_message(columns, point_step, big=big, padding=padding, holder=holder)
    points, colors = read_cloud(message)
    expected = np.stack([columns[axis][0] for axis in "xyz"], axis=-1)
    np.testing.assert_array_equal(points, expected[0] if message.height == 1 else expected)
    assert not points.flags.writeable
    packed = columns.get("rgb", columns.get("rgba"))
    if packed is None:
        assert colors is None
    else:
        bits = packed[0].reshape(-1).copy().view(np.uint32)
        np.testing.assert_array_equal(colors, np.stack([bits >> s & 255 for s in (16, 8, 0)], 1))


@pytest.mark.parametrize("padding", [0, 5])
def test_points_and_depth_lie_in_the_messages_memory_where_they_can(padding):
    columns = {axis: (SEEN.points[..., i], 4 * i + 4) for i, axis in enumerate("xyz")}
    cloud = cloud_message(columns, 20, padding=padding, holder="array")
    assert np.shares_memory(read_cloud(cloud)[0], np.frombuffer(cloud.data, np.uint8))
    meters = image_message(SEEN.depth, "32FC1", padding=padding, holder="array")
    assert np.shares_memory(read_depth(meters), np.frombuffer(meters.data, np.uint8))


def test_clouds_become_captures_with_pose_and_warning():
    for message in (plain_cloud(), plain_cloud(is_bigendian=0)):
        capture = cloud_capture(message, "optical")
        np.testing.assert_array_equal(capture.points, Capture.from_cloud(SEEN.points).points)
        assert capture.shape == (HEIGHT, WIDTH) and capture.warnings == ()
    named = plain_cloud(header=Message(frame_id="base_link"))
    (warning,) = cloud_capture(named, "optical").warnings
    assert warning.code == "frame_taken_as_optical" and "'base_link'" in warning.message
    posed = cloud_capture(named, "base", SEEN.T_base_camera)
    np.testing.assert_array_equal(posed.T_base_camera, SEEN.T_base_camera)
    assert not [w for w in posed.warnings if w.code == "frame_taken_as_optical"]


@pytest.mark.parametrize("coding", ["raw", *CODINGS])
def test_depth_images_become_captures(coding):
    if coding == "raw":
        depth = image_message(MILLIMETERS, "16UC1")
    else:
        depth = compressed_message(f"16UC1; compressedDepth {coding}", CODINGS[coding](MILLIMETERS))
    color, arm = image_message(SEEN.rgb, "rgb8"), np.zeros((HEIGHT, WIDTH), bool)
    arm[:3] = True
    given = {"color": color, "T_base_camera": SEEN.T_base_camera, "robot_mask": arm}
    found = depth_capture(depth, info_message(), topic="/d/image_raw", **given)
    same = Capture(
        (MILLIMETERS * 0.001).astype(np.float32),
        SEEN.intrinsics,
        SEEN.T_base_camera,
        SEEN.rgb,
        robot_mask=arm,
    )
    for name in ("depth", "intrinsics", "T_base_camera", "rgb", "robot_mask", "warnings"):
        np.testing.assert_array_equal(getattr(found, name), getattr(same, name))
    bare = depth_capture(depth, info_message())
    assert bare.rgb is None and bare.T_base_camera is None and bare.robot_mask is None
    bent = info_message(d=[0.1])
    tail = "" if coding == "raw" else "/compressedDepth"
    rectified = depth_capture(depth, bent, topic=f"/d/image_rect{tail}")
    np.testing.assert_array_equal(rectified.intrinsics, SEEN.intrinsics + np.diag([1, 1, 0]))
    with pytest.raises(CaptureError, match="CameraInfo of '/d/image_raw' has lens distortion"):
        depth_capture(depth, bent, topic="/d/image_raw")
    with pytest.raises(CaptureError, match="CameraInfo has lens distortion"):
        depth_capture(depth, bent)


def test_color_and_masks_must_fit_the_depth():
    depth = image()
    other = image_message(SEEN.rgb, "rgb8")
    other.header = header(frame_id="color_optical_frame")
    said = "color is in frame 'color_optical_frame'; valid: 'camera_optical_frame', registered"
    with pytest.raises(CaptureError, match=said):
        depth_capture(depth, info_message(), color=other)
    with pytest.raises(CaptureError, match="rgb has shape"):
        depth_capture(depth, info_message(), color=image_message(SEEN.rgb[1:], "rgb8"))
    with pytest.raises(CaptureError, match="robot_mask has shape"):
        depth_capture(depth, info_message(), robot_mask=np.zeros((3, 4), bool))
    with pytest.raises(CaptureError, match="T_base_camera"):
        depth_capture(depth, info_message(), T_base_camera=np.zeros((4, 4)))


def colored(stamp: int, **changes: Any) -> Message:
    message = image_message(SEEN.rgb, "rgb8")
    message.header = header(stamp)
    message.__dict__.update(changes)
    return message


@pytest.mark.parametrize("coding", ["raw", *CODINGS])
def test_the_color_image_is_the_nearest_that_fits(coding):
    depth, near = image(), 100_000_000
    if coding != "raw":
        depth = compressed_message(f"16UC1; compressedDepth {coding}", CODINGS[coding](MILLIMETERS))
    depth.header = header(10 * near)
    exact = 10 * near
    first, second = colored(exact - 5), colored(exact + 5)
    assert nearest_color([colored(exact - 9), first, second, colored(exact + 99)], depth) is first
    assert nearest_color(iter([second, first]), depth) is second
    assert nearest_color([colored(exact + near - 1)], depth) is not None
    for unfit in (
        colored(exact + near),
        colored(exact - near),
        colored(exact, header=header(exact, "color_optical_frame")),
        colored(exact, encoding="mono8"),
        colored(exact, width=WIDTH - 1),
        colored(exact, data=bytes(5)),
        colored(exact, header=None),
        colored(exact, encoding=3),
        None,
        Message(),
    ):
        assert nearest_color([unfit], depth) is None
        assert nearest_color([unfit, first], depth) is first


def test_points_of_another_frame_are_moved_into_the_cameras():
    turn = np.array([[0, -1, 0, 2], [0, 0, -1, 30], [1, 0, 0, -7], [0, 0, 0, 1]], float)
    elsewhere = (SEEN.points - turn[:3, 3]) @ turn[:3, :3]  # in the cloud's frame
    elsewhere = elsewhere.astype(np.float32)
    elsewhere[np.isnan(elsewhere)] = 0  # missing, as some drivers have it
    columns = {axis: (elsewhere[..., i], 4 * i) for i, axis in enumerate("xyz")}
    for big in (False, True):
        message = cloud_message(columns, 16, big=big)
        message.header = header(frame_id="camera_link")
        arm = np.zeros((HEIGHT, WIDTH), bool)
        arm[0] = True
        capture = cloud_capture(message, "optical", SEEN.T_base_camera, arm, turn)
        same = Capture.from_cloud(SEEN.points).points
        np.testing.assert_array_equal(np.isnan(capture.points), np.isnan(same))
        np.testing.assert_allclose(capture.points, same, atol=5e-6)
        assert capture.warnings == () and capture.shape == (HEIGHT, WIDTH)
        np.testing.assert_array_equal(capture.robot_mask, arm)
    assert "T_camera_cloud is mirrored" in refused(
        cloud_capture, message, "optical", None, None, np.diag([1, 1, -1, 1])
    )
    assert "for cloud frame 'base'" in refused(cloud_capture, message, "base", None, None, turn)


# What is malformed is refused in one line.


def refused(call: Any, *given: Any) -> str:
    with pytest.raises(CaptureError) as caught:
        call(*given)
    said = str(caught.value)
    assert said.isprintable() and len(said) < 300
    return said


def image(**changes: Any) -> Message:
    message = image_message(SEEN.depth, "32FC1")
    message.__dict__.update(changes)
    return message


def without(message: Message, name: str) -> Message:
    del message.__dict__[name]
    return message


BAD_SIZES = {
    "short": ({"data": bytes(10)}, "10 bytes; truncated"),
    "empty": ({"data": b""}, "0 bytes; truncated"),
    "none wide": ({"width": 0}, "image of 0 x 24"),
    "huge": ({"width": 2**32 - 1, "height": 2**32 - 1}, "does not fit"),
    "narrow rows": ({"step": 4 * WIDTH - 1}, "in rows of 127 bytes"),
    "negative width": ({"width": -WIDTH}, "width -32; valid: 0 or more"),
    "negative both": ({"width": -WIDTH, "height": -HEIGHT}, "width -32"),
    "negative step": ({"step": -128}, "step -128"),
    "word": ({"height": "24"}, "height '24'; valid: a whole number"),
    "fraction": ({"height": 24.0}, "height 24.0"),
    "encoding": ({"encoding": "bayer\n"}, r"image is 'bayer\n'; valid: 16UC1, mono16, 32FC1"),
    "list": ({"data": [1, 2, 3]}, "data of type list; valid: a contiguous buffer"),
    "strided": ({"data": np.zeros(9999, np.uint8)[::2]}, "data of type ndarray"),
    "nothing": ({"data": None}, "data of type NoneType"),
}


@pytest.mark.parametrize("name", BAD_SIZES)
def test_malformed_images_are_refused(name):
    changes, message = BAD_SIZES[name]
    assert message in refused(read_depth, image(**changes))


def test_color_of_another_encoding_is_refused():
    assert "valid: rgb8, bgr8, rgba8, bgra8" in refused(read_color, image())


BAD_CLOUDS = {
    "none": ({"width": 0}, "cloud is empty"),
    "huge": ({"width": 2**32 - 1}, "valid: at most"),
    "short": ({"data": bytes(100)}, "cloud is truncated"),
    "narrow rows": ({"row_step": 8}, "rows of 8 bytes for 32 points of 16"),
    "small points": ({"point_step": 8}, "z at byte 8; valid: within a point's 8 bytes"),
    "negative": ({"height": -1}, "height -1"),
    "negative rows": ({"row_step": -512}, "row_step -512"),
    "no fields": ({"fields": []}, "cloud has fields ''; valid: float x, y, z"),
    "fields": ({"fields": 3}, "fields that are no list"),
    "fields of nothing": ({"fields": [None]}, "no field 'name'"),
}


@pytest.mark.parametrize("name", BAD_CLOUDS)
def test_malformed_clouds_are_refused(name):
    changes, message = BAD_CLOUDS[name]
    assert message in refused(cloud_capture, plain_cloud(**changes), "optical")


def test_clouds_with_other_fields_are_refused():
    for changes, message in (
        ({"datatype": 5}, "fields 'x, y, z'; valid: float x, y, z"),
        ({"datatype": 99}, "fields 'x, y'"),
        ({"name": "w\n"}, r"fields 'x, y, w\n'"),
        ({"offset": -4}, "offset -4"),
        ({"offset": 13}, "z at byte 13; valid: within a point's 16 bytes"),
        ({"offset": 2**32 - 1}, "valid: within a point's 16 bytes"),
    ):
        cloud = plain_cloud()
        cloud.fields[2].__dict__.update(changes)
        assert message in refused(read_cloud, cloud)


@pytest.mark.parametrize(
    "changes, message",
    [
        ({"width": 31}, "CameraInfo on /info is for 31 x 24 pixels; valid: 32 x 24"),
        ({"width": -1}, "width -1"),
        ({"k": np.zeros(8)}, "8 numbers in k; valid: 9"),
        ({"k": None}, "1 numbers in k"),
        ({"k": ["a"] * 9}, "a k that is no list of numbers"),
    ],
)
def test_malformed_camera_infos_are_refused(changes, message):
    info = info_message(**changes)
    assert message in refused(read_intrinsics, info, "/info", "/image_raw", (WIDTH, HEIGHT))


@pytest.mark.parametrize(
    "changes, message",
    [
        ({"d": ["a"]}, "a d that is no list of numbers"),
        ({"d": [np.nan]}, "CameraInfo on /info has lens distortion"),
        ({"d": [0.1] * 5, "distortion_model": "bent"}, "model 'bent'"),
        ({"d": [0.1] * 5, "distortion_model": 3}, "distortion_model"),
    ],
)
def test_malformed_distortions_are_refused(changes, message):
    assert message in refused(read_lens, info_message(**changes), "/info", "/image_raw")


def test_missing_fields_are_named():
    packed = compressed_message("16UC1; compressedDepth png", b"")
    named = (
        *((read_depth, (image(),), n) for n in ("width", "height", "step", "encoding", "data")),
        (read_depth, (image(),), "is_bigendian"),
        *((read_compressed_depth, (packed,), n) for n in ("format", "data")),
        *((read_cloud, (plain_cloud(),), n) for n in ("fields", "point_step", "row_step", "data")),
        (cloud_capture, (plain_cloud(), "optical"), "header"),
        *(
            (read_intrinsics, (info_message(), "i", "/image_raw", (WIDTH, HEIGHT)), n)
            for n in ("k", "width")
        ),
        (read_lens, (info_message(), "i", "/image_raw"), "d"),
    )
    for call, (message, *others), name in named:
        bare = without(Message(**vars(message)), name)
        assert f"message has no field '{name}'" in refused(call, bare, *others)


def test_compressed_depth_of_other_formats_is_refused():
    for told in ("8UC1; compressedDepth png", "64FC1; compressedDepth rvl", "", "jpeg", "x\n"):
        message = compressed_message(told, b"")
        assert "valid: 16UC1, 32FC1 as PNG or RVL" in refused(read_compressed_depth, message)


@pytest.mark.parametrize("coding", CODINGS)
def test_truncated_compressed_depth_is_refused(coding):
    told, data = f"16UC1; compressedDepth {coding}", CODINGS[coding](MILLIMETERS)
    for cut in (0, 5, 8, 20, 41, len(data) // 2):
        refused(read_compressed_depth, compressed_message(told, data[:cut]))
    refused(read_compressed_depth, Message(format=told, data=b"1234"))


@pytest.mark.parametrize(
    "data, message",
    [
        (b"", "truncated: its RVL has no size"),
        (struct.pack("<II", 0, 5), "claims 0 x 5 pixels"),
        (struct.pack("<II", 2**32 - 1, 2**32 - 1), "claims 4294967295 x 4294967295 pixels"),
        (struct.pack("<II", 8000, 8000), "truncated: no RVL of 8000 x 8000 pixels"),
        (rvl_of(MILLIMETERS)[:-4], "truncated: no RVL of 32 x 24 pixels"),
        (rvl_of(MILLIMETERS)[:-1], "truncated: no RVL of 32 x 24 pixels"),
        (struct.pack("<III", 2, 1, 0x30000000), "damaged"),  # 3 zeros of 2 pixels
        (struct.pack("<III", 2, 1, 0x03222000), "damaged"),  # 3 others
        (struct.pack("<III", 2, 1, 0x01100000), "damaged"),  # -1
        (struct.pack("<IIII", 2, 1, 0xFFFFFFFF, 0xFFFFFFFF), "damaged"),  # a number without end
        (struct.pack("<II", 9, 9) + bytes(4000), "truncated"),  # runs of nothing
    ],
)
def test_malformed_rvl_is_refused(data, message):
    packed = compressed_message("16UC1; compressedDepth rvl", data)
    assert message in refused(read_compressed_depth, packed)


anything = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-(2**80), 2**80),
    st.floats(),
    st.text(max_size=3),
    st.binary(max_size=3),
    st.lists(st.integers(), max_size=3),
    st.builds(Message),
    st.builds(lambda: np.zeros(3, np.float32)),
)
ENTRIES: dict[str, tuple[Any, Any]] = {
    "depth": (lambda m: depth_capture(m, info_message()), image),
    "packed": (
        lambda m: depth_capture(m, info_message()),
        lambda: compressed_message("16UC1; compressedDepth png", png_of(MILLIMETERS)),
    ),
    "info": (lambda m: depth_capture(image(), m), info_message),
    "color": (
        lambda m: depth_capture(image(), info_message(), color=m),
        lambda: image_message(SEEN.rgb, "rgb8"),
    ),
    "near color": (lambda m: nearest_color([m], image()), lambda: colored(0)),
    "near depth": (lambda m: nearest_color([colored(0)], m), image),
    "cloud": (lambda m: cloud_capture(m, "optical"), plain_cloud),
    "mask": (read_mask, lambda: image_message(SEEN.rgb[..., 0], "mono8")),
    "stamp": (stamp_ns, image),
}


def holders_in(message: Any) -> list[Message]:
    """The message, and every message in it."""
    found = [message]
    for value in vars(message).values():
        for inner in value if isinstance(value, list) else [value]:
            found += holders_in(inner) if isinstance(inner, Message) else []
    return found


@pytest.mark.parametrize("name", ENTRIES)
@settings(max_examples=150, deadline=None)
@given(data=st.data())
def test_messages_with_any_fields_are_read_or_refused(name, data):
    call, make = ENTRIES[name]
    message = make()
    for _ in range(data.draw(st.integers(1, 2))):
        holder = data.draw(st.sampled_from(holders_in(message)))
        field = data.draw(st.sampled_from(sorted(vars(holder)) or ["data"]))
        if data.draw(st.booleans()) and hasattr(holder, field):
            delattr(holder, field)
        else:
            setattr(holder, field, data.draw(anything))
    try:
        call(data.draw(anything) if data.draw(st.integers(0, 9)) == 0 else message)
    except CaptureError as error:
        assert str(error).isprintable()


@pytest.mark.parametrize("coding", CODINGS)
@quick
@given(noise=st.binary(max_size=200), keep=st.integers(0, 400), change=st.integers(0, 255))
def test_noise_in_a_compressed_depth_gives_an_image_or_a_reason(coding, noise, keep, change):
    data = bytearray(CODINGS[coding](MILLIMETERS)[:keep] + noise)
    if len(data) > 8:
        data[keep % (len(data) - 8) + 8] ^= change  # behind the size
    message = compressed_message(f"16UC1; compressedDepth {coding}", bytes(data))
    try:
        depth = read_compressed_depth(message)
    except CaptureError as error:
        assert str(error).isprintable()
        return
    assert depth.ndim == 2 and (
        coding == "png" or depth.shape[::-1] == struct.unpack("<II", data[:8])
    )
