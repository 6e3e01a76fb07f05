"""Rays into a dense log-odds grid by OctoMap's rules (Hornung et al., OctoMap, 2013)."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from boxgrasp.arrays import Floats, Points, readonly
from boxgrasp.errors import MapError
from boxgrasp.geometry.transforms import invert, validate_transform
from boxgrasp.kernels import rays
from boxgrasp.kernels._threads import run_chunks
from boxgrasp.mapping.local_map import (
    Flags,
    Lattice,
    LocalMap,
    MappingConfig,
    local_map_of,
    log_odds,
)

# Points (N, 3) float32, m, and the camera's position (3,), m, or None where it is unknown.
Scan = tuple[Points, ArrayLike | None]

_CHUNK_RAYS = 20_000  # a thread's least work
_CHUNK_BUNDLES = 1_000  # likewise
_BUNDLE_CELLS = 0.45  # width of a bundle at the grid's center, in cells: about half a one
_MOST_BINS = 192  # along a cube face, which bounds the tables of bundles
_LEAST_BINS = 4  # along a cube face


def lattice_transform(T_base_map: Floats, resolution_m: float) -> Floats:
    """The lattice frame, whose cells are OctoMap's: half a cell below the map frame.

    Args:
        T_base_map: (4, 4).
        resolution_m: edge of a cell, m.

    Returns:
        (4, 4) T_lattice_base.
    """
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

    Equal to `insertPointCloud(points, origin, -1, discretize=False)` of OctoMap on the points in
    the lattice frame, in every cell (Hornung et al., OctoMap, 2013).

    Args:
        scans: each points (N, 3) float32 and the camera's position (3,), base frame, m. Without a
            position (None) its points are occupied and nothing becomes free. Points that are not
            finite are left out.
        T_base_map: (4, 4), where the map lies.
        config: cells and sensor model; None for the defaults.
        threads: 1 stays on the caller's thread.

    Returns:
        The map.

    Raises:
        MapError: points or a position of another shape, or a position that is not finite.
        ConfigError: the extent and the resolution make more cells than memory holds.
        BoxgraspError: T_base_map is not a rigid transform.
    """
    config = config or MappingConfig()
    T = validate_transform(T_base_map, "T_base_map")
    T_lattice_source = lattice_transform(T, config.resolution_m)
    values, known = insert_scans(
        scans, config.lattice(), config, T_lattice_source=T_lattice_source, threads=threads
    )
    return local_map_of(values, known, T, config)


