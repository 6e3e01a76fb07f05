"""Rays into a dense log-odds grid by OctoMap's rules (Hornung et al., OctoMap, 2013)."""

from __future__ import annotations

import math
import threading
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from boxgrasp.arrays import Floats, Points, readonly
from boxgrasp.errors import MapError
from boxgrasp.geometry.transforms import invert, validate_transform
from boxgrasp.kernels import rays
from boxgrasp.kernels._threads import run_chunks
from boxgrasp.mapping.local_map import Flags, LocalMap, MappingConfig, local_map_of, log_odds

Scan = tuple[NDArray[np.float32], ArrayLike | None]


def lattice_transform(T_base_map: Floats, resolution_m: float) -> Floats:
    """T_lattice_base: half a cell below the map frame, where the cells are OctoMap's."""
    T = invert(T_base_map)
    T[2, 3] += 0.5 * resolution_m
    return T


def build_local_map(
    scans: Sequence[Scan],
    T_base_map: ArrayLike,
    config: MappingConfig | None = None,
    *,
    threads: int = 2,
) -> LocalMap:
    """Insert scans in their order into an empty map round the target.

    A scan is points (N, 3) float32 and the camera's position (3,), both in the base frame. Without
    a position (None) its points are occupied and nothing becomes free. Points that are not finite
    are left out. Equal to `insertPointCloud(points, origin, -1, discretize=False)` of OctoMap on
    the points in the lattice frame, in every cell.
    """
    config = config or MappingConfig()
    T = validate_transform(T_base_map, "T_base_map")
    lowest, shape = config.lattice()
    values, known = insert_scans(
        scans,
        lowest,
        shape,
        config,
        T_lattice_points=lattice_transform(T, config.resolution_m),
        threads=threads,
    )
    return local_map_of(values, known, T, config)


