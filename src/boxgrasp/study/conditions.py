"""What the spiral's samples would say had the map of the same scenes been made otherwise.

The box is taken from the rows, which a map does not change, so no scene is segmented again.
"""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Final

import numpy as np

from boxgrasp.arrays import Array, Floats
from boxgrasp.execution import Store, Workers, finish
from boxgrasp.forks import cached_property
from boxgrasp.geometry.box import Box
from boxgrasp.geometry.transforms import invert, make_transform, rotation_z, transform
from boxgrasp.grasps.candidates import RIGHT, TOP_PERPENDICULAR
from boxgrasp.mapping.local_map import LocalMap, MappingConfig, local_map_of, log_odds
from boxgrasp.mapping.ray_insertion import Scan, build_local_map
from boxgrasp.mapping.view_rays import view_rays
from boxgrasp.perception.view import View, scan_views
from boxgrasp.ranking.model_set import FACE_NUMBERS
from boxgrasp.ranking.sampling import RESOLUTION_M, is_side, portion, sampling
from boxgrasp.study.running import BEFORE
from boxgrasp.teaching.rows import RowConfig, box_of, scenario_of_row, selector
from boxgrasp.teaching.samples import sample_points, states_at
from boxgrasp.teaching.sets import Rows

SAMPLING: Final = "spiral"
OCTOMAP_MISS: Final = 0.4  # probability, OctoMap's default
LEFT_BY: Final = 2  # scenes before this one whose cells a map that is never cleared still holds
# The spiral's angles are multiples of it, counted from 1 in the print, from 0 by its own counts.
GOLDEN_RAD: Final = math.pi * (3.0 - math.sqrt(5.0))
FRAMES: Final = BEFORE + 1  # of each scene, in a map that is never cleared
PART_ROWS: Final = 50  # the scenes before the first are cast again

Numbers = Sequence[int]
Task = tuple[RowConfig, Numbers, Array, Array]


@dataclass(frozen=True, eq=False)
class Seen:
    """One scene, its box, and what came before.

    Attributes:
        box: round the target.
        rays: of the scene's view, source frame, m.
        T_base_source: (4, 4), the view's own frame.
        earlier: views of the scenes before, the earliest first.
        mapping: cells and sensor model, cells of the spiral's size.
    """

    box: Box
    rays: Sequence[Scan]
    T_base_source: Floats
    earlier: Sequence[View]
    mapping: MappingConfig

    def map_at(self, T_base_map: Floats) -> LocalMap:
        """The map of this scene's one frame.

        Args:
            T_base_map: (4, 4), where it lies.

        Returns:
            The map.
        """
        return build_local_map(self.rays, invert(self.T_base_source) @ T_base_map, self.mapping)

    @cached_property
    def T_base_map(self) -> Floats:
        """(4, 4), the half sphere's frame."""
        return self.box.T_base_map(self.mapping.center_above_support_m)

    @cached_property
    def local_map(self) -> LocalMap:
        """The map that follows the box, as rows are made with."""
        return self.map_at(self.T_base_map)


Reading = Callable[[Seen, Floats], Array]


def usual(seen: Seen, points: Floats) -> Array:
    """The states that rows hold.

    Args:
        seen: the scene.
        points: (N, 3), map frame, m.

    Returns:
        (N,) uint8 as `states_at`.
    """
    return states_at(seen.local_map, points)


def world_lattice(seen: Seen, points: Floats) -> Array:
    """Cells on the lattice of the base frame's origin, as OctoMap's are, whatever the box.

    Args:
        seen: the scene.
        points: (N, 3), map frame, m.

    Returns:
        (N,) uint8 as `states_at`.
    """
    T_base_cells = on_world_lattice(seen.T_base_map, seen.mapping.resolution_m)
    moved = transform(invert(T_base_cells) @ seen.T_base_map, points)
    return states_at(seen.map_at(T_base_cells), moved)


