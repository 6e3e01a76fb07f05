"""Which pixels lie between two surfaces and show neither, found before anything is measured."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Points, readonly
from boxgrasp.kernels._threads import run_chunks
from boxgrasp.kernels.flying import mark_flying
from boxgrasp.sensing.capture import Capture
from boxgrasp.sensing.sensor_model import SensorModel

# Measured on cast tables with mixed pixels at their outlines (tests/test_flying_pixels.py).
_STEEPEST = 1.0 / np.tan(np.deg2rad(8.0))  # nearer to the ray a surface gives next to no depth
_NOISE_GAIN = 4.2  # standard deviations of depth: three of a difference of two
_LONGEST_PX = 9  # steps of a slope: a veil has fewer
_LEAST_ROWS = 120  # a thread's least work


def flying_pixels(capture: Capture, sensor: SensorModel) -> NDArray[np.bool_]:
    """Mixed pixels, veils behind outlines and the ramps of edges.

    Args:
        capture: a view with an image; in others nothing is found.
        sensor: whose noise it has.

    Returns:
        (H, W) bool, or (0, 0) where there is no image.
    """
    depth, focal_px = _depth_image(capture), capture.focal_px
    if depth is None or focal_px is None:
        return np.zeros((0, 0), dtype=np.bool_)
    flying = np.zeros(depth.shape, dtype=np.bool_)
    noise = sensor.seen_with(focal_px).noise

    def work(first: int, last: int) -> None:
        mark_flying(
            depth, _STEEPEST / focal_px, _NOISE_GAIN, noise, _LONGEST_PX, first, last, flying
        )

    run_chunks(work, len(depth), smallest=_LEAST_ROWS)
    return readonly(flying)


def _depth_image(capture: Capture) -> Points | None:
    """(H, W) float32 depth, m, 0 for missing; None for what is no image from the camera."""
    if capture.depth is not None:
        return capture.depth
    if capture.points is None or capture.cloud_shape is None or capture.cloud_frame != "optical":
        return None
    depth = np.nan_to_num(capture.points[:, 2], nan=0.0).reshape(capture.cloud_shape)
    return readonly(np.ascontiguousarray(depth, dtype=np.float32))
