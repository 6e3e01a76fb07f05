"""Random cluttered tables of the thesis's kind (sections 3-1, 3-3-1), seen by a robot's camera."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Floats
from boxgrasp.errors import SceneError
from boxgrasp.sensing.capture import Capture
from boxgrasp.simulate.camera import CastView, cast, intrinsics_matrix, look_at
from boxgrasp.simulate.distance import gap
from boxgrasp.simulate.noise import NoiseModel, add_noise, color_noise, edge_pixels
from boxgrasp.simulate.objects import SimulatedObject, load_objects
from boxgrasp.simulate.primitives import Box, Color, Cylinder, Plane, Primitive, upright

TABLE_HEIGHT_M = 0.80
TABLE_CENTER_M = (0.85, 0.0)
TABLE_SIZE_M = (0.80, 1.20, 0.04)
TABLE_COLOR = (170, 140, 110)
FLOOR_LABEL, TABLE_LABEL, TARGET_LABEL = 0, 1, 2
PALETTE: tuple[Color, ...] = (
    (200, 60, 50),
    (60, 120, 200),
    (70, 170, 80),
    (220, 180, 60),
    (150, 90, 170),
    (240, 140, 60),
)
_SCENE_TRIES = 200
_PLACE_TRIES = 60


@dataclass(frozen=True, eq=False)
class TableScene:
    """Objects on a table and a camera; base frame, m.

    primitives: floor (label 0), table (1), target (2) and obstacles (3 and up), one label an
    object; floating_labels: of those that do not stand. spec: plain values from which `build_scene`
    makes the same scene again.
    """

    primitives: tuple[Primitive, ...]
    target_label: int
    obstacle_labels: tuple[int, ...]
    floating_labels: tuple[int, ...]
    names: Mapping[int, str]
    T_base_camera: Floats
    intrinsics: Floats
    table_height_m: float
    spec: Mapping[str, Any]

    @property
    def target(self) -> tuple[Box | Cylinder, ...]:
        """The target's solids."""
        return self._solids((self.target_label,))

    @property
    def obstacles(self) -> tuple[Box | Cylinder, ...]:
        """The obstacles' solids; neither table nor floor is an obstacle."""
        return self._solids(self.obstacle_labels)

    def view(self, *, shading: float = 0.0) -> CastView:
        """What the camera sees, without noise."""
        return cast(self.primitives, self.intrinsics, self.T_base_camera, shading=shading)

    def _solids(self, labels: Sequence[int]) -> tuple[Box | Cylinder, ...]:
        return tuple(p for p in self.primitives if not isinstance(p, Plane) and p.label in labels)


def build_scene(
    spec: Mapping[str, Any], objects: Mapping[str, SimulatedObject] | None = None
) -> TableScene:
    """The scene of a spec: `target` and each of `obstacles` as {name, x, y, z, yaw, color}.

    `camera` is {position, gaze}; z is the base's height over the table, all m and radians.

    Raises:
        SceneError: an object that the set does not have, or a key that is missing.
    """
    known = load_objects() if objects is None else objects
    try:
        table = Box(
            upright(*TABLE_CENTER_M, TABLE_HEIGHT_M - TABLE_SIZE_M[2] / 2),
            np.array(TABLE_SIZE_M),
            TABLE_COLOR,
            TABLE_LABEL,
        )
        primitives: list[Primitive] = [Plane(0.0, (40, 44, 46), FLOOR_LABEL), table]
        named = {FLOOR_LABEL: "floor", TABLE_LABEL: "table"}
        for label, item in enumerate((spec["target"], *spec["obstacles"]), start=TARGET_LABEL):
            primitives += _place(known, item, label)
            named[label] = item["name"]
        T_base_camera = look_at(spec["camera"]["position"], spec["camera"]["gaze"])
    except KeyError as error:
        raise SceneError(f"scene has no {error}; valid: a spec as draw_scene makes it") from None
    return TableScene(
        tuple(primitives),
        TARGET_LABEL,
        tuple(range(TARGET_LABEL + 1, TARGET_LABEL + 1 + len(spec["obstacles"]))),
        tuple(n for n in named if n >= TARGET_LABEL and known[named[n]].floats_m is not None),
        named,
        T_base_camera,
        intrinsics_matrix(),
        TABLE_HEIGHT_M,
        spec,
    )