def insert_scans(
    scans: Sequence[Scan],
    lowest: ArrayLike,
    shape: tuple[int, int, int],
    config: MappingConfig,
    *,
    T_lattice_points: Floats | None = None,
    threads: int = 2,
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Log-odds and known flags (nx, ny, nz) of a grid whose cells are OctoMap's cells.

    `lowest` (3,) is the key of the first cell: its corner lies at `lowest * resolution_m` of the
    lattice frame. Points are rounded to float32 there, as OctoMap rounds them.

    Raises:
        MapError: points or origins of another shape, or an origin that is not finite.
    """
    low = np.asarray(lowest, dtype=np.int64)
    T = np.eye(4) if T_lattice_points is None else np.ascontiguousarray(T_lattice_points)
    values = np.zeros(shape, dtype=np.float32)
    known = np.zeros(shape, dtype=np.bool_)
    hit, miss = log_odds(config.prob_hit), log_odds(config.prob_miss)
    least, most = log_odds(config.clamp_min), log_odds(config.clamp_max)
    for number, (points, origin) in enumerate(scans):
        cloud = _points(points, number)
        start = None if origin is None else _origin(origin, T, number)
        free, occupied = mark(cloud, start, low, shape, config.resolution_m, T, threads)
        is_occupied = occupied != 0
        is_free = (free != 0) & ~is_occupied
        # OctoMap updates free cells first; the sets are apart, so the order changes nothing.
        # A cell already at its clamp is left alone there, which adding and clamping also does.
        values[is_free] = np.clip(values[is_free] + miss, least, most)
        values[is_occupied] = np.clip(values[is_occupied] + hit, least, most)
        known |= is_free | is_occupied
    return values, known


def mark(
    points: Points,
    origin: NDArray[np.float32] | None,
    lowest: NDArray[np.int64],
    shape: tuple[int, int, int],
    resolution_m: float,
    T_lattice_points: Floats,
    threads: int = 2,
) -> tuple[Flags, Flags]:
    """Cells that one scan's rays cross, and cells that its points end in: (nx, ny, nz) uint8 each.

    The origin is in the lattice frame. A cell may be in both; occupied is then the one to keep.
    """
    occupied = np.zeros(shape, dtype=np.uint8)
    free = np.zeros(shape, dtype=np.uint8)
    count = len(points)
    if count == 0:
        return free, occupied
    # Kernels are compiled for read-only or for writable arrays: always hand them the same.
    points, T_lattice_points, lowest = points.view(), T_lattice_points.view(), lowest.view()
    for array in (points, T_lattice_points, lowest):
        readonly(array)
    factor = 1.0 / resolution_m
    has_origin = origin is not None and bool(np.all(np.abs(origin * factor) < rays.TREE_HALF))
    start = np.zeros(3, dtype=np.float32) if origin is None else origin
    side = _bundle_side(start, lowest, shape, resolution_m, count) if has_origin else 1
    moved = np.empty((count, 3), dtype=np.float32)
    bundle = np.empty(count, dtype=np.int32)
    parts: list[tuple[NDArray[np.float32], NDArray[np.int32]]] = []
    lock = threading.Lock()

    def classify(first: int, last: int) -> None:
        far = np.zeros(6 * side * side, dtype=np.float32)
        deepest = np.zeros(6 * side * side, dtype=np.int32)
        rays.classify(
            points, T_lattice_points, start, has_origin, factor, lowest, occupied,
            side, moved, bundle, far, deepest, first, last,
        )  # fmt: skip
        with lock:
            parts.append((far, deepest))

    _run(classify, count, 20_000, threads)
    if not has_origin:
        return free, occupied
    far, deepest = parts[0]
    for other, index in parts[1:]:
        deepest = np.where(other > far, index, deepest)
        far = np.maximum(far, other)
    chosen = np.flatnonzero(far)
    opening = np.full(len(far), -1, dtype=np.int32)
    for walk in (True, False):

        def bundles(first: int, last: int, walk: bool = walk) -> None:
            rays.bundles(
                walk, chosen, side, far, deepest, opening, moved, start, resolution_m, lowest,
                occupied, free, first, last,
            )  # fmt: skip

        _run(bundles, len(chosen), 1_000, threads)

    def rest(first: int, last: int) -> None:
        rays.walk_rest(bundle, side, opening, moved, start, resolution_m, lowest, free, first, last)

    _run(rest, count, 20_000, threads)
    return free, occupied


def _run(work: Any, count: int, smallest: int, threads: int) -> None:
    if count:
        run_chunks(work, count, smallest if threads > 1 else count + 1)


def _bundle_side(
    origin: NDArray[np.float32],
    lowest: NDArray[np.int64],
    shape: tuple[int, int, int],
    resolution_m: float,
    count: int,
) -> int:
    """Bins along a cube face: a bundle is about half a cell wide at the grid's center."""
    center = (lowest + np.array(shape) / 2) * resolution_m
    distance = float(np.max(np.abs(center - origin)))
    wanted = 2.0 * distance / (0.45 * resolution_m)
    return int(max(4, min(wanted, 192, math.sqrt(count))))


def _points(points: ArrayLike, number: int) -> Points:
    cloud = np.asarray(points)
    if cloud.ndim != 2 or cloud.shape[1] != 3 or cloud.dtype.kind not in "fiu":
        raise MapError(
            f"scan {number}: points have shape {cloud.shape}, {cloud.dtype}; valid: (N, 3) floats"
        )
    return np.ascontiguousarray(cloud, dtype=np.float32)


def _origin(origin: ArrayLike, T_lattice_points: Floats, number: int) -> NDArray[np.float32]:
    position = np.asarray(origin, dtype=np.float64)
    if position.shape != (3,) or not np.isfinite(position).all():
        raise MapError(f"scan {number}: origin is {origin!r}; valid: 3 finite numbers or None")
    moved = T_lattice_points[:3, :3] @ position + T_lattice_points[:3, 3]
    return moved.astype(np.float32)
