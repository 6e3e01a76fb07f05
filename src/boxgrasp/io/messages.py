"""Depth, color, camera and clouds out of ROS messages, whoever decoded them; needs no ROS.

A message is any object with the fields of its sensor_msgs type: rosbags', rclpy's or rospy's. Its
`data` is any contiguous buffer: bytes, array.array, memoryview or a numpy array.
"""

from __future__ import annotations

import io
import operator
import struct
from collections.abc import Mapping
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from boxgrasp.arrays import Floats, Points, readonly
from boxgrasp.errors import CaptureError, CodedWarning
from boxgrasp.io.colors import unpack_rgb
from boxgrasp.io.extent import MAX_PIXELS, validate_cloud_size
from boxgrasp.io.images import read_depth_png
from boxgrasp.kernels import rvl
from boxgrasp.sensing.capture import Capture
from boxgrasp.sensing.validation import Bytes, CloudFrame

T = TypeVar("T")

_DEPTH_ENCODINGS: Final = {"16UC1": ("u2", 0.001), "mono16": ("u2", 0.001), "32FC1": ("f4", 1.0)}
_COLOR_ENCODINGS: Final = {"rgb8": (3, 1), "bgr8": (3, -1), "rgba8": (4, 1), "bgra8": (4, -1)}
_POINT_TYPES: Final = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
_COMPRESSED_HEADER: Final = 12  # of compressed_depth_image_transport, before the image
_RVL_HEADER: Final = 8  # bytes: width and height, before the stream


def read_depth(image: Any) -> Points:
    """The depth of a sensor_msgs/Image.

    Args:
        image: 16UC1 or mono16 in mm, or 32FC1 in m.

    Returns:
        (H, W) float32, m, read-only; it may lie in the message's memory.

    Raises:
        CaptureError: another encoding, a field missing, or sizes that do not fit its data.
    """
    kind, scale = _coded(image, _DEPTH_ENCODINGS)
    values = _pixels(image, kind, 1)[..., 0]
    if kind == "u2":
        values = values * scale
    return readonly(values.astype(np.float32, copy=False))


def read_compressed_depth(image: Any) -> Points:
    """The depth of a sensor_msgs/CompressedImage of compressed_depth_image_transport.

    Args:
        image: 16UC1 in mm, as PNG or RVL.

    Returns:
        (H, W) float32, m, read-only.

    Raises:
        CaptureError: another format, a field missing, or damaged data.
    """
    told = str(_field(image, "format"))
    if not told.startswith("16UC1"):  # of 32FC1 the inverse depth is sent, quantized
        raise CaptureError(f"compressed depth is {told!r:.60}; valid: 16UC1 as PNG or RVL")
    unpack = _unpack_rvl if "rvl" in told.lower() else _unpack_png
    millimeters = unpack(_data(image)[_COMPRESSED_HEADER:])
    return readonly((millimeters * 0.001).astype(np.float32))


def _unpack_png(data: Bytes) -> NDArray[np.uint16]:
    try:
        return read_depth_png(io.BytesIO(data.tobytes()), None)
    except (CaptureError, MemoryError):
        raise
    except Exception as error:  # a damaged PNG makes Pillow raise nearly anything
        raise CaptureError(f"compressed depth is damaged: {type(error).__name__}") from None


def _unpack_rvl(data: Bytes) -> NDArray[np.uint16]:
    if len(data) < _RVL_HEADER:
        raise CaptureError("compressed depth is truncated: its RVL has no size")
    width, height = struct.unpack_from("<II", data.data)
    if not 0 < width * height <= MAX_PIXELS:
        raise CaptureError(
            f"compressed depth claims {width} x {height} pixels; valid: 1 to {MAX_PIXELS}"
        )
    words = data[_RVL_HEADER : len(data) - len(data) % 4].tobytes()  # aligned
    pixels = np.empty(width * height, np.uint16)
    filled = rvl.unpack(np.frombuffer(words, "<u4").astype(np.uint32), pixels)
    if filled < 0:
        what = "truncated" if filled == rvl.TRUNCATED else "damaged"
        raise CaptureError(f"compressed depth is {what}: no RVL of {width} x {height} pixels")
    return pixels.reshape(height, width)


