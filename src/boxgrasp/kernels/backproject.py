"""Depth image to points, in one pass over the pixels."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Array, Points
from boxgrasp.kernels._jit import jit


@jit
def backproject(
    depth: NDArray[np.float32],
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    dropped: NDArray[np.bool_],
    points: NDArray[np.float32],
    pixels: NDArray[np.int32],
) -> int:
    """The points of a depth image, in row-major order.

    Args:
        depth: (H, W) float32, m, 0 for missing.
        fx: focal length, px.
        fy: focal length, px.
        cx: principal point, px.
        cy: principal point, px.
        dropped: (H, W) bool, pixels to leave out; (0, 0) to keep all.
        points: (N, 3) or longer, float32 to fill, optical frame, m.
        pixels: (N,) or longer, int32 to fill, flat pixels v * W + u.

    Returns:
        N.
    """
    height, width = depth.shape
    keep_all = dropped.shape[0] == 0
    n = 0
    for v in range(height):
        y = (v - cy) / fy
        for u in range(width):
            z = depth[v, u]
            if z > 0 and (keep_all or not dropped[v, u]):
                points[n, 0] = (u - cx) / fx * z
                points[n, 1] = y * z
                points[n, 2] = z
                pixels[n] = v * width + u
                n += 1
    return n


@jit
def every_step(
    points: Points, pixels: NDArray[np.int32], width: int, step: int, kept: Points
) -> int:
    """Take the points whose row and column are multiples of a step.

    Args:
        points: (N, 3) float32, m.
        pixels: (N,) int32 flat pixels v * width + u, rising.
        width: of the image, px.
        step: at least 1.
        kept: (n, 3) float32 to fill, m.

    Returns:
        How many were taken.
    """
    column_kept = np.zeros(width, dtype=np.bool_)
    column_kept[::step] = True
    total = pixels.shape[0]
    rows = pixels[-1] // width + 1 if total else 0
    i, count = 0, 0
    for row in range(0, rows, step):
        start = row * width
        while i < total and pixels[i] < start:
            i += 1
        while i < total and pixels[i] < start + width:
            if column_kept[pixels[i] - start]:
                kept[count, 0] = points[i, 0]
                kept[count, 1] = points[i, 1]
                kept[count, 2] = points[i, 2]
                count += 1
            i += 1
    return count


def backproject_naive(
    depth: NDArray[np.float32], intrinsics: NDArray[np.float64], dropped: NDArray[np.bool_] | None
) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """The same points and pixels, a pixel at a time, by solving K ray = (u, v, 1).

    Args:
        depth: (H, W) float32, m, 0 for missing.
        intrinsics: (3, 3), px.
        dropped: (H, W) bool, pixels to leave out, or None.

    Returns:
        (N, 3) float32, optical frame, m, and (N,) int32 flat pixels.
    """
    points: list[Any] = []
    pixels: list[int] = []
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            if depth[v, u] > 0 and not (dropped is not None and dropped[v, u]):
                ray = np.linalg.solve(intrinsics, (u, v, 1.0))
                points.append(ray * float(depth[v, u]))
                pixels.append(v * depth.shape[1] + u)
    return np.array(points, np.float32).reshape(-1, 3), np.array(pixels, np.int32)


@jit
def depth_and_height(
    points: Array, pixels: Array, plane: Array, depth: Array, height: Array
) -> None:
    """Lay points out as images of their depth and of their height over a plane.

    Args:
        points: (N, 3) float32, optical frame, m.
        pixels: (N,) int32, flat pixel of each.
        plane: (4,) float64 unit normal n and d of n . p + d = 0, m.
        depth: (H * W,) float32 to fill where there are points, m.
        height: (H * W,) float32 likewise, m.
    """
    for k in range(points.shape[0]):
        x, y, z = points[k, 0], points[k, 1], points[k, 2]
        depth[pixels[k]] = z
        height[pixels[k]] = plane[0] * x + plane[1] * y + plane[2] * z + plane[3]
