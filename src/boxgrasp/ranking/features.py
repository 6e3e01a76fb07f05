"""The numbers a learned ranker sees: occupancy of the samples, box dimensions, face (thesis 3-3-2).

All features lie in [0, 1]. A sample of which the map knows nothing, outside its grid too, is 0.5.
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from boxgrasp.arrays import Floats, Points
from boxgrasp.errors import BoxgraspError, ConfigError
from boxgrasp.forks import cached_property
from boxgrasp.grasps.candidates import FRONT, LEFT, RIGHT, TOP_PARALLEL, TOP_PERPENDICULAR
from boxgrasp.ranking.sampling import PORTION_WIDTH_M, is_side, portion

# Thesis 3-3-2: side and top faces go to different models, so values may repeat.
FACE_FEATURE = {LEFT: 0.0, FRONT: 0.5, RIGHT: 1.0, TOP_PARALLEL: 0.0, TOP_PERPENDICULAR: 1.0}
DIMENSIONS = ("depth_x", "width_y", "height_z")


@dataclass(frozen=True)
class FeatureSchema:
    """What each feature is, in order. Two schemas with one hash have the same features.

    Attributes:
        names: one a feature.
    """

    names: tuple[str, ...]

    @cached_property
    def hash(self) -> str:
        """SHA-256 of the names, hexadecimal."""
        return hashlib.sha256("\n".join(self.names).encode()).hexdigest()

    def __len__(self) -> int:
        return len(self.names)


def single_schema(points: Floats) -> FeatureSchema:
    """Schema of `single_features`: samples by their place, then x, y, z dimensions.

    Args:
        points: (P, 3) sample points, map frame, m.

    Returns:
        P + 3 names.
    """
    return FeatureSchema(_occupancy_names(points) + DIMENSIONS)


def line_schema(points: Floats, face: int, width_m: float = PORTION_WIDTH_M) -> FeatureSchema:
    """Schema of `line_features`: the portion by its place at the face it was cut for, and the rest.

    The same for all side faces, and for both top faces: one model serves them.

    Args:
        points: (P, 3) sample points, map frame, m.
        face: 1 to 5.
        width_m: of the portion, m.

    Returns:
        p + 4 names.

    Raises:
        ConfigError: a face other than 1 to 5, a width that is not positive.
    """
    cut_for = RIGHT if is_side(face) else TOP_PERPENDICULAR
    kind = "side" if is_side(face) else "top"
    names = _occupancy_names(portion(points, cut_for, width_m))
    return FeatureSchema((*names, *DIMENSIONS, f"{kind}_face"))


def normalized(dimensions_m: ArrayLike, largest_edge_m: float | None) -> Points:
    """Box dimensions over the largest edge, clipped to 1.

    Args:
        dimensions_m: (N, 3) x, y, z of N boxes, m.
        largest_edge_m: the training set's, m, stored in the model. None takes each box's own
            largest edge, which loses its scale; the thesis can be read either way.

    Returns:
        (N, 3) float32 in [0, 1].

    Raises:
        BoxgraspError: dimensions that are not three positive numbers.
        ConfigError: a largest edge that is not positive.
    """
    d: Floats = np.asarray(dimensions_m, dtype=np.float64)
    if d.ndim != 2 or d.shape[1] != 3 or not (np.isfinite(d).all() and (d > 0).all()):
        raise BoxgraspError(f"box dimensions are {d.tolist()}; valid: three positive meters a box")
    if largest_edge_m is None:
        d = d / d.max(axis=1, keepdims=True)
        return np.minimum(d, 1.0).astype(np.float32)
    edge = float(largest_edge_m)
    if not (math.isfinite(edge) and edge > 0):
        raise ConfigError(f"largest edge is {edge}; valid: a positive number of meters")
    return np.minimum(d / edge, 1.0).astype(np.float32)


def single_features(
    occupancy: Points, dimensions_m: ArrayLike, largest_edge_m: float | None
) -> Points:
    """Features of the single model, and of the cascade's first.

    Args:
        occupancy: (N, P) float32, 0 free, 1 occupied, 0.5 else, of each sample.
        dimensions_m: (N, 3) box dimensions, m.
        largest_edge_m: as `normalized`, m.

    Returns:
        (N, P + 3) float32: 187 for the thesis's 184 samples.

    Raises:
        BoxgraspError: dimensions that are not three positive numbers.
        ConfigError: a largest edge that is not positive.
    """
    return np.asarray(np.hstack((occupancy, normalized(dimensions_m, largest_edge_m))))


def line_features(
    occupancy: Points, dimensions_m: ArrayLike, face: int, largest_edge_m: float | None
) -> Points:
    """Features of the cascade's second models, which choose a line on a face.

    Args:
        occupancy: (N, p) float32 of the face's portion.
        dimensions_m: (N, 3) box dimensions, m.
        face: 1 to 5.
        largest_edge_m: as `normalized`, m.

    Returns:
        (N, p + 4) float32: 61 (spiral) or 64 (grid) for a side face, 122 or 124 for a top face.

    Raises:
        BoxgraspError: dimensions that are not three positive numbers.
        ConfigError: a largest edge that is not positive.
    """
    feature = np.full((len(occupancy), 1), FACE_FEATURE[face], dtype=np.float32)
    return np.hstack((occupancy, normalized(dimensions_m, largest_edge_m), feature))


def _occupancy_names(points: Floats) -> tuple[str, ...]:
    # Tenths of millimeters; adding 0.0 turns -0.0 into 0.0, so that equal places have equal names.
    rounded = np.round(points, 4) + 0.0
    return tuple(f"occupancy_x{x:+.4f}_y{y:+.4f}_z{z:+.4f}" for x, y, z in rounded)
