"""Tables as ugly as real ones: full, stacked, cut by edges, before walls and chairs, hands in view.

They teach a network to tell things apart. The study's tables are those of `scenes`.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Floats, readonly
from boxgrasp.geometry.transforms import make_transform, rotation_z
from boxgrasp.kernels.raycast import BOX, CYLINDER, PLANE, raycast
from boxgrasp.simulate.camera import SolidsSeen, look_at
from boxgrasp.simulate.household import Rng, Thing, about_x, draw_small, draw_thing, spun
from boxgrasp.simulate.primitives import Solids

NO_THING = 0  # floor, tables, walls, chairs, the robot's own hand
UNTOLD = -1  # wires: neither thing nor table

_CELL_M = 0.01  # of the map in which things are kept apart
_SIDE_M = 2.4  # of that map
_TRIES = 8
_MOST_OVERLAP = 0.02  # of a thing's cells, from which it would stand in another
_HELD = 0.08  # of the things, tried to be put into a hollow one
_LEAST_SCALE = 0.5  # of a thing that is made as wide as what it stands on
_SLIDE_M = 0.006  # steps in which a thing comes near another


@dataclass(frozen=True, eq=False)
class View:
    """What a camera without noise sees of such a table; z = 0 is its top.

    Attributes:
        depth_m: (H, W) float32 along the optical axis, 0 where nothing is.
        things: (H, W) int32, from 1, `NO_THING` or `UNTOLD`.
        focal_px: px.
        center_px: (2,) u, v where the optical axis meets the image; it may lie outside.
        T_table_camera: (4, 4), optical frame.
        solids: P of them, all that is there, in the table's frame.
        owners: (P,) int32, the thing that each solid is of, as in `things`.
    """

    depth_m: NDArray[np.float32]
    things: NDArray[np.int32]
    focal_px: float
    center_px: tuple[float, float]
    T_table_camera: Floats
    solids: Solids
    owners: NDArray[np.int32]

    def solids_of(self, thing: int) -> Solids:
        """The solids of a thing, hidden ones included.

        Args:
            thing: its number.

        Returns:
            Solids in the table's frame.
        """
        own, there = self.owners == thing, self.solids
        return Solids(there.kinds[own], there.T_base_solid[own], there.sizes[own])


@dataclass(eq=False)
class _Table:
    """The solids so far, and which cells of the table are taken."""

    kinds: list[int] = field(default_factory=list)
    poses: list[Floats] = field(default_factory=list)
    sizes: list[Floats] = field(default_factory=list)
    things: list[int] = field(default_factory=list)
    taken: NDArray[np.bool_] = field(
        default_factory=lambda: np.zeros((int(_SIDE_M / _CELL_M),) * 2, dtype=np.bool_)
    )

    def add(self, kind: int, T: Floats, size: Floats, thing: int) -> None:
        self.kinds.append(kind)
        self.poses.append(T)
        self.sizes.append(size)
        self.things.append(thing)

    def put(self, thing: Thing, T: Floats, number: int) -> None:
        for kind, pose, size in zip(thing.kinds, thing.T_thing_solid, thing.sizes, strict=True):
            self.add(int(kind), T @ pose, size, number)

    def cells(self, points: Floats) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        at = np.floor(points[:, :2] / _CELL_M + self.taken.shape[0] / 2).astype(np.int64)
        np.clip(at, 0, self.taken.shape[0] - 1, out=at)
        return at[:, 0], at[:, 1]

    def free(self, points: Floats) -> bool:
        return float(self.taken[self.cells(points)].mean()) <= _MOST_OVERLAP


@dataclass(frozen=True, eq=False)
class _Placed:
    """A thing where it stands."""

    thing: Thing
    place: Floats
    reach_m: float


def draw_view(rng: Rng, shape: tuple[int, int], focal_px: float | None = None) -> View:
    """Cast a random table from a random camera.

    Args:
        rng: draws all of it.
        shape: height and width of the image, px.
        focal_px: of a whole camera's image; None for a part of one, so that what is looked at is
            sampled every 1.3 to 6.2 mm.

    Returns:
        The view.
    """
    table = _Table()
    half = _ground(table, rng)
    placed = _things(table, half, rng)
    elevation = rng.uniform(0.17, 1.5)
    range_m = float(np.exp(rng.uniform(np.log(0.4), np.log(2.4))))
    spacing_m = rng.uniform(0.0013, 0.0062)  # of pixels, on what is looked at
    gaze = np.zeros(3)
    if placed:
        gaze = placed[int(rng.integers(len(placed)))].place + (*rng.uniform(-0.05, 0.05, 2), 0.03)
    azimuth = rng.uniform(-np.pi, np.pi)
    flat = np.cos(elevation) * np.array([np.cos(azimuth), np.sin(azimuth)])
    eye = gaze + range_m * np.array([*flat, np.sin(elevation)])
    T = _rolled(look_at(eye, gaze), rng)
    _round_about(table, half, azimuth, rng)
    if rng.random() < 0.15:
        _hand(table, eye, gaze, rng)
    away = rng.uniform(-0.3, 0.3, 2) * shape[::-1]
    center = (shape[1] / 2 + away[0], shape[0] / 2 + away[1])
    if focal_px is not None:
        center = ((shape[1] - 1) / 2, (shape[0] - 1) / 2)
    else:
        focal_px = float(np.clip(range_m / spacing_m, 180.0, 1200.0))
    solids = Solids(np.array(table.kinds), np.array(table.poses), np.array(table.sizes))
    rays = SolidsSeen.of(solids, T)
    focal = np.array([focal_px, focal_px, *center])
    depth, index = np.empty(shape), np.empty(shape, dtype=np.int32)
    raycast(*rays.arrays, rays.rectangles(focal, shape), focal, 0, shape[0], depth, index)
    owners = np.array([*table.things, NO_THING], dtype=np.int32)  # the last is of no solid met
    depth[~np.isfinite(depth)] = 0.0
    seen = depth.astype(np.float32)
    return View(seen, owners[index], focal_px, center, T, solids, readonly(owners[:-1]))


def _rolled(T: Floats, rng: Rng) -> Floats:
    """The camera, in one view of five held askew."""
    if rng.random() > 0.2:
        return T
    return T @ make_transform(rotation_z(float(rng.normal(0.0, 0.15))), np.zeros(3))


def _ground(table: _Table, rng: Rng) -> Floats:
    """Floor, the table, and now and then a second one; the first one's half lengths, m."""
    half = rng.uniform(0.2, 0.9, 2)
    thick = rng.uniform(0.008, 0.03)
    if rng.random() < 0.2:
        half[1] = half[0]
        table.add(CYLINDER, _at(z=-thick), np.array([half[0], half[0], thick]), NO_THING)
    else:
        table.add(BOX, _at(z=-thick), np.array([*half, thick]), NO_THING)
    floor = _at(z=-rng.uniform(0.3, 0.9))
    table.add(PLANE, floor, np.array([np.inf, np.inf, 0.0]), NO_THING)
    if rng.random() < 0.2:
        other = rng.uniform(0.2, 0.7, 2)
        top = float(rng.choice((-1, 1)) * rng.uniform(0.01, 0.12))
        aside = half[0] + other[0] + rng.uniform(0.0, 0.05)
        place = _at(aside, rng.uniform(-0.2, 0.2), top - 0.015)
        table.add(BOX, place, np.array([*other, 0.015]), NO_THING)
    return half


