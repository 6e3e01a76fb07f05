"""One map that runs on while the grasp is asked for again and again, as the thesis's did (3-5-2).

Its OctoMap was fed by every frame and never begun anew; a decision read what had gathered by then.
Here the cells' place is that of the first box, since the thesis's lattice did not follow the box;
the box itself is fitted anew to each frame.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from boxgrasp.arrays import Array, Floats
from boxgrasp.geometry.transforms import invert
from boxgrasp.mapping.ray_insertion import build_local_map
from boxgrasp.perception.target import Target
from boxgrasp.ranking.sampling import RESOLUTION_M
from boxgrasp.teaching.rows import RowConfig, scenario_of_row, selector
from boxgrasp.teaching.samples import sample_states

BEFORE = 5  # frames that the map has seen before the first decision (ours)
COLUMNS = ("given_grid", "given_grid_portions", "given_dimensions_m")


def running_part(task: tuple[RowConfig, range]) -> bytes:
    """What the grid samples say in every run of some scenarios; a task of its own.

    Args:
        task: how rows are made, and the scenarios' numbers.

    Returns:
        A .npz of `COLUMNS`, each (scenarios * runs, ...).
    """
    config, numbers = task
    found: dict[str, list[Array]] = {name: [] for name in COLUMNS}
    for number in numbers:
        for columns in _runs(config, number):
            for name, value in zip(COLUMNS, columns, strict=True):
                found[name].append(value)
    out = io.BytesIO()
    np.savez_compressed(out, **{name: np.array(v) for name, v in found.items()})  # type: ignore[arg-type]
    return out.getvalue()


def read_running(parts: list[bytes]) -> Mapping[str, Array]:
    """The parts put together.

    Args:
        parts: of `running_part`.

    Returns:
        Columns as in a set's rows.
    """
    loaded = [np.load(io.BytesIO(data), allow_pickle=False) for data in parts]
    return {name: np.concatenate([part[name] for part in loaded]) for name in COLUMNS}


def _runs(config: RowConfig, number: int) -> list[tuple[Array, Array, Floats]]:
    scenario = scenario_of_row(config, number)
    chosen = selector("given", config.lines, config.stride)
    frames = [scenario.capture(config.recipe.noise, k) for k in range(BEFORE + config.runs)]
    rays = [(frame.valid_points()[0][:: config.stride], np.zeros(3)) for frame, _ in frames]
    cells = replace(chosen.config.mapping, resolution_m=RESOLUTION_M["grid"])
    T_source_map: Floats | None = None
    found: list[tuple[Array, Array, Floats]] = []
    for run in range(config.runs):
        frame, object_ids = frames[BEFORE + run]
        target = Target(mask=object_ids == scenario.scene.target_id)
        analysis = chosen.analyze(frame, target)
        box = analysis.context.box
        if T_source_map is None:
            T_source_map = invert(analysis.scene.T_base_source) @ box.T_base_map()
        local_map = build_local_map(rays[: BEFORE + run + 1], T_source_map, cells)
        found.append((*sample_states(local_map, "grid"), box.dimensions_m))
    return found
