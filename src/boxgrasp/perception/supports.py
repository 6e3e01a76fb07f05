"""Level surfaces beside the support plane: a step or a second table, each over its own patch.

What stands on such a surface is judged over it: its points near the surface are a table's, not a
thing's. A box's top is level too; a surface counts only where it is too large to be a thing's, or
broad and low with something on it. What lies lower than the support plane counts from less.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Floats, Points, readonly
from boxgrasp.errors import CodedWarning
from boxgrasp.geometry.transforms import invert, transform
from boxgrasp.kernels.levels import cells_at_heights, points_near
from boxgrasp.kernels.plan import patches
from boxgrasp.perception.support_plane import fitted_plane, spans

# Found on cast tables and on the real captures that the tests read.
_SAMPLE = 20_000  # points tell the levels as well as all; of 10,000 some miss the cells of a board
_STEP_M = (0.012, 0.10)  # m up or down from the support plane: less is warp, more another storey
_CELL_M = 0.025  # m, cells of the plan: four points or so of the sample at 1 m
_BIN_M = 0.004  # m of height
_ON_M = 0.008  # m from a level: noise at 1.5 m and the warp of a sensor
_LEAST_M2 = 0.05  # m2, of a lower level, or of a low one that carries something
_LARGE_M2 = 0.15  # m2, from which a raised level is no thing's, whatever it carries
_BOARD_M = 0.05  # m, height up to which a smaller one may be a board
_BROAD_M = 0.20  # m, its narrower side at least: a gripper's thing is less
_CARRIED_M = (0.015, 0.30)  # m over a level, where things on it are looked for
_CARRIED_SHARE = 0.02  # points there for each of its own, from which it carries something
# A sensor that smooths its depth blurs things' feet into slopes that share heights, too.
_INNER_SHARE = 0.15  # of a level's cells that lie amid others at least
_UNDER_SHARE = 0.15  # points under a level for each on it at most
_ROUGH_M = 0.004  # m, standard deviation of its points: evenly spread ones have 4.6 mm
_LEVEL = np.cos(np.deg2rad(5.0))  # of the angle to the support plane
_TRIES = 4  # heights looked at
_MOST_CELLS = 400  # along an axis: 10 m
_PATCH_M2 = 0.03  # m2, smaller parts of the support plane's height may be a thing's top
_SPECK_CELLS = 4  # of a level, up to which they are no thing's top
_BESIDE_CELLS = 4  # up to which such a speck lies beside the rest


@dataclass(frozen=True, eq=False)
class Supports:
    """The surfaces that things stand on, table frame; the first is the support plane.

    Attributes:
        planes: (S, 4) float64 unit normals n and d of n . p + d = 0, m.
        owner: (R, C) int8, which of them each cell of the plan belongs to; (0, 0) where S is 1.
        corner_m: (2,) float64, the plan's lowest x and y, m.
        cell_m: edge of a cell, m.
        steps_m: (S - 1,) float64, height of each but the first over it, amid its patch, m.
        areas_m2: (S - 1,) float64, what was seen of each but the first, m2.
        points_m: S arrays (n, 3) float32, some points on each, m; none where S is 1.
    """

    planes: Floats
    owner: NDArray[np.int8]
    corner_m: Floats
    cell_m: float
    steps_m: Floats
    areas_m2: Floats
    points_m: tuple[Points, ...]

    def owners(self, points: Points) -> NDArray[np.int64]:
        """Which surface each point stands over.

        Args:
            points: (N, 3) table frame, m.

        Returns:
            (N,) int64 rows of `planes`.
        """
        owners = np.zeros(len(points), dtype=np.int64)
        if self.owner.size:
            at = np.floor((points[:, :2] - self.corner_m) / self.cell_m).astype(np.int64)
            inside = np.all((at >= 0) & (at < self.owner.shape), axis=1)
            owners[inside] = self.owner[tuple(at[inside].T)]
        return owners

    def heights(self, points: Points) -> Points:
        """Signed height of each point over the surface that it stands over.

        Args:
            points: (N, 3) table frame, m.

        Returns:
            (N,) float32, m.
        """
        if not self.owner.size:
            return np.asarray(points[:, 2], dtype=np.float32)
        own = self.planes[self.owners(points)]
        return np.asarray(np.sum(points * own[:, :3], axis=1) + own[:, 3], dtype=np.float32)

    def warnings(self) -> tuple[CodedWarning, ...]:
        """One for each surface beside the support plane."""
        return tuple(
            CodedWarning(
                "second_support",
                f"a level surface of {area_m2:.2f} m2 lies {abs(step_m) * 100:.1f} cm "
                f"{'over' if step_m > 0 else 'under'} the support plane: a step or a second table; "
                "what stands on it is judged over it",
            )
            for step_m, area_m2 in zip(self.steps_m, self.areas_m2, strict=True)
        )


ALONE = Supports(
    readonly(np.array([[0.0, 0.0, 1.0, 0.0]])),
    readonly(np.zeros((0, 0), dtype=np.int8)),
    readonly(np.zeros(2)),
    _CELL_M,
    readonly(np.zeros(0)),
    readonly(np.zeros(0)),
    (),
)


def find_supports(
    points: Points, T_source_table: Floats, camera_position_m: Floats | None, max_range_m: float
) -> Supports:
    """The support plane, and the level surfaces up to 10 cm over and under it.

    Args:
        points: (N, 3) float32, source frame, m.
        T_source_table: (4, 4).
        camera_position_m: (3,) source frame, m, or None where it is unknown.
        max_range_m: how far from the camera objects are looked for, m.

    Returns:
        The surfaces, in the table's frame.
    """
    T_table_source = invert(T_source_table)
    low = _low(points, T_table_source, camera_position_m, max_range_m)
    plan = _Plan.of(low) if len(low) else None
    if plan is None:
        return ALONE
    found: list[tuple[Floats, NDArray[np.bool_]]] = []
    left = low[np.abs(low[:, 2]) >= _ON_M]
    for _ in range(_TRIES):
        height_m = _shared_height(plan, left)
        if height_m is None:
            break
        plane, cells = _surface(plan, low, height_m)
        if _is_support(plan, plane, cells, low) and (
            _is_table(plan, plane, cells) or _carries(plan, plane, cells, points, T_table_source)
        ):
            found.append((plane, cells))
        left = left[np.abs(left[:, 2] - height_m) >= _BIN_M]
        left = left[np.abs(left @ plane[:3] + plane[3]) >= _ON_M]
    return _supports(plan, low, found) if found else ALONE


def _supports(plan: _Plan, low: Points, found: list[tuple[Floats, NDArray[np.bool_]]]) -> Supports:
    """The support plane and the surfaces found beside it."""
    planes = np.vstack([ALONE.planes, [plane for plane, _ in found]])
    part = plan.parts(plan.cells(low[np.abs(low[:, 2]) < _ON_M]))
    large = np.bincount(part[part >= 0], minlength=1) >= _PATCH_M2 / _CELL_M**2
    main = (part >= 0) & large[part]
    on = [
        plan.held(cells, low) & (np.abs(low @ plane[:3] + plane[3]) < _ON_M)
        for plane, cells in ((ALONE.planes[0], main), *found)
    ]
    return Supports(
        readonly(planes),
        readonly(_owners(planes, [main, *(cells for _, cells in found)])),
        readonly(plan.corner_m),
        _CELL_M,
        readonly(np.array([plan.height(plane, cells) for plane, cells in found])),
        readonly(np.array([np.count_nonzero(cells) * _CELL_M**2 for _, cells in found])),
        tuple(readonly(low[rows]) for rows in on),
    )


def _low(
    points: Points, T_table_source: Floats, camera_position_m: Floats | None, max_range_m: float
) -> Points:
    """(K, 3) some points near the support plane and in reach of the camera, table frame."""
    camera, farthest_m = camera_position_m, max_range_m
    if camera is None:
        camera, farthest_m = np.zeros(3), np.inf
    step = max(1, len(points) // _SAMPLE)
    found = np.empty((len(points) // step + 1, 3), dtype=np.float32)
    height_m = _STEP_M[1] + _ON_M
    count = points_near(points, step, T_table_source, camera, farthest_m, height_m, found)
    return found[:count]


@dataclass(frozen=True, eq=False)
class _Plan:
    """A grid of cells over the points, with an empty rim."""

    corner_m: Floats
    shape: tuple[int, int]

    @classmethod
    def of(cls, points: Points) -> _Plan | None:
        """The one that holds points; None where they lie too far apart."""
        low = np.floor(points[:, :2].min(axis=0) / _CELL_M) - 2
        high = np.floor(points[:, :2].max(axis=0) / _CELL_M) + 3
        rows, columns = (high - low).astype(np.int64).tolist()
        if max(rows, columns) > _MOST_CELLS:
            return None
        return cls(low.astype(np.float64) * _CELL_M, (rows, columns))

    def at(self, points: Points) -> NDArray[np.int64]:
        """(N,) flat cell of each point."""
        at = np.floor((points[:, :2] - self.corner_m) / _CELL_M).astype(np.int64)
        return np.asarray(at[:, 0] * self.shape[1] + at[:, 1])

    def cells(self, points: Points) -> NDArray[np.bool_]:
        """Which cells hold points."""
        cells = np.zeros(self.shape[0] * self.shape[1], dtype=bool)
        cells[self.at(points)] = True
        return cells.reshape(self.shape)

    def held(self, cells: NDArray[np.bool_], points: Points) -> NDArray[np.bool_]:
        """(N,) which points, of any, lie over the cells."""
        off = points[:, :2] - self.corner_m
        inside = np.all((off >= 0) & (off < np.array(self.shape) * _CELL_M), axis=1)
        inside[inside] = cells.reshape(-1)[self.at(points[inside])]
        return np.asarray(inside)

    def height(self, plane: Floats, cells: NDArray[np.bool_]) -> float:
        """How high a plane lies amid cells of it, m."""
        rows, columns = np.nonzero(cells)
        x, y = self.corner_m + (np.array([rows.mean(), columns.mean()]) + 0.5) * _CELL_M
        return float(-(plane[0] * x + plane[1] * y + plane[3]) / plane[2])

    def parts(self, cells: NDArray[np.bool_]) -> NDArray[np.int64]:
        """(R, C) the part of a surface that each cell belongs to, -1 for none."""
        nothing = np.zeros((*self.shape, 3), dtype=np.float32)
        return np.asarray(patches(cells, nothing[..., 0], nothing, np.inf, np.inf))


def _shared_height(plan: _Plan, points: Points) -> float | None:
    """The height that most cells share, m; None where too few do to be a level's."""
    bins = round((_STEP_M[1] + _ON_M) / _BIN_M)
    counts = cells_at_heights(points, plan.corner_m, plan.shape, _CELL_M, _BIN_M, bins)
    middle_m = (np.arange(2 * bins) - bins + 0.5) * _BIN_M
    counts[np.abs(middle_m) < _STEP_M[0]] = 0
    shared = np.convolve(counts, np.ones(3), mode="same")
    peak = int(np.argmax(shared))
    return float(middle_m[peak]) if shared[peak] * _CELL_M**2 >= _LEAST_M2 else None


