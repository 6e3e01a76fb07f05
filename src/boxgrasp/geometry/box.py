"""A box that stands upright, turned about the vertical alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from boxgrasp.arrays import Floats, readonly
from boxgrasp.forks import cached_property

# From the support plane to the center of the half sphere round the target (thesis section 3-2).
CENTER_ABOVE_SUPPORT_M: Final = 0.05


@dataclass(frozen=True, eq=False)
class Box:
    """A box that stands upright.

    Attributes:
        T_base_box: (4, 4) at its center, turned about z only.
        dimensions_m: (3,) along its x, y, z, m.
    """

    T_base_box: Floats
    dimensions_m: Floats

    @cached_property
    def base_center_m(self) -> Floats:
        """(3,) middle of the bottom face, base frame, m."""
        return readonly(self.T_base_box[:3, 3] - (0.0, 0.0, self.dimensions_m[2] / 2))

    @property
    def yaw_rad(self) -> float:
        """Turn of the box about the base's z, rad."""
        return float(np.arctan2(self.T_base_box[1, 0], self.T_base_box[0, 0]))

    def T_base_map(self, height_m: float = CENTER_ABOVE_SUPPORT_M) -> Floats:
        """The half sphere's frame, in which the local map lies (thesis section 3-2).

        Args:
            height_m: of its origin over the middle of the bottom face, m.

        Returns:
            (4, 4), with the box's axes.
        """
        T = np.array(self.T_base_box)
        T[:3, 3] = self.base_center_m + (0.0, 0.0, height_m)
        return readonly(T)
