"""How base-frame points fall on a panel: through the camera, from above, from the side, oblique."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from boxgrasp.arrays import Array, Floats, readonly
from boxgrasp.draw.canvas import XY
from boxgrasp.geometry.transforms import invert, make_transform, transform

_NEAR_M = 0.03


@dataclass(frozen=True, eq=False)
class View:
    """T_view_base (4, 4): x right, y down, z into the panel; fx, fy, cx, cy in panel pixels.

    perspective: a pinhole camera; else parallel, and fx, fy are pixels a meter.
    """

    T_view_base: Floats
    fx: float
    fy: float
    cx: float
    cy: float
    perspective: bool

    def project(self, points: Array) -> tuple[Floats, Floats]:
        """(N, 3) base points to (N, 2) panel pixels and (N,) depths, m; NaN behind the camera."""
        seen = np.asarray(transform(self.T_view_base, points))  # a cloud stays float32: quicker
        return self._flat(seen), seen[:, 2]

    def point(self, at: Array) -> XY | None:
        """One point in panel pixels, or None behind the camera."""
        xy, _ = self.project(np.asarray(at, np.float64)[None])
        return None if np.isnan(xy).any() else (float(xy[0, 0]), float(xy[0, 1]))

    def segment(self, a: Array, b: Array) -> tuple[XY, XY] | None:
        """Both ends in panel pixels, cut at the camera; None where it lies behind."""
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
        """Cosine between a surface's outward normal and the way to the viewer; above 0 is seen."""
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


def camera_view(
    T_base_camera: Floats, K: Floats, extent: tuple[float, float, float], size: tuple[int, int]
) -> View:
    """The camera's image, cut out at `extent` (left, upper, pixels a panel pixel), upright.

    left and upper are on pixel edges: pixel (0, 0) covers 0 to 1.
    """
    left, upper, step = extent
    return View(
        T_view_base=readonly(invert(T_base_camera)),
        fx=float(K[0, 0]) / step,
        fy=float(K[1, 1]) / step,
        cx=(float(K[0, 2]) + 0.5 - left) / step - 0.5,
        cy=(float(K[1, 2]) + 0.5 - upper) / step - 0.5,
        perspective=True,
    )


# Rows are the panel's right, down and into-the-panel axes in the base frame.
_ABOVE = ((0.0, -1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, -1.0))
_SIDE = ((1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0))


def plan_view(kind: str, focus: Floats, size: tuple[int, int], least_m: float) -> View:
    """`above` (base x up, y to the left) or `side` (x to the right, z up) round (M, 3) points.

    least_m: the smaller side of the panel shows at least this much.
    """
    axes = np.array(_ABOVE if kind == "above" else _SIDE)
    flat = focus @ axes.T
    low, high = flat.min(axis=0), flat.max(axis=0)
    spans = np.maximum(high - low, least_m * np.array(size)[[0, 1, 1]] / min(size))
    scale = float(min((size[0] - 90) / spans[0], (size[1] - 90) / spans[1]))
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
    """A pinhole view from a given place and attitude, zoomed so that (M, 3) points fill it."""
    seen = focus @ T_view_base[:3, :3].T + T_view_base[:3, 3]
    rays = seen[:, :2] / np.maximum(seen[:, 2:], 0.2)
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


def oblique_frame(target: Floats, distance_m: float = 1.2) -> Floats:
    """T_view_base of a viewer on the robot's side, to the right and above, looking at a point."""
    back = np.array((-0.72, -0.42, 0.62))
    eye = target + back / np.linalg.norm(back) * distance_m
    z = (target - eye) / distance_m
    x = np.cross(z, (0.0, 0.0, 1.0))
    x /= np.linalg.norm(x)
    rotation = np.array((x, np.cross(z, x), z))
    return make_transform(rotation, -rotation @ eye)
