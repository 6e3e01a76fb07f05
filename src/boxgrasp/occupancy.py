"""What is occupied, free and unseen round the target: a dense log-odds grid with OctoMap's rules.

Thesis section 1-2-2 and 2-2; the update of Hornung et al., OctoMap, 2013, cell by cell.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from boxgrasp.arrays import Floats, Points, readonly
from boxgrasp.errors import ConfigError, MapError
from boxgrasp.geometry.transforms import check_transform, invert
from boxgrasp.kernels import rays
from boxgrasp.kernels._threads import run_chunks

FREE, UNSEEN, OCCUPIED = 0, 1, 2

Scan = tuple[NDArray[np.float32], ArrayLike | None]
Flags = NDArray[np.uint8]

_MOST_CELLS = 50_000_000
_ABOVE_SUPPORT_M = 0.002  # the lowest layer keeps this far off the support plane's noise
_LATTICE_SLACK = 1e-9  # of a cell: 0.42 / 0.07 must be 6 cells, not 7


@dataclass(frozen=True)
class OccupancyConfig:
    """The local map: cell size, OctoMap's sensor model, thresholds, extent round the target.

    thin: insert every thin-th point in the image's order (thesis 3-5-2: every second); None takes
    every second row and column of a dense image, which still crosses every cell.
    """

    resolution_m: Annotated[float, msgspec.Meta(ge=0.005, le=0.2)] = 0.03
    hit: Annotated[float, msgspec.Meta(gt=0.5, lt=1.0)] = 0.7
    miss: Annotated[float, msgspec.Meta(gt=0.0, lt=0.5)] = 0.3
    clamp_min: Annotated[float, msgspec.Meta(gt=0.0, lt=0.5)] = 0.1192
    clamp_max: Annotated[float, msgspec.Meta(gt=0.5, lt=1.0)] = 0.971
    occupied_above: Annotated[float, msgspec.Meta(ge=0.5, lt=1.0)] = 0.66
    free_below: Annotated[float, msgspec.Meta(gt=0.0, le=0.5)] = 0.33
    half_width_m: Annotated[float, msgspec.Meta(ge=0.05, le=2.0)] = 0.36
    height_m: Annotated[float, msgspec.Meta(ge=0.05, le=2.0)] = 0.54
    centre_above_support_m: Annotated[float, msgspec.Meta(ge=0.0, le=0.5)] = 0.05
    thin: Annotated[int, msgspec.Meta(ge=1, le=100)] | None = None

    def lattice(self) -> tuple[NDArray[np.int64], tuple[int, int, int]]:
        """Key of the lowest cell and (nx, ny, nz).

        Keys count cells in the lattice frame: the map frame, moved half a cell down.

        Raises:
            ConfigError: the extent and the resolution make more cells than memory holds.
        """
        s = self.resolution_m
        n = max(1, math.ceil(self.half_width_m / s - _LATTICE_SLACK))
        # Layer k spans (k - 1/2) s to (k + 1/2) s round the half sphere's centre.
        down = self.centre_above_support_m - _ABOVE_SUPPORT_M
        low = math.ceil(0.5 - down / s - _LATTICE_SLACK)
        up = self.height_m - self.centre_above_support_m
        top = max(low, math.ceil(up / s - 0.5 - _LATTICE_SLACK))
        shape = (2 * n, 2 * n, top - low + 1)
        if shape[0] * shape[1] * shape[2] > _MOST_CELLS:
            raise ConfigError(
                f"occupancy: resolution_m {s} makes {shape[0]} x {shape[1]} x {shape[2]} cells; "
                f"valid: at most {_MOST_CELLS} (coarser, or a smaller half_width_m, height_m)"
            )
        return np.array([-n, -n, low], dtype=np.int64), shape


def log_odds(probability: float) -> np.float32:
    """Logarithm of p / (1 - p), rounded to float32 as OctoMap stores it."""
    return np.float32(math.log(probability / (1.0 - probability)))


@dataclass(frozen=True, eq=False)
class LocalMap:
    """Cells round the target.

    T_base_map (4, 4): origin at the half sphere's centre, turned with the box. `lowest` (3,): the
    map-frame corner of cell 0, 0, 0, metres. `log_odds` (nx, ny, nz) float32, 0 where not `known`
    (nx, ny, nz) bool. Horizontally cells have their borders on multiples of the resolution, and
    vertically their centres, so that every sample of a grid of that spacing is a cell's centre.
    """

    T_base_map: Floats
    resolution_m: float
    lowest: Floats
    log_odds: NDArray[np.float32]
    known: NDArray[np.bool_]
    occupied_above: float = 0.66
    free_below: float = 0.33

    def __post_init__(self) -> None:
        readonly(self.lowest)
        readonly(self.log_odds)
        readonly(self.known)
        # Log-odds rise with p, so the thresholds are compared there, without an exp a cell. A cell
        # that is not known has 0, between them.
        state = (self.log_odds > log_odds(self.occupied_above)).astype(np.uint8)
        state += self.log_odds >= log_odds(self.free_below)
        object.__setattr__(self, "_state", readonly(state))

    @property
    def shape(self) -> tuple[int, int, int]:
        """(nx, ny, nz)."""
        nx, ny, nz = self.log_odds.shape
        return nx, ny, nz

    @property
    def probability(self) -> NDArray[np.float64]:
        """(nx, ny, nz) occupancy probability, 0.5 where nothing is known."""
        return np.asarray(1.0 - 1.0 / (1.0 + np.exp(self.log_odds.astype(np.float64))))

    @property
    def state(self) -> Flags:
        """(nx, ny, nz) uint8: 0 free, 1 unseen or uncertain, 2 occupied (thesis section 2-2)."""
        state: Flags = self.__dict__["_state"]
        return state

    def keys(self, points_map: ArrayLike) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """(M, 3) cell of each point (map frame) and (M,) whether that cell is in the map."""
        p = np.asarray(points_map, dtype=np.float64).reshape(-1, 3)
        cells = np.floor((p - self.lowest) / self.resolution_m)
        inside = np.all((cells >= 0) & (cells < self.shape), axis=1)  # NaN is outside
        return np.where(inside[:, None], cells, 0).astype(np.int64), inside

    def values_at(self, points_map: ArrayLike) -> NDArray[np.float32]:
        """(M,) float32 for points (M, 3) of the map frame: 0 free, 1 occupied, 0.5 else."""
        cells, inside = self.keys(points_map)
        state = self.state[cells[:, 0], cells[:, 1], cells[:, 2]]
        return np.where(inside, state * np.float32(0.5), np.float32(0.5)).astype(np.float32)

    def cells(self, state: int) -> Floats:
        """(K, 3) centres, map frame, of the cells in `state`, in the order of their index."""
        found = np.argwhere(self.state == state)
        return np.asarray(self.lowest + (found + 0.5) * self.resolution_m)

    @property
    def centres(self) -> Floats:
        """(nx, ny, nz, 3) centres of all cells, map frame."""
        index = np.moveaxis(np.indices(self.shape), 0, -1)
        return np.asarray(self.lowest + (index + 0.5) * self.resolution_m)


@dataclass(frozen=True, eq=False)
class MapCells:
    """The leaves of an OctoMap, in the frame of its file, which is taken as the base frame.

    `keys` (K, 3) int32: the lowest cell of each leaf, cell 0 having its lower corner at the origin.
    `spans` (K,) int64: its edge in cells, a power of two. `log_odds` (K,) float32. No two overlap.
    """

    resolution_m: float
    keys: NDArray[np.int32]
    spans: NDArray[np.int64]
    log_odds: NDArray[np.float32]

    def __post_init__(self) -> None:
        codes = _morton(self.keys.astype(np.int64) + rays.TREE_HALF)
        order = np.argsort(codes, kind="stable")
        for name in ("keys", "spans", "log_odds"):
            object.__setattr__(self, name, readonly(getattr(self, name)[order]))
        object.__setattr__(self, "_codes", readonly(codes[order]))

    def __len__(self) -> int:
        return len(self.spans)

    def log_odds_at(self, points: ArrayLike) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """(M,) log-odds of the leaves that hold points (M, 3), 0 where none does, and (M,) known.

        As OctoMap's `search` at the lowest level, pruned leaves included.
        """
        p = np.asarray(points, dtype=np.float64).reshape(-1, 3)
        scaled = np.floor(p * (1.0 / self.resolution_m)) + rays.TREE_HALF
        inside = np.all((scaled >= 0) & (scaled < 2 * rays.TREE_HALF), axis=1)
        codes = _morton(np.where(inside[:, None], scaled, 0).astype(np.int64))
        starts: NDArray[np.int64] = self.__dict__["_codes"]
        leaf = np.searchsorted(starts, codes, side="right") - 1
        held = inside & (leaf >= 0)
        leaf = np.where(held, leaf, 0)
        if len(self):
            held &= codes - starts[leaf] < self.spans[leaf] ** 3
            return np.where(held, self.log_odds[leaf], np.float32(0)), held
        return np.zeros(len(p), dtype=np.float32), held

    def occupied(self, above: float = 0.66) -> tuple[Floats, Floats]:
        """(K, 3) centres, base frame, and (K,) edges in metres of the leaves with p above that."""
        kept = self.log_odds > log_odds(above)
        edges: Floats = self.spans[kept] * np.float64(self.resolution_m)
        return np.asarray(self.keys[kept] * self.resolution_m + 0.5 * edges[:, None]), edges


def _morton(keys: NDArray[np.int64]) -> NDArray[np.int64]:
    """(K,) codes of keys (K, 3) from 0 to 65535: the order in which OctoMap stores leaves."""
    spread = keys.astype(np.int64)
    for shift, mask in (
        (16, 0x0000FF0000FF),
        (8, 0x00F00F00F00F),
        (4, 0x0C30C30C30C3),
        (2, 0x249249249249),
    ):
        spread = (spread | (spread << shift)) & mask
    return np.asarray(spread[:, 0] | (spread[:, 1] << 1) | (spread[:, 2] << 2))


def map_from_octomap(
    cells: MapCells, T_base_map: ArrayLike, config: OccupancyConfig | None = None
) -> LocalMap:
    """A local map that takes at each cell's centre the value of an OctoMap in the base frame.

    Free and unseen come from the file as they are: what it does not know stays unknown. Its
    resolution may differ; occupied cells smaller than ours may lie between the centres, so an
    obstacle check takes them from `MapCells.occupied`.
    """
    config = config or OccupancyConfig()
    T = check_transform(T_base_map, "T_base_map")
    lowest, shape = config.lattice()
    s = config.resolution_m
    index = np.moveaxis(np.indices(shape), 0, -1).reshape(-1, 3)
    centres = (index + lowest + np.array([0.5, 0.5, 0.0])) * s
    values, known = cells.log_odds_at(centres @ T[:3, :3].T + T[:3, 3])
    return local_map_of(values.reshape(shape), known.reshape(shape), T, config)


def lattice_transform(T_base_map: Floats, resolution_m: float) -> Floats:
    """T_lattice_base: half a cell below the map frame, where the cells are OctoMap's."""
    T = invert(T_base_map)
    T[2, 3] += 0.5 * resolution_m
    return T


