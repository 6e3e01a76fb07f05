"""The scene of `boxgrasp demo`: a cereal box amid clutter, under a lamp."""

from __future__ import annotations

from typing import Any

import numpy as np

from boxgrasp.errors import SceneError
from boxgrasp.sensing.capture import Capture
from boxgrasp.simulate.scenes import TableScene, build_scene, to_capture

_RED, _BLUE, _GREEN, _YELLOW, _VIOLET, _GRAY = (
    [200, 60, 50],
    [60, 120, 200],
    [70, 170, 80],
    [220, 180, 60],
    [150, 90, 170],
    [214, 214, 208],
)


def _item(
    name: str, x: float, y: float, yaw: float, color: list[int], z: float = 0.0
) -> dict[str, Any]:
    return {"name": name, "x": x, "y": y, "z": z, "yaw": yaw, "color": color}


DEMO_SPEC: dict[str, Any] = {
    "target": _item("cereal_y", 0.82, -0.01, 0.30, _RED),
    "obstacles": [
        _item("crisps_tube", 0.90, 0.235, 0.0, _BLUE),
        _item("mug", 0.715, 0.155, 2.2, _VIOLET),
        _item("cereal_x", 1.03, -0.12, 0.5, _YELLOW),
        _item("beans_can", 0.86, -0.20, 0.0, _GREEN),
        _item("cigarettes", 0.66, -0.16, -0.5, _GRAY),
        _item("lamp", 0.88, 0.14, 0.0, _GRAY, 0.25),
    ],
    "camera": {"position": [0.12, -0.1, 1.36], "gaze": [0.86, 0.0, 0.87]},
}


def demo_scene() -> TableScene:
    """A cereal box between a tube, a mug, a can and another box, with a lamp over them.

    Returns:
        The scene.
    """
    return build_scene(DEMO_SPEC)


def demo_capture(seed: int = 0, *, noise: bool = True) -> Capture:
    """The demo's scene as a capture with colors and target pixel.

    Args:
        seed: of the noise.
        noise: an Xtion's, or none.

    Returns:
        The capture.

    Raises:
        SceneError: a seed below 0.
    """
    if seed < 0:
        raise SceneError(f"seed is {seed}; valid: 0 or more")
    capture, _ = to_capture(demo_scene(), np.random.default_rng(seed), noise, shading=0.4)
    return capture
