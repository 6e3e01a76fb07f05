"""Things of a household as random solids: cups with handles, bottles, tools, plates, bags, crates.

They teach a network to tell things apart; the study has its own objects (`objects`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Floats
from boxgrasp.forks import cached_property
from boxgrasp.geometry.transforms import make_transform, rotation_z
from boxgrasp.kernels.raycast import BALL, BOWL, BOX, CONE, CUP, CYLINDER
from boxgrasp.simulate.camera import half_size
from boxgrasp.simulate.objects import load_objects

_LATTICE_M = 0.01  # between the points that tell where a thing is
_HANDLE_PIECES = 5

Solid = tuple[int, Floats, Floats]  # kind, T_thing_solid (4, 4), size (3,), m
Rng = np.random.Generator


@dataclass(frozen=True, eq=False)
class Thing:
    """Solids that are one thing, standing with its origin on what carries it.

    Attributes:
        kinds: (P,) int32, of `kernels.raycast`.
        T_thing_solid: (P, 4, 4).
        sizes: (P, 3), as `raycast` takes them, m.
        top_m: height of a flat top that may carry another thing, 0 for none, m.
        hollow: whether small things may stand in it.
    """

    kinds: NDArray[np.int32]
    T_thing_solid: Floats
    sizes: Floats
    top_m: float = 0.0
    hollow: bool = False

    @staticmethod
    def of(solids: list[Solid], top_m: float = 0.0, hollow: bool = False) -> Thing:
        """A thing of solids.

        Args:
            solids: kind, pose and size of each.
            top_m: as `Thing.top_m`.
            hollow: as `Thing.hollow`.

        Returns:
            The thing.
        """
        kinds, poses, sizes = zip(*solids, strict=True)
        return Thing(
            np.array(kinds, dtype=np.int32), np.array(poses), np.array(sizes), top_m, hollow
        )

    def turned(self, rotation: Floats) -> Thing:
        """The thing turned and set down again on its lowest point.

        Args:
            rotation: (3, 3).

        Returns:
            The thing; a tilted one has no flat top, but for a box on its side, and holds nothing.
        """
        poses = make_transform(rotation, np.zeros(3)) @ self.T_thing_solid
        if rotation[2, 2] > 1.0 - 1e-9:
            return Thing(self.kinds, poses, self.sizes, self.top_m, self.hollow)
        tilted = Thing(self.kinds, poses, self.sizes)
        poses[:, 2, 3] -= tilted.lattice[:, 2].min()
        on_side = len(poses) == 1 and self.kinds[0] == BOX and abs(rotation[2, 2]) < 1e-9
        return Thing(self.kinds, poses, self.sizes, 2 * poses[0, 2, 3] if on_side else 0.0)

    def scaled(self, factor: float) -> Thing:
        """The thing, larger or smaller.

        Args:
            factor: of all its lengths.

        Returns:
            The thing.
        """
        poses = self.T_thing_solid.copy()
        poses[:, :3, 3] *= factor
        return Thing(self.kinds, poses, self.sizes * factor, self.top_m * factor, self.hollow)

    @property
    def yaw_rad(self) -> float:
        """Turn of its first solid about z."""
        return float(np.arctan2(self.T_thing_solid[0, 1, 0], self.T_thing_solid[0, 0, 0]))

    @cached_property
    def lattice(self) -> Floats:
        """(N, 3) float64 points that fill the thing, its corners among them, its frame, m."""
        found = []
        for kind, T, size in zip(self.kinds, self.T_thing_solid, self.sizes, strict=True):
            half = half_size(kind, size)
            counts = 2 * np.ceil(half / _LATTICE_M).astype(int) + 1  # the middle is among them
            axes = [np.linspace(-h, h, n) for h, n in zip(half, counts, strict=True)]
            points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
            if kind != BOX:
                points = points[((points[:, :2] / half[:2]) ** 2).sum(axis=1) <= 1.0 + 1e-9]
            if kind in (BALL, BOWL):
                points = points[((points / half) ** 2).sum(axis=1) <= 1.0 + 1e-9]
            found.append(points @ T[:3, :3].T + T[:3, 3])
        return np.vstack(found)


def draw_thing(rng: Rng) -> Thing:
    """A random thing, upright.

    Args:
        rng: draws kind and sizes.

    Returns:
        The thing.
    """
    weights = np.array([weight for _, weight in _KINDS])
    draw, _ = _KINDS[int(rng.choice(len(_KINDS), p=weights / weights.sum()))]
    return draw(rng)


def draw_small(rng: Rng) -> Thing:
    """A random thing that may stand in a cup or bowl.

    Args:
        rng: draws kind and sizes.

    Returns:
        The thing, upright or leaning.
    """
    draw = (_fruit, _thin, _can)[int(rng.integers(3))]
    thing = draw(rng)
    if draw is _thin:
        return thing.turned(about_x(np.pi / 2 + rng.uniform(-0.4, 0.4)))
    return thing.scaled(rng.uniform(0.4, 0.7))


def _at(x: float = 0.0, y: float = 0.0, z: float = 0.0, turn: Floats | None = None) -> Floats:
    return make_transform(np.eye(3) if turn is None else turn, (x, y, z))


def _size(*lengths: float) -> Floats:
    return np.array(lengths, dtype=np.float64)


def about_x(angle_rad: float) -> Floats:
    """A turn about x.

    Args:
        angle_rad: right-handed.

    Returns:
        (3, 3) rotation.
    """
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def about_y(angle_rad: float) -> Floats:
    """A turn about y.

    Args:
        angle_rad: right-handed.

    Returns:
        (3, 3) rotation.
    """
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def _box(rng: Rng) -> Thing:
    half = rng.uniform((0.012, 0.012, 0.008), (0.11, 0.10, 0.13))
    return Thing.of([(BOX, _at(z=half[2]), half)], 2 * half[2])


def _brick(rng: Rng) -> Thing:
    """A box with studs, buttons or lids on it."""
    half = rng.uniform((0.012, 0.025, 0.008), (0.05, 0.08, 0.04))
    solids: list[Solid] = [(BOX, _at(z=half[2]), half)]
    count, stud = int(rng.integers(1, 5)), rng.uniform(0.004, 0.012)
    radius = min(half[0], half[1] / count) * rng.uniform(0.5, 0.9)
    for place in (np.arange(count) + 0.5) / count * 2 - 1:
        at = _at(y=place * half[1], z=2 * half[2] + stud)
        solids.append((CYLINDER, at, _size(radius, radius, stud)))
    return Thing.of(solids)


def _carton(rng: Rng) -> Thing:
    """A cereal box, a book on its edge, a tea box: two sides long, one short."""
    half = _size(rng.uniform(0.02, 0.05), rng.uniform(0.05, 0.11), rng.uniform(0.06, 0.15))
    return Thing.of([(BOX, _at(z=half[2]), half)], 2 * half[2])


def _flat(rng: Rng) -> Thing:
    """A book, a phone, a plate of wood."""
    half = rng.uniform((0.02, 0.03, 0.003), (0.10, 0.14, 0.016))
    return Thing.of([(BOX, _at(z=half[2]), half)], 2 * half[2])


def _thin(rng: Rng) -> Thing:
    """A marker, a spoon, scissors."""
    radius, half = rng.uniform(0.004, 0.010), rng.uniform(0.05, 0.11)
    lying = about_x(np.pi / 2)
    solids: list[Solid] = [(CYLINDER, _at(z=radius, turn=lying), _size(radius, radius, half))]
    if rng.random() < 0.5:  # a head or a second leg
        wide = rng.uniform(0.008, 0.025)
        place = _at(y=half * rng.uniform(0.5, 1.0), z=radius)
        solids.append((BOX, place, _size(wide, rng.uniform(0.01, 0.03), radius)))
    return Thing.of(solids)


def _scissors(rng: Rng) -> Thing:
    """Two crossed bars with rings or grips at one end: scissors, pliers, tongs."""
    half, thick, angle = rng.uniform(0.05, 0.10), rng.uniform(0.004, 0.009), rng.uniform(0.1, 0.4)
    solids: list[Solid] = []
    for sign in (-1, 1):
        turn = rotation_z(sign * angle / 2)
        bar = _size(half, rng.uniform(0.005, 0.012), thick)
        solids.append((BOX, make_transform(turn, (0.0, 0.0, thick)), bar))
        grip = turn @ (-half, 0.0, 0.0) + (0.0, -sign * 0.012, thick)
        radius = rng.uniform(0.012, 0.024)
        solids.append((CYLINDER, make_transform(np.eye(3), grip), _size(radius, radius, thick)))
    return Thing.of(solids)


def _can(rng: Rng) -> Thing:
    radius, half = rng.uniform(0.015, 0.075), rng.uniform(0.02, 0.13)
    return Thing.of([(CYLINDER, _at(z=half), _size(radius, radius, half))], 2 * half)


def _bottle(rng: Rng) -> Thing:
    radius, body = rng.uniform(0.02, 0.05), rng.uniform(0.04, 0.10)
    neck, shoulder, top = radius * rng.uniform(0.25, 0.6), *rng.uniform(0.008, 0.03, 2)
    if rng.random() < 0.3:  # of bleach, of oil: long shoulders beside which a handle comes down
        shoulder *= 2
    solids: list[Solid] = [
        (CYLINDER, _at(z=body), _size(radius, radius, body)),
        (CONE, _at(z=2 * body + shoulder), _size(radius, neck, shoulder)),
        (CYLINDER, _at(z=2 * (body + shoulder) + top), _size(neck, neck, top)),
    ]
    if rng.random() < 0.25:
        solids += _handle(radius * rng.uniform(0.6, 1.0), 2 * (body + shoulder), rng)
    return Thing.of(solids)


def _handle(radius: float, height: float, rng: Rng) -> list[Solid]:
    """A half ring of bars at the side of a cup, x outwards, or a plain bar."""
    reach, wide, thick = rng.uniform(0.02, 0.035), rng.uniform(0.005, 0.009), 0.004
    middle, tall = height * rng.uniform(0.45, 0.6), height * rng.uniform(0.25, 0.38)
    angles = np.linspace(-np.pi / 2, np.pi / 2, _HANDLE_PIECES + 1)
    out, up = radius - 0.003 + reach * np.cos(angles), middle + tall * np.sin(angles)
    ring = np.column_stack([out, up])
    solids: list[Solid] = []
    for (x0, z0), (x1, z1) in zip(ring[:-1], ring[1:], strict=True):
        length = np.hypot(x1 - x0, z1 - z0)
        along = np.array([x1 - x0, 0.0, z1 - z0]) / length
        turn = np.column_stack([np.cross([0.0, 1.0, 0.0], along), [0.0, 1.0, 0.0], along])
        place = _at((x0 + x1) / 2, 0.0, (z0 + z1) / 2, turn)
        solids.append((BOX, place, _size(thick, wide, length / 2 + thick)))
    return solids


def _cup(rng: Rng) -> Thing:
    grown = 1.0 if rng.random() < 0.75 else rng.uniform(1.2, 2.0)  # a jug, a bin
    lower, half = grown * rng.uniform(0.025, 0.05), grown * rng.uniform(0.03, 0.07)
    upper = lower * rng.uniform(0.85, 1.4)
    solids: list[Solid] = [(CUP, _at(z=half), _size(lower, upper, half))]
    if rng.random() < 0.6:
        solids += _handle(max(lower, (lower + upper) / 2), 2 * half, rng)
    return Thing.of(solids, hollow=True)


def _bowl(rng: Rng) -> Thing:
    if rng.random() < 0.5:
        radius = rng.uniform(0.05, 0.12)
        deep = radius * rng.uniform(0.35, 0.9)
        return Thing.of([(BOWL, _at(z=deep), _size(radius, radius, deep))], hollow=True)
    lower, half = rng.uniform(0.03, 0.09), rng.uniform(0.01, 0.045)  # a plate, a pan
    solids: list[Solid] = [(CUP, _at(z=half), _size(lower, lower * rng.uniform(1.1, 2.0), half))]
    if rng.random() < 0.3:
        long = rng.uniform(0.05, 0.1)
        place = _at(x=lower * 1.1 + long, z=2 * half)
        solids.append((BOX, place, _size(long, rng.uniform(0.008, 0.015), 0.005)))
    return Thing.of(solids, hollow=True)


def _fruit(rng: Rng) -> Thing:
    half = rng.uniform(0.02, 0.055) * rng.uniform(0.75, 1.25, 3)
    return Thing.of([(BALL, _at(z=half[2]), half)])


def _bag(rng: Rng) -> Thing:
    """A soft, uneven thing: a bag, a sponge, a toy."""
    solids: list[Solid] = []
    for _ in range(int(rng.integers(3, 7))):
        half = rng.uniform(0.02, 0.06, 3)
        x, y = rng.uniform(-0.05, 0.05, 2)
        solids.append((BALL, _at(x, y, half[2] * rng.uniform(0.6, 1.0)), half))
    return Thing.of(solids)


def _tool(rng: Rng) -> Thing:
    """A drill, a spray bottle, a lamp: a body with parts that stick out of it."""
    half = rng.uniform((0.015, 0.015, 0.04), (0.05, 0.05, 0.11))
    body = (BOX, _at(z=half[2]), half)
    if rng.random() < 0.4:
        body = (CYLINDER, _at(z=half[2]), _size(half[0], half[0], half[2]))
    solids: list[Solid] = [body]
    for _ in range(int(rng.integers(1, 3))):
        part = rng.uniform((0.012, 0.012, 0.012), (0.06, 0.035, 0.05))
        if rng.random() < 0.6:  # on top, reaching out
            place = _at(rng.uniform(-0.8, 0.8) * half[0], 0.0, 2 * half[2] + 0.8 * part[2])
        else:
            side = half[0] + 0.7 * part[0]
            place = _at(side, 0.0, rng.uniform(part[2], max(part[2], 2 * half[2] - part[2])))
        turn = about_x(np.pi / 2) if rng.random() < 0.3 else np.eye(3)
        kind = CYLINDER if rng.random() < 0.3 else BOX
        place[:3, :3] = turn
        solids.append((kind, place, _size(part[0], part[0] if kind else part[1], part[2])))
    return Thing.of(solids)


def _drill(rng: Rng) -> Thing:
    """A cordless drill on its battery: motor and chuck, a slim handle under them, a broad foot."""
    grown = rng.uniform(0.75, 1.2)
    motor, radius = grown * rng.uniform(0.05, 0.09), grown * rng.uniform(0.022, 0.034)
    foot = grown * rng.uniform((0.03, 0.02, 0.010), (0.06, 0.035, 0.03))
    grip = grown * rng.uniform((0.012, 0.012, 0.035), (0.022, 0.018, 0.06))
    chuck = grown * rng.uniform(0.02, 0.045)
    lean, back = float(rng.uniform(-0.25, 0.25)), rng.uniform(-0.5, 0.3) * motor
    up = 2 * (foot[2] + grip[2])
    level = about_y(np.pi / 2)
    nose = back + motor + chuck
    at = _at(z=2 * foot[2] + grip[2], turn=about_y(lean))
    solids: list[Solid] = [
        (BOX, _at(x=rng.uniform(-0.3, 0.5) * foot[0], z=foot[2]), foot),
        (BOX, at, grip * (1.0, 1.0, 1.15)),
        (CONE, _at(x=nose, z=up + radius, turn=level), _size(0.8 * radius, 0.4 * radius, chuck)),
    ]
    if rng.random() < 0.5:
        solids.append(
            (CYLINDER, _at(x=back, z=up + radius, turn=level), _size(radius, radius, motor))
        )
    else:
        solids.append((BOX, _at(x=back, z=up + radius), _size(motor, radius, radius)))
    thing = Thing.of(solids)
    if rng.random() < 0.5:  # on its side
        return thing.turned(about_x(np.pi / 2 + float(rng.normal(0.0, 0.1))))
    return thing


def _tub(rng: Rng) -> Thing:
    """A lunch box, a tin, a tub: a body under a wider lid."""
    half = rng.uniform((0.03, 0.03, 0.012), (0.10, 0.08, 0.06))
    lid, over = rng.uniform(0.002, 0.012), rng.uniform(0.0, 0.006)
    if rng.random() < 0.3:
        radius = half[0]
        solids: list[Solid] = [
            (CONE, _at(z=half[2]), _size(radius * rng.uniform(0.75, 1.0), radius, half[2])),
            (CYLINDER, _at(z=2 * half[2] + lid), _size(radius + over, radius + over, lid)),
        ]
    else:
        solids = [
            (BOX, _at(z=half[2]), half),
            (BOX, _at(z=2 * half[2] + lid), _size(half[0] + over, half[1] + over, lid)),
        ]
    return Thing.of(solids, 2 * (half[2] + lid))


def _crate(rng: Rng) -> Thing:
    """An open box: a tray, a basket, a drawer."""
    x, y, z = rng.uniform((0.05, 0.05, 0.012), (0.12, 0.16, 0.06))
    wall = 0.003
    return Thing.of(
        [
            (BOX, _at(z=wall), _size(x, y, wall)),
            *((BOX, _at(x=s * x, z=z), _size(wall, y, z)) for s in (-1, 1)),
            *((BOX, _at(y=s * y, z=z), _size(x, wall, z)) for s in (-1, 1)),
        ],
        hollow=True,
    )


def _mill(rng: Rng) -> Thing:
    """A turned thing: a vase, a mill, a lamp's foot, a glass on a stem."""
    solids: list[Solid] = []
    z, radius = 0.0, rng.uniform(0.02, 0.05)
    for _ in range(int(rng.integers(2, 5))):
        half, after = rng.uniform(0.006, 0.045), rng.uniform(0.01, 0.05)
        solids.append((CONE, _at(z=z + half), _size(radius, after, half)))
        z, radius = z + 2 * half, after
    return Thing.of(solids)


