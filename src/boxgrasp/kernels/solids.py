"""Exact distance of a solid box from another solid box or cylinder, hidden sides included.

The distance of two convex solids is taken between their features: corners, edges and faces of the
box against the whole other solid, whose distance from a point has a closed form.
"""

from __future__ import annotations

import numpy as np

from boxgrasp.arrays import Array
from boxgrasp.kernels._jit import jit
from boxgrasp.kernels.raycast import CYLINDER


@jit
def point_to_solid(kind: int, h: Array, x: float, y: float, z: float) -> float:
    """Distance of a point from a solid, 0 inside.

    Args:
        kind: `BOX` or `CYLINDER`.
        h: (3,) half sizes of the solid, m.
        x: in the solid's frame, m.
        y: in the solid's frame, m.
        z: in the solid's frame, m.

    Returns:
        m.
    """
    dz = max(abs(z) - h[2], 0.0)
    if kind == CYLINDER:
        dr = max(np.sqrt(x * x + y * y) - h[0], 0.0)
        return float(np.sqrt(dr * dr + dz * dz))
    dx, dy = max(abs(x) - h[0], 0.0), max(abs(y) - h[1], 0.0)
    return float(np.sqrt(dx * dx + dy * dy + dz * dz))


@jit
def edge_to_solid(kind: int, h: Array, a: Array, b: Array) -> float:
    """Distance of a segment from a solid: a convex function of the place on it.

    Args:
        kind: `BOX` or `CYLINDER`.
        h: (3,) half sizes of the solid, m.
        a: (3,) one end, solid's frame, m.
        b: (3,) the other end, m.

    Returns:
        m.
    """
    ratio = 0.6180339887498949
    low, high = 0.0, 1.0
    s, t = 1.0 - ratio, ratio
    d = b - a
    fs = point_to_solid(kind, h, a[0] + s * d[0], a[1] + s * d[1], a[2] + s * d[2])
    ft = point_to_solid(kind, h, a[0] + t * d[0], a[1] + t * d[1], a[2] + t * d[2])
    best = min(fs, ft)
    # 40 golden sections leave 1e-8 of the edge.
    for _ in range(40):
        if fs <= ft:
            high, t, ft = t, s, fs
            s = high - ratio * (high - low)
            fs = point_to_solid(kind, h, a[0] + s * d[0], a[1] + s * d[1], a[2] + s * d[2])
        else:
            low, s, fs = s, t, ft
            t = low + ratio * (high - low)
            ft = point_to_solid(kind, h, a[0] + t * d[0], a[1] + t * d[1], a[2] + t * d[2])
        best = min(best, fs, ft)
        if best == 0.0:
            break
    return best


@jit
def box_to_solid(T: Array, hb: Array, kind: int, h: Array) -> float:
    """Distance of a solid box from a solid, 0 where they meet.

    Args:
        T: (4, 4) T_solid_box.
        hb: (3,) half sizes of the box, m.
        kind: `BOX` or `CYLINDER`.
        h: (3,) half sizes of the solid, m.

    Returns:
        m.
    """
    best = np.inf
    corners = np.empty((8, 3))
    for i in range(8):
        sx = hb[0] if i & 1 else -hb[0]
        sy = hb[1] if i & 2 else -hb[1]
        sz = hb[2] if i & 4 else -hb[2]
        for k in range(3):
            corners[i, k] = T[k, 0] * sx + T[k, 1] * sy + T[k, 2] * sz + T[k, 3]
        best = min(best, point_to_solid(kind, h, corners[i, 0], corners[i, 1], corners[i, 2]))
    if best == 0.0:
        return 0.0
    # The solid's center in the box's frame.
    center = np.zeros(3)
    for k in range(3):
        for j in range(3):
            center[k] -= T[j, k] * T[j, 3]
    if abs(center[0]) <= hb[0] and abs(center[1]) <= hb[1] and abs(center[2]) <= hb[2]:
        return 0.0
    for i in range(8):
        for bit in (1, 2, 4):
            if not i & bit:
                best = min(best, edge_to_solid(kind, h, corners[i], corners[i | bit]))
                if best == 0.0:
                    return 0.0
    # Faces of the box against the solid's farthest points along the face's normal.
    support = np.zeros(3)
    for axis in range(3):
        n = T[:3, axis]
        if kind == CYLINDER:
            flat = np.sqrt(n[0] * n[0] + n[1] * n[1])
            scale = h[0] / flat if flat > 1e-12 else 0.0
            support[0], support[1] = n[0] * scale, n[1] * scale
        else:
            support[0] = h[0] * np.sign(n[0]) if abs(n[0]) > 1e-12 else 0.0
            support[1] = h[1] * np.sign(n[1]) if abs(n[1]) > 1e-12 else 0.0
        support[2] = h[2] * np.sign(n[2]) if abs(n[2]) > 1e-12 else 0.0
        span = np.zeros(3)
        for k in range(3):
            for j in range(3):
                span[k] += T[j, k] * support[j]
        reach, middle = span[axis], center[axis]
        b, c = (axis + 1) % 3, (axis + 2) % 3
        for side in (-1.0, 1.0):
            face = side * hb[axis]
            # The point of the solid nearest to the face from outside, and where it would pierce it.
            near = middle - side * reach
            if side * near >= hb[axis]:
                t = -side
                gap = side * near - hb[axis]
            elif reach > 0.0 and abs(face - middle) <= reach:
                t = (face - middle) / reach
                gap = 0.0
            else:
                continue
            if abs(center[b] + t * span[b]) <= hb[b] and abs(center[c] + t * span[c]) <= hb[c]:
                best = min(best, gap)
    return best


@jit
def clearances(
    T_gripper_base: Array, hb: Array, kinds: Array, T_base_solids: Array, sizes: Array, out: Array
) -> None:
    """The smallest distance of each of M boxes from P solids.

    Args:
        T_gripper_base: (M, 4, 4) of the boxes.
        hb: (3,) half sizes of the boxes, m.
        kinds: (P,) int, `BOX` or `CYLINDER`.
        T_base_solids: (P, 4, 4).
        sizes: (P, 3) half sizes of the solids, m.
        out: (M,) float64 to lower, m.
    """
    T = np.empty((4, 4))
    for m in range(T_gripper_base.shape[0]):
        # T_gripper_base holds T_base_gripper inverted; both directions are needed below.
        for p in range(kinds.shape[0]):
            # T_solid_gripper = (T_gripper_base @ T_base_solid)^-1, rigid.
            for i in range(3):
                for j in range(3):
                    total = 0.0
                    for k in range(3):
                        total += T_gripper_base[m, j, k] * T_base_solids[p, k, i]
                    T[i, j] = total
            for j in range(3):
                center = T_gripper_base[m, j, 3]
                for k in range(3):
                    center += T_gripper_base[m, j, k] * T_base_solids[p, k, 3]
                T[3, j] = center
            for i in range(3):
                T[i, 3] = -(T[i, 0] * T[3, 0] + T[i, 1] * T[3, 1] + T[i, 2] * T[3, 2])
            out[m] = min(out[m], box_to_solid(T, hb, kinds[p], sizes[p]))