def insert_scans(
    scans: Sequence[Scan],
    lattice: Lattice,
    config: MappingConfig,
    *,
    T_lattice_source: Floats | None = None,
    threads: int = 2,
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Log-odds of a grid whose cells are OctoMap's cells, after scans in their order.

    Points are rounded to float32 in the lattice frame, as OctoMap rounds them.

    Args:
        scans: points (N, 3) and positions (3,) as `build_local_map`, in a frame of their own.
        lattice: the grid's first cell and shape.
        config: cell size and sensor model.
        T_lattice_source: (4, 4) maps that frame into the lattice frame; None for the identity.
        threads: 1 stays on the caller's thread.

    Returns:
        (nx, ny, nz) float32 log-odds, 0 where nothing is known, and (nx, ny, nz) bool, known.

    Raises:
        MapError: points or a position of another shape, or a position that is not finite.
    """
    T = np.eye(4) if T_lattice_source is None else np.ascontiguousarray(T_lattice_source)
    values = np.zeros(lattice.shape, dtype=np.float32)
    known = np.zeros(lattice.shape, dtype=np.bool_)
    hit, miss = log_odds(config.prob_hit), log_odds(config.prob_miss)
    least, most = log_odds(config.clamp_min), log_odds(config.clamp_max)
    for number, (points, origin) in enumerate(scans):
        cloud = _points(points, number)
        start = None if origin is None else _origin(origin, T, number)
        free, occupied = mark(cloud, start, lattice, config.resolution_m, T, threads)
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
    lattice: Lattice,
    resolution_m: float,
    T_lattice_source: Floats,
    threads: int = 2,
) -> tuple[Flags, Flags]:
    """Cells that one scan's rays cross, and cells that its points end in.

    Args:
        points: (N, 3) float32, m, in a frame of their own, source.
        origin: (3,) float32 camera position, lattice frame, m; None marks end cells alone.
        lattice: the grid's first cell and shape.
        resolution_m: edge of a cell, m.
        T_lattice_source: (4, 4).
        threads: 1 stays on the caller's thread.

    Returns:
        (nx, ny, nz) uint8 free, and (nx, ny, nz) uint8 occupied. A cell may be in both; occupied
        is then the one to keep.
    """
    occupied = np.zeros(lattice.shape, dtype=np.uint8)
    free = np.zeros(lattice.shape, dtype=np.uint8)
    if len(points) == 0:
        return free, occupied
    # Kernels are compiled for read-only or for writable arrays: always hand them the same.
    lowest = readonly(np.asarray(lattice.lowest, dtype=np.int64).view())
    if origin is not None and not np.all(np.abs(origin * (1.0 / resolution_m)) < rays.TREE_HALF):
        origin = None  # as OctoMap: a camera outside its cube frees nothing
    grid = _Grid(lowest, resolution_m, free, occupied, threads)
    bundled = _bundled(readonly(points.view()), origin, readonly(T_lattice_source.view()), grid)
    if origin is None:
        return free, occupied
    opening = _walk_deepest(bundled, origin, grid)

    def rest(first: int, last: int) -> None:
        rays.walk_rest(
            bundled.bundle, bundled.side, opening, bundled.moved, origin, resolution_m, lowest,
            free, first, last,
        )  # fmt: skip

    grid.run(rest, len(points), _CHUNK_RAYS)
    return free, occupied


@dataclass(frozen=True, eq=False)
class _Grid:
    """The cells to mark: (3,) key of the first, (nx, ny, nz) flags, and on how many threads."""

    lowest: NDArray[np.int64]
    resolution_m: float
    free: Flags
    occupied: Flags
    threads: int

    def run(self, work: Callable[[int, int], object], count: int, smallest: int) -> None:
        """Call `work` over [0, count), in chunks where there are threads."""
        if count:
            run_chunks(work, count, smallest if self.threads > 1 else count + 1)

    def side(self, origin: NDArray[np.float32], count: int) -> int:
        """Bins along a cube face for bundles of `count` rays."""
        center = (self.lowest + np.array(self.free.shape) / 2) * self.resolution_m
        distance = float(np.max(np.abs(center - origin)))
        wanted = 2.0 * distance / (_BUNDLE_CELLS * self.resolution_m)
        return int(max(_LEAST_BINS, min(wanted, _MOST_BINS, math.sqrt(count))))


@dataclass(frozen=True, eq=False)
class _Bundled:
    """One scan's rays in bundles by direction.

    Attributes:
        side: bins along each of six cube faces; B = 6 side^2 bundles.
        moved: (N, 3) float32, ends of the rays, lattice frame, m.
        bundle: (N,) int32, bundle of each ray, -1 for none.
        far: (B,) float32, largest depth in each bundle, m.
        deepest: (B,) int32, the ray that has it.
    """

    side: int
    moved: NDArray[np.float32]
    bundle: NDArray[np.int32]
    far: NDArray[np.float32]
    deepest: NDArray[np.int32]


def _bundled(
    points: Points, origin: NDArray[np.float32] | None, T_lattice_source: Floats, grid: _Grid
) -> _Bundled:
    """Mark the end cells and sort the rays into bundles."""
    count = len(points)
    start = np.zeros(3, dtype=np.float32) if origin is None else origin
    side = 1 if origin is None else grid.side(origin, count)
    moved = np.empty((count, 3), dtype=np.float32)
    bundle = np.empty(count, dtype=np.int32)
    parts: list[tuple[NDArray[np.float32], NDArray[np.int32]]] = []
    lock = threading.Lock()

    def classify(first: int, last: int) -> None:
        far = np.zeros(6 * side * side, dtype=np.float32)
        deepest = np.zeros(6 * side * side, dtype=np.int32)
        rays.classify(
            points, T_lattice_source, start, origin is not None, 1.0 / grid.resolution_m,
            grid.lowest, grid.occupied, side, moved, bundle, far, deepest, first, last,
        )  # fmt: skip
        with lock:
            parts.append((far, deepest))

    grid.run(classify, count, _CHUNK_RAYS)
    far, deepest = parts[0]
    for other, index in parts[1:]:
        deepest = np.where(other > far, index, deepest)
        far = np.maximum(far, other)
    return _Bundled(side, moved, bundle, far, deepest)


def _walk_deepest(bundled: _Bundled, origin: NDArray[np.float32], grid: _Grid) -> NDArray[np.int32]:
    """Walk each bundle's deepest ray; (B,) first slab that is then open, -1 for a done bundle."""
    chosen = np.flatnonzero(bundled.far)
    opening = np.full(len(bundled.far), -1, dtype=np.int32)
    for walk in (True, False):

        def bundles(first: int, last: int, walk: bool = walk) -> None:
            rays.bundles(
                walk, chosen, bundled.side, bundled.far, bundled.deepest, opening, bundled.moved,
                origin, grid.resolution_m, grid.lowest, grid.occupied, grid.free, first, last,
            )  # fmt: skip

        grid.run(bundles, len(chosen), _CHUNK_BUNDLES)
    return opening


def _points(points: ArrayLike, number: int) -> Points:
    cloud = np.asarray(points)
    if cloud.ndim != 2 or cloud.shape[1] != 3 or cloud.dtype.kind not in "fiu":
        raise MapError(
            f"scan {number}: points have shape {cloud.shape}, {cloud.dtype}; valid: (N, 3) floats"
        )
    return np.ascontiguousarray(cloud, dtype=np.float32)


def _origin(origin: ArrayLike, T_lattice_source: Floats, number: int) -> NDArray[np.float32]:
    position = np.asarray(origin, dtype=np.float64)
    if position.shape != (3,) or not np.isfinite(position).all():
        raise MapError(f"scan {number}: origin is {origin!r}; valid: 3 finite numbers or None")
    moved = T_lattice_source[:3, :3] @ position + T_lattice_source[:3, 3]
    return moved.astype(np.float32)