def _of_the_study(rng: Rng) -> Thing:
    """One of the thesis's simulated objects, each drawn as it is."""
    known = _study_objects()
    return known[int(rng.integers(len(known)))]


@cache
def _study_objects() -> tuple[Thing, ...]:
    found = []
    for item in load_objects().values():
        solids: list[Solid] = []
        for part in item.place(0.0, 0.0, 0.0):
            kind = BOX if type(part).__name__ == "Box" else CYLINDER
            solids.append((kind, np.array(part.T_base_solid), np.array(part.half_size)))
        found.append(Thing.of(solids))
    return tuple(found)


_KINDS: tuple[tuple[Callable[[Rng], Thing], float], ...] = (
    (_box, 4.0),
    (_carton, 1.5),
    (_brick, 0.8),
    (_flat, 1.5),
    (_thin, 1.6),
    (_scissors, 0.5),
    (_can, 2.5),
    (_bottle, 1.5),
    (_cup, 2.8),
    (_bowl, 2.2),
    (_fruit, 0.8),
    (_bag, 0.6),
    (_tool, 2.0),
    (_drill, 1.2),
    (_tub, 1.0),
    (_crate, 0.4),
    (_mill, 0.8),
    (_of_the_study, 3.0),
)


def spun(thing: Thing, rng: Rng) -> Thing:
    """The thing as it may lie about: turned, laid on its side or leaning.

    Args:
        thing: upright.
        rng: draws how.

    Returns:
        The thing, set down.
    """
    roll, chance = 0.0, rng.random()
    if chance < 0.15:
        roll = np.pi / 2
    elif chance < 0.27:
        roll = rng.uniform(-0.5, 0.5)
    about = rotation_z(float(rng.uniform(-np.pi, np.pi)))
    return thing.turned(about if roll == 0.0 else about @ about_x(roll))