def is_color(image: Any) -> bool:
    """Whether `read_color` knows the encoding of a sensor_msgs/Image.

    Args:
        image: the message.

    Returns:
        True for rgb8, bgr8, rgba8 and bgra8.

    Raises:
        CaptureError: the field is missing.
    """
    return str(_field(image, "encoding")) in _COLOR_ENCODINGS


def read_color(image: Any) -> Bytes:
    """The colors of a sensor_msgs/Image.

    Args:
        image: rgb8, bgr8, rgba8 or bgra8.

    Returns:
        (H, W, 3) uint8 red, green, blue, read-only; it may lie in the message's memory.

    Raises:
        CaptureError: another encoding, a field missing, or sizes that do not fit its data.
    """
    channels, order = _coded(image, _COLOR_ENCODINGS)
    return readonly(_pixels(image, "u1", channels)[..., :3][..., ::order])


def _coded(image: Any, encodings: Mapping[str, T]) -> T:
    """What is known of the encoding of a sensor_msgs/Image."""
    encoding = str(_field(image, "encoding"))
    if encoding not in encodings:
        raise CaptureError(f"image is {encoding!r:.40}; valid: {', '.join(encodings)}")
    return encodings[encoding]


def _pixels(image: Any, kind: str, channels: int) -> NDArray[Any]:
    """(H, W, channels) of a sensor_msgs/Image, its rows cut to the width, in its own memory."""
    width, height, step = (_count(image, name) for name in ("width", "height", "step"))
    data = _data(image)
    dtype = np.dtype(_byte_order(image) + kind)
    row = dtype.itemsize * channels * width
    if not 0 < width * height <= MAX_PIXELS or step < row or len(data) < step * height:
        raise CaptureError(
            f"image of {width} x {height} in rows of {step} bytes does not fit its "
            f"{len(data)} bytes; truncated?"
        )
    strides = (step, dtype.itemsize * channels, dtype.itemsize)
    return np.ndarray((height, width, channels), dtype, data, strides=strides)


def read_intrinsics(info: Any, name: str, image_topic: str, size: tuple[int, int]) -> Floats:
    """The camera matrix of a sensor_msgs/CameraInfo.

    Args:
        info: of ROS 1 (K, D, P) or ROS 2 (k, d, p).
        name: of the message, in errors.
        image_topic: topic of its image; on one named `image_rect...` P counts, whatever D says.
        size: (width, height) of that image, pixels.

    Returns:
        (3, 3) float64, pixels, read-only; `Capture` judges its values.

    Raises:
        CaptureError: for another size, lens distortion, or a field missing or of another length.
    """
    width, height = _count(info, "width"), _count(info, "height")
    if (width, height) != size:
        raise CaptureError(
            f"CameraInfo on {name} is for {width} x {height} pixels; "
            f"valid: {size[0]} x {size[1]}, as the image"
        )
    if image_topic.rpartition("/")[2].startswith("image_rect"):
        return readonly(_matrix(info, "p", (3, 4))[:, :3])
    if not (_numbers(info, "d") == 0).all():
        raise CaptureError(
            f"CameraInfo on {name} has lens distortion; valid: a rectified image (image_rect)"
        )
    return readonly(_matrix(info, "k", (3, 3)))


def _numbers(info: Any, name: str) -> Floats:
    """A float array of a CameraInfo, whose names ROS 1 has in capitals."""
    values = _field(info, name.upper() if hasattr(info, name.upper()) else name)
    try:
        return np.array(values, np.float64)
    except (TypeError, ValueError):
        raise CaptureError(f"CameraInfo has a {name} that is no list of numbers") from None


def _matrix(info: Any, name: str, shape: tuple[int, int]) -> Floats:
    values = _numbers(info, name)
    if values.size != shape[0] * shape[1]:
        raise CaptureError(
            f"CameraInfo has {values.size} numbers in {name}; valid: {shape[0] * shape[1]}"
        )
    return values.reshape(shape)


def cloud_capture(
    message: Any, cloud_frame: CloudFrame, T_base_camera: ArrayLike | None = None
) -> Capture:
    """The capture of a sensor_msgs/PointCloud2.

    Args:
        message: with float x, y, z, and colors in rgb or rgba or none.
        cloud_frame: 'optical' or 'base', of its points.
        T_base_camera: (4, 4), or None where it is unknown.

    Returns:
        The capture, organized where the cloud's height is above 1; warned of where points taken
        as optical are in a frame not named so.

    Raises:
        CaptureError: a field missing, sizes that do not fit its data, or no usable view.
    """
    frame_id = str(_field(_field(message, "header"), "frame_id"))
    points, colors = read_cloud(message)
    capture = Capture.from_cloud(
        points, cloud_frame=cloud_frame, colors=colors, T_base_camera=T_base_camera
    )
    if cloud_frame == "optical" and frame_id and "optical" not in frame_id:
        return capture.with_warnings(
            CodedWarning(
                "frame_taken_as_optical",
                f"cloud's frame {frame_id!r:.60} is taken as a camera's optical frame",
            )
        )
    return capture


