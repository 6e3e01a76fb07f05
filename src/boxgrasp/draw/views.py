"""How base-frame points fall on a panel: through the camera, from above, from the side, oblique."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from boxgrasp.arrays import Array, Floats, readonly
from boxgrasp.draw.planar import XY
from boxgrasp.geometry.transforms import invert, make_transform, transform

_NEAR_M: Final = 0.03
_ROOM_PX: Final = 90  # round what a plan must show
_NEAREST_M: Final = 0.2  # that a looking view takes a point to be
_OBLIQUE_M: Final = 1.2


@dataclass(frozen=True)
class Extent:
    """The part of an image that a panel shows, on pixel edges: pixel (0, 0) covers 0 to 1.

    Attributes:
        left: image px.
        upper: image px.
        step: image pixels a panel pixel.
    """

    left: float
    upper: float
    step: float

    @staticmethod
    def of(image_size: tuple[int, int], size: tuple[int, int]) -> Extent:
        """The whole image in the middle of a panel.

        Args:
            image_size: width and height, px.
            size: of the panel, px.

        Returns:
            The extent, beyond the image where the panel has another shape.
        """
        step = max(image_size[0] / size[0], image_size[1] / size[1])
        left, upper = (image_size[k] / 2 - step * size[k] / 2 for k in (0, 1))
        return Extent(left, upper, step)


@dataclass(frozen=True, eq=False)
class View:
    """How base-frame points fall on a panel.

    Attributes:
        T_view_base: (4, 4) float64, m: x right, y down, z into the panel.
        fx: panel pixels, as of a camera; pixels a meter where it is parallel.
        fy: likewise.
        cx: panel pixels.
        cy: panel pixels.
        perspective: whether it is a pinhole camera's; else parallel.
    """

    T_view_base: Floats
    fx: float
    fy: float
    cx: float
    cy: float
    perspective: bool

    def project(self, points: Array) -> tuple[Floats, Floats]:
        """Many points.

        Args:
            points: (N, 3) float, base frame, m.

        Returns:
            (N, 2) float64 panel pixels, NaN behind the camera; and (N,) depths, m.
        """
        seen = np.asarray(transform(self.T_view_base, points))  # a cloud stays float32: quicker
        return self._flat(seen), seen[:, 2]

    def point(self, at: Array) -> XY | None:
        """One point.

        Args:
            at: (3,) float, base frame, m.

        Returns:
            x, y in panel pixels, or None behind the camera.
        """
        xy, _ = self.project(np.asarray(at, np.float64)[None])
        return None if np.isnan(xy).any() else (float(xy[0, 0]), float(xy[0, 1]))

    def segment(self, a: Array, b: Array) -> tuple[XY, XY] | None:
        """A straight line, cut at the camera.

        Args:
            a: (3,) float, base frame, m.
            b: likewise.

        Returns:
            Its two ends in panel pixels; None where all of it lies behind the camera.
        """
        ends = np.array((a, b), np.float64) @ self.T_view_base[:3, :3].T + self.T_view_base[:3, 3]
        if self.perspective:
            gap = ends[:, 2] - _NEAR_M
            if (gap <= 0).all():
                return None
            if (gap <= 0).any():
                share = gap[0] / (gap[0] - gap[1])
                ends[int(np.argmin(gap))] = ends[0] + share * (ends[1] - ends[0])
                ends[:, 2] = np.maximum(ends[:, 2], _NEAR_M)
        (x0, y0), (x1, y1) = self._flat(ends).tolist()
        return (x0, y0), (x1, y1)

    def faces(self, at: Array, normal: Array) -> float:
        """How a surface faces the viewer.

        Args:
            at: (3,) float64, base frame, m, a point of the surface.
            normal: (3,) float64, its outward unit normal, base frame.

        Returns:
            Cosine between the normal and the way to the viewer; above 0 it is seen.
        """
        if not self.perspective:
            return float(-self.T_view_base[2, :3] @ normal)
        way = invert(self.T_view_base)[:3, 3] - at
        return float(way @ normal / max(float(np.linalg.norm(way)), 1e-9))

    def _flat(self, seen: Floats) -> Floats:
        flat = np.empty((len(seen), 2))
        if self.perspective:
            z = np.where(seen[:, 2] >= _NEAR_M * 0.999, seen[:, 2], np.nan)
        else:
            z = np.ones(len(seen))
        flat[:, 0] = self.fx * seen[:, 0] / z + self.cx
        flat[:, 1] = self.fy * seen[:, 1] / z + self.cy
        return flat


def camera_view(T_base_camera: Floats, K: Floats, extent: Extent) -> View:
    """The camera's image, cut out, upright.

    Args:
        T_base_camera: (4, 4) float64, m.
        K: (3, 3) float64 intrinsics, px.
        extent: the part that the panel shows.

    Returns:
        A perspective view.
    """
    return View(
        T_view_base=readonly(invert(T_base_camera)),
        fx=float(K[0, 0]) / extent.step,
        fy=float(K[1, 1]) / extent.step,
        cx=(float(K[0, 2]) + 0.5 - extent.left) / extent.step - 0.5,
        cy=(float(K[1, 2]) + 0.5 - extent.upper) / extent.step - 0.5,
        perspective=True,
    )


# Rows are the panel's right, down and into-the-panel axes in the base frame.
_ABOVE = ((0.0, -1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, -1.0))
_SIDE = ((1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0))


def plan_view(kind: str, focus: Floats, size: tuple[int, int], least_m: float) -> View:
    """A parallel view along an axis of the base frame.

    Args:
        kind: `above` (base x up, y to the left) or `side` (x to the right, z up).
        focus: (M, 3) float64, base frame, m, what the panel must show.
        size: width and height of the panel, px.
        least_m: the smaller side of the panel shows at least this much.

    Returns:
        A parallel view.
    """
    axes = np.array(_ABOVE if kind == "above" else _SIDE)
    flat = focus @ axes.T
    low, high = flat.min(axis=0), flat.max(axis=0)
    spans = np.maximum(high - low, least_m * np.array(size)[[0, 1, 1]] / min(size))
    scale = float(min((size[0] - _ROOM_PX) / spans[0], (size[1] - _ROOM_PX) / spans[1]))
    middle = (low + high) / 2
    return View(
        T_view_base=readonly(make_transform(axes, (0.0, 0.0, 0.0))),
        fx=scale,
        fy=scale,
        cx=size[0] / 2 - scale * float(middle[0]),
        cy=size[1] / 2 - scale * float(middle[1]),
        perspective=False,
    )


def looking_view(
    T_view_base: Floats, focus: Floats, size: tuple[int, int], share: float = 0.72
) -> View:
    """A pinhole view from a given place and attitude, zoomed so that points fill it.

    Args:
        T_view_base: (4, 4) float64, m.
        focus: (M, 3) float64, base frame, m, what the panel must show.
        size: width and height of the panel, px.
        share: how much of the panel they fill.

    Returns:
        A perspective view.
    """
    seen = focus @ T_view_base[:3, :3].T + T_view_base[:3, 3]
    rays = seen[:, :2] / np.maximum(seen[:, 2:], _NEAREST_M)
    low, high = rays.min(axis=0), rays.max(axis=0)
    spans = np.maximum(high - low, 1e-3)
    f = float(min(size[0] * share / spans[0], size[1] * share / spans[1]))
    middle = (low + high) / 2
    return View(
        T_view_base=readonly(T_view_base),
        fx=f,
        fy=f,
        cx=size[0] / 2 - f * float(middle[0]),
        cy=size[1] / 2 - f * float(middle[1]),
        perspective=True,
    )


def oblique_frame(target: Floats) -> Floats:
    """The frame of a viewer on the robot's side, to the right and above, who looks at a point.

    Args:
        target: (3,) float64, base frame, m.

    Returns:
        (4, 4) float64 T_view_base, m.
    """
    back = np.array((-0.72, -0.42, 0.62))
    eye = target + back / np.linalg.norm(back) * _OBLIQUE_M
    z = (target - eye) / _OBLIQUE_M
    x = np.cross(z, (0.0, 0.0, 1.0))
    x /= np.linalg.norm(x)
    rotation = np.array((x, np.cross(z, x), z))
    return make_transform(rotation, -rotation @ eye)