def default_miss(seen: Seen, points: Floats) -> Array:
    """A miss of OctoMap's default: a cell seen free once stays uncertain by the 33 % rule.

    Args:
        seen: the scene.
        points: (N, 3), map frame, m.

    Returns:
        (N,) uint8 as `states_at`.
    """
    mapping = replace(seen.mapping, prob_miss=OCTOMAP_MISS)
    return usual(replace(seen, mapping=mapping), points)


def never_cleared(seen: Seen, points: Floats) -> Array:
    """A map that still holds what the scenes before left in it, each seen for several frames.

    Args:
        seen: the scene.
        points: (N, 3), map frame, m.

    Returns:
        (N,) uint8 as `states_at`.
    """
    m = seen.mapping
    least, most = log_odds(m.clamp_min), log_odds(m.clamp_max)
    before = [
        replace(seen, rays=view_rays([view], m.stride), T_base_source=view.T_base_source)
        for view in seen.earlier
    ]
    maps = [*(scene.map_at(seen.T_base_map) for scene in before), seen.local_map]
    values = np.zeros_like(maps[0].log_odds)
    known = np.zeros_like(maps[0].known)
    for one in maps:
        # A cell's updates in one scene are all of one sign: adding them at once clamps alike.
        values = np.clip(values + FRAMES * one.log_odds, least, most)
        known |= one.known
    return states_at(local_map_of(values, known, seen.T_base_map, m), points)


def over_box_middle(seen: Seen, points: Floats) -> Array:
    """The half sphere 5 cm over the middle of the box, as section 5-2-3 has it, not of its base.

    Args:
        seen: the scene.
        points: (N, 3), map frame, m.

    Returns:
        (N,) uint8 as `states_at`.
    """
    return usual(seen, points + (0.0, 0.0, seen.box.dimensions_m[2] / 2))


def turned(seen: Seen, points: Floats, angle_rad: float) -> Array:
    """The samples turned about the vertical, the box not.

    Args:
        seen: the scene.
        points: (N, 3), map frame, m.
        angle_rad: from x to y, rad.

    Returns:
        (N,) uint8 as `states_at`.
    """
    return usual(seen, points @ rotation_z(angle_rad).T)


READINGS: Final[Mapping[str, Reading]] = {
    "world-lattice": world_lattice,
    "default-miss": default_miss,
    "never-cleared": never_cleared,
    "over-box-middle": over_box_middle,
    "quarter-left": partial(turned, angle_rad=math.pi / 2),
    "quarter-right": partial(turned, angle_rad=-math.pi / 2),
    "half-turn": partial(turned, angle_rad=math.pi),
    "counted-from-1": partial(turned, angle_rad=GOLDEN_RAD),
}


def on_world_lattice(T_base_map: Floats, resolution_m: float) -> Floats:
    """The nearest place of a map whose cells' borders are the base frame's multiples of their size.

    Args:
        T_base_map: (4, 4), where the map lies.
        resolution_m: edge of a cell, m.

    Returns:
        (4, 4), turned like the base frame; at most half a cell off along each axis.
    """
    # A map's cells have their borders at its origin along x and y, half a cell off along z.
    off = np.array([0.0, 0.0, 0.5])
    return make_transform(
        np.eye(3), (np.round(T_base_map[:3, 3] / resolution_m - off) + off) * resolution_m
    )


def seen_in(config: RowConfig, number: int, box: Box) -> Seen:
    """One row's scene again.

    Args:
        config: how rows are made, one run and one frame each.
        number: of the row.
        box: that the row has.

    Returns:
        The scene.
    """
    mapping = replace(
        selector("given", config.lines, config.stride).config.mapping,
        resolution_m=RESOLUTION_M[SAMPLING],
    )
    view = _view(config, number)
    earlier = [_view(config, k) for k in range(max(0, number - LEFT_BY), number)]
    return Seen(box, view_rays([view], mapping.stride), view.T_base_source, earlier, mapping)


@lru_cache(maxsize=LEFT_BY + 1)
def _view(config: RowConfig, number: int) -> View:
    capture, _ = scenario_of_row(config, number).capture(config.recipe.noise)
    sensor = selector("given", config.lines, config.stride).config.scene.sensor_model
    return scan_views([capture], sensor.seen_with(capture.focal_px))[0]


