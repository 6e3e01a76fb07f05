"""The pixels at the table's own level, which no height over the plane tells from the table."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Floats, Points, readonly
from boxgrasp.forks import cached_property
from boxgrasp.geometry.transforms import invert, transform
from boxgrasp.kernels.table_cells import cell_heights, cell_owners, rows_in_cells
from boxgrasp.perception.placement import Placement
from boxgrasp.perception.segmentation.clusters import Clusters
from boxgrasp.perception.view import View

_CELLS = 160  # across the image: 4 px of 640, over which the noise of single pixels averages out
_LEVEL_M = (-0.02, 0.03)  # m over the plane: what lies deeper is seen past the table


@dataclass(frozen=True, eq=False)
class LevelPoints:
    """Points of a view at the table's level that are a thing's.

    Attributes:
        rows: (n,) int32 rows of the view's points, rising.
        owners: (n,) int64 whose each is.
    """

    rows: NDArray[np.int32]
    owners: NDArray[np.int64]

    def of(self, kept: NDArray[np.bool_]) -> LevelPoints:
        """Some of them.

        Args:
            kept: (n,) bool.

        Returns:
            Those that are kept.
        """
        return LevelPoints(self.rows[kept], self.owners[kept])


@dataclass(frozen=True, eq=False)
class TableLevel:
    """The points of a view at the table's level, by square cells of its image.

    Attributes:
        view: the view, with an image.
        placement: where it lies.
        taken: (P,) int32, rising, rows of the view's points that are not the table's own.
        owner: (rows, columns) int64 the cluster that most of a cell's pixels show, -1 for none.
        cell_px: edge of a cell, px.
    """

    view: View
    placement: Placement
    taken: NDArray[np.int32]
    owner: NDArray[np.int64]
    cell_px: int

    @staticmethod
    def of(
        view: View, placement: Placement, over: NDArray[np.int32], shown: Clusters
    ) -> TableLevel:
        """The table's level of a view.

        Args:
            view: with an image.
            placement: where it lies.
            over: (P,) int32, rising, rows of its points over the table.
            shown: (P,) int64 the cluster of each of them, -1 for none: noise of the table.

        Returns:
            The cells.
        """
        height, width = view.shape or (0, 0)
        cell_px = max(1, round(width / _CELLS))
        taken, owners = over[shown >= 0], shown[shown >= 0]
        owner = cell_owners(view.pixels[taken], owners, cell_px, width, -(-height // cell_px))
        if len(placement.supports.planes) > 1:  # a step or second table is at a level of its own
            local = transform(invert(placement.T_source_table), view.points)
            beside = np.flatnonzero(placement.supports.owners(local) > 0)
            taken = np.union1d(taken, beside).astype(np.int32)
        return TableLevel(view, placement, taken, owner, cell_px)

    @property
    def _plane(self) -> Floats:
        """(4,) normal and offset, source frame, m."""
        plane = self.placement.plane
        return np.append(plane.normal, plane.offset_m)

    @property
    def _width(self) -> int:
        return (self.view.shape or (0, 0))[1]

    @cached_property
    def _sums(self) -> tuple[Floats, NDArray[np.int32], NDArray[np.int32]]:
        total = np.zeros(self.owner.shape)
        count = np.zeros(self.owner.shape, dtype=np.int32)
        first = np.full(self.owner.shape, -1, dtype=np.int32)
        cell_heights(
            self.view.points, self.view.pixels, self.taken, self._plane, _LEVEL_M,
            self.cell_px, self._width, total, count, first,
        )  # fmt: skip
        return readonly(total / np.maximum(count, 1)), readonly(count), readonly(first)

    @property
    def height_m(self) -> Floats:
        """(rows, columns) float64 mean height of each cell's points at this level, m."""
        return self._sums[0]

    @property
    def count(self) -> NDArray[np.int32]:
        """(rows, columns) int32 how many points each cell has at this level."""
        return self._sums[1]

    @property
    def first(self) -> NDArray[np.int32]:
        """(rows, columns) int32 row in the view of one of them, -1 where there is none."""
        return self._sums[2]

    def rows_in(
        self, wanted: NDArray[np.int64]
    ) -> tuple[NDArray[np.int32], NDArray[np.int64], Points]:
        """The points at this level in some cells.

        Args:
            wanted: (rows, columns) int64 a name of each cell, -1 for none.

        Returns:
            (n,) int32 rows of the view, rising, (n,) int64 the names of their cells, and (n,)
            float32 heights, m.
        """
        return rows_in_cells(
            self.view.points, self.view.pixels, self.taken, self._plane, _LEVEL_M,
            self.cell_px, self._width, wanted,
        )  # fmt: skip

    def in_table_frame(self, rows: NDArray[np.int32]) -> Points:
        """Points of the view in the table's frame.

        Args:
            rows: (n,) int32.

        Returns:
            (n, 3) float32, m.
        """
        points: Points = transform(invert(self.placement.T_source_table), self.view.points[rows])
        return points