def _surface(plan: _Plan, low: Points, height_m: float) -> tuple[Floats, NDArray[np.bool_]]:
    """The plane near a height, and the largest patch of cells on it.

    With it come the specks beside it that things on it part from it: under them nothing was seen,
    as it is under the rim of a wall.
    """
    level = np.array([0.0, 0.0, 1.0, -height_m])
    fitted = fitted_plane(low, level, (_ON_M, _ON_M, _ON_M))
    plane = level if fitted is None else fitted
    over = low @ plane[:3] + plane[3]
    part = plan.parts(plan.cells(low[np.abs(over) < _ON_M]))
    inside = part >= 0
    area = np.bincount(part[inside], minlength=1)
    hollow = np.bincount(part[inside & plan.cells(low[over <= -_ON_M])], minlength=len(area))
    cells = inside & (part == np.argmax(area))
    near = cells
    for _ in range(_BESIDE_CELLS):
        near = _grown(near)
    specks = (area <= _SPECK_CELLS) & (hollow == 0)
    return plane, np.asarray(cells | (near & inside & specks[part]))


def _is_support(plan: _Plan, plane: Floats, cells: NDArray[np.bool_], low: Points) -> bool:
    """Whether a patch is a broad level surface of its own, high or low enough over the plane."""
    area, inner = np.count_nonzero(cells), ~_grown(~cells)  # past the edge lies the next level
    if area * _CELL_M**2 < _LEAST_M2 or np.count_nonzero(inner) < _INNER_SHARE * area:
        return False
    if plane[2] < _LEVEL or not _STEP_M[0] <= abs(plan.height(plane, cells)) <= _STEP_M[1]:
        return False
    over = (low @ plane[:3] + plane[3])[plan.held(inner, low)]
    on = over[np.abs(over) < _ON_M]
    under = np.count_nonzero(over <= -_ON_M)
    if len(on) == 0 or under > _UNDER_SHARE * len(on) or np.sqrt(np.mean(on**2)) > _ROUGH_M:
        return False
    # A rectangle of sides a and b spreads by a / sqrt(12) and b / sqrt(12).
    spread = np.linalg.eigvalsh(np.cov(np.argwhere(cells).T))[0]
    return bool(np.sqrt(12.0 * max(spread, 0.0)) * _CELL_M >= _BROAD_M)