def _at(x: float = 0.0, y: float = 0.0, z: float = 0.0, yaw: float = 0.0) -> Floats:
    """The pose of what stands level."""
    return make_transform(rotation_z(yaw), (x, y, z))


def _things(table: _Table, half: Floats, rng: Rng) -> list[_Placed]:
    """Things spread, touching, aligned, stacked."""
    spread = np.minimum(half, rng.uniform(0.08, 0.45))
    touching, stacking = rng.uniform(0.1, 0.8), rng.uniform(0.0, 0.4)
    middle = rng.uniform(-1, 1, 2) * np.maximum(half - spread, 0.0)
    placed: list[_Placed] = []
    for number in range(1, int(rng.integers(2, 18))):
        thing = spun(draw_thing(rng), rng)
        found = None
        if placed and rng.random() < _HELD:
            thing, found = _held(thing, placed, rng)
        elif placed and rng.random() < stacking:
            thing, found = _stacked(thing, placed, rng)
        elif placed and rng.random() < touching:
            thing, found = _touching(table, thing, placed, rng)
        for _ in range(_TRIES):
            if found is not None:
                break
            at = np.array([*(middle + rng.uniform(-1, 1, 2) * spread), 0.0])
            found = at if table.free(thing.lattice + at) else None
        if found is None or (found[2] == 0 and (np.abs(found[:2]) > half).any()):
            continue
        table.put(thing, _at(*found), number)
        if found[2] == 0:
            table.taken[table.cells(thing.lattice + found)] = True
        placed.append(_Placed(thing, found, float(np.abs(thing.lattice[:, :2]).max())))
    if rng.random() < 0.15:
        _wire(table, middle, rng)
    return placed


