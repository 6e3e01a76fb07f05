"""Random cluttered tables of the thesis's kind (sections 3-1, 3-3-1), seen by a robot's camera."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
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
FLOOR_ID, TABLE_ID, TARGET_ID = 0, 1, 2
YAWS = ("thesis", "random", "none")
PALETTE: tuple[Color, ...] = (
    (200, 60, 50),
    (60, 120, 200),
    (70, 170, 80),
    (220, 180, 60),
    (150, 90, 170),
    (240, 140, 60),
)
_AREA_M = 0.50
_MOST_OBSTACLES = 200  # far more than any area of a table holds
_LEAST_GAP_M = 0.002  # between two objects
_LEAST_TARGET_PX = 300  # of the target that the camera sees
_SCENE_TRIES = 200
_PLACE_TRIES = 60


@dataclass(frozen=True, eq=False)
class TableScene:
    """Objects on a table and a camera; base frame, m.

    Attributes:
        primitives: solids of floor (object 0), table (1), target (2) and obstacles (3 and up).
        target_id: the target's number.
        obstacle_ids: the obstacles' numbers.
        floating_ids: numbers of the objects that do not stand.
        names: of the objects by number.
        T_base_camera: (4, 4), optical frame.
        intrinsics: (3, 3), px.
        table_height_m: z of the table's top, m.
        spec: plain values from which `build_scene` makes the same scene again.
    """

    primitives: tuple[Primitive, ...]
    target_id: int
    obstacle_ids: tuple[int, ...]
    floating_ids: tuple[int, ...]
    names: Mapping[int, str]
    T_base_camera: Floats
    intrinsics: Floats
    table_height_m: float
    spec: Mapping[str, Any]

    @property
    def target(self) -> tuple[Box | Cylinder, ...]:
        """The target's solids."""
        return self.solids_of((self.target_id,))

    @property
    def obstacles(self) -> tuple[Box | Cylinder, ...]:
        """The obstacles' solids; neither table nor floor is an obstacle."""
        return self.solids_of(self.obstacle_ids)

    def solids_of(self, object_ids: Sequence[int]) -> tuple[Box | Cylinder, ...]:
        """The solids of some objects.

        Args:
            object_ids: their numbers.

        Returns:
            Boxes and cylinders, in the order of the primitives.
        """
        return tuple(
            p for p in self.primitives if not isinstance(p, Plane) and p.object_id in object_ids
        )

    def view(self, *, shading: float = 0.0) -> CastView:
        """What the camera sees, without noise.

        Args:
            shading: as `cast` takes it.

        Returns:
            Depth, colors and object numbers of 480 x 640 pixels.
        """
        return cast(self.primitives, self.intrinsics, self.T_base_camera, shading=shading)


@dataclass(frozen=True)
class Clutter:
    """How obstacles stand round a target.

    Attributes:
        obstacles: least and most number.
        yaw: `thesis` (target along the base's axes, obstacles turned at random), `random` (the
            target too) or `none`.
        area_m: edge of the square that holds the obstacles' centers, m.

    Raises:
        SceneError: a mode that is not there, or numbers that are not in order.
    """

    obstacles: tuple[int, int] = (0, 4)
    yaw: str = "thesis"
    area_m: float = _AREA_M

    def __post_init__(self) -> None:
        if self.yaw not in YAWS:
            raise SceneError(f"yaw is {self.yaw!r}; valid: {', '.join(YAWS)}")
        least, most = self.obstacles
        if not 0 <= least <= most <= _MOST_OBSTACLES:
            raise SceneError(
                f"obstacles is {self.obstacles}; valid: 0 to {_MOST_OBSTACLES}, the least first"
            )