def build_local_map(
    scans: Sequence[Scan],
    T_base_map: ArrayLike,
    config: OccupancyConfig | None = None,
    *,
    threads: int = 2,
) -> LocalMap:
    """Insert scans in their order into an empty map round the target.

    A scan is points (N, 3) float32 and the camera's position (3,), both in the base frame. Without
    a position (None) its points are occupied and nothing becomes free. Points that are not finite
    are left out. Equal to `insertPointCloud(points, origin, -1, discretize=False)` of OctoMap on
    the points in the lattice frame, in every cell.
    """
    config = config or OccupancyConfig()
    T = check_transform(T_base_map, "T_base_map")
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


def local_map_of(
    values: NDArray[np.float32], known: NDArray[np.bool_], T_base_map: Floats, c: OccupancyConfig
) -> LocalMap:
    """A LocalMap from arrays on the lattice of `c`."""
    lowest, _ = c.lattice()
    corner = (lowest - np.array([0.0, 0.0, 0.5])) * c.resolution_m
    return LocalMap(
        T_base_map, c.resolution_m, corner, values, known, c.occupied_above, c.free_below
    )


def insert_scans(
    scans: Sequence[Scan],
    lowest: ArrayLike,
    shape: tuple[int, int, int],
    config: OccupancyConfig,
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
    hit, miss = log_odds(config.hit), log_odds(config.miss)
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
    """Bins along a cube face: a bundle is about half a cell wide at the grid's centre."""
    centre = (lowest + np.array(shape) / 2) * resolution_m
    distance = float(np.max(np.abs(centre - origin)))
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