def draw_scene(
    rng: np.random.Generator,
    target: str | None = None,
    obstacles: int | tuple[int, int] = (0, 4),
    *,
    yaw: str = "thesis",
    min_gap_m: float = 0.002,
    area_m: float = 0.50,
    min_target_pixels: int = 300,
    objects: Mapping[str, SimulatedObject] | None = None,
    accept: Callable[[TableScene], bool] | None = None,
) -> TableScene:
    """A random scene: target in the middle, obstacles and lamps round it, nothing interpenetrating.

    target: a name, or None for any of the known and novel ones; obstacles: how many, or the least
    and most; yaw `thesis` (target along the base's axes, obstacles turned at random), `random` (the
    target too) or `none`; area_m: edge of the square that holds the obstacles' centers. Poses are
    rounded to 0.1 mm and 0.1 mrad. Drawn again while `accept` says no, or fewer than
    min_target_pixels are visible.

    Raises:
        SceneError: a name or mode that is not there, or no scene found in 200 draws.
    """
    known = load_objects() if objects is None else objects
    targets = [name for name, item in known.items() if item.set != "obstacle"]
    if target is not None and target not in known:
        raise SceneError(f"no object {target!r}; valid: {', '.join(known)}")
    if yaw not in ("thesis", "random", "none"):
        raise SceneError(f"yaw is {yaw!r}; valid: thesis, random, none")
    least, most = (obstacles, obstacles) if isinstance(obstacles, int) else obstacles
    if not 0 <= least <= most:
        raise SceneError(f"obstacles is {obstacles}; valid: 0 or more, the least first")
    name = targets[int(rng.integers(len(targets)))] if target is None else target
    for _ in range(_SCENE_TRIES):
        count = int(rng.integers(least, most + 1))
        spec = _draw_spec(rng, name, count, known, yaw, min_gap_m, area_m)
        if spec is None:
            continue
        scene = build_scene(spec, known)
        if accept is not None and not accept(scene):
            continue
        visible = int(np.count_nonzero(scene.view().labels == scene.target_label))
        if visible >= min_target_pixels:
            return scene
    raise SceneError(
        f"no scene of {name} with {least} to {most} obstacles in {_SCENE_TRIES} draws; "
        "valid: fewer obstacles, a larger area, a smaller gap or other wishes"
    )


def to_capture(
    scene: TableScene,
    rng: np.random.Generator | None = None,
    noise: bool | NoiseModel = True,
    *,
    shading: float = 0.0,
) -> tuple[Capture, NDArray[np.int32]]:
    """The scene as a capture, its target pixel amid the visible target, and labels (H, W) int32.

    noise False gives the exact depth; else rng is needed.

    Raises:
        SceneError: noise without rng, or no target pixel is visible.
    """
    view = scene.view(shading=shading)
    depth, rgb = view.depth, view.rgb
    if noise:
        if rng is None:
            raise SceneError("noise needs rng; valid: a numpy Generator, or noise=False")
        model = noise if isinstance(noise, NoiseModel) else NoiseModel()
        depth = add_noise(depth, rng, model)
        rgb = color_noise(rgb, rng, model)
    pixel = target_pixel(view.labels == scene.target_label, depth)
    capture = Capture(depth, scene.intrinsics, scene.T_base_camera, rgb, target_pixel=pixel)
    return capture, view.labels


def target_pixel(visible: NDArray[np.bool_], depth: NDArray[np.float32]) -> tuple[int, int]:
    """(u, v) of the visible pixel with depth, off the edges, nearest to the visible area's middle.

    Raises:
        SceneError: nothing is visible.
    """
    seen = visible & (depth > 0)
    inner = seen & ~edge_pixels(np.where(visible, depth, np.float32(0)), 0.02)
    v, u = np.nonzero(inner if inner.any() else seen)
    if len(u) == 0:
        raise SceneError("the target is not visible; valid: at least one pixel with depth")
    rows, columns = np.nonzero(visible)
    off = (u - np.median(columns)) ** 2 + (v - np.median(rows)) ** 2
    nearest = int(np.argmin(off))
    return int(u[nearest]), int(v[nearest])


