"""Obstacles that the spiral's samples cannot tell apart: figure 5-1, by search over real castings.

Boxes of random size are put at random places beside a can, one at a time, and cast; what the 184
samples read is compared. Sets of boxes with the same readings are kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from boxgrasp.arrays import Array, Floats
from boxgrasp.draw.palette import CATEGORY
from boxgrasp.draw.shapes import corners
from boxgrasp.geometry.box import Box
from boxgrasp.geometry.transforms import invert
from boxgrasp.mapping.local_map import MappingConfig
from boxgrasp.mapping.ray_insertion import build_local_map
from boxgrasp.perception.target import Target
from boxgrasp.ranking.sampling import RESOLUTION_M, sampling
from boxgrasp.simulate.objects import Part, SimulatedObject, load_objects
from boxgrasp.simulate.primitives import upright
from boxgrasp.simulate.scenes import (
    TABLE_CENTER_M,
    TABLE_HEIGHT_M,
    TableScene,
    build_scene,
    to_capture,
)
from boxgrasp.simulate.truth import true_box
from boxgrasp.study.plots.scenes import Heading, Panel, stacked
from boxgrasp.study.report import Picture
from boxgrasp.study.seen import Seen
from boxgrasp.teaching.rows import selector
from boxgrasp.teaching.samples import states_at

DRAWN = 48  # boxes; about 2 s
_SEED = 51
_TARGET, _OBSTACLE = "beans_can", "box"
# The middle of the drawn camera poses.
_CAMERA = {"position": [0.10, 0.0, 1.325], "gaze": [*TABLE_CENTER_M, TABLE_HEIGHT_M + 0.05]}
_LOW = (0.03, 0.03, 0.03, -0.09, -0.18)  # size x, y, z and place x, y beside the can, m
_HIGH = (0.09, 0.09, 0.08, 0.09, -0.10)


@dataclass(frozen=True, eq=False)
class Alike:
    """Three boxes whose samples read the same.

    Attributes:
        boxes: (3, 5) size x, y, z and place x, y relative to the target, m.
        states: (3, 184) uint8 what the spiral's samples read with each.
        grid_states: (3, 184) uint8 what the grid's samples read with each.
        alike: how many boxes of those drawn read just so.
        unseen: how many read as if no box were there.
    """

    boxes: Floats
    states: Array
    grid_states: Array
    alike: int
    unseen: int


def find_alike(count: int = DRAWN) -> Alike | None:
    """Search for three boxes far from each other in size and place, with the same readings.

    Args:
        count: of boxes to draw.

    Returns:
        Of the readings that differ from those without a box the commonest, and of its boxes the
        three whose nearest two differ most; None where no three read the same.
    """
    rng = np.random.default_rng(_SEED)
    boxes = np.round(rng.uniform(_LOW, _HIGH, (count, len(_LOW))), 3)
    states = np.array([_states(_scene(box), "spiral") for box in boxes])
    nothing = (states == _states(_scene(None), "spiral")).all(axis=1)
    seen = np.flatnonzero(~nothing)
    _, which, counts = np.unique(states[seen], axis=0, return_inverse=True, return_counts=True)
    if not len(seen) or counts.max() < 3:
        return None
    group = seen[which.ravel() == counts.argmax()]
    apart = np.linalg.norm(boxes[group][:, None] - boxes[group][None], axis=2)
    kept = max(
        combinations(range(len(group)), 3),
        key=lambda three: min(apart[a, b] for a, b in combinations(three, 2)),
    )
    three = group[list(kept)]
    grid_states = np.array([_states(_scene(box), "grid") for box in boxes[three]])
    return Alike(boxes[three], states[three], grid_states, len(group), int(nothing.sum()))


def alike_picture() -> Picture | str:
    """Figure 5-1: three boxes from above, with the samples and the cells that are occupied.

    Returns:
        The picture, or why there is none.
    """
    found = find_alike()
    if found is None:
        return f"Figure 5-1 is not drawn: no three of {DRAWN} boxes read the same."
    solids = [_solid(box) for box in found.boxes]
    panels = [_panel(_scene(box), box, solids) for box in found.boxes]
    told = len(np.unique(found.grid_states, axis=0))
    return Picture(
        "figure-5-1",
        "Three boxes from above for which the 184 samples of the spiral read the same (figure "
        f"5-1): target blue, box gray, occupied 3 cm cells green, samples white and where "
        f"occupied red. {DRAWN} boxes of 3 to 9 cm were drawn at random beside a can and cast "
        f"without noise: {found.unseen} read as if no box were there, {found.alike} just like "
        "these; of those the three that differ most in size and place. The grid's 184 samples "
        f"read them in {told} different {'way' if told == 1 else 'ways'}.",
        png=stacked(panels),
        alt="Three boxes of different size and place, and the same occupied samples",
    )


def _scene(box: Array | None) -> TableScene:
    """The can with a box beside it, or alone."""
    objects = dict(load_objects())
    obstacles: list[dict[str, Any]] = []
    if box is not None:
        size = float(box[0]), float(box[1]), float(box[2])
        part = Part("box", size, (0.0, 0.0, size[2] / 2), None)
        objects[_OBSTACLE] = SimulatedObject(_OBSTACLE, "obstacle", (150, 150, 150), (part,))
        x, y = float(box[3]), float(box[4])
        obstacles.append(_item(_OBSTACLE, TABLE_CENTER_M[0] + x, y, (150, 150, 150)))
    target = _item(_TARGET, *TABLE_CENTER_M, (60, 120, 200))
    return build_scene({"target": target, "obstacles": obstacles, "camera": _CAMERA}, objects)


def _item(name: str, x: float, y: float, color: Sequence[int]) -> dict[str, Any]:
    return {"name": name, "x": x, "y": y, "z": 0.0, "yaw": 0.0, "color": list(color)}


def _states(scene: TableScene, name: str) -> Array:
    """What a sampling reads round the true box of the target."""
    points = to_capture(scene, noise=False)[0].valid_points()[0]
    T_camera_map = invert(scene.T_base_camera) @ Box(*true_box(scene, mode="aligned")).T_base_map()
    cells = replace(MappingConfig(), resolution_m=RESOLUTION_M[name])
    return states_at(build_local_map([(points, np.zeros(3))], T_camera_map, cells), sampling(name))


def _solid(box: Array) -> Floats:
    """(8, 3) corners of a box, base frame, m."""
    place = upright(TABLE_CENTER_M[0] + box[3], TABLE_CENTER_M[1] + box[4], 0.0)
    place[2, 3] = TABLE_HEIGHT_M + box[2] / 2
    return corners(place, box[:3])


def _panel(scene: TableScene, box: Array, solids: Sequence[Floats]) -> Panel:
    """The box from above; all three in the picture, so that the panels have one scale."""
    capture, object_ids = to_capture(scene, noise=False)
    target = Target(mask=object_ids == scene.target_id)
    seen = Seen(capture, selector("given", 3).analyze(capture, target))
    words = " x ".join(f"{100 * value:.1f}" for value in box[:3])
    x, y = (100 * float(value) for value in box[3:])
    away = f"{abs(x):.1f} cm {'behind' if x > 0 else 'before'}, {abs(y):.1f} cm right of the can"
    panel = Panel(seen, Heading(f"{words} cm\n{away}"), solids, "above")
    panel.solid(corners(seen.box.T_base_box, seen.box.dimensions_m), (60, 120, 200))
    panel.solid(_solid(box), (140, 140, 140))
    local_map, points = seen.local_map(RESOLUTION_M["spiral"]), sampling("spiral")
    panel.outlines(local_map, CATEGORY["green"])
    return panel.samples(points, states_at(local_map, points), 7.0)
