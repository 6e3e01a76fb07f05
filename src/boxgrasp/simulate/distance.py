"""Exact distances between solids, hidden sides included."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from boxgrasp.arrays import Floats
from boxgrasp.geometry.transforms import invert
from boxgrasp.kernels.solids import clearances
from boxgrasp.simulate.primitives import Box, Cylinder, Solids


def boxes_to_solids(
    T_base_boxes: Floats, dimensions_m: Floats, solids: Sequence[Box | Cylinder]
) -> Floats:
    """The shortest distance of each of M equal boxes from some solids.

    Args:
        T_base_boxes: (M, 4, 4) poses of the boxes' centers.
        dimensions_m: (3,) full lengths of a box along its axes, m.
        solids: boxes and cylinders, turned anyhow.

    Returns:
        (M,) float64, m, 0 where they meet; infinity where there is no solid.
    """
    boxes = np.asarray(T_base_boxes, dtype=np.float64).reshape(-1, 4, 4)
    out = np.full(len(boxes), np.inf)
    if solids and len(boxes):
        inverse = np.ascontiguousarray([invert(T) for T in boxes])
        half = np.ascontiguousarray(np.asarray(dimensions_m, dtype=np.float64) / 2)
        there = Solids.of(solids)
        clearances(inverse, half, there.kinds, there.T_base_solid, there.sizes, out)
    return out


def gap(a: Box | Cylinder, b: Box | Cylinder) -> float:
    """Distance of two solids.

    Args:
        a: one of them.
        b: the other; two cylinders that are not parallel are taken as if the second were the box
            round it, which is a lower bound.

    Returns:
        m, 0 where they meet.
    """
    if isinstance(a, Box):
        return float(boxes_to_solids(a.T_base_solid[None], a.dimensions_m, [b])[0])
    if isinstance(b, Box):
        return gap(b, a)
    between = invert(a.T_base_solid) @ b.T_base_solid
    if abs(between[2, 2]) < 1.0 - 1e-9:
        return gap(Box(b.T_base_solid, 2 * b.half_size), a)
    flat = max(float(np.hypot(between[0, 3], between[1, 3])) - a.radius_m - b.radius_m, 0.0)
    tall = max(float(abs(between[2, 3])) - (a.height_m + b.height_m) / 2, 0.0)
    return float(np.hypot(flat, tall))