def read_cloud(message: Any) -> tuple[NDArray[np.floating[Any]], Bytes | None]:
    """Points and colors of a sensor_msgs/PointCloud2.

    Args:
        message: with float x, y, z, and colors in rgb or rgba or none.

    Returns:
        (H, W, 3) float32 or float64, m, in either byte order, (N, 3) for a height of 1, read-only,
        in the message's memory where x, y, z lie side by side; and (N, 3) uint8, or None.

    Raises:
        CaptureError: a field missing, or sizes that do not fit its data.
    """
    width, height = _count(message, "width"), _count(message, "height")
    point, row = _count(message, "point_step"), _count(message, "row_step")
    data = _data(message)
    validate_cloud_size(width * height, row * height, len(data))
    if row < width * point:
        raise CaptureError(f"cloud has rows of {row} bytes for {width} points of {point}")
    layout = _layout(message, point)

    def column(name: str, count: int = 1) -> NDArray[Any]:
        """(H, W, count) values from a field on, in the message's memory."""
        dtype, offset = layout[name]
        strides = (row, point, dtype.itemsize)
        return np.ndarray((height, width, count), dtype, data, offset, strides)

    (kind, first), *others = (layout[axis] for axis in "xyz")
    if others == [(kind, first + kind.itemsize), (kind, first + 2 * kind.itemsize)]:
        xyz = column("x", 3)
    else:
        xyz = np.concatenate([column(axis) for axis in "xyz"], axis=-1)
    packed = next((name for name in ("rgb", "rgba") if name in layout), None)
    colors = unpack_rgb(column(packed).reshape(-1)) if packed is not None else None
    points = readonly(xyz.reshape(-1, 3) if height == 1 else xyz)
    return points, readonly(colors) if colors is not None else None


def _layout(message: Any, point: int) -> dict[str, tuple[np.dtype[Any], int]]:
    """Type and offset of the fields used, each within a point's bytes."""
    order, layout = _byte_order(message), {}
    try:
        fields = list(_field(message, "fields"))
    except TypeError:
        raise CaptureError("cloud has fields that are no list; valid: PointFields") from None
    for field in fields:
        name, datatype = str(_field(field, "name")), _count(field, "datatype")
        if datatype in _POINT_TYPES:
            layout[name] = np.dtype(order + _POINT_TYPES[datatype]), _count(field, "offset")
    if any(axis not in layout or layout[axis][0].kind != "f" for axis in "xyz"):
        raise CaptureError(f"cloud has fields {', '.join(layout)!r:.80}; valid: float x, y, z")
    for name in ("x", "y", "z", "rgb", "rgba"):
        if name in layout and layout[name][1] + layout[name][0].itemsize > point:
            raise CaptureError(
                f"cloud has {name} at byte {layout[name][1]}; valid: within a point's {point} bytes"
            )
    return layout


def _field(message: Any, name: str) -> Any:
    try:
        return getattr(message, name)
    except AttributeError:
        raise CaptureError(
            f"message has no field {name!r}; valid: those of its sensor_msgs type"
        ) from None


def _count(message: Any, name: str) -> int:
    value = _field(message, name)
    try:
        number = operator.index(value)
    except TypeError:
        raise CaptureError(f"message has {name} {value!r:.40}; valid: a whole number") from None
    if number < 0:
        raise CaptureError(f"message has {name} {number}; valid: 0 or more")
    return number


def _byte_order(message: Any) -> str:
    return ">" if _field(message, "is_bigendian") else "<"


def _data(message: Any) -> Bytes:
    """(n,) uint8 of a message's data, in its own memory."""
    data = _field(message, "data")
    try:
        return np.frombuffer(data, np.uint8)
    except (TypeError, ValueError, BufferError):
        raise CaptureError(
            f"message has data of type {type(data).__name__}; valid: a contiguous buffer of bytes"
        ) from None
