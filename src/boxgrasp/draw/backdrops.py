"""What lies behind the lines: the camera's image, or points painted nearest last."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Floats, Points
from boxgrasp.draw.palette import NIGHT, PAPER, RGB
from boxgrasp.draw.views import View, camera_view, looking_view, oblique_frame
from boxgrasp.geometry.transforms import invert, transform
from boxgrasp.sensing.capture import Capture

if TYPE_CHECKING:
    from PIL.Image import Image

Colors = NDArray[np.uint8]

_MOST_POINTS = 400_000
_FIT_WITHIN_PX = 1.0
_CLOSEST = 0.4  # of the whole image: enough round the target to know the place
_BEYOND = 0.12  # of the image: room beside it for a gripper that stands out of it


@dataclass(frozen=True, eq=False)
class Cloud:
    """A capture's points in the base frame: (N, 3) float32, and (N, 3) uint8 colors or None."""

    points: Points
    colors: Colors | None

    def part(self, keep: NDArray[Any]) -> Cloud:
        """The points that a mask or an index keeps."""
        return Cloud(self.points[keep], None if self.colors is None else self.colors[keep])


def base_cloud(capture: Capture, T_base_camera: Floats | None) -> Cloud:
    """The valid points of a capture in the base frame, thinned evenly where there are very many."""
    points, pixels = capture.valid_points()
    colors = None
    if capture.rgb is not None:
        colors = capture.rgb.reshape(-1, 3)[pixels]
    elif capture.colors is not None and capture.cloud_shape is not None:
        colors = capture.colors[pixels]
    elif capture.colors is not None:
        dropped = capture.robot_mask
        colors = capture.colors if dropped is None else capture.colors[~dropped.reshape(-1)]
    cloud = Cloud(points, colors).part(slice(None, None, -(-len(points) // _MOST_POINTS)))  # type: ignore[arg-type]
    if capture.cloud_frame == "optical" and T_base_camera is not None:
        cloud = Cloud(transform(T_base_camera, cloud.points), cloud.colors)
    return cloud


def shades(cloud: Cloud, floor_m: float) -> Colors:
    """(N, 3) quiet colors: the capture's own, paled, else gray that darkens with the height."""
    height = cloud.points[:, 2] - np.float32(floor_m)
    gray = 205.0 - 120.0 * np.clip(height / 0.30, 0.0, 1.0)
    if cloud.colors is None:
        blue = np.clip(height / 0.30, 0.0, 1.0) * 18.0
        tint = np.column_stack((gray - blue, gray, gray + blue))
    else:
        own = cloud.colors.astype(np.float32)
        tint = 0.75 * own + 0.25 * own.mean(axis=1, keepdims=True)
        tint = tint * 0.8 + 50.0
    low = height < 0.012  # the support and what lies under it stay behind
    tint[low] = 0.45 * tint[low] + 0.55 * np.array(PAPER, np.float32)
    return np.asarray(np.clip(tint, 0, 255), np.uint8)


def painted(
    cloud: Cloud, view: View, size: tuple[int, int], floor_m: float, paper: RGB = PAPER
) -> Image:
    """The points as seen in a view, near before far, each grown until surfaces close."""
    from PIL import Image as Images

    width, height = size
    canvas = np.empty((height, width, 3), np.uint8)
    canvas[:] = paper
    xy, depth = view.project(cloud.points)
    with np.errstate(invalid="ignore"):
        column, row = np.rint(xy[:, 0]), np.rint(xy[:, 1])
        seen = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    if not seen.any():
        return Images.fromarray(canvas)
    cell = row[seen].astype(np.int64) * width + column[seen].astype(np.int64)
    far_first = np.argsort(-depth[seen], kind="stable")
    cell = cell[far_first]
    nearest = np.full(height * width, np.inf, np.float32)
    color = np.zeros((height * width, 3), np.uint8)
    nearest[cell] = depth[seen][far_first]  # the last of equal cells stays: the nearest
    color[cell] = shades(cloud.part(seen), floor_m)[far_first]
    near: Points = nearest.reshape(height, width)
    tint: Colors = color.reshape(height, width, 3)
    for _ in range(_growth(cell, width)):
        near, tint = _grown(near, tint)
    hit = np.isfinite(near)
    canvas[hit] = tint[hit]
    return Images.fromarray(canvas)


def _growth(cell: NDArray[np.int64], width: int) -> int:
    """How many times to grow the points by a pixel, from their spacing where they are."""
    block = (cell // width // 8) * (width // 8 + 1) + (cell % width) // 8
    blocks, counts = np.unique(block, return_counts=True)
    spacing = 8.0 / np.sqrt(float(np.median(counts)))
    return int(np.clip(np.ceil(spacing / 2), 1, 5))


def _grown(nearest: Points, color: Colors) -> tuple[Points, Colors]:
    grown, tint = nearest.copy(), color.copy()
    for here, there in (
        (np.s_[1:, :], np.s_[:-1, :]),
        (np.s_[:-1, :], np.s_[1:, :]),
        (np.s_[:, 1:], np.s_[:, :-1]),
        (np.s_[:, :-1], np.s_[:, 1:]),
    ):
        closer = nearest[there] < grown[here] - 0.004
        grown[here][closer] = nearest[there][closer]
        tint[here][closer] = color[there][closer]
    return grown, tint


def camera_panel(
    capture: Capture,
    cloud: Cloud,
    T_base_camera: Floats | None,
    focus: Floats | None,
    size: tuple[int, int],
    floor_m: float,
) -> tuple[View, Image, str]:
    """The view through the camera with its backdrop and a caption.

    focus: (M, 3) base points the panel must show; None shows the whole image or cloud. A cloud
    without an image is painted from the camera's place; from the robot's side where even that
    is unknown.
    """
    image = picture_of(capture)
    K = capture.intrinsics if capture.intrinsics is not None else fitted_intrinsics(capture)
    if image is not None and K is not None and T_base_camera is not None:
        extent = _extent(image.size, K, T_base_camera, focus, size)
        view = camera_view(T_base_camera, K, extent, size)
        word = (
            "Camera image"
            if capture.rgb is not None or capture.colors is not None
            else "Depth image"
        )
        return view, _cut(image, extent, size), f"{word}{'' if focus is None else ' (cut out)'}"
    around = focus if focus is not None else _bulk(cloud.points)
    if T_base_camera is not None:
        view = looking_view(invert(T_base_camera), around, size)
        return view, painted(cloud, view, size, floor_m), "Points, seen from the camera"
    view = looking_view(oblique_frame(around.mean(axis=0)), around, size)
    return view, painted(cloud, view, size, floor_m), "Points, seen obliquely (camera unknown)"


def _bulk(points: Points) -> Floats:
    """(8, 3) corners of the middle 98 % of the points."""
    low, high = np.percentile(points[:: max(1, len(points) // 20_000)], (1, 99), axis=0)
    return np.array(
        [[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]
    )


def _extent(
    image_size: tuple[int, int],
    K: Floats,
    T_base_camera: Floats,
    focus: Floats | None,
    size: tuple[int, int],
) -> tuple[float, float, float]:
    """Left, upper, pixels a panel pixel, so that the focus is well in and the image is used."""
    wide, high = image_size
    whole = max(wide / size[0], high / size[1])
    step, middle = whole, (wide / 2, high / 2)
    if focus is not None:
        view = camera_view(T_base_camera, K, (0.0, 0.0, 1.0), image_size)
        xy, _ = view.project(focus)
        beyond = np.array((wide, high)) * _BEYOND
        xy = np.clip(xy[~np.isnan(xy).any(axis=1)], -beyond, (wide, high) + beyond)
        if len(xy):
            low, top = xy.min(axis=0), xy.max(axis=0)
            need = max((top[0] - low[0]) / size[0], (top[1] - low[1]) / size[1]) * 1.3
            step = float(np.clip(need, _CLOSEST * whole, whole))
            middle = (float(low[0] + top[0]) / 2, float(low[1] + top[1]) / 2)
    left, upper = middle[0] - step * size[0] / 2, middle[1] - step * size[1] / 2
    if focus is None:
        return left, upper, step
    return _held(left, step * size[0], wide), _held(upper, step * size[1], high), step


def _held(start: float, span: float, limit: float) -> float:
    """The start of a window that leaves the image by no more than a share of it."""
    low, high = -_BEYOND * limit, (1 + _BEYOND) * limit - span
    return (low + high) / 2 if high < low else min(max(start, low), high)


def _cut(image: Image, extent: tuple[float, float, float], size: tuple[int, int]) -> Image:
    from PIL import Image as Images

    left, upper, step = extent
    edges = (left, upper, left + step * size[0], upper + step * size[1])
    return image.transform(
        size, Images.Transform.EXTENT, edges, Images.Resampling.BILINEAR, fillcolor=NIGHT
    )


def picture_of(capture: Capture) -> Image | None:
    """The capture's image: colors, slightly grayed so that marks stand out, or shaded depth."""
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
    """The pinhole matrix that an organized cloud's own points tell; None where none fits."""
    if capture.cloud_shape is None or capture.points is None:
        return None
    points, pixels = capture.valid_points()
    if capture.cloud_frame == "base":
        if capture.T_base_camera is None:
            return None
        points = transform(invert(capture.T_base_camera), points)
    ahead = points[:, 2] > 0.05
    step = max(1, len(points) // 5000)
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
