"""A capture's points, painted nearest last."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Floats, Points
from boxgrasp.draw.palette import PAPER
from boxgrasp.draw.views import View
from boxgrasp.geometry.transforms import transform
from boxgrasp.sensing.capture import Capture

if TYPE_CHECKING:
    from PIL.Image import Image

Colors = NDArray[np.uint8]

_MOST_POINTS: Final = 400_000
_TALL_M: Final = 0.30  # over the floor, where the gray is darkest
_LOW_M: Final = 0.012  # the support and what lies under it stay pale
_CLOSER_M: Final = 0.004
_BLOCK_PX: Final = 8


@dataclass(frozen=True, eq=False)
class Cloud:
    """A capture's points in the base frame.

    Attributes:
        points: (N, 3) float32, m.
        colors: (N, 3) uint8, or None.
        T_base_camera: (4, 4) float64, or None where the camera is unknown.
    """

    points: Points
    colors: Colors | None
    T_base_camera: Floats | None = None

    def part(self, keep: NDArray[Any] | slice) -> Cloud:
        """Some of the points.

        Args:
            keep: a mask, an index or a slice.

        Returns:
            The cloud of those.
        """
        colors = None if self.colors is None else self.colors[keep]
        return replace(self, points=self.points[keep], colors=colors)


def base_cloud(capture: Capture, T_base_camera: Floats | None) -> Cloud:
    """The valid points of a capture, thinned evenly where there are very many.

    Args:
        capture: the view.
        T_base_camera: (4, 4) float64 as the answer says it, None where it is unknown.

    Returns:
        The cloud in the base frame.
    """
    points, pixels = capture.valid_points()
    colors = None
    if capture.rgb is not None:
        colors = capture.rgb.reshape(-1, 3)[pixels]
    elif capture.colors is not None and capture.cloud_shape is not None:
        colors = capture.colors[pixels]
    elif capture.colors is not None:
        dropped = capture.robot_mask
        colors = capture.colors if dropped is None else capture.colors[~dropped.reshape(-1)]
    every = -(-len(points) // _MOST_POINTS)
    cloud = Cloud(points, colors, T_base_camera).part(slice(None, None, every))
    if capture.cloud_frame == "optical" and T_base_camera is not None:
        cloud = replace(cloud, points=transform(T_base_camera, cloud.points))
    return cloud


def shades(cloud: Cloud, floor_m: float) -> Colors:
    """Quiet colors: the capture's own, paled, else gray that darkens with the height.

    Args:
        cloud: the points.
        floor_m: height of the support, base frame.

    Returns:
        (N, 3) uint8.
    """
    height = cloud.points[:, 2] - np.float32(floor_m)
    share = np.clip(height / _TALL_M, 0.0, 1.0)
    if cloud.colors is None:
        gray, blue = 205.0 - 120.0 * share, share * 18.0
        tint = np.column_stack((gray - blue, gray, gray + blue))
    else:
        own = cloud.colors.astype(np.float32)
        tint = 0.75 * own + 0.25 * own.mean(axis=1, keepdims=True)
        tint = tint * 0.8 + 50.0
    low = height < _LOW_M
    tint[low] = 0.45 * tint[low] + 0.55 * np.array(PAPER, np.float32)
    return np.asarray(np.clip(tint, 0, 255), np.uint8)


def painted(cloud: Cloud, view: View, size: tuple[int, int], floor_m: float) -> Image:
    """The points as seen in a view, near before far, each grown until surfaces close.

    Args:
        cloud: the points.
        view: of the panel.
        size: width and height of the panel, px.
        floor_m: height of the support, base frame.

    Returns:
        An RGB image.
    """
    from PIL import Image as Images

    width, height = size
    canvas = np.empty((height, width, 3), np.uint8)
    canvas[:] = PAPER
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
    across = width // _BLOCK_PX + 1
    block = (cell // width // _BLOCK_PX) * across + (cell % width) // _BLOCK_PX
    _, counts = np.unique(block, return_counts=True)
    spacing = _BLOCK_PX / np.sqrt(float(np.median(counts)))
    return int(np.clip(np.ceil(spacing / 2), 1, 5))


def _grown(nearest: Points, color: Colors) -> tuple[Points, Colors]:
    grown, tint = nearest.copy(), color.copy()
    for here, there in (
        (np.s_[1:, :], np.s_[:-1, :]),
        (np.s_[:-1, :], np.s_[1:, :]),
        (np.s_[:, 1:], np.s_[:, :-1]),
        (np.s_[:, :-1], np.s_[:, 1:]),
    ):
        closer = nearest[there] < grown[here] - _CLOSER_M
        grown[here][closer] = nearest[there][closer]
        tint[here][closer] = color[there][closer]
    return grown, tint