def _held(thing: Thing, placed: list[_Placed], rng: Rng) -> tuple[Thing, Floats | None]:
    """A small thing in place of this one, and a place in a hollow one; or none."""
    hollow = [item for item in placed if item.thing.hollow]
    if not hollow:
        return thing, None
    around = hollow[int(rng.integers(len(hollow)))]
    off = rng.uniform(-0.25, 0.25, 2) * around.reach_m
    return draw_small(rng), around.place + (off[0], off[1], 0.004)


def _stacked(thing: Thing, placed: list[_Placed], rng: Rng) -> tuple[Thing, Floats | None]:
    """The thing, now and then as wide as what it stands on, and a place on another's flat top."""
    tops = [item for item in placed if item.thing.top_m > 0 and not _carries(item, placed)]
    if not tops:
        return thing, None
    under = tops[int(rng.integers(len(tops)))]
    reach, spread = float(np.abs(thing.lattice[:, :2]).max()), 0.4
    if rng.random() < 0.5:  # of one width and one over the other, so that no outline parts them
        spread = 0.12
        factor = under.reach_m * rng.uniform(0.75, 1.1) / reach
        if _LEAST_SCALE <= factor <= 1 / _LEAST_SCALE:
            thing, reach = thing.scaled(factor), reach * factor
        if rng.random() < 0.5:
            thing = _turned_as(under.thing, thing, float(rng.normal(0.0, 0.1)))
    if reach > 1.8 * under.reach_m:
        return thing, None
    off = rng.uniform(-spread, spread, 2) * under.reach_m
    return thing, under.place + (off[0], off[1], under.thing.top_m)


def _turned_as(other: Thing, thing: Thing, off_rad: float) -> Thing:
    """The thing, turned as another one is but for an angle."""
    return thing.turned(rotation_z(other.yaw_rad - thing.yaw_rad + off_rad))


def _carries(under: _Placed, placed: list[_Placed]) -> bool:
    """Whether something stands on a thing, or as high as on it."""
    return any(abs(p.place[2] - under.place[2] - under.thing.top_m) < 1e-9 for p in placed)


def _touching(
    table: _Table, thing: Thing, placed: list[_Placed], rng: Rng
) -> tuple[Thing, Floats | None]:
    """The thing, mostly turned as its neighbor, and the nearest free place beside that."""
    beside = placed[int(rng.integers(len(placed)))]
    if beside.place[2] > 0:
        return thing, None
    angle = rng.uniform(-np.pi, np.pi)
    if rng.random() < 0.6:
        thing = _turned_as(beside.thing, thing, float(rng.normal(0.0, 0.04)))
        angle = beside.thing.yaw_rad + rng.integers(4) * np.pi / 2
    points, way = thing.lattice, np.array([np.cos(angle), np.sin(angle), 0.0])
    across = np.array([-way[1], way[0], 0.0]) * rng.uniform(-0.5, 0.5) * beside.reach_m
    for away in np.arange(0.0, 0.35, _SLIDE_M):
        at = beside.place + across + away * way
        if table.free(points + at):
            return thing, at - way * rng.uniform(0.0, 0.006)
    return thing, None