def _is_table(plan: _Plan, plane: Floats, cells: NDArray[np.bool_]) -> bool:
    """Whether a surface lies too low or is too large to be a thing's."""
    large = np.count_nonzero(cells) * _CELL_M**2 >= _LARGE_M2
    return bool(large or plan.height(plane, cells) < 0)


def _carries(
    plan: _Plan, plane: Floats, cells: NDArray[np.bool_], points: Points, T_table_source: Floats
) -> bool:
    """Whether a surface is as low as a board and something stands on it."""
    if plan.height(plane, cells) > _BOARD_M:
        return False
    sample = transform(T_table_source, points[:: max(1, len(points) // _SAMPLE)])
    over = (sample @ plane[:3] + plane[3])[plan.held(spans(cells), sample)]
    on = np.count_nonzero(np.abs(over) < _ON_M)
    carried = np.count_nonzero((over > _CARRIED_M[0]) & (over < _CARRIED_M[1]))
    return bool(carried >= _CARRIED_SHARE * on)


def _owners(planes: Floats, surfaces: list[NDArray[np.bool_]]) -> NDArray[np.int8]:
    """(R, C) the surface of each cell: where several claim one, the highest that was seen there."""
    order = np.argsort(-planes[:, 3]).tolist()  # d is minus the height
    owner = np.zeros(surfaces[0].shape, dtype=np.int8)
    for number in order:
        owner[spans(surfaces[number])] = number  # what stands on it hides some of it
    for number in order:
        owner[_grown(surfaces[number])] = number  # its edge's front is its own
    return owner


def _grown(cells: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The cells and their neighbors; the rim of the grid is empty, so nothing rolls over."""
    grown = cells.copy()
    for axis in (0, 1):
        grown |= np.roll(grown, 1, axis) | np.roll(grown, -1, axis)
    return grown
