"""A plane and the heights of points over it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from boxgrasp.arrays import Floats, Points, readonly


@dataclass(frozen=True, eq=False)
class Plane:
    """n . p + offset_m = 0 with n (3,) a unit normal pointing up; heights are n . p + offset_m."""

    normal: Floats
    offset_m: float

    def heights(self, points: Points) -> Points:
        """(N,) signed heights of (N, 3) points in meters."""
        return points @ self.normal.astype(np.float32) + np.float32(self.offset_m)

    def moved(self, T_a_b: Floats) -> Plane:
        """The same plane in frame a, where this one is given in b."""
        normal = T_a_b[:3, :3] @ self.normal
        return Plane(readonly(normal), float(self.offset_m - normal @ T_a_b[:3, 3]))