def reading_part(task: Task) -> bytes:
    """What the spiral's samples and portions say under every condition; a task of its own.

    Args:
        task: how rows are made, the rows' numbers, and their boxes' places (n, 4) and dimensions
            (n, 3), m.

    Returns:
        A .npz of two columns a condition, (n, ...) uint8 as rows keep them.
    """
    config, numbers, places, dimensions_m = task
    points = sample_points(SAMPLING)
    found: dict[str, list[Array]] = {name: [] for name in _columns()}
    for number, place, size_m in zip(numbers, places, dimensions_m, strict=True):
        seen = seen_in(config, number, box_of(place, size_m))
        for name, reading in READINGS.items():
            states = reading(seen, np.concatenate(points))
            whole, portions = np.split(states, [len(points[0])])
            found[f"{name}/whole"].append(whole)
            found[f"{name}/portions"].append(portions)
    out = io.BytesIO()
    np.savez_compressed(out, **{name: np.array(v) for name, v in found.items()})  # type: ignore[arg-type]
    return out.getvalue()


def _columns() -> list[str]:
    return [f"{name}/{part}" for name in READINGS for part in ("whole", "portions")]


def rows_under(
    store: Store, workers: Workers, name: str, config: RowConfig, rows: Rows
) -> dict[str, Rows]:
    """Rows of a set with the spiral's samples as each condition has them.

    Args:
        store: where finished parts are kept.
        workers: who makes them.
        name: of the set.
        config: how its rows were made, one run and one frame each.
        rows: some of them, every one answered.

    Returns:
        By the condition's name.

    Raises:
        StoreError: the place cannot be read or written.
        WorkError: workers were lost.
    """
    numbers = rows["number"].tolist()
    tasks: dict[str, Task] = {
        f"causes/{name}/{k // PART_ROWS:05d}.npz": (
            config,
            numbers[k : k + PART_ROWS],
            rows["given_box"][k : k + PART_ROWS],
            rows["given_dimensions_m"][k : k + PART_ROWS],
        )
        for k in range(0, rows.count, PART_ROWS)
    }
    finish(store, tasks, reading_part, workers, f"other maps, {name}")
    parts = [np.load(io.BytesIO(store.read(part)), allow_pickle=False) for part in tasks]
    columns = {column: np.concatenate([part[column] for part in parts]) for column in _columns()}
    return {
        condition: Rows(
            {
                **rows.columns,
                f"given_{SAMPLING}": columns[f"{condition}/whole"],
                f"given_{SAMPLING}_portions": columns[f"{condition}/portions"],
            }
        )
        for condition in READINGS
    }


OrderOf = Callable[[Floats], Array]


def reordered(rows: Rows, name: str, order_of: OrderOf) -> Rows:
    """Rows whose samples come in another order: one for all, one for each kind of portion.

    Args:
        rows: of a set.
        name: of the sampling.
        order_of: gives the order of (n, 3) samples: which one comes at each place, (n,).

    Returns:
        Other rows.
    """
    points = sampling(name)
    side, top = (portion(points, face) for face in (RIGHT, TOP_PERPENDICULAR))
    own = {True: order_of(side), False: order_of(top)}
    orders = [own[is_side(face)] for face in FACE_NUMBERS]
    firsts = np.cumsum([0, *(len(order) for order in orders[:-1])])
    portions = np.concatenate([at + order for at, order in zip(firsts, orders, strict=True)])
    whole, parts = f"given_{name}", f"given_{name}_portions"
    return Rows(
        {
            **rows.columns,
            whole: rows[whole][:, order_of(points)],
            parts: rows[parts][:, portions],
        }
    )


def outermost_first(points: Floats) -> Array:
    """The order of samples whose layers come from the outermost in.

    Args:
        points: (n, 3), map frame, m.

    Returns:
        (n,) indices.
    """
    return np.argsort(-np.round(np.linalg.norm(points, axis=1), 6), kind="stable")
