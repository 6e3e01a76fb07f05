"""A plane and the heights of points over it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from boxgrasp.arrays import Floats, Points, readonly


@dataclass(frozen=True, eq=False)
class Plane:
    """The points p with n . p + offset_m = 0.

    Attributes:
        normal: (3,) float64 unit normal n, pointing up.
        offset_m: m.
    """

    normal: Floats
    offset_m: float

    def heights(self, points: Points) -> Points:
        """Signed heights over the plane.

        Args:
            points: (N, 3) float32, m.

        Returns:
            (N,) float32, m.
        """
        return points @ self.normal.astype(np.float32) + np.float32(self.offset_m)

    def moved(self, T_a_b: Floats) -> Plane:
        """The same plane in another frame.

        Args:
            T_a_b: (4, 4), where the plane is given in b.

        Returns:
            The plane in a.
        """
        normal = T_a_b[:3, :3] @ self.normal
        return Plane(readonly(normal), float(self.offset_m - normal @ T_a_b[:3, 3]))
