"""Flat things within the noise of single pixels: a marker 6 mm high at 0.8 m.

The mean over a cell of pixels is far quieter than a pixel, but a real table is not flat: stereo
and structured light show waves of several millimeters over ten centimeters and more. So a flat
thing must rise over the table a few centimeters round it, and do so in a step.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Floats
from boxgrasp.geometry.transforms import invert, transform
from boxgrasp.kernels.table_cells import box_sums, dilated, regions
from boxgrasp.perception.table_level import TableLevel
from boxgrasp.sensing.sensor_model import SensorModel

# Found on 45 labeled captures and 17 others by Xtion, Kinect and RealSense.
_FULL = 0.5  # share of a cell's pixels that must be measured
_REACH = 6  # cells to each side, over which the table's own level is taken: 8 cm at 0.8 m
_LEAST_ROUND = 0.25  # of them, that must show it
_BESIDE = 2  # cells from a thing, whose rim and shadow are no table
_CORE_NOISE = 1.0  # standard deviations of a pixel's depth that a core rises over the least height
_SKIRT_M = 0.001  # m, that cells round a core rise over the table, beside that noise
_LEAST_CORE = 8  # cells: 3 cm2 at 0.8 m
_STEP_NOISE = 0.5  # standard deviations that the step must be over the least height
_STEP_WAVES = 4.0  # and times the table's own waves: 0.7 to 0.9 mm by Xtion, up to 2 by RealSense
_ONE_SIDED = 0.84  # of a normal distribution's values lie under its standard deviation
_RING = (1, 3)  # rings of cells from a thing between which the table beside it is looked at
_HIGH_SHARE = 0.75  # of those cells that lie lower than the level that the step is taken from
_RING_SHARE = 0.7  # of those cells that must show the table: no thing is told at an edge
_MOST = 32  # candidates looked at, the largest ones


def flat_things(
    level: TableLevel, sensor: SensorModel, min_height_m: float
) -> list[NDArray[np.int32]]:
    """The flat things at the table's level.

    Args:
        level: the table's level in the image.
        sensor: that saw it.
        min_height_m: height over the table under which a point is the table's, m.

    Returns:
        (n,) int32 rows of the view's points, rising, for each.
    """
    height = level.height_m
    whole = level.count >= _FULL * level.cell_px**2
    table = whole & ~dilated(level.owner >= 0, _BESIDE)
    round_it = box_sums(table, _REACH)
    mean = box_sums(np.where(table, height, 0.0), _REACH) / np.maximum(round_it, 1)
    rise = np.where(
        table & (round_it >= _LEAST_ROUND * (2 * _REACH + 1) ** 2), height - mean, -np.inf
    )
    if level.view.T_base_camera is None or np.count_nonzero(rise > min_height_m) < _LEAST_CORE:
        return []
    noise = _noise_m(level, sensor)
    waves_m = float(np.quantile(rise[np.isfinite(rise)], _ONE_SIDED))
    core = rise > min_height_m + _CORE_NOISE * noise
    region, found = regions(rise > _SKIRT_M + _CORE_NOISE * noise, True)
    cores = np.bincount(region[core & (region >= 0)], minlength=found)
    largest = np.argsort(-cores, kind="stable")[:_MOST]
    things: list[NDArray[np.int32]] = []
    for name in np.sort(largest[cores[largest] >= _LEAST_CORE]).tolist():
        inside = region == name
        foot = _foot(inside, whole, height)
        least = max(min_height_m + _STEP_NOISE * float(noise[inside].mean()), _STEP_WAVES * waves_m)
        middle = float(np.median(height[inside]))
        if foot is not None and middle - foot >= least and middle >= min_height_m:
            things.append(_rows(level, inside, (foot + middle) / 2))
    return things


def _noise_m(level: TableLevel, sensor: SensorModel) -> Floats:
    """(rows, columns) standard deviation of a pixel's depth in each cell, m; 0 for empty cells."""
    view, first = level.view, level.first
    noise = np.zeros(first.shape)
    assert view.T_base_camera is not None
    camera_m = transform(invert(view.T_base_source), view.T_base_camera[None, :3, 3])
    away = view.points[first[first >= 0]] - camera_m.astype(np.float32)
    noise[first >= 0] = sensor.axial_noise_m(np.linalg.norm(away, axis=1))
    return noise


def _foot(inside: NDArray[np.bool_], whole: NDArray[np.bool_], height: Floats) -> float | None:
    """Height of the table beside a flat thing, m; None where too little of it is seen."""
    if inside[0].any() or inside[-1].any() or inside[:, 0].any() or inside[:, -1].any():
        return None
    ring = dilated(inside, _RING[1]) & ~dilated(inside, _RING[0])
    seen = ring & whole
    if np.count_nonzero(seen) < _RING_SHARE * np.count_nonzero(ring):
        return None
    return float(np.quantile(height[seen], _HIGH_SHARE))


def _rows(level: TableLevel, inside: NDArray[np.bool_], least_m: float) -> NDArray[np.int32]:
    """The points of a flat thing: those in its cells and beside them that rise half the step."""
    wanted = np.where(dilated(inside, 1) & (level.owner < 0), 0, -1)
    rows, _, heights = level.rows_in(wanted)
    return rows[heights > least_m]
