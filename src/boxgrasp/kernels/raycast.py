"""One ray a pixel against solids and thin shells: depth and the solid it meets."""

from __future__ import annotations

import numpy as np

from boxgrasp.arrays import Array
from boxgrasp.kernels._jit import jit

BOX, CYLINDER, PLANE, CONE, CUP, BALL, BOWL = 0, 1, 2, 3, 4, 5, 6
WALL_M = 0.003  # of cups and bowls


@jit
def round_hit(kind: int, size: Array, origin: Array, direction: Array) -> float:
    """Where a ray first meets a solid or shell of revolution.

    Args:
        kind: `CONE` (cut off, closed), `CUP` (the same, open at the top), `BALL` (an ellipsoid) or
            `BOWL` (its lower half, open).
        size: (3,) lower radius, upper radius, half height, or the half axes, m.
        origin: (3,) of the ray, in the solid's frame, m.
        direction: (3,) of the ray.

    Returns:
        In lengths of `direction`, infinity where it misses.
    """
    best = np.inf
    if kind == BALL or kind == BOWL:
        shells = 2 if kind == BOWL else 1
        for shell in range(shells):
            a = b = c = 0.0
            for k in range(3):
                half = size[k] - shell * WALL_M
                o, d = origin[k] / half, direction[k] / half
                a, b, c = a + d * d, b + o * d, c + o * o
            root = b * b - a * (c - 1.0)
            if root < 0.0:
                continue
            root = np.sqrt(root)
            for sign in (-1.0, 1.0):
                t = (-b + sign * root) / a
                open_half = kind == BOWL and origin[2] + t * direction[2] > 0.0
                if 0.0 < t < best and not open_half:
                    best = t
        if kind == BOWL and direction[2] != 0.0:  # the rim between the shells
            t = -origin[2] / direction[2]
            outer = inner = 0.0
            for k in range(2):
                at = origin[k] + t * direction[k]
                outer, inner = outer + (at / size[k]) ** 2, inner + (at / (size[k] - WALL_M)) ** 2
            if 0.0 < t < best and outer <= 1.0 <= inner:
                best = t
        return best
    lower, upper, h = size[0], size[1], size[2]
    grows = (upper - lower) / (2.0 * h)
    shells = 2 if kind == CUP else 1
    for shell in range(shells):
        middle = (lower + upper) / 2.0 - shell * WALL_M
        bottom = -h + shell * WALL_M
        radius = middle + grows * origin[2]
        a = direction[0] ** 2 + direction[1] ** 2 - (grows * direction[2]) ** 2
        b = origin[0] * direction[0] + origin[1] * direction[1] - grows * direction[2] * radius
        c = origin[0] ** 2 + origin[1] ** 2 - radius * radius
        root = b * b - a * c
        if root >= 0.0 and abs(a) > 1e-12:
            root = np.sqrt(root)
            for sign in (-1.0, 1.0):
                t = (-b + sign * root) / a
                z = origin[2] + t * direction[2]
                if 0.0 < t < best and bottom <= z <= h:
                    best = t
        if direction[2] != 0.0:
            t = (bottom - origin[2]) / direction[2]
            x, y = origin[0] + t * direction[0], origin[1] + t * direction[1]
            if 0.0 < t < best and x * x + y * y <= (middle + grows * bottom) ** 2:
                best = t
    if direction[2] != 0.0:  # the top: closed, or a rim
        t = (h - origin[2]) / direction[2]
        x, y = origin[0] + t * direction[0], origin[1] + t * direction[1]
        inner = upper - WALL_M if kind == CUP else 0.0
        if 0.0 < t < best and inner * inner <= x * x + y * y <= upper * upper:
            best = t
    return best


