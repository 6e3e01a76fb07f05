"""The numbers a learnt ranker sees: occupancy of the samples, box dimensions, face (thesis 3-3-2).

All features lie in [0, 1]. A sample of which the map knows nothing, outside its grid too, is 0.5.
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from boxgrasp.arrays import Floats
from boxgrasp.errors import BoxgraspError, ConfigError
from boxgrasp.mapping.local_map import LocalMap
from boxgrasp.ranking.sampling import PORTION_WIDTH_M, RIGHT, TOP_PERPENDICULAR, is_side, portion

# Thesis 3-3-2: side and top faces go to different models, so values may repeat.
FACE_FEATURE = {1: 0.0, 2: 0.5, 3: 1.0, 4: 0.0, 5: 1.0}
DIMENSIONS = ("depth_x", "width_y", "height_z")


@dataclass(frozen=True)
class FeatureSchema:
    """What each feature is, in order. Two schemas with one hash have the same features."""

    names: tuple[str, ...]

    @cached_property
    def hash(self) -> str:
        """SHA-256 of the names, hexadecimal."""
        return hashlib.sha256("\n".join(self.names).encode()).hexdigest()

    def __len__(self) -> int:
        return len(self.names)


def single_schema(points: Floats) -> FeatureSchema:
    """Schema of `single`: P samples by their place (map frame), then x, y, z dimensions."""
    return FeatureSchema(_occupancy_names(points) + DIMENSIONS)


def line_schema(points: Floats, face: int, width: float = PORTION_WIDTH_M) -> FeatureSchema:
    """Schema of `line`: p samples by their place at the face they were cut for, dimensions, face.

    The same for all side faces, and for both top faces: one model serves them.
    """
    cut_for = RIGHT if is_side(face) else TOP_PERPENDICULAR
    kind = "side" if is_side(face) else "top"
    names = _occupancy_names(portion(points, cut_for, width))
    return FeatureSchema((*names, *DIMENSIONS, f"{kind}_face"))


def normalized(dimensions_m: ArrayLike, largest_edge_m: float | None) -> NDArray[np.float32]:
    """(3,) box dimensions over the largest edge, clipped to 1.

    `largest_edge_m` is the training set's, stored in the model. None takes this box's own largest
    edge, which loses its scale; the thesis can be read either way.

    Raises:
        BoxgraspError: dimensions that are not three positive numbers.
        ConfigError: a largest edge that is not positive.
    """
    d = np.asarray(dimensions_m, dtype=np.float64)
    if d.shape != (3,) or not (np.isfinite(d).all() and (d > 0).all()):
        raise BoxgraspError(f"box dimensions are {d.tolist()}; valid: three positive meters")
    edge = float(d.max()) if largest_edge_m is None else float(largest_edge_m)
    if not (math.isfinite(edge) and edge > 0):
        raise ConfigError(f"largest edge is {edge}; valid: a positive number of meters")
    return np.minimum(d / edge, 1.0).astype(np.float32)


def single(
    local_map: LocalMap, dimensions_m: ArrayLike, points: Floats, largest_edge_m: float | None
) -> NDArray[np.float32]:
    """(P + 3,) features of the single model, and of the cascade's first: 187 for 184 samples."""
    return np.concatenate([local_map.values_at(points), normalized(dimensions_m, largest_edge_m)])


def line(
    local_map: LocalMap,
    dimensions_m: ArrayLike,
    points: Floats,
    face: int,
    largest_edge_m: float | None,
    width: float = PORTION_WIDTH_M,
) -> NDArray[np.float32]:
    """(p + 4,) features of the cascade's second models, which choose a line on `face`.

    61 (spiral) or 64 (grid) for a side face, 122 or 124 for a top face.
    """
    values = local_map.values_at(portion(points, face, width))
    feature = np.array([FACE_FEATURE[face]], dtype=np.float32)
    return np.concatenate([values, normalized(dimensions_m, largest_edge_m), feature])


def _occupancy_names(points: Floats) -> tuple[str, ...]:
    # Tenths of millimeters; adding 0.0 turns -0.0 into 0.0, so that equal places have equal names.
    rounded = np.round(points, 4) + 0.0
    return tuple(f"occupancy_x{x:+.4f}_y{y:+.4f}_z{z:+.4f}" for x, y, z in rounded)
