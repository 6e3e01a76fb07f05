"""Cast scenes that several tests share; made once a process, never changed."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np

from boxgrasp import Capture, GraspSelector
from boxgrasp.kernels.raycast import BALL, BOWL, BOX, CUP, CYLINDER, WALL_M
from boxgrasp.simulate import TableScene, build_scene, draw_scene, to_capture

TABLE_M = 0.80
CAMERA = {"position": [0.10, 0.0, 1.40], "gaze": [0.85, 0.0, 0.85]}


def item(name: str, x: float, y: float, yaw: float = 0.0, z: float = 0.0) -> dict[str, Any]:
    """One object of a scene's spec, base frame, z over the table."""
    return {"name": name, "x": x, "y": y, "z": z, "yaw": yaw, "color": [200, 60, 50]}


def laid(target: dict[str, Any], *obstacles: dict[str, Any]) -> TableScene:
    """A scene laid by hand; obstacles get colors of their own."""
    colors = [[60, 120, 200], [70, 170, 80], [220, 180, 60], [150, 90, 170], [240, 140, 60]]
    painted = [{**other, "color": color} for other, color in zip(obstacles, colors, strict=False)]
    return build_scene({"target": target, "obstacles": painted, "camera": CAMERA})


@cache
def drawn(seed: int, obstacles: tuple[int, int] = (0, 4), yaw: str = "thesis") -> TableScene:
    """A random scene of the thesis's kind."""
    return draw_scene(np.random.default_rng(seed), obstacles=obstacles, yaw=yaw)


def seen(scene: TableScene, noise_seed: int | None = None) -> Capture:
    """The scene's view, exact unless a seed for the sensor's noise is given."""
    rng = None if noise_seed is None else np.random.default_rng(noise_seed)
    return to_capture(scene, rng, noise=noise_seed is not None)[0]


def halved(capture: Capture) -> Capture:
    """The same view with every second pixel of every second row: a quarter of the work."""
    assert capture.depth is not None and capture.rgb is not None
    assert capture.intrinsics is not None and capture.target_pixel is not None
    K = np.diag([0.5, 0.5, 1.0]) @ capture.intrinsics
    u, v = (value // 2 for value in capture.target_pixel)
    images = capture.depth[::2, ::2], K, capture.T_base_camera, capture.rgb[::2, ::2]
    return Capture(*images, target_pixel=(u, v))


def answer_text(selection: Any) -> str:
    """The answer's line but for its timings."""
    plain = selection.to_dict()
    plain.pop("timings_ms")
    return repr(plain)


def angle_deg(a: Sequence[float] | np.ndarray, b: Sequence[float] | np.ndarray) -> float:
    """Angle between two unit vectors."""
    return float(np.rad2deg(np.arctan2(np.linalg.norm(np.cross(a, b)), np.dot(a, b))))


def in_matter(kind: int, size: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Whether points lie in the matter of a solid or shell, by its equation alone."""
    x, y, z = points.T
    if kind == BOX:
        return np.asarray((np.abs(points) <= size).all(axis=1))
    if kind == CYLINDER:
        return np.asarray((np.hypot(x, y) <= size[0]) & (np.abs(z) <= size[2]))
    if kind in (BALL, BOWL):
        within = ((points / size) ** 2).sum(axis=1) <= 1
        if kind == BALL:
            return np.asarray(within)
        hollow = ((points / (size - WALL_M)) ** 2).sum(axis=1) < 1
        return np.asarray(within & ~hollow & (z <= 0))
    lower, upper, h = size
    radius = lower + (upper - lower) * (z + h) / (2 * h)
    r = np.hypot(x, y)
    within = (np.abs(z) <= h) & (r <= radius)
    if kind == CUP:
        within &= ~((r < radius - WALL_M) & (z > -h + WALL_M))
    return np.asarray(within)


def drawn_answer(seed: int) -> str:
    """The answer to a random scene's view, to be compared; importable in a process of its own."""
    return answer_text(GraspSelector().select(seen(drawn(seed), seed)))