def _wire(table: _Table, middle: Floats, rng: Rng) -> None:
    """A cable that winds over the table."""
    at, heading = np.array([*(middle + rng.uniform(-0.2, 0.2, 2)), 0.0]), rng.uniform(-3, 3)
    radius, half = rng.uniform(0.002, 0.004), 0.015
    for _ in range(int(rng.integers(10, 30))):
        heading += rng.normal(0.0, 0.35)
        way = np.array([np.cos(heading), np.sin(heading), 0.0])
        turn = rotation_z(float(heading) - np.pi / 2) @ about_x(np.pi / 2)
        place = make_transform(turn, at + half * way + (0.0, 0.0, radius))
        table.add(CYLINDER, place, np.array([radius, radius, half * 1.1]), UNTOLD)
        at = at + 2 * half * way


def _round_about(table: _Table, half: Floats, azimuth: float, rng: Rng) -> None:
    """Walls and chairs behind the table as the camera sees it."""
    away = -np.array([np.cos(azimuth), np.sin(azimuth)])
    yaw = azimuth + rng.normal(0.0, 0.3)
    if rng.random() < 0.4:
        at = away * (float(np.hypot(*half)) + rng.uniform(0.02, 1.0))
        table.add(BOX, _at(at[0], at[1], 0.5, yaw), np.array([0.02, 3.0, 1.5]), NO_THING)
    if rng.random() < 0.25:
        side = np.array([-away[1], away[0]]) * rng.uniform(-0.3, 0.3)
        at = away * (float(half.max()) + rng.uniform(0.05, 0.3)) + side
        tall, wide = rng.uniform(0.0, 0.35), rng.uniform(0.15, 0.25)
        table.add(BOX, _at(at[0], at[1], tall - 0.1, yaw), np.array([0.015, wide, 0.1]), NO_THING)
        for sign in (-1, 1):
            post = at + sign * wide * np.array([-np.sin(yaw), np.cos(yaw)])
            table.add(
                BOX, _at(post[0], post[1], tall - 0.3, yaw), np.array([0.02, 0.02, 0.35]), NO_THING
            )
    if rng.random() < 0.3:
        _clutter(table, away, float(np.hypot(*half)), rng)
    if rng.random() < 0.15:  # a screen or a rack on the table itself, at its far end
        at = away * (float(half.min()) - rng.uniform(0.03, 0.1))
        tall = rng.uniform(0.1, 0.3)
        size = np.array([rng.uniform(0.01, 0.08), rng.uniform(0.15, 0.4), tall])
        table.add(BOX, _at(at[0], at[1], tall, yaw), size, NO_THING)


def _clutter(table: _Table, away: Floats, beyond_m: float, rng: Rng) -> None:
    """What stands on the floor or on other furniture behind the table: nothing on it is asked."""
    side = np.array([-away[1], away[0]])
    for _ in range(int(rng.integers(1, 7))):
        thing = spun(draw_thing(rng), rng).scaled(rng.uniform(1.0, 4.0))
        reach = float(np.hypot(*np.abs(thing.lattice[:, :2]).max(axis=0)))
        at = away * (beyond_m + reach + rng.uniform(0.0, 0.8)) + side * rng.uniform(-0.8, 0.8)
        table.put(thing, _at(at[0], at[1], rng.uniform(-0.6, 0.3)), NO_THING)


def _hand(table: _Table, eye: Floats, gaze: Floats, rng: Rng) -> None:
    """The robot's own hand between camera and table: a palm, two fingers, a forearm."""
    share = rng.uniform(0.45, 0.8)
    at = eye + share * (gaze - eye) + (*rng.uniform(-0.15, 0.15, 2), rng.uniform(0.0, 0.1))
    if at[2] < 0.2:
        return
    turn = rotation_z(float(rng.uniform(-3, 3))) @ about_x(float(rng.normal(0.0, 0.4)))
    T = make_transform(turn, at)
    for x, z, size in (
        (0.0, 0.0, (0.10, 0.035, 0.03)),
        (-0.05, -0.065, (0.01, 0.012, 0.035)),
        (0.05, -0.065, (0.01, 0.012, 0.035)),
        (0.0, 0.2, (0.045, 0.045, 0.17)),
    ):
        table.add(BOX, T @ _at(x, 0.0, z), np.array(size), NO_THING)
