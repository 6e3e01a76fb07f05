"""Depth, color, camera and clouds out of ROS messages, whoever decoded them; needs no ROS.

A message is any object with the fields of its sensor_msgs type: rosbags', rclpy's or rospy's. Its
`data` is any contiguous buffer: bytes, array.array, memoryview or a numpy array.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from boxgrasp.arrays import Bools, Floats, Points, readonly
from boxgrasp.errors import BoxgraspError, CaptureError, CodedWarning
from boxgrasp.geometry.transforms import transform, validate_transform
from boxgrasp.io.colors import unpack_rgb
from boxgrasp.io.compressed_depth import compressed_size, unpack_depth
from boxgrasp.io.extent import MAX_PIXELS, validate_cloud_size
from boxgrasp.io.fields import bytes_of, count_of, field_of, flag_of, frame_id_of, text_of
from boxgrasp.io.fields import stamp_ns as stamp_ns  # the time of any message; public here
from boxgrasp.io.lens import Lens, lens_of, undistorted
from boxgrasp.sensing.capture import Capture
from boxgrasp.sensing.validation import Bytes, CloudFrame, validate_pose

T = TypeVar("T")

_DEPTH_ENCODINGS: Final = {"16UC1": ("u2", 0.001), "mono16": ("u2", 0.001), "32FC1": ("f4", 1.0)}
_COLOR_ENCODINGS: Final = {"rgb8": (3, 1), "bgr8": (3, -1), "rgba8": (4, 1), "bgra8": (4, -1)}
_MASK_ENCODINGS: Final = {"mono8": 1, "8UC1": 1}
_POINT_TYPES: Final = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
_COMPRESSED_TOPIC: Final = "/compressedDepth"  # how a topic of compressed depth ends
COLOR_NEAR_NS: Final = 100_000_000  # between depth and the color image beside it


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
        image: 16UC1 in mm, or 32FC1 as inverse depth; as PNG or RVL.

    Returns:
        (H, W) float32, m, read-only; NaN where 32FC1 has none.

    Raises:
        CaptureError: another format, a field missing, or damaged data.
    """
    return unpack_depth(text_of(image, "format"), bytes_of(image))


def read_mask(image: Any) -> Bools:
    """The mask in a sensor_msgs/Image.

    Args:
        image: mono8 or 8UC1.

    Returns:
        (H, W) bool, True where it is not 0, read-only.

    Raises:
        CaptureError: another encoding, a field missing, or sizes that do not fit its data.
    """
    channels = _coded(image, _MASK_ENCODINGS)
    return readonly(_pixels(image, "u1", channels)[..., 0] != 0)


def is_color(image: Any) -> bool:
    """Whether `read_color` knows the encoding of a sensor_msgs/Image.

    Args:
        image: the message.

    Returns:
        True for rgb8, bgr8, rgba8 and bgra8.

    Raises:
        CaptureError: the field is missing.
    """
    return text_of(image, "encoding") in _COLOR_ENCODINGS


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
    encoding = text_of(image, "encoding")
    if encoding not in encodings:
        raise CaptureError(f"image is {encoding!r:.40}; valid: {', '.join(encodings)}")
    return encodings[encoding]


