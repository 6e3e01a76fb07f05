"""A box that stands upright, turned about the vertical alone."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from boxgrasp.arrays import Floats, readonly


@dataclass(frozen=True, eq=False)
class Box:
    """T_base_box (4, 4) at the center, turned about z only; dimensions_m (3,) along x, y, z."""

    T_base_box: Floats
    dimensions_m: Floats

    @cached_property
    def base_center_m(self) -> Floats:
        """(3,) middle of the bottom face, base frame."""
        return readonly(self.T_base_box[:3, 3] - (0.0, 0.0, self.dimensions_m[2] / 2))

    @property
    def yaw_rad(self) -> float:
        """Turn of the box about the base's z."""
        return float(np.arctan2(self.T_base_box[1, 0], self.T_base_box[0, 0]))

    def T_base_map(self, height_m: float = 0.05) -> Floats:
        """The half sphere's frame: the box's axes, origin above the base center (3-2)."""
        T = np.array(self.T_base_box)
        T[:3, 3] = self.base_center_m + (0.0, 0.0, height_m)
        return readonly(T)
