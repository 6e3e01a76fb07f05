"""What a pose truly holds: areas as geometry has them, and the same however the scene is moved."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import in_matter
from hypothesis import given, settings
from hypothesis import strategies as st

from boxgrasp import Gripper
from boxgrasp.arrays import Floats
from boxgrasp.geometry.transforms import make_transform, rotation_z
from boxgrasp.kernels.raycast import BALL, BOWL, BOX, CONE, CUP, CYLINDER
from boxgrasp.simulate import HoldTruth, Solids, hold_truth
from boxgrasp.simulate.holding import GIVE_M, LEAST_M2, MIDDLE_M, TIP_M
from boxgrasp.simulate.household import about_x
from boxgrasp.simulate.ugly import draw_view

HAND = Gripper()
SLIM = replace(HAND, thickness_m=0.02)
KINDS = (BOX, CYLINDER, CONE, CUP, BALL, BOWL)
M2 = 1e-4  # a square centimeter


def solids(*each: tuple[int, Floats, tuple[float, float, float]]) -> Solids:
    kinds, poses, sizes = zip(*each, strict=True)
    return Solids(np.array(kinds), np.array(poses), np.array(sizes))


def at(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Floats:
    return make_transform(np.eye(3), (x, y, z))


def down(x: float, y: float, tip_z: float, hand: Gripper = HAND) -> Floats:
    """The hand straight down with its fingertips at a height, opening along y."""
    turn = np.array(((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0)))
    return make_transform(turn, (x, y, tip_z + hand.length_m / 2))


def held(target: Solids, T: Floats, hand: Gripper = HAND) -> HoldTruth:
    return hold_truth(target, T[None], gripper=hand)


def told(found: HoldTruth) -> str:
    """What is said of a pose."""
    names = [
        name
        for name in ("holds", "on_air", "by_edge", "touching", "glancing")
        if getattr(found, name)[0]
    ]
    return " ".join(names)


@given(
    st.tuples(*[st.integers(10, 100)] * 2),
    st.integers(-60, 60),
    st.integers(-20, 40),
    st.integers(-5, 5),
)
@settings(deadline=None, max_examples=60)
def test_a_box_is_held_by_the_area_that_it_shares_with_the_pads(
    size_mm: tuple[int, int], x_mm: int, under_mm: int, y_mm: int
) -> None:
    """Edges of whole millimeters lie between the lines, so that the areas are exact."""
    long, wide = 2 * size_mm[0] / 1e3, size_mm[1] / 1e3
    box = solids((BOX, at(z=0.1), (long / 2, wide / 2, 0.1)))
    found = held(box, down(x_mm / 1e3, y_mm / 1e3, 0.2 - under_mm / 1e3))
    tall = np.clip(under_mm / 1e3, 0.0, TIP_M)
    low, high = -long / 2 - x_mm / 1e3, long / 2 - x_mm / 1e3  # in the hand

    def shared(half: float) -> float:
        return tall * max(min(high, half) - max(low, -half), 0.0)

    assert wide / 2 + abs(y_mm) / 1e3 <= HAND.max_opening_m / 2
    assert found.contact_m2[0] == pytest.approx([shared(MIDDLE_M)] * 2, abs=1e-12)
    assert found.middle_m2[0] == pytest.approx(shared(MIDDLE_M), abs=1e-12)
    assert found.between_m2[0] == pytest.approx(shared(HAND.thickness_m / 2), abs=1e-12)
    assert found.inside_m2[0] == 0.0


@pytest.mark.parametrize("radius_m", (0.004, 0.0065, 0.012, 0.03, 0.045))
def test_a_standing_cylinder_is_held_where_it_is_no_deeper_than_a_pad_gives_way(
    radius_m: float,
) -> None:
    can = solids((CYLINDER, at(z=0.1), (radius_m, radius_m, 0.1)))
    found = held(can, down(0.0, 0.01, 0.1))
    half = np.sqrt(radius_m**2 - (radius_m - GIVE_M) ** 2)
    cell = TIP_M * 1.1e-3  # a column of cells each side may be half on it
    assert found.contact_m2[0] == pytest.approx([2 * min(half, MIDDLE_M) * TIP_M] * 2, abs=cell)
    between = 2 * min(radius_m, HAND.thickness_m / 2) * TIP_M
    assert found.between_m2[0] == pytest.approx(between, abs=cell)
    assert told(found) == "holds"


def by_points(
    kind: int, pose: Floats, size: Floats, T: Floats, hand: Gripper
) -> tuple[Floats, float, float, float]:
    """Contacts, middle, between and inside of a solid by points in its equation alone, m2."""
    ys = np.linspace(-hand.width_m / 2, hand.width_m / 2, 1201)

    def matter(start_m: float, stop_m: float, counts: tuple[int, int]) -> tuple[np.ndarray, float]:
        """(X, Z, Y) bool and the area of a cell."""
        x = start_m + (np.arange(counts[0]) + 0.5) / counts[0] * (stop_m - start_m)
        z = ((np.arange(counts[1]) + 0.5) / counts[1] - 0.5) * hand.thickness_m
        places = np.stack(np.meshgrid(x, z, ys, indexing="ij"), -1)
        local = (places[..., [0, 2, 1]] @ T[:3, :3].T + T[:3, 3] - pose[:3, 3]) @ pose[:3, :3]
        within = np.linalg.norm(local, axis=-1) < 0.12
        within[within] = in_matter(kind, size, local[within])
        return within, (stop_m - start_m) * hand.thickness_m / (counts[0] * counts[1])

    end, half = hand.length_m / 2, hand.max_opening_m / 2
    within, cell = matter(end - TIP_M, end, (15, 24))
    filled = (within & (np.abs(ys) < half)).any(axis=2)
    central = np.abs((np.arange(24) + 0.5) / 24 - 0.5) * hand.thickness_m <= MIDDLE_M
    contacts = []
    for own in (within, within[:, :, ::-1]):
        open_ = filled & central & ~own[:, :, np.argmax(ys >= -half)]
        way = np.where(open_, ys[np.argmax(own & (ys >= -half), axis=2)], np.inf)
        contacts.append((open_ & (way <= way.min() + GIVE_M)).sum() * cell)
    middle, between = (filled & central).sum() * cell, filled.sum() * cell
    within, cell = matter(-end, end, (55, 12))
    inside = sum((within & beyond).any(axis=2).sum() for beyond in (ys < -half, ys > half)) * cell
    return np.array(contacts), float(middle), float(between), float(inside)


@given(st.sampled_from(KINDS), st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=30)
def test_any_solid_is_held_as_points_in_its_equation_say(kind: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    size = rng.uniform((0.015, 0.015, 0.02), (0.05, 0.05, 0.08))
    if kind == CYLINDER:
        size[1] = size[0]
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    pose = make_transform(turn * np.sign(np.linalg.det(turn)), rng.uniform(-0.02, 0.02, 3))
    hand = replace(HAND, thickness_m=0.024)
    T = down(*rng.uniform(-0.06, 0.06, 2), float(rng.uniform(-0.04, 0.03)), hand)
    found = held(solids((kind, pose, tuple(size))), T, hand)
    contacts, middle, between, inside = by_points(kind, pose, size, T, hand)
    assert found.middle_m2[0] == pytest.approx(middle, abs=0.15 * M2)
    assert found.between_m2[0] == pytest.approx(between, abs=0.15 * M2)
    # A surface 0.1 mm off may change what is touched on a pad that meets a slope or a corner.
    assert found.contact_m2[0] == pytest.approx(contacts, abs=0.4 * M2)
    assert found.inside_m2[0] == pytest.approx(inside, abs=0.8 * M2)


BOTTLE = solids(
    (CYLINDER, at(z=0.08), (0.05, 0.05, 0.08)),
    (CONE, at(z=0.165), (0.05, 0.013, 0.005)),
    (CYLINDER, at(z=0.185), (0.013, 0.013, 0.015)),
)


@pytest.mark.parametrize(
    ("place", "says"),
    [
        ((0.0, 0.0, 0.18), "holds"),  # round its neck
        ((0.0, 0.0, 0.1), "holds"),  # round its body
        ((0.034, 0.0, 0.1605), "holds glancing"),  # on its shoulder
        ((0.0, 0.0, 0.201), "on_air"),  # over it
        ((0.03, 0.0, 0.172), "by_edge"),  # beside its neck, which the hand's corner meets
        ((0.05, 0.0, 0.172), "on_air"),  # beside its neck, over its shoulder
        ((0.0, 0.03, 0.1), "touching"),  # a finger in its body
        ((0.0, 0.3, 0.1), "on_air"),  # beside it
    ],
)
def test_a_bottle_is_held_by_neck_or_body_but_not_beside(
    place: tuple[float, float, float], says: str
) -> None:
    assert told(held(BOTTLE, down(*place))) == says


def test_one_wall_of_a_hollow_thing_is_held() -> None:
    bowl = solids((CUP, at(z=0.05), (0.11, 0.11, 0.05)))
    pinched = held(bowl, down(0.0, 0.11 - 0.0015, 0.085))
    assert told(pinched) == "holds"
    assert pinched.contact_m2[0] == pytest.approx([3 * M2] * 2)
    filled = solids((CONE, at(z=0.05), (0.11, 0.11, 0.05)))
    assert told(held(filled, down(0.0, 0.11 - 0.0015, 0.085))) == "touching"
    assert told(held(bowl, down(0.0, 0.0, 0.085))) == "on_air"  # the whole hand in the hollow
    cup = solids((CUP, at(z=0.05), (0.04, 0.04, 0.05)))
    assert told(held(cup, down(0.0, 0.04, 0.085, SLIM), SLIM)) == "touching"  # its other wall
    short = replace(SLIM, max_opening_m=0.04, width_m=0.06)  # its fingers go into the cup
    assert told(held(cup, down(0.0, 0.04, 0.085, short), short)) == "holds"


def test_a_handle_is_held_and_the_air_in_it_is_not() -> None:
    mug = solids(
        (CUP, at(z=0.05), (0.04, 0.04, 0.05)),
        (BOX, at(x=0.055, z=0.08), (0.02, 0.004, 0.004)),
        (BOX, at(x=0.055, z=0.03), (0.02, 0.004, 0.004)),
        (BOX, at(x=0.075, z=0.055), (0.004, 0.004, 0.03)),
    )
    side = np.array(((-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, -1.0)))

    def from_the_handle(tip_x: float, z: float) -> Floats:
        return make_transform(side, (tip_x + HAND.length_m / 2, 0.0, z))

    found = held(mug, from_the_handle(0.068, 0.055))
    assert found.contact_m2[0] == pytest.approx([0.008 * 0.02] * 2, abs=0.002 * 0.02)
    assert told(found) == "holds"
    assert told(held(mug, from_the_handle(0.080, 0.055))) == "on_air"


def test_a_leaning_box_is_touched_by_a_strip_as_steep_as_it_leans() -> None:
    lean = 0.4
    box = solids((BOX, make_transform(about_x(lean), (0.0, 0.0, 0.1)), (0.05, 0.01, 0.1)))
    found = held(box, down(0.0, 0.0, 0.09))
    strip = GIVE_M / np.tan(lean) * 2 * MIDDLE_M
    assert found.contact_m2[0] == pytest.approx([strip] * 2, abs=1.1e-3 * 2 * MIDDLE_M)
    assert told(found) == "holds"


def test_a_corner_between_the_pads_is_touched_by_its_edge_alone() -> None:
    post = solids((BOX, make_transform(rotation_z(np.pi / 4), (0.0, 0.0, 0.1)), (0.03, 0.03, 0.1)))
    found = held(post, down(0.0, 0.0, 0.1))
    assert found.contact_m2[0] == pytest.approx([2 * GIVE_M * TIP_M] * 2, abs=1.1e-3 * TIP_M)


@given(st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=30)
def test_moving_turning_and_mirroring_change_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    lean = make_transform(about_x(float(rng.uniform(-0.5, 0.5))), rng.uniform(-0.01, 0.01, 3))
    target = Solids(BOTTLE.kinds, lean @ BOTTLE.T_base_solid, BOTTLE.sizes)
    T = down(*rng.uniform(-0.05, 0.05, 2), float(rng.uniform(0.08, 0.2)))
    found = held(target, T)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    moved = make_transform(turn * np.sign(np.linalg.det(turn)), rng.uniform(-1, 1, 3))
    away = held(Solids(target.kinds, moved @ target.T_base_solid, target.sizes), moved @ T)
    # A line that grazes may fall to either side by rounding: a cell or two.
    assert away.contact_m2[0] == pytest.approx(found.contact_m2[0], abs=0.06 * M2)
    assert away.between_m2[0] == pytest.approx(found.between_m2[0], abs=0.03 * M2)
    assert away.inside_m2[0] == pytest.approx(found.inside_m2[0], abs=0.13 * M2)
    half_turn = make_transform(np.diag((1.0, -1.0, -1.0)), np.zeros(3))
    swapped = held(target, T @ half_turn)  # the fingers change places
    assert swapped.contact_m2[0, ::-1] == pytest.approx(found.contact_m2[0], abs=0.06 * M2)
    flip = np.diag((1.0, -1.0, 1.0, 1.0))  # these solids are their own mirror images in x and y
    mirrored = held(Solids(target.kinds, flip @ target.T_base_solid @ flip, target.sizes),
                    flip @ T @ flip)  # fmt: skip
    assert mirrored.contact_m2[0, ::-1] == pytest.approx(found.contact_m2[0], abs=0.06 * M2)
    assert mirrored.between_m2[0] == pytest.approx(found.between_m2[0], abs=0.03 * M2)


def test_poses_are_judged_one_by_one_and_nothing_holds_nothing() -> None:
    box = solids((BOX, at(z=0.05), (0.02, 0.02, 0.05)))
    poses = np.array([down(0.0, 0.0, 0.09), down(0.0, 0.045, 0.09), down(0.0, 0.0, 0.2)])
    found = hold_truth(box, poses)
    assert found.holds.tolist() == [True, False, False]
    assert found.touching.tolist() == [False, True, False]
    assert found.on_air.tolist() == [False, False, True]
    assert found.by_edge.tolist() == [False, False, False]
    assert not found.contact_m2.flags.writeable and LEAST_M2 > 0
    nothing = Solids(np.empty(0, dtype=np.int32), np.empty((0, 4, 4)), np.empty((0, 3)))
    assert hold_truth(nothing, poses).on_air.all()
    assert hold_truth(box, poses[:0]).contact_m2.shape == (0, 2)


def test_a_view_keeps_the_solids_that_it_shows() -> None:
    rng, shown = np.random.default_rng(2), 0
    for _ in range(6):
        view = draw_view(rng, (96, 128))
        v, u = np.nonzero(view.things > 0)
        depth = view.depth_m[v, u].astype(np.float64)
        rays = np.column_stack([u - view.center_px[0], v - view.center_px[1], 0 * u]) / (
            view.focal_px
        ) + (0.0, 0.0, 1.0)
        T = view.T_table_camera
        places = rays * (depth + 5e-5)[:, None] @ T[:3, :3].T + T[:3, 3]  # just behind a surface
        for thing in np.unique(view.things[v, u]).tolist():
            own, target = places[view.things[v, u] == thing], view.solids_of(thing)
            within = np.zeros(len(own), dtype=bool)
            each = zip(target.kinds, target.T_base_solid, target.sizes, strict=True)
            for kind, pose, size in each:
                within |= in_matter(kind, size, (own - pose[:3, 3]) @ pose[:3, :3])
            assert within.mean() > 0.97  # but where a ray cuts an edge
            shown += len(own)
    assert shown > 2000