def _place(
    known: Mapping[str, SimulatedObject], item: Mapping[str, Any], label: int
) -> tuple[Box | Cylinder, ...]:
    if item["name"] not in known:
        raise SceneError(f"no object {item['name']!r}; valid: {', '.join(known)}")
    return known[item["name"]].place(
        item["x"],
        item["y"],
        TABLE_HEIGHT_M + item["z"],
        item["yaw"],
        label=label,
        color=tuple(item["color"]),
    )


def _draw_spec(
    rng: np.random.Generator,
    name: str,
    count: int,
    known: Mapping[str, SimulatedObject],
    yaw: str,
    min_gap_m: float,
    area_m: float,
) -> dict[str, Any] | None:
    """Plain values of one scene, or None where an obstacle found no place."""
    colors = [PALETTE[i] for i in rng.permutation(len(PALETTE))]
    center = np.array(TABLE_CENTER_M) + rng.uniform(-0.02, 0.02, 2)
    turn = float(rng.uniform(-np.pi, np.pi)) if yaw == "random" else 0.0
    target = _item(name, center, 0.0, turn, colors[0])
    placed = [_place(known, target, TARGET_LABEL)]
    items: list[dict[str, Any]] = []
    pool = list(known)
    for k in range(count):
        other = pool[int(rng.integers(len(pool)))]
        color = colors[(k + 1) % len(colors)]
        for _ in range(_PLACE_TRIES):
            item = _draw_obstacle(rng, known[other], center, yaw, area_m, color)
            solids = _place(known, item, 0)
            if _apart(solids, placed, min_gap_m):
                items.append(item)
                placed.append(solids)
                break
        else:
            return None
    return {"target": target, "obstacles": items, "camera": _draw_camera(rng)}


def _draw_obstacle(
    rng: np.random.Generator,
    kind: SimulatedObject,
    center: Floats,
    yaw: str,
    area_m: float,
    color: Color,
) -> dict[str, Any]:
    place = center + rng.uniform(-area_m / 2, area_m / 2, 2)
    turn = float(rng.uniform(-np.pi, np.pi))
    height = 0.0 if kind.floats_m is None else float(rng.uniform(*kind.floats_m))
    return _item(kind.name, place, height, 0.0 if yaw == "none" else turn, color)


def _item(name: str, place: Floats, height: float, turn: float, color: Color) -> dict[str, Any]:
    return {
        "name": name,
        "x": round(float(place[0]), 4),
        "y": round(float(place[1]), 4),
        "z": round(height, 4),
        "yaw": round(turn, 4),
        "color": list(color),
    }


def _draw_camera(rng: np.random.Generator) -> dict[str, Any]:
    """A TIAGo's head: torso up, gaze on the table (pose and jitter are ours)."""
    position = rng.uniform((0.0, -0.15, 1.20), (0.20, 0.15, 1.45))
    gaze = np.array([*TABLE_CENTER_M, TABLE_HEIGHT_M + 0.05]) + rng.uniform(-0.05, 0.05, 3)
    return {
        "position": [round(float(value), 4) for value in position],
        "gaze": [round(float(value), 4) for value in gaze],
    }


def _apart(
    solids: Sequence[Box | Cylinder],
    placed: Sequence[Sequence[Box | Cylinder]],
    min_gap_m: float,
) -> bool:
    return all(_gap(a, b, min_gap_m) for a in solids for other in placed for b in other)


def _gap(a: Box | Cylinder, b: Box | Cylinder, min_gap_m: float) -> bool:
    """Whether two solids are apart by the gap; their balls are tried first."""
    between = float(np.linalg.norm(a.T_base_solid[:3, 3] - b.T_base_solid[:3, 3]))
    if between > np.linalg.norm(a.half_size) + np.linalg.norm(b.half_size) + min_gap_m:
        return True
    return gap(a, b) > min_gap_m


def with_camera(scene: TableScene, T_base_camera: Floats) -> TableScene:
    """The same objects seen from another place."""
    return replace(scene, T_base_camera=T_base_camera)
