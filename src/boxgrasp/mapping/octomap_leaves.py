"""The leaves of an OctoMap file, and the local map they give."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from boxgrasp.arrays import Floats, readonly
from boxgrasp.geometry.transforms import validate_transform
from boxgrasp.kernels import rays
from boxgrasp.mapping.local_map import (
    OCCUPIED_ABOVE,
    LocalMap,
    MappingConfig,
    local_map_of,
    log_odds,
)


@dataclass(frozen=True, eq=False)
class MapCells:
    """The leaves of an OctoMap, in the frame of its file, which is taken as the base frame.

    No two overlap; they are kept in the order in which OctoMap stores them.

    Attributes:
        resolution_m: edge of the smallest cell, m.
        keys: (K, 3) int32, the lowest cell of each leaf; cell 0 has its lower corner at the origin.
        spans: (K,) int64, its edge in cells, a power of two.
        log_odds: (K,) float32.
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
        """Log-odds at points, as OctoMap's `search` at the lowest level, pruned leaves included.

        Args:
            points: (M, 3), base frame, m.

        Returns:
            (M,) float32 log-odds, 0 where no leaf holds the point, and (M,) bool, known.
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

    def occupied(self, above: float = OCCUPIED_ABOVE) -> tuple[Floats, Floats]:
        """The occupied leaves.

        Args:
            above: probability above which a leaf is occupied.

        Returns:
            (n, 3) float64 centers, base frame, m, and (n,) float64 edges, m.
        """
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
    cells: MapCells, T_base_map: ArrayLike, config: MappingConfig | None = None
) -> LocalMap:
    """A local map that takes at each cell's center the value of an OctoMap in the base frame.

    Free and unseen come from the file as they are: what it does not know stays unknown. Its
    resolution may differ; occupied cells smaller than ours may lie between the centers, so an
    obstacle check takes them from `MapCells.occupied`.

    Args:
        cells: the leaves.
        T_base_map: (4, 4), where the map lies.
        config: cells and thresholds; None for the defaults.

    Returns:
        The map.

    Raises:
        BoxgraspError: T_base_map is not a rigid transform.
        ConfigError: the extent and the resolution make more cells than memory holds.
    """
    config = config or MappingConfig()
    T = validate_transform(T_base_map, "T_base_map")
    lowest, shape = config.lattice()
    s = config.resolution_m
    index = np.moveaxis(np.indices(shape), 0, -1).reshape(-1, 3)
    centers = (index + lowest + np.array([0.5, 0.5, 0.0])) * s
    values, known = cells.log_odds_at(centers @ T[:3, :3].T + T[:3, 3])
    return local_map_of(values.reshape(shape), known.reshape(shape), T, config)