@jit
def raycast(
    kinds: Array,
    rotations: Array,
    origins: Array,
    sizes: Array,
    rectangles: Array,
    focal: Array,
    row_start: int,
    row_stop: int,
    depth: Array,
    index: Array,
) -> None:
    """Nearest surface of P solids for the pixels of rows [row_start, row_stop).

    Args:
        kinds: (P,) int, `BOX`, `CYLINDER`, `PLANE` or one that `round_hit` knows.
        rotations: (P, 3, 3), of the camera's frame seen from each solid's.
        origins: (P, 3), its origin there, m.
        sizes: (P, 3) half lengths (box), radius, radius, half height (cylinder), unused (plane),
            else as `round_hit` takes them, m.
        rectangles: (P, 4) int pixel bounds u0, u1, v0, v1 of each solid, half open.
        focal: (4,) fx, fy, cx, cy, px.
        row_start: row.
        row_stop: row.
        depth: (H, W) float64 whose rows are filled, m along the optical axis, infinity for nothing.
        index: (H, W) int32 whose rows are filled, the solid met, -1 for nothing.
    """
    depth[row_start:row_stop] = np.inf
    index[row_start:row_stop] = -1
    ray = np.empty(3)
    fx, fy, cx, cy = focal[0], focal[1], focal[2], focal[3]
    for p in range(kinds.shape[0]):
        kind = kinds[p]
        r = rotations[p]
        ox, oy, oz = origins[p, 0], origins[p, 1], origins[p, 2]
        hx, hy, hz = sizes[p, 0], sizes[p, 1], sizes[p, 2]
        c = ox * ox + oy * oy - hx * hx
        for v in range(max(row_start, rectangles[p, 2]), min(row_stop, rectangles[p, 3])):
            b = (v - cy) / fy
            ax = r[0, 1] * b + r[0, 2]
            ay = r[1, 1] * b + r[1, 2]
            az = r[2, 1] * b + r[2, 2]
            for u in range(rectangles[p, 0], rectangles[p, 1]):
                a = (u - cx) / fx
                dz = r[2, 0] * a + az
                near, far = -np.inf, np.inf
                # These are convex: the ray is inside between `near` and `far`.
                if kind > PLANE:
                    ray[0], ray[1], ray[2] = r[0, 0] * a + ax, r[1, 0] * a + ay, dz
                    near = round_hit(kind, sizes[p], origins[p], ray)
                elif kind == PLANE:
                    if dz == 0.0:
                        continue
                    near = -oz / dz
                    far = near
                else:
                    dx = r[0, 0] * a + ax
                    dy = r[1, 0] * a + ay
                    if dz == 0.0:
                        if abs(oz) > hz:
                            continue
                    else:
                        inverse = 1.0 / dz
                        half = abs(hz * inverse)
                        middle = -oz * inverse
                        near, far = middle - half, middle + half
                    if kind == BOX:
                        if dx == 0.0:
                            if abs(ox) > hx:
                                continue
                        else:
                            inverse = 1.0 / dx
                            half = abs(hx * inverse)
                            middle = -ox * inverse
                            near, far = max(near, middle - half), min(far, middle + half)
                        if dy == 0.0:
                            if abs(oy) > hy:
                                continue
                        else:
                            inverse = 1.0 / dy
                            half = abs(hy * inverse)
                            middle = -oy * inverse
                            near, far = max(near, middle - half), min(far, middle + half)
                    else:
                        square = dx * dx + dy * dy
                        if square == 0.0:
                            if c > 0.0:
                                continue
                        else:
                            linear = ox * dx + oy * dy
                            root = linear * linear - square * c
                            if root < 0.0:
                                continue
                            root = np.sqrt(root)
                            near = max(near, (-linear - root) / square)
                            far = min(far, (-linear + root) / square)
                    if near > far:
                        continue
                # From within a solid its far wall is seen.
                z = near if near > 0.0 else far
                if 0.0 < z < depth[v, u]:
                    depth[v, u] = z
                    index[v, u] = p


@jit
def paint(
    kinds: Array,
    rotations: Array,
    origins: Array,
    sizes: Array,
    colors: Array,
    object_ids: Array,
    light: Array,
    shading: float,
    focal: Array,
    row_start: int,
    row_stop: int,
    depth: Array,
    index: Array,
    depth_out: Array,
    rgb_out: Array,
    object_ids_out: Array,
) -> None:
    """Depth, color and object of each pixel that `raycast` has met.

    Args:
        kinds: (P,) int, as `raycast`.
        rotations: (P, 3, 3), as `raycast`.
        origins: (P, 3), as `raycast`.
        sizes: (P, 3), as `raycast`.
        colors: (P + 1, 3) uint8, ending with what nothing looks like.
        object_ids: (P + 1,) int32, likewise.
        light: (3,) unit vector towards the light, camera frame.
        shading: 0 leaves the colors flat, 1 makes sides away from the light black.
        focal: (4,) fx, fy, cx, cy, px.
        row_start: row.
        row_stop: row.
        depth: (H, W) float64 of `raycast`, m.
        index: (H, W) int32 of `raycast`.
        depth_out: (H, W) float32 to fill, m, 0 for nothing.
        rgb_out: (H, W, 3) uint8 to fill.
        object_ids_out: (H, W) int32 to fill.
    """
    normal = np.zeros(3)
    here = np.zeros(3)
    for v in range(row_start, row_stop):
        for u in range(index.shape[1]):
            p = index[v, u]
            object_ids_out[v, u] = object_ids[p]
            depth_out[v, u] = depth[v, u] if p >= 0 else 0.0
            factor = 1.0
            if shading > 0.0 and p >= 0:
                a, b, z = (u - focal[2]) / focal[0], (v - focal[3]) / focal[1], depth[v, u]
                r = rotations[p]
                for k in range(3):
                    here[k] = origins[p, k] + z * (r[k, 0] * a + r[k, 1] * b + r[k, 2])
                    normal[k] = 0.0
                side = 2
                if kinds[p] == PLANE:
                    here[2] = origins[p, 2]
                elif kinds[p] == BOX:
                    for k in range(2):
                        if abs(here[k]) * sizes[p, side] > abs(here[side]) * sizes[p, k]:
                            side = k
                elif abs(here[2]) * sizes[p, 0] < np.hypot(here[0], here[1]) * sizes[p, 2]:
                    side = -1
                if side >= 0:
                    normal[side] = np.sign(here[side])
                else:
                    normal[0], normal[1] = here[0] / sizes[p, 0], here[1] / sizes[p, 0]
                lit = 0.0
                for k in range(3):
                    lit += normal[k] * (
                        r[k, 0] * light[0] + r[k, 1] * light[1] + r[k, 2] * light[2]
                    )
                factor = 1.0 - shading * (1.0 - min(max(lit, 0.0), 1.0))
            for k in range(3):
                rgb_out[v, u, k] = np.uint8(colors[p, k] * factor + 0.5)