def build_scene(
    spec: Mapping[str, Any], objects: Mapping[str, SimulatedObject] | None = None
) -> TableScene:
    """The scene of a spec.

    Args:
        spec: `target` and each of `obstacles` as {name, x, y, z, yaw, color}, `camera` as
            {position, gaze}; z is the base's height over the table, all m and radians.
        objects: by name; None for the thesis's simulated ones.

    Returns:
        The scene.

    Raises:
        SceneError: an object that the set does not have, or a key that is missing.
    """
    known = load_objects() if objects is None else objects
    try:
        primitives: list[Primitive] = [Plane(0.0, (40, 44, 46), FLOOR_ID), _table()]
        named = {FLOOR_ID: "floor", TABLE_ID: "table"}
        for number, item in enumerate((spec["target"], *spec["obstacles"]), start=TARGET_ID):
            primitives += _place(known, item, number)
            named[number] = item["name"]
        T_base_camera = look_at(spec["camera"]["position"], spec["camera"]["gaze"])
    except KeyError as error:
        raise SceneError(f"scene has no {error}; valid: a spec as draw_scene makes it") from None
    return TableScene(
        tuple(primitives),
        TARGET_ID,
        tuple(range(TARGET_ID + 1, TARGET_ID + 1 + len(spec["obstacles"]))),
        tuple(n for n in named if n >= TARGET_ID and known[named[n]].floats_m is not None),
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
    area_m: float = _AREA_M,
    objects: Mapping[str, SimulatedObject] | None = None,
) -> TableScene:
    """A random scene: target in the middle, obstacles and lamps round it, none in another.

    Poses are rounded to 0.1 mm and 0.1 mrad. Drawn again while the camera sees fewer than 300
    pixels of the target.

    Args:
        rng: draws it.
        target: a name, or None for any of the known and novel ones.
        obstacles: how many, or the least and most.
        yaw: as `Clutter.yaw`.
        area_m: as `Clutter.area_m`, m.
        objects: by name; None for the thesis's simulated ones.

    Returns:
        The scene.

    Raises:
        SceneError: a name or mode that is not there, or no scene found in 200 draws.
    """
    pair = (obstacles, obstacles) if isinstance(obstacles, int) else obstacles
    drawn = drawn_scenes(rng, target, Clutter(pair, yaw, area_m), objects)
    return next(scene for scene in drawn if shows_target(scene))


def drawn_scenes(
    rng: np.random.Generator,
    target: str | None = None,
    clutter: Clutter | None = None,
    objects: Mapping[str, SimulatedObject] | None = None,
) -> Iterator[TableScene]:
    """Scenes drawn one after the other, for who takes the first that is as wished.

    Args:
        rng: draws them.
        target: as `draw_scene` takes it.
        clutter: what stands round it; None for the defaults.
        objects: by name; None for the thesis's simulated ones.

    Yields:
        200 draws at most, less those in which an obstacle found no place.

    Raises:
        SceneError: no object has the name, or none of the 200 was taken.
    """
    known = load_objects() if objects is None else objects
    clutter = Clutter() if clutter is None else clutter
    if target is not None and target not in known:
        raise SceneError(f"no object {target!r}; valid: {', '.join(known)}")
    targets = [name for name, item in known.items() if item.set != "obstacle"]
    name = targets[int(rng.integers(len(targets)))] if target is None else target
    least, most = clutter.obstacles
    for _ in range(_SCENE_TRIES):
        spec = _draw_spec(rng, name, int(rng.integers(least, most + 1)), known, clutter)
        if spec is not None:
            yield build_scene(spec, known)
    raise SceneError(
        f"no scene of {name} with {least} to {most} obstacles in {_SCENE_TRIES} draws; "
        "valid: fewer obstacles, a larger area, or other wishes"
    )


def shows_target(scene: TableScene) -> bool:
    """Whether the camera sees enough of the target to name it by a pixel.

    Args:
        scene: any.

    Returns:
        Whether 300 of its pixels or more are visible.
    """
    visible = int(np.count_nonzero(scene.view().object_ids == scene.target_id))
    return visible >= _LEAST_TARGET_PX


