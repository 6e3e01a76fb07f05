"""Ray traversal of a local grid, equal to OctoMap's exact insertion cell by cell.

A ray's cells follow from comparisons of accumulated doubles, so they can only be repeated by doing
the same arithmetic. That costs too much for every ray, and most rays are not needed: they run
through cells that others have marked. So rays are bundled by direction, the deepest ray of each
bundle is walked, and a bundle whose every possible cell is then marked is done. The rays of the
other bundles are walked from the first slab that holds an unmarked cell on.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from boxgrasp.kernels._jit import jit

TREE_HALF = 32768  # OctoMap: 16 levels, keys from -32768 to 32767 round the origin
_HUGE = 1.7976931348623157e308  # std::numeric_limits<double>::max()
_LOOSE = 2e-6  # widens a bundle by more than float32 directions can stray from their line
_TIE = 1e-10  # of a ray's length: crossings closer than this are left to the accumulated sums


@jit
def classify(
    points: NDArray[np.float32],
    T_grid_source: NDArray[np.float64],
    origin: NDArray[np.float32],
    has_origin: bool,
    factor: float,
    lowest: NDArray[np.int64],
    occupied: NDArray[np.uint8],
    side: int,
    moved: NDArray[np.float32],
    bundle: NDArray[np.int32],
    far: NDArray[np.float32],
    deepest: NDArray[np.int32],
    start: int,
    stop: int,
) -> None:
    """Move points[start:stop] into the grid's frame, mark end cells, sort rays into bundles.

    A bundle is one of side x side bins on one of the six faces of a cube round the origin, B in
    all.

    Args:
        points: (N, 3) float32, source frame, m.
        T_grid_source: (4, 4).
        origin: (3,) float32 camera position, grid's frame, m.
        has_origin: whether it is known; without, end cells alone are marked.
        factor: 1 / edge of a cell, 1/m.
        lowest: (3,) int64 key of the first cell.
        occupied: (nx, ny, nz) uint8 to mark.
        side: bins along a face.
        moved: (N, 3) float32 to fill, grid's frame, m.
        bundle: (N,) int32 to fill; -1 where there is no ray: a point that is not finite or outside
            OctoMap's cube.
        far: (B,) float32 to raise, largest depth along the face's axis, m.
        deepest: (B,) int32 to fill, the point that has it.
        start: row.
        stop: row.
    """
    # Read once: the compiler cannot know that writing `moved` leaves these alone.
    T = T_grid_source
    xx, xy, xz, x1 = T[0, 0], T[0, 1], T[0, 2], T[0, 3]
    yx, yy, yz, y1 = T[1, 0], T[1, 1], T[1, 2], T[1, 3]
    zx, zy, zz, z1 = T[2, 0], T[2, 1], T[2, 2], T[2, 3]
    lx, ly, lz = lowest[0], lowest[1], lowest[2]
    ox, oy, oz = origin[0], origin[1], origin[2]
    nx, ny, nz = occupied.shape
    hx, hy, hz = lx + nx, ly + ny, lz + nz
    half = 0.5 * side
    for i in range(start, stop):
        x, y, z = float(points[i, 0]), float(points[i, 1]), float(points[i, 2])
        px = np.float32(xx * x + xy * y + xz * z + x1)
        py = np.float32(yx * x + yy * y + yz * z + y1)
        pz = np.float32(zx * x + zy * y + zz * z + z1)
        moved[i, 0] = px
        moved[i, 1] = py
        moved[i, 2] = pz
        bundle[i] = -1
        fx, fy, fz = factor * px, factor * py, factor * pz
        if not (
            -TREE_HALF <= fx < TREE_HALF
            and -TREE_HALF <= fy < TREE_HALF
            and -TREE_HALF <= fz < TREE_HALF
        ):
            continue
        if lx <= fx < hx and ly <= fy < hy and lz <= fz < hz:
            kx, ky, kz = math.floor(fx), math.floor(fy), math.floor(fz)
            occupied[int(kx) - lx, int(ky) - ly, int(kz) - lz] = 1
        if not has_origin:
            continue
        dx, dy, dz = px - ox, py - oy, pz - oz
        ax, ay, az = abs(dx), abs(dy), abs(dz)
        if ax >= ay and ax >= az:
            face, depth, u, v = (0 if dx > 0 else 1), ax, dy, dz
        elif ay >= az:
            face, depth, u, v = (2 if dy > 0 else 3), ay, dx, dz
        else:
            face, depth, u, v = (4 if dz > 0 else 5), az, dx, dy
        if depth == 0:
            continue
        scale = half / depth
        iu = min(side - 1, int(u * scale + half))
        iv = min(side - 1, int(v * scale + half))
        b = (face * side + iu) * side + iv
        bundle[i] = b
        if depth > far[b]:
            far[b] = depth
            deepest[b] = i


@jit
def _walk(
    ox: np.float32,
    oy: np.float32,
    oz: np.float32,
    px: np.float32,
    py: np.float32,
    pz: np.float32,
    resolution: float,
    lx: int,
    ly: int,
    lz: int,
    free: NDArray[np.uint8],
    axis: int,
    slab: int,
) -> None:
    """Mark the cells of the ray from o to p, its last one excluded, as OctoMap's DDA visits them.

    Slabs before number `slab` along `axis`, counted from the origin's, hold nothing to mark: the
    walk starts there with counted steps. Where a decision is closer than `_TIE`, the counted steps
    cannot stand for the accumulated ones, and the ray is walked again from its origin.
    """
    factor = 1.0 / resolution
    nx, ny, nz = free.shape
    cx = int(math.floor(factor * ox)) - lx
    cy = int(math.floor(factor * oy)) - ly
    cz = int(math.floor(factor * oz)) - lz
    ex = int(math.floor(factor * px)) - lx
    ey = int(math.floor(factor * py)) - ly
    ez = int(math.floor(factor * pz)) - lz
    if cx == ex and cy == ey and cz == ez:
        return
    dx: Any = px - ox  # float32 all along: the twin of OctoMap's point3d
    dy: Any = py - oy
    dz: Any = pz - oz
    length = np.float32(math.sqrt(float(dx * dx + dy * dy + dz * dz)))
    if length == 0:  # underflow: OctoMap's own walk is undefined, only the origin's cell is sure
        if 0 <= cx < nx and 0 <= cy < ny and 0 <= cz < nz:
            free[cx, cy, cz] = 1
        return
    dx, dy, dz = dx / length, dy / length, dz / length
    # The border's offset is rounded to float32 on purpose: OctoMap does so.
    half = float(np.float32(resolution * 0.5))
    sx, tx0, gx = 0, _HUGE, _HUGE
    sy, ty0, gy = 0, _HUGE, _HUGE
    sz, tz0, gz = 0, _HUGE, _HUGE
    if dx != 0:
        sx = 1 if dx > 0 else -1
        tx0 = (((cx + lx) + 0.5) * resolution + sx * half - ox) / dx
        gx = resolution / abs(float(dx))
    if dy != 0:
        sy = 1 if dy > 0 else -1
        ty0 = (((cy + ly) + 0.5) * resolution + sy * half - oy) / dy
        gy = resolution / abs(float(dy))
    if dz != 0:
        sz = 1 if dz > 0 else -1
        tz0 = (((cz + lz) + 0.5) * resolution + sz * half - oz) / dz
        gz = resolution / abs(float(dz))
    # The index at which the ray has left the grid for good.
    qx = nx if sx > 0 else -1
    qy = ny if sy > 0 else -1
    qz = nz if sz > 0 else -1
    tie = _TIE * float(length)
    while True:
        x, y, z = cx, cy, cz
        tx, ty, tz = tx0, ty0, tz0
        sure: Any = True
        stepped = False
        if slab > 0:
            if axis == 0:
                t = tx0 + (slab - 1) * gx
            elif axis == 1:
                t = ty0 + (slab - 1) * gy
            else:
                t = tz0 + (slab - 1) * gz
            if t > length + tie:
                return
            sure = t < length - tie
            if axis == 0:
                mx = slab
            else:
                f = (t - tx0) / gx
                sure = sure and abs(f - round(f)) * gx > tie
                mx = max(0, int(math.floor(f)) + 1)
            if axis == 1:
                my = slab
            else:
                f = (t - ty0) / gy
                sure = sure and abs(f - round(f)) * gy > tie
                my = max(0, int(math.floor(f)) + 1)
            if axis == 2:
                mz = slab
            else:
                f = (t - tz0) / gz
                sure = sure and abs(f - round(f)) * gz > tie
                mz = max(0, int(math.floor(f)) + 1)
            x += sx * mx
            y += sy * my
            z += sz * mz
            if mx:
                tx += mx * gx
            if my:
                ty += my * gy
            if mz:
                tz += mz * gz
            if sure and x == ex and y == ey and z == ez:
                return
            # The end's cell must still lie ahead, or the walk may have ended before.
            sure = sure and ((ex - x) * sx > 0 or (ey - y) * sy > 0 or (ez - z) * sz > 0)
            stepped = True
        else:
            tie = -1.0
            if 0 <= x < nx and 0 <= y < ny and 0 <= z < nz:
                free[x, y, z] = 1
        if sure:
            if (
                (sx == 0 and not 0 <= x < nx)
                or (sy == 0 and not 0 <= y < ny)
                or (sz == 0 and not 0 <= z < nz)
                or (x - qx) * sx >= 0
                and sx != 0
                or (y - qy) * sy >= 0
                and sy != 0
                or (z - qz) * sz >= 0
                and sz != 0
            ):
                return
            while True:
                if stepped:
                    nearest = min(tx, ty, tz)
                    if x == ex and y == ey and z == ez:
                        return
                    if abs(float(nearest) - float(length)) < tie:
                        sure = False
                        break
                    if nearest > length:
                        return
                    if 0 <= x < nx and 0 <= y < ny and 0 <= z < nz:
                        free[x, y, z] = 1
                    elif x == qx or y == qy or z == qz:
                        return
                stepped = True
                if tx < ty and tx < tz:
                    if min(ty, tz) - tx < tie:
                        sure = False
                        break
                    x += sx
                    tx += gx
                elif ty < tz and not tx < ty:
                    if min(tx, tz) - ty < tie:
                        sure = False
                        break
                    y += sy
                    ty += gy
                else:
                    if min(tx, ty) - tz < tie:
                        sure = False
                        break
                    z += sz
                    tz += gz
        slab = 0  # not sure: again from the origin, with OctoMap's own sums


@jit
def bundles(
    walk: bool,
    chosen: NDArray[np.int64],
    side: int,
    far: NDArray[np.float32],
    deepest: NDArray[np.int32],
    first: NDArray[np.int32],
    moved: NDArray[np.float32],
    origin: NDArray[np.float32],
    resolution: float,
    lowest: NDArray[np.int64],
    occupied: NDArray[np.uint8],
    free: NDArray[np.uint8],
    start: int,
    stop: int,
) -> None:
    """Set each bundle's first slab that may hold an unmarked cell, -1 when it has none.

    With `walk`, `first` becomes the slab where the bundle enters the grid, and its deepest ray is
    walked from there. Without, marks are read, from the slab that `first` names on.

    Args:
        walk: which of the two.
        chosen: (n,) int64 bundles that have rays.
        side: bins along a face.
        far: (B,) float32, as `classify` filled it, m.
        deepest: (B,) int32, likewise.
        first: (B,) int32 to fill.
        moved: (N, 3) float32 ends of the rays, grid's frame, m.
        origin: (3,) float32, grid's frame, m.
        resolution: edge of a cell, m.
        lowest: (3,) int64 key of the first cell.
        occupied: (nx, ny, nz) uint8.
        free: (nx, ny, nz) uint8 to mark.
        start: row of `chosen`.
        stop: row of `chosen`.
    """
    factor = 1.0 / resolution
    shape = np.array(free.shape)
    reach = 0.0
    for a in range(3):
        reach = max(reach, abs(float(origin[a])))
    for n in range(start, stop):
        bin_ = chosen[n]
        if not walk and first[bin_] < 0:
            continue
        face = bin_ // (side * side)
        iu = (bin_ // side) % side
        iv = bin_ % side
        a = face // 2
        b = 1 if a == 0 else 0
        c = 1 if a == 2 else 2
        sign = 1 - 2 * (face % 2)
        eps = _LOOSE * (reach + far[bin_] + resolution)
        u0 = 2.0 * iu / side - 1.0 - _LOOSE
        u1 = 2.0 * (iu + 1) / side - 1.0 + _LOOSE
        v0 = 2.0 * iv / side - 1.0 - _LOOSE
        v1 = 2.0 * (iv + 1) / side - 1.0 + _LOOSE
        oa, ob, oc = float(origin[a]), float(origin[b]), float(origin[c])
        ka = int(math.floor(factor * oa)) - lowest[a]
        if sign > 0:
            border = (ka + lowest[a] + 1) * resolution - oa
            slab, last = max(0, -ka), shape[a] - 1 - ka
        else:
            border = oa - (ka + lowest[a]) * resolution
            slab, last = max(0, ka - shape[a] + 1), ka
        if not walk:
            slab = max(slab, first[bin_])
        found = -1
        while slab <= last:
            near_edge = border + (slab - 1) * resolution - eps
            if near_edge > far[bin_]:
                break
            w0 = max(0.0, near_edge)
            w1 = min(float(far[bin_]), border + slab * resolution) + eps
            b0 = int(math.floor((ob + min(u0 * w0, u0 * w1) - eps) * factor)) - lowest[b]
            b1 = int(math.floor((ob + max(u1 * w0, u1 * w1) + eps) * factor)) - lowest[b]
            c0 = int(math.floor((oc + min(v0 * w0, v0 * w1) - eps) * factor)) - lowest[c]
            c1 = int(math.floor((oc + max(v1 * w0, v1 * w1) + eps) * factor)) - lowest[c]
            b0, b1 = max(b0, 0), min(b1, shape[b] - 1)
            c0, c1 = max(c0, 0), min(c1, shape[c] - 1)
            i = ka + sign * slab
            if b0 <= b1 and c0 <= c1:
                if walk:
                    found = slab
                    break
                open_ = False
                for j in range(b0, b1 + 1):
                    for k in range(c0, c1 + 1):
                        if a == 0:
                            open_ = open_ or free[i, j, k] | occupied[i, j, k] == 0
                        elif a == 1:
                            open_ = open_ or free[j, i, k] | occupied[j, i, k] == 0
                        else:
                            open_ = open_ or free[j, k, i] | occupied[j, k, i] == 0
                if open_:
                    found = slab
                    break
            slab += 1
        first[bin_] = found
        if walk and found >= 0:
            p = deepest[bin_]
            _walk(
                origin[0],
                origin[1],
                origin[2],
                moved[p, 0],
                moved[p, 1],
                moved[p, 2],
                resolution,
                lowest[0],
                lowest[1],
                lowest[2],
                free,
                a,
                found,
            )


@jit
def walk_rest(
    bundle: NDArray[np.int32],
    side: int,
    first: NDArray[np.int32],
    moved: NDArray[np.float32],
    origin: NDArray[np.float32],
    resolution: float,
    lowest: NDArray[np.int64],
    free: NDArray[np.uint8],
    start: int,
    stop: int,
) -> None:
    """Walk the rays of points[start:stop] whose bundle is not done, from its first open slab on.

    Args:
        bundle: (N,) int32 of each ray.
        side: bins along a face.
        first: (B,) int32, as `bundles` left it.
        moved: (N, 3) float32 ends of the rays, grid's frame, m.
        origin: (3,) float32, grid's frame, m.
        resolution: edge of a cell, m.
        lowest: (3,) int64 key of the first cell.
        free: (nx, ny, nz) uint8 to mark.
        start: row.
        stop: row.
    """
    factor = 1.0 / resolution
    reach = max(abs(float(origin[0])), abs(float(origin[1])), abs(float(origin[2])))
    for i in range(start, stop):
        b = bundle[i]
        if b < 0 or first[b] < 0:
            continue
        slab: Any = np.int64(first[b])  # as the other caller has it: one compiled walk
        face = b // (side * side)
        a = face // 2
        oa = float(origin[a])
        ka = math.floor(factor * oa)
        border = (ka + 1) * resolution - oa if face % 2 == 0 else oa - ka * resolution
        depth = abs(float(moved[i, a]) - oa)
        if border + (slab - 1) * resolution > depth + _LOOSE * (reach + depth + resolution):
            continue
        _walk(
            origin[0],
            origin[1],
            origin[2],
            moved[i, 0],
            moved[i, 1],
            moved[i, 2],
            resolution,
            lowest[0],
            lowest[1],
            lowest[2],
            free,
            a,
            slab,
        )


def ray_cells_naive(
    origin: NDArray[np.float32], end: NDArray[np.float32], resolution: float
) -> list[tuple[int, ...]]:
    """The cells that a ray frees, plainly: Amanatides and Woo in OctoMap's number types.

    Args:
        origin: (3,) float32, m.
        end: (3,) float32, m.
        resolution: edge of a cell, m.

    Returns:
        Keys, in the order of the walk, the last cell excluded.
    """
    factor = 1.0 / resolution
    o, e = np.asarray(origin, np.float32), np.asarray(end, np.float32)
    key = [math.floor(factor * float(v)) for v in o]
    goal = [math.floor(factor * float(v)) for v in e]
    if not all(-TREE_HALF <= k < TREE_HALF for k in key + goal) or key == goal:
        return []
    cells: list[tuple[int, ...]] = [tuple(key)]
    d = e - o
    length = np.float32(math.sqrt(float(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])))
    d = d / length
    step = [int(np.sign(v)) for v in d]
    t: list[Any] = [_HUGE] * 3
    delta: list[Any] = [_HUGE] * 3
    for a in range(3):
        if step[a]:
            border = (key[a] + 0.5) * resolution + float(np.float32(step[a] * resolution * 0.5))
            t[a] = (border - float(o[a])) / float(d[a])
            delta[a] = resolution / abs(float(d[a]))
    while True:
        if t[0] < t[1]:
            a = 0 if t[0] < t[2] else 2
        else:
            a = 1 if t[1] < t[2] else 2
        key[a] += step[a]
        t[a] += delta[a]
        if key == goal or min(t) > float(length):
            return cells
        cells.append(tuple(key))
