"""A structured-light depth camera: how its depth scatters, how far its pixels lie apart."""

from __future__ import annotations

from typing import Final

import numpy as np

from boxgrasp.arrays import Points

# Nguyen, Izadi and Lovell, 3DIMPVT 2012: sigma(z) = 1.2 mm + 1.9 mm (z - 0.4 m)^2, z in meters.
NOISE_FLOOR_M: Final = 0.0012
NOISE_GROWTH_PER_M: Final = 0.0019
NOISE_LEAST_AT_M: Final = 0.4
# Focal length of such a camera's 640 x 480 image, in pixels.
FOCAL_PX: Final = 525.0


def axial_noise_m(ranges_m: Points) -> Points:
    """Standard deviation of the camera's depth (Nguyen 2012).

    Args:
        ranges_m: (N,) float32, distance from the camera, m.

    Returns:
        (N,) float32, m.
    """
    off = ranges_m - NOISE_LEAST_AT_M
    return np.asarray(NOISE_FLOOR_M + NOISE_GROWTH_PER_M * off**2, dtype=np.float32)
