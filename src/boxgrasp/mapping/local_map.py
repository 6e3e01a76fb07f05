"""What is occupied, free and unseen round the target: a dense log-odds grid with OctoMap's rules.

Thesis section 1-2-2 and 2-2; the update of Hornung et al., OctoMap, 2013, cell by cell.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar, Final, NamedTuple

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from boxgrasp.arrays import Floats, readonly
from boxgrasp.errors import ConfigError
from boxgrasp.geometry.box import CENTER_ABOVE_SUPPORT_M

FREE, UNSEEN, OCCUPIED = 0, 1, 2

OCCUPIED_ABOVE: Final = 0.66  # probability (thesis section 2-2)
FREE_BELOW: Final = 0.33  # probability (thesis section 2-2)
CLAMP_MIN: Final = 0.1192  # probability, as OctoMap's default, and what it reads for free in a .bt
CLAMP_MAX: Final = 0.971  # likewise, for occupied

Flags = NDArray[np.uint8]

_MOST_CELLS = 50_000_000  # 250 MB
_ABOVE_SUPPORT_M = 0.002  # the lowest layer keeps this far off the support plane's noise
_LATTICE_SLACK = 1e-9  # of a cell: 0.42 / 0.07 must be 6 cells, not 7


class Lattice(NamedTuple):
    """Cells as OctoMap numbers them, in the lattice frame: the map frame, half a cell down.

    Attributes:
        lowest: (3,) int64 key of the first cell; the lower corner of cell 0 is the origin.
        shape: (nx, ny, nz).
    """

    lowest: NDArray[np.int64]
    shape: tuple[int, int, int]


@dataclass(frozen=True)
class MappingConfig:
    """The local map: cell size, OctoMap's sensor model, thresholds, extent round the target.

    Attributes:
        resolution_m: edge of a cell, m (thesis: 3 cm with the spiral, 7 cm with the grid).
        prob_hit: probability that a cell is occupied where a ray ends in it, as OctoMap's.
        prob_miss: where a ray crosses it; OctoMap's own 0.4 leaves a cell seen free once at 0.4,
            which the 33 % rule calls uncertain.
        clamp_min: least probability that a cell comes to, as OctoMap's.
        clamp_max: greatest, as OctoMap's.
        occupied_above: a cell is occupied above this probability (thesis section 2-2).
        free_below: a cell is free below this probability (thesis section 2-2).
        half_width_m: the map reaches so far from its center along x and y, m.
        height_m: and so far up from the support plane, m.
        center_above_support_m: of the half sphere over the support plane, m (thesis section 3-2).
        stride: insert every stride-th point in the image's order (thesis 3-5-2: every second);
            None takes every second row and column of a dense image, which still crosses every cell.
    """

    resolution_m: Annotated[float, msgspec.Meta(ge=0.005, le=0.2)] = 0.03
    prob_hit: Annotated[float, msgspec.Meta(gt=0.5, lt=1.0)] = 0.7
    prob_miss: Annotated[float, msgspec.Meta(gt=0.0, lt=0.5)] = 0.3
    clamp_min: Annotated[float, msgspec.Meta(gt=0.0, lt=0.5)] = CLAMP_MIN
    clamp_max: Annotated[float, msgspec.Meta(gt=0.5, lt=1.0)] = CLAMP_MAX
    occupied_above: Annotated[float, msgspec.Meta(ge=0.5, lt=1.0)] = OCCUPIED_ABOVE
    free_below: Annotated[float, msgspec.Meta(gt=0.0, le=0.5)] = FREE_BELOW
    half_width_m: Annotated[float, msgspec.Meta(ge=0.05, le=2.0)] = 0.36
    height_m: Annotated[float, msgspec.Meta(ge=0.05, le=2.0)] = 0.54
    center_above_support_m: Annotated[float, msgspec.Meta(ge=0.0, le=0.5)] = CENTER_ABOVE_SUPPORT_M
    stride: Annotated[int, msgspec.Meta(ge=1, le=100)] | None = None

    RENAMED: ClassVar[dict[str, str]] = {
        "hit": "prob_hit",
        "miss": "prob_miss",
        "thin": "stride",
        "centre_above_support_m": "center_above_support_m",
    }

    def lattice(self) -> Lattice:
        """The cells of the map.

        Returns:
            The first cell's key and the map's shape.

        Raises:
            ConfigError: the extent and the resolution make more cells than memory holds.
        """
        s = self.resolution_m
        n = max(1, math.ceil(self.half_width_m / s - _LATTICE_SLACK))
        # Layer k spans (k - 1/2) s to (k + 1/2) s round the half sphere's center.
        down = self.center_above_support_m - _ABOVE_SUPPORT_M
        low = math.ceil(0.5 - down / s - _LATTICE_SLACK)
        up = self.height_m - self.center_above_support_m
        top = max(low, math.ceil(up / s - 0.5 - _LATTICE_SLACK))
        shape = (2 * n, 2 * n, top - low + 1)
        if shape[0] * shape[1] * shape[2] > _MOST_CELLS:
            raise ConfigError(
                f"mapping: resolution_m {s} makes {shape[0]} x {shape[1]} x {shape[2]} cells; "
                f"valid: at most {_MOST_CELLS} (coarser, or a smaller half_width_m, height_m)"
            )
        return Lattice(np.array([-n, -n, low], dtype=np.int64), shape)


def log_odds(probability: float) -> np.float32:
    """Logarithm of p / (1 - p), as OctoMap stores it.

    Args:
        probability: p, between 0 and 1.

    Returns:
        float32.
    """
    return np.float32(math.log(probability / (1.0 - probability)))


@dataclass(frozen=True, eq=False)
class LocalMap:
    """Cells round the target.

    Horizontally cells have their borders on multiples of the resolution, and vertically their
    centers, so that every sample of a grid of that spacing is a cell's center.

    Attributes:
        T_base_map: (4, 4), origin at the half sphere's center, turned with the box.
        resolution_m: edge of a cell, m.
        lowest: (3,) corner of cell 0, 0, 0, map frame, m.
        log_odds: (nx, ny, nz) float32, 0 where not known.
        known: (nx, ny, nz) bool.
        occupied_above: probability above which a cell is occupied.
        free_below: probability below which a cell is free.
    """

    T_base_map: Floats
    resolution_m: float
    lowest: Floats
    log_odds: NDArray[np.float32]
    known: NDArray[np.bool_]
    occupied_above: float = OCCUPIED_ABOVE
    free_below: float = FREE_BELOW

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
        """The cell of each point.

        Args:
            points_map: (M, 3), map frame, m.

        Returns:
            (M, 3) int64 cells, 0, 0, 0 for points outside, and (M,) bool, whether each is in the
            map.
        """
        p = np.asarray(points_map, dtype=np.float64).reshape(-1, 3)
        cells = np.floor((p - self.lowest) / self.resolution_m)
        inside = np.all((cells >= 0) & (cells < self.shape), axis=1)  # NaN is outside
        return np.where(inside[:, None], cells, 0).astype(np.int64), inside

    def values_at(self, points_map: ArrayLike) -> NDArray[np.float32]:
        """Occupancy at points, as the thesis's features take it (section 2-2).

        Args:
            points_map: (M, 3), map frame, m.

        Returns:
            (M,) float32: 0 free, 1 occupied, 0.5 else.
        """
        cells, inside = self.keys(points_map)
        state = self.state[cells[:, 0], cells[:, 1], cells[:, 2]]
        return np.where(inside, state * np.float32(0.5), np.float32(0.5)).astype(np.float32)

    def cells(self, state: int) -> Floats:
        """The cells in a state.

        Args:
            state: `FREE`, `UNSEEN` or `OCCUPIED`.

        Returns:
            (K, 3) float64 centers, map frame, m, in the order of their index.
        """
        found = np.argwhere(self.state == state)
        return np.asarray(self.lowest + (found + 0.5) * self.resolution_m)

    @property
    def centers(self) -> Floats:
        """(nx, ny, nz, 3) float64 centers of all cells, map frame, m."""
        index = np.moveaxis(np.indices(self.shape), 0, -1)
        return np.asarray(self.lowest + (index + 0.5) * self.resolution_m)


def local_map_of(
    values: NDArray[np.float32],
    known: NDArray[np.bool_],
    T_base_map: Floats,
    config: MappingConfig,
) -> LocalMap:
    """A local map from arrays on a configuration's lattice.

    Args:
        values: (nx, ny, nz) float32 log-odds.
        known: (nx, ny, nz) bool.
        T_base_map: (4, 4).
        config: cells and thresholds.

    Returns:
        The map.
    """
    s = config.resolution_m
    corner = (config.lattice().lowest - np.array([0.0, 0.0, 0.5])) * s
    return LocalMap(T_base_map, s, corner, values, known, config.occupied_above, config.free_below)
