"""What the camera measured on its way to a place."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Floats, Points

_AHEAD_M = 1e-3  # m, nearer places have no pixel


def depth_towards(
    depth: Points, intrinsics: Floats, places: Points
) -> tuple[Points, NDArray[np.bool_]]:
    """The depth at the pixel through which the camera would see each place.

    Args:
        depth: (H, W) float32, m, 0 where it is missing.
        intrinsics: (3, 3), px.
        places: (..., 3) float32, optical frame, m.

    Returns:
        (...) float32, m; and (...) bool, which places are ahead and in the image.
    """
    height, width = depth.shape
    z = np.maximum(places[..., 2], np.float32(_AHEAD_M))
    u = np.rint(places[..., 0] / z * intrinsics[0, 0] + intrinsics[0, 2]).astype(np.int64)
    v = np.rint(places[..., 1] / z * intrinsics[1, 1] + intrinsics[1, 2]).astype(np.int64)
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height) & (places[..., 2] > 0)
    return depth[np.clip(v, 0, height - 1), np.clip(u, 0, width - 1)], inside