def _pixels(image: Any, kind: str, channels: int) -> NDArray[Any]:
    """(H, W, channels) of a sensor_msgs/Image, its rows cut to the width, in its own memory."""
    width, height, step = (count_of(image, name) for name in ("width", "height", "step"))
    data = bytes_of(image)
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
        CaptureError: for another size, or a field missing or of another length.
    """
    return _intrinsics(info, f"CameraInfo on {name}", image_topic, size)


def _intrinsics(info: Any, name: str, image_topic: str, size: tuple[int, int]) -> Floats:
    width, height = count_of(info, "width"), count_of(info, "height")
    if (width, height) != size:
        raise CaptureError(
            f"{name} is for {width!s:.20} x {height!s:.20} pixels; "
            f"valid: {size[0]} x {size[1]}, as the image"
        )
    if _is_rectified(image_topic):
        return readonly(_matrix(info, "p", (3, 4))[:, :3])
    return readonly(_matrix(info, "k", (3, 3)))


def read_lens(info: Any, name: str, image_topic: str) -> Lens | None:
    """The lens distortion that a sensor_msgs/CameraInfo tells of.

    Args:
        info: of ROS 1 (D) or ROS 2 (d).
        name: of the message, in errors.
        image_topic: topic of its image; one named `image_rect...` has none, whatever D says.

    Returns:
        The lens; None without distortion.

    Raises:
        CaptureError: a field missing, or an unknown model.
    """
    return _lens(info, f"CameraInfo on {name}", image_topic)


def _lens(info: Any, name: str, image_topic: str) -> Lens | None:
    if _is_rectified(image_topic):
        return None
    coefficients = _numbers(info, "d")
    if (coefficients == 0).all():
        return None
    return lens_of(text_of(info, "distortion_model"), coefficients, name)


def _is_rectified(image_topic: str) -> bool:
    return image_topic.rpartition("/")[2].startswith("image_rect")


def _numbers(info: Any, name: str) -> Floats:
    """A float array of a CameraInfo, whose names ROS 1 has in capitals."""
    values = field_of(info, name.upper() if hasattr(info, name.upper()) else name)
    try:
        return np.array(values, np.float64)
    except (TypeError, ValueError, OverflowError):
        raise CaptureError(f"CameraInfo has a {name} that is no list of numbers") from None


def _matrix(info: Any, name: str, shape: tuple[int, int]) -> Floats:
    values = _numbers(info, name)
    if values.size != shape[0] * shape[1]:
        raise CaptureError(
            f"CameraInfo has {values.size} numbers in {name}; valid: {shape[0] * shape[1]}"
        )
    return values.reshape(shape)


def depth_capture(
    depth: Any,
    info: Any,
    *,
    topic: str = "",
    color: Any = None,
    T_base_camera: ArrayLike | None = None,
    robot_mask: Bools | None = None,
) -> Capture:
    """The capture of a depth image, its camera, and the color image registered to it.

    Args:
        depth: a sensor_msgs/Image, or a CompressedImage of compressed_depth_image_transport.
        info: its sensor_msgs/CameraInfo.
        topic: of the depth; on one named `image_rect...` the info's P counts, whatever D says.
        color: a sensor_msgs/Image of the same size and frame, or None.
        T_base_camera: (4, 4) m, or None where it is unknown.
        robot_mask: (H, W) bool, True on the robot's own arm, or None.

    Returns:
        The capture, small lens distortion undone.

    Raises:
        CaptureError: a field missing, sizes or frames that do not fit, or no usable view.
        MissingExtraError: there is lens distortion, and OpenCV is not installed.
    """
    meters = read_compressed_depth(depth) if _is_compressed(depth) else read_depth(depth)
    name = f"CameraInfo of {topic!r:.100}" if topic else "CameraInfo"
    size = (meters.shape[1], meters.shape[0])
    image_topic = topic.removesuffix(_COMPRESSED_TOPIC)
    intrinsics, lens = _intrinsics(info, name, image_topic, size), _lens(info, name, image_topic)
    rgb = None
    if color is not None:
        frame, other = frame_id_of(depth), frame_id_of(color)
        if frame != other:
            raise CaptureError(
                f"color is in frame {other!r:.60}; valid: {frame!r:.60}, registered to the depth"
            )
        rgb = read_color(color)
    pose = validate_pose(T_base_camera)
    capture = Capture(meters, intrinsics, pose, rgb, robot_mask=robot_mask)
    return capture if lens is None else undistorted(capture, lens, name)


def nearest_color(images: Iterable[Any], depth: Any) -> Any | None:
    """The color image that belongs to a depth image.

    Args:
        images: sensor_msgs/Image of any kind; those that are damaged are passed over.
        depth: a sensor_msgs/Image, or a CompressedImage of compressed_depth_image_transport.

    Returns:
        The color image of the same frame and size that is nearest in time, less than 0.1 s away;
        the first of two as near; None where there is none.

    Raises:
        CaptureError: the depth image has no time, no frame or no size.
    """
    place = frame_id_of(depth), _size(depth)
    stamp, best, apart = stamp_ns(depth), None, COLOR_NEAR_NS
    for image in images:
        try:
            off = abs(stamp_ns(image) - stamp)
            if off < apart and (frame_id_of(image), _size(image)) == place and is_color(image):
                read_color(image)
                best, apart = image, off
        except CaptureError:
            continue
    return best


def _is_compressed(depth: Any) -> bool:
    return hasattr(depth, "format")


def _size(image: Any) -> tuple[int, int]:
    """(width, height) of an Image, or of a CompressedImage of depth."""
    if _is_compressed(image):
        return compressed_size(text_of(image, "format"), bytes_of(image))
    return count_of(image, "width"), count_of(image, "height")


def cloud_capture(
    message: Any,
    cloud_frame: CloudFrame,
    T_base_camera: ArrayLike | None = None,
    robot_mask: Bools | None = None,
    T_camera_cloud: ArrayLike | None = None,
) -> Capture:
    """The capture of a sensor_msgs/PointCloud2.

    Args:
        message: with float x, y, z, and colors in rgb or rgba or none.
        cloud_frame: 'optical' or 'base', of its points.
        T_base_camera: (4, 4) m, or None where it is unknown.
        robot_mask: (H, W) bool, or (N,) for a height of 1, True on the robot's own arm, or None.
        T_camera_cloud: (4, 4) m, by which points of another frame come into the camera's optical
            frame; None where they are in `cloud_frame`.

    Returns:
        The capture, organized where the cloud's height is above 1; warned of where points taken
        as optical are in a frame not named so.

    Raises:
        CaptureError: a field missing, sizes that do not fit its data, `T_camera_cloud` is no rigid
            transform or given for a base cloud, or no usable view.
    """
    frame_id = frame_id_of(message)
    points, colors = read_cloud(message)
    if T_camera_cloud is not None:
        if cloud_frame != "optical":
            raise CaptureError(
                f"T_camera_cloud is given for cloud frame {cloud_frame!r:.40}; valid: 'optical'"
            )
        points = _moved(points, T_camera_cloud)
    capture = Capture.from_cloud(
        points,
        cloud_frame=cloud_frame,
        colors=colors,
        T_base_camera=T_base_camera,
        robot_mask=robot_mask,
    )
    taken = cloud_frame == "optical" and T_camera_cloud is None
    if taken and frame_id and "optical" not in frame_id:
        return capture.with_warnings(
            CodedWarning(
                "frame_taken_as_optical",
                f"cloud's frame {frame_id!r:.60} is taken as a camera's optical frame",
            )
        )
    return capture


@np.errstate(invalid="ignore", over="ignore")
def _moved(points: NDArray[np.floating[Any]], T_camera_cloud: ArrayLike) -> Floats:
    """(..., 3) points in the camera's frame; what is missing, 0, 0, 0 too, becomes NaN."""
    try:
        T = validate_transform(T_camera_cloud, "T_camera_cloud")
    except BoxgraspError as error:
        raise CaptureError(str(error)) from None
    held = points.astype(np.float64)  # frames may lie far apart
    missing = ~np.isfinite(held).all(axis=-1) | (held == 0).all(axis=-1)
    held[missing] = np.nan
    return transform(T, held)


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
    width, height = count_of(message, "width"), count_of(message, "height")
    point, row = count_of(message, "point_step"), count_of(message, "row_step")
    data = bytes_of(message)
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
        fields = list(field_of(message, "fields"))
    except TypeError:
        raise CaptureError("cloud has fields that are no list; valid: PointFields") from None
    for field in fields:
        name, datatype = text_of(field, "name"), count_of(field, "datatype")
        if datatype in _POINT_TYPES:
            layout[name] = np.dtype(order + _POINT_TYPES[datatype]), count_of(field, "offset")
    if any(axis not in layout or layout[axis][0].kind != "f" for axis in "xyz"):
        raise CaptureError(f"cloud has fields {', '.join(layout)!r:.80}; valid: float x, y, z")
    for name in ("x", "y", "z", "rgb", "rgba"):
        if name in layout and layout[name][1] + layout[name][0].itemsize > point:
            raise CaptureError(
                f"cloud has {name} at byte {layout[name][1]}; valid: within a point's {point} bytes"
            )
    return layout


def _byte_order(message: Any) -> str:
    return ">" if flag_of(message, "is_bigendian") else "<"
