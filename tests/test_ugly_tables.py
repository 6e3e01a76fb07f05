"""Ugly tables: shells are hit where geometry says, things stand apart, sensors do what they do."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import in_matter
from hypothesis import example, given, settings
from hypothesis import strategies as st

from boxgrasp.kernels.raycast import BALL, BOWL, BOX, CONE, CUP, round_hit
from boxgrasp.simulate.household import Thing, draw_thing, spun
from boxgrasp.simulate.sensors import sensed
from boxgrasp.simulate.ugly import NO_THING, UNTOLD, draw_view

SHAPE = (144, 192)


@settings(deadline=None, max_examples=200)
@example(BOWL, 233727)  # onto the rim, between the shells
@given(st.sampled_from((CONE, CUP, BALL, BOWL)), st.integers(0, 2**32 - 1))
def test_a_ray_meets_round_solids_where_their_equation_says(kind: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    size = rng.uniform(0.02, 0.08, 3)
    origin = rng.normal(size=3)
    origin *= 0.4 / np.linalg.norm(origin)
    direction = rng.uniform(-0.06, 0.06, 3) - origin
    found = round_hit(kind, size, origin, direction)
    steps = np.linspace(0.0, 2.0, 40_001)  # 0.02 mm apart
    within = in_matter(kind, size, origin + steps[:, None] * direction)
    if not within.any():
        # At most a corner is cut, of less than a step.
        assert (
            np.isinf(found)
            or in_matter(
                kind, size, origin + (found + np.linspace(-1e-4, 1e-4, 21))[:, None] * direction
            ).sum()
            <= 4
        )
        return
    assert found == pytest.approx(steps[np.argmax(within)], abs=2e-4)


@pytest.mark.parametrize("seed", range(40))
def test_a_thing_stands_on_what_carries_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    upright = draw_thing(rng)
    for thing in (upright, spun(upright, rng)):
        lowest = thing.lattice[:, 2].min()
        assert lowest == pytest.approx(0.0, abs=2e-3) or thing.kinds[0] != BOX and lowest < 2e-3
        assert np.ptp(thing.lattice, axis=0).max() < 1.2
        assert thing.top_m <= thing.lattice[:, 2].max() + 1e-9
    turned = Thing(upright.kinds, upright.T_thing_solid, upright.sizes, upright.top_m)
    np.testing.assert_allclose(turned.turned(np.eye(3)).T_thing_solid, upright.T_thing_solid)


def test_views_are_full_of_different_things() -> None:
    rng = np.random.default_rng(3)
    views = [draw_view(rng, SHAPE) for _ in range(40)]
    shares = [np.mean(view.things > NO_THING) for view in views]
    assert 0.05 < np.mean(shares) < 0.6
    assert np.mean([len(np.unique(v.things[v.things > 0])) for v in views]) > 3
    assert any((view.things == UNTOLD).any() for view in views)
    for view in views:
        assert view.depth_m.dtype == np.float32 and np.isfinite(view.depth_m).all()
        assert (view.things[view.depth_m == 0] == NO_THING).all()
        # What is a thing lies over some table, what is none may lie anywhere.
        v, u = np.nonzero(view.things > 0)
        z = view.depth_m[v, u]
        rays = np.stack([(u - view.center_px[0]), (v - view.center_px[1]), 0 * u], 1)
        points = np.column_stack([rays[:, :2] / view.focal_px * z[:, None], z])
        height = points @ view.T_table_camera[2, :3] + view.T_table_camera[2, 3]
        assert len(height) == 0 or height.min() > -2e-3


def test_the_same_seed_gives_the_same_view_and_measurement() -> None:
    for _ in range(2):
        one, two = (np.random.default_rng(11) for _ in range(2))
        first, second = draw_view(one, SHAPE), draw_view(two, SHAPE)
        np.testing.assert_array_equal(first.depth_m, second.depth_m)
        for a, b in zip(
            sensed(first.depth_m, first.things, first.focal_px, one),
            sensed(second.depth_m, second.things, second.focal_px, two),
            strict=True,
        ):
            np.testing.assert_array_equal(a, b)


def test_sensors_leave_most_of_a_surface_and_lose_some_of_an_outline() -> None:
    depth = np.full(SHAPE, 1.0, dtype=np.float32)
    depth[40:100, 60:120] = 0.8
    inner = np.zeros(SHAPE, dtype=np.bool_)
    inner[50:90, 70:110] = True
    lost, off = [], []
    for seed in range(60):
        found, edge = sensed(
            depth, np.zeros(SHAPE, dtype=np.int32), 500.0, np.random.default_rng(seed)
        )
        assert found.dtype == np.float32 and (found >= 0).all()
        assert edge[40, 60:120].all() and not edge[inner].any()
        seen = inner & (found > 0)
        lost.append(1 - seen.sum() / inner.sum())
        off.append(float(np.abs(found[seen] - 0.8).mean()))
    assert np.mean(lost) < 0.1 and max(off) < 0.03
    assert np.mean(off) > 0.0005
