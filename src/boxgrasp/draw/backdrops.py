"""What lies behind the lines of the first panel: the camera's image, or painted points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Floats, Points
from boxgrasp.draw.clouds import Cloud, painted
from boxgrasp.draw.palette import NIGHT
from boxgrasp.draw.views import Extent, View, camera_view, looking_view, oblique_frame
from boxgrasp.geometry.transforms import invert, transform
from boxgrasp.sensing.capture import Capture

if TYPE_CHECKING:
    from PIL.Image import Image

_FIT_WITHIN_PX: Final = 1.0
_FIT_POINTS: Final = 5000
_CLOSEST: Final = 0.4  # of the whole image: enough round the target to know the place
_BEYOND: Final = 0.12  # of the image: room beside it for a gripper that stands out of it


@dataclass(frozen=True, eq=False)
class Backdrop:
    """What a panel shows before a line is drawn.

    Attributes:
        view: how base-frame points fall on it.
        image: RGB, of the panel's size.
        caption: what it is.
    """

    view: View
    image: Image
    caption: str


def camera_panel(
    capture: Capture, cloud: Cloud, focus: Floats | None, size: tuple[int, int], floor_m: float
) -> Backdrop:
    """The view through the camera.

    A cloud without an image is painted from the camera's place; from the robot's side where even
    that is unknown.

    Args:
        capture: the view.
        cloud: its points, and where the camera is.
        focus: (M, 3) float64, base frame, m, what the panel must show; None shows all.
        size: width and height of the panel, px.
        floor_m: height of the support, base frame.

    Returns:
        The view with its image and a caption.
    """
    T_base_camera = cloud.T_base_camera
    image = picture_of(capture)
    K = capture.intrinsics if capture.intrinsics is not None else fitted_intrinsics(capture)
    if image is not None and K is not None and T_base_camera is not None:
        whole = Extent.of(image.size, size)
        extent = whole
        if focus is not None:
            xy, _ = camera_view(T_base_camera, K, Extent(0.0, 0.0, 1.0)).project(focus)
            extent = _around(image.size, size, xy)
        colored = capture.rgb is not None or capture.colors is not None
        caption = f"{'Camera' if colored else 'Depth'} image{'' if focus is None else ' (cut out)'}"
        return Backdrop(camera_view(T_base_camera, K, extent), _cut(image, extent, size), caption)
    around = focus if focus is not None else _bulk(cloud.points)
    if T_base_camera is not None:
        view = looking_view(invert(T_base_camera), around, size)
        caption = "Points, seen from the camera"
    else:
        view = looking_view(oblique_frame(around.mean(axis=0)), around, size)
        caption = "Points, seen obliquely (camera unknown)"
    return Backdrop(view, painted(cloud, view, size, floor_m), caption)


def _bulk(points: Points) -> Floats:
    """(8, 3) corners of the middle 98 % of the points."""
    low, high = np.percentile(points[:: max(1, len(points) // 20_000)], (1, 99), axis=0)
    return np.array(
        [[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]
    )


def _around(image_size: tuple[int, int], size: tuple[int, int], xy: Floats) -> Extent:
    """The part of the image in whose midst (M, 2) image pixels lie, and that leaves it little."""
    wide, high = image_size
    whole = max(wide / size[0], high / size[1])
    step, middle = whole, (wide / 2, high / 2)
    beyond = np.array((wide, high)) * _BEYOND
    xy = np.clip(xy[~np.isnan(xy).any(axis=1)], -beyond, (wide, high) + beyond)
    if len(xy):
        low, top = xy.min(axis=0), xy.max(axis=0)
        need = max((top[0] - low[0]) / size[0], (top[1] - low[1]) / size[1]) * 1.3
        step = float(np.clip(need, _CLOSEST * whole, whole))
        middle = (float(low[0] + top[0]) / 2, float(low[1] + top[1]) / 2)
    left, upper = middle[0] - step * size[0] / 2, middle[1] - step * size[1] / 2
    return Extent(_held(left, step * size[0], wide), _held(upper, step * size[1], high), step)


def _held(start: float, span: float, limit: float) -> float:
    """The start of a window that leaves the image by no more than a share of it."""
    low, high = -_BEYOND * limit, (1 + _BEYOND) * limit - span
    return (low + high) / 2 if high < low else min(max(start, low), high)


def _cut(image: Image, extent: Extent, size: tuple[int, int]) -> Image:
    from PIL import Image as Images

    left, upper, step = extent.left, extent.upper, extent.step
    edges = (left, upper, left + step * size[0], upper + step * size[1])
    return image.transform(
        size, Images.Transform.EXTENT, edges, Images.Resampling.BILINEAR, fillcolor=NIGHT
    )


def picture_of(capture: Capture) -> Image | None:
    """The capture's image: colors, slightly grayed so that marks stand out, or shaded depth.

    Args:
        capture: the view.

    Returns:
        An RGB image; None for a view without one.
    """
    from PIL import Image as Images

    shape = capture.shape
    if shape is None:
        return None
    rgb = capture.rgb if capture.rgb is not None else capture.colors
    if rgb is not None:
        own = rgb.reshape(*shape, 3).astype(np.float32)
        calm = 0.72 * own + 0.28 * own.mean(axis=2, keepdims=True)
        return Images.fromarray((calm * 0.86).astype(np.uint8))
    if capture.depth is not None:
        return _shaded(capture.depth)
    if capture.cloud_frame != "optical" or capture.points is None:
        return None
    return _shaded(np.nan_to_num(capture.points[:, 2]).reshape(shape))


def _shaded(depth: NDArray[np.float32]) -> Image:
    """Depth as gray, near bright, lit from the left; missing pixels dark blue."""
    from PIL import Image as Images

    valid = depth > 0
    near, far = np.percentile(depth[valid], (2, 95)) if valid.any() else (0.0, 1.0)
    level = 1.0 - np.clip((depth - near) / max(float(far - near), 1e-3), 0.0, 1.0)
    down, right = np.gradient(depth)
    light = np.clip(0.5 * np.tanh(-(down + right) * 150.0), -0.5, 0.5)
    gray = np.clip(70.0 + 130.0 * level + 70.0 * light, 20, 235)
    image = np.repeat(gray[:, :, None], 3, axis=2).astype(np.uint8)
    image[~valid] = NIGHT
    return Images.fromarray(image)


def fitted_intrinsics(capture: Capture) -> Floats | None:
    """The pinhole matrix that an organized cloud's own points tell.

    Args:
        capture: the view.

    Returns:
        (3, 3) float64, px; None where none fits, or for another kind of view.
    """
    if capture.cloud_shape is None or capture.points is None:
        return None
    points, pixels = capture.valid_points()
    if capture.cloud_frame == "base":
        if capture.T_base_camera is None:
            return None
        points = transform(invert(capture.T_base_camera), points)
    ahead = points[:, 2] > 0.05
    step = max(1, len(points) // _FIT_POINTS)
    points, pixels = points[ahead][::step].astype(np.float64), pixels[ahead][::step]
    width = capture.cloud_shape[1]
    K = np.eye(3)
    for axis, pixel in ((0, pixels % width), (1, pixels // width)):
        ray = points[:, axis] / points[:, 2]
        if len(ray) < 20 or np.ptp(ray) < 1e-3:
            return None
        slope, start = np.polyfit(ray, pixel, 1)
        if np.median(np.abs(slope * ray + start - pixel)) > _FIT_WITHIN_PX or slope <= 0:
            return None
        K[axis, axis], K[axis, 2] = slope, start
    return K