def to_capture(
    scene: TableScene,
    rng: np.random.Generator | None = None,
    noise: bool | NoiseModel = True,
    *,
    shading: float = 0.0,
) -> tuple[Capture, NDArray[np.int32]]:
    """The scene as a capture, its target pixel amid the visible target, and what is true of it.

    Args:
        scene: any.
        rng: draws the noise; needed unless there is none.
        noise: a model, True for an Xtion's, or False for the exact depth.
        shading: as `cast` takes it.

    Returns:
        The capture, and (H, W) int32 the true object of each pixel, -1 for nothing.

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
    pixel = target_pixel(view.object_ids == scene.target_id, depth)
    capture = Capture(depth, scene.intrinsics, scene.T_base_camera, rgb, target_pixel=pixel)
    return capture, view.object_ids


def target_pixel(visible: NDArray[np.bool_], depth: NDArray[np.float32]) -> tuple[int, int]:
    """The visible pixel with depth, off the edges, nearest to the visible area's middle.

    Args:
        visible: (H, W) bool, where the target is seen.
        depth: (H, W) float32, m, 0 missing.

    Returns:
        u, v.

    Raises:
        SceneError: nothing is visible.
    """
    seen = visible & (depth > 0)
    edge = edge_pixels(np.where(visible, depth, np.float32(0)), NoiseModel.edge_jump_m)
    inner = seen & ~edge
    v, u = np.nonzero(inner if inner.any() else seen)
    if len(u) == 0:
        raise SceneError("the target is not visible; valid: at least one pixel with depth")
    rows, columns = np.nonzero(visible)
    off = (u - np.median(columns)) ** 2 + (v - np.median(rows)) ** 2
    nearest = int(np.argmin(off))
    return int(u[nearest]), int(v[nearest])


def _table() -> Box:
    center = upright(*TABLE_CENTER_M, TABLE_HEIGHT_M - TABLE_SIZE_M[2] / 2)
    return Box(center, np.array(TABLE_SIZE_M), TABLE_COLOR, TABLE_ID)


def _place(
    known: Mapping[str, SimulatedObject], item: Mapping[str, Any], object_id: int
) -> tuple[Box | Cylinder, ...]:
    if item["name"] not in known:
        raise SceneError(f"no object {item['name']!r}; valid: {', '.join(known)}")
    return known[item["name"]].place(
        item["x"],
        item["y"],
        TABLE_HEIGHT_M + item["z"],
        item["yaw"],
        object_id=object_id,
        color=tuple(item["color"]),
    )


def _draw_spec(
    rng: np.random.Generator,
    name: str,
    count: int,
    known: Mapping[str, SimulatedObject],
    clutter: Clutter,
) -> dict[str, Any] | None:
    """Plain values of one scene, or None where an obstacle found no place."""
    colors = [PALETTE[i] for i in rng.permutation(len(PALETTE))]
    center = np.array(TABLE_CENTER_M) + rng.uniform(-0.02, 0.02, 2)
    turn = float(rng.uniform(-np.pi, np.pi)) if clutter.yaw == "random" else 0.0
    target = _item(name, center, 0.0, turn, colors[0])
    placed = [_place(known, target, TARGET_ID)]
    items: list[dict[str, Any]] = []
    pool = list(known)
    for k in range(count):
        other = known[pool[int(rng.integers(len(pool)))]]
        color = colors[(k + 1) % len(colors)]
        for _ in range(_PLACE_TRIES):
            item = _draw_obstacle(rng, other, center, clutter, color)
            solids = _place(known, item, 0)
            if _apart(solids, placed):
                items.append(item)
                placed.append(solids)
                break
        else:
            return None
    return {"target": target, "obstacles": items, "camera": _draw_camera(rng)}


def _draw_obstacle(
    rng: np.random.Generator, kind: SimulatedObject, center: Floats, clutter: Clutter, color: Color
) -> dict[str, Any]:
    place = center + rng.uniform(-clutter.area_m / 2, clutter.area_m / 2, 2)
    turn = float(rng.uniform(-np.pi, np.pi))
    height = 0.0 if kind.floats_m is None else float(rng.uniform(*kind.floats_m))
    return _item(kind.name, place, height, 0.0 if clutter.yaw == "none" else turn, color)


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


def _apart(solids: Sequence[Box | Cylinder], placed: Sequence[Sequence[Box | Cylinder]]) -> bool:
    return all(_two_apart(a, b) for a in solids for other in placed for b in other)


def _two_apart(a: Box | Cylinder, b: Box | Cylinder) -> bool:
    """Whether two solids keep the least gap; the balls round them are tried first."""
    between = float(np.linalg.norm(a.T_base_solid[:3, 3] - b.T_base_solid[:3, 3]))
    if between > np.linalg.norm(a.half_size) + np.linalg.norm(b.half_size) + _LEAST_GAP_M:
        return True
    return gap(a, b) > _LEAST_GAP_M
