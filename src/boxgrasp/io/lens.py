"""Small lens distortion is undone: one map a camera, made and applied by OpenCV (extra `lens`).

An extra, since OpenCV brings 150 MB for what most captures do not need: depth cameras and ROS's
`image_rect` topics come rectified. The distortion models and the maps are its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Floats
from boxgrasp.errors import CaptureError, CodedWarning, MissingExtraError
from boxgrasp.sensing.capture import Capture

_BROWN: Final = ("plumb_bob", "rational_polynomial")  # one model, of more or fewer numbers
FISHEYE: Final = ("equidistant", "fisheye")
_COUNTS: Final = {**dict.fromkeys(_BROWN, (4, 5, 8, 12, 14)), **dict.fromkeys(FISHEYE, (4,))}
_RECTIFIED: Final = "valid: a rectified image (image_rect)"
_CAMERAS: Final = 8  # whose maps are kept
# In area. The sensor model takes pixels to lie evenly; so they do to a factor of 1.6 along an edge.
# At its rim an Azure Kinect's narrow view has 2.1, a webcam 2; beyond, one pixel becomes several.
_MOST_GROWTH: Final = 2.5
_MOVED_PX: Final = 0.5  # by which a pixel must move to be another one


@dataclass(frozen=True)
class Lens:
    """How a lens bends the image, as OpenCV and ROS have it.

    Attributes:
        model: 'plumb_bob', 'rational_polynomial', 'equidistant' or 'fisheye'.
        coefficients: k1, k2, p1, p2, k3 and on; of the last two models k1 to k4.
    """

    model: str
    coefficients: tuple[float, ...]


class _Map(NamedTuple):
    """Where each rectified pixel lies in the image as it was taken, and how far it moved."""

    u: NDArray[np.float32]
    v: NDArray[np.float32]
    moved_px: float


def lens_of(model: str, coefficients: Sequence[float] | Floats, name: str) -> Lens | None:
    """The lens of a camera's coefficients.

    Args:
        model: as ROS names it; empty for that which fits the number of coefficients.
        coefficients: in OpenCV's order; all 0 or none for no distortion.
        name: of what gives them, in messages.

    Returns:
        The lens, or None for none.

    Raises:
        CaptureError: an unknown model, or numbers that do not fit it.
    """
    values = np.asarray(coefficients, dtype=np.float64).reshape(-1)
    if (values == 0).all():
        return None
    known = model or _BROWN[0]
    if known not in _COUNTS:
        raise CaptureError(
            f"{name} has lens distortion of model {model!r:.40}; {_RECTIFIED}, or the model one of "
            f"{', '.join(_COUNTS)}"
        )
    if len(values) not in _COUNTS[known] or not np.isfinite(values).all():
        counts = ", ".join(map(str, _COUNTS[known]))
        raise CaptureError(
            f"{name} has lens distortion {values.tolist()!r:.60}; {_RECTIFIED}, or {counts} "
            f"finite numbers for {known}"
        )
    return Lens(known, tuple(values.tolist()))


def undistorted(capture: Capture, lens: Lens, name: str) -> Capture:
    """A depth image as a camera without distortion takes it, with the same intrinsics.

    Depth and masks take the nearest pixel, so that no edge is smeared; colors are interpolated.

    Args:
        capture: as it was taken, its masks and pixel too.
        lens: that took it.
        name: of what says so, in messages.

    Returns:
        The rectified capture, warned of by how much its pixels moved; the same where none did.

    Raises:
        CaptureError: the distortion is not small.
        MissingExtraError: OpenCV is not installed.
    """
    if capture.depth is None or capture.intrinsics is None:
        raise CaptureError(f"{name} has lens distortion, but there is no depth image")
    cv2 = _opencv(name)
    (fx, _, cx), (_, fy, cy) = capture.intrinsics[:2].tolist()
    made = _map(lens, (fx, fy, cx, cy), (capture.depth.shape[1], capture.depth.shape[0]), name)
    if made.moved_px < _MOVED_PX:
        return capture

    def moved(image: NDArray[Any] | None, how: int = cv2.INTER_NEAREST) -> NDArray[Any] | None:
        if image is None:
            return None
        pixels = image.astype(np.uint8) if image.dtype == np.bool_ else np.ascontiguousarray(image)
        found = cv2.remap(pixels, made.u, made.v, how, borderMode=cv2.BORDER_CONSTANT)
        return np.asarray(found)

    rectified = Capture(
        moved(capture.depth),
        capture.intrinsics,
        capture.T_base_camera,
        moved(capture.rgb, cv2.INTER_LINEAR),
        moved(capture.mask),
        target_pixel=_pixel(capture.target_pixel, made),
        robot_mask=moved(capture.robot_mask),
    )
    warning = CodedWarning(
        "lens_undistorted",
        f"lens distortion was undone, by up to {made.moved_px:.1f} pixels; pixels and masks of the "
        "target count in the rectified image",
    )
    return rectified.with_warnings(*capture.warnings, warning)


def _opencv(name: str) -> Any:
    try:
        import cv2
    except ImportError:
        raise MissingExtraError(
            f"{name} has lens distortion, and to undo it needs OpenCV; install it with: "
            f"pip install 'boxgrasp[lens]'; or {_RECTIFIED}"
        ) from None
    return cv2


@lru_cache(_CAMERAS)
def _map(
    lens: Lens, pinhole: tuple[float, float, float, float], size: tuple[int, int], name: str
) -> _Map:
    """The map of a camera of fx, fy, cx, cy and of (width, height), px."""
    cv2 = _opencv(name)
    fx, fy, cx, cy = pinhole
    K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    made = cv2.fisheye if lens.model in FISHEYE else cv2
    u, v = made.initUndistortRectifyMap(
        K, np.array(lens.coefficients), np.eye(3), K, size, cv2.CV_32FC1
    )
    width, height = size
    inside = (u > -0.5) & (u < width - 0.5) & (v > -0.5) & (v < height - 0.5)
    growth = _growth(u, v)[inside]
    low, high = (float(growth.min()), float(growth.max())) if growth.size else (0.0, 0.0)
    if not 1 / _MOST_GROWTH <= low <= high <= _MOST_GROWTH:
        raise CaptureError(
            f"{name} has strong lens distortion: a pixel covers {low:.2g} to {high:.2g} times its "
            f"area; {_RECTIFIED}, or up to {_MOST_GROWTH:g} times"
        )
    rows, columns = np.mgrid[:height, :width]
    return _Map(u, v, float(np.hypot(u - columns, v - rows)[inside].max()))


def _growth(u: NDArray[np.float32], v: NDArray[np.float32]) -> NDArray[np.float32]:
    """(H, W) how much of the image as it was taken each rectified pixel covers, px2."""
    u_down, u_right = np.gradient(u)
    v_down, v_right = np.gradient(v)
    return np.asarray(u_right * v_down - u_down * v_right)


def _pixel(pixel: tuple[int, int] | None, made: _Map) -> tuple[int, int] | None:
    """The rectified pixel that shows what a pixel showed: the one that lies nearest to it."""
    if pixel is None:
        return None
    off = np.hypot(made.u - np.float32(pixel[0]), made.v - np.float32(pixel[1]))
    v, u = np.unravel_index(int(np.argmin(off)), off.shape)
    if off[v, u] > 1.0:
        raise CaptureError(f"target_pixel {pixel} is outside the rectified image; valid: inside it")
    return int(u), int(v)
