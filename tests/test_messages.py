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
    is_color,
    read_cloud,
    read_color,
    read_compressed_depth,
    read_depth,
    read_intrinsics,
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
        header=Message(frame_id="camera_optical_frame"),
        height=pixels.shape[0],
        width=pixels.shape[1],
        encoding=encoding,
        is_bigendian=int(big),
        step=len(rows[0]),
        data=HOLDERS[holder](b"".join(rows)),
    )


def compressed_message(told: str, data: bytes, holder: str = "bytes") -> Message:
    return Message(format=told, data=HOLDERS[holder](bytes(12) + data))


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
    return Message(**size, **{n.upper() if upper else n: value for n, value in fields.items()})


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
        header=Message(frame_id="camera_optical_frame"),
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
    with pytest.raises(CaptureError, match="/camera_info has lens distortion; valid: a rectified"):
        read_intrinsics(bent, "/camera_info", "/depth/image_raw", size)
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
        ({"d": ["a"]}, "a d that is no list of numbers"),
        ({"d": [np.nan]}, "distortion"),
    ],
)
def test_malformed_camera_infos_are_refused(changes, message):
    info = info_message(**changes)
    assert message in refused(read_intrinsics, info, "/info", "/image_raw", (WIDTH, HEIGHT))


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
            for n in ("k", "d", "width")
        ),
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
