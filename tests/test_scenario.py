"""Scenarios: same from the seed, granted wishes, mirror images, truth beside."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from boxgrasp.errors import SceneError
from boxgrasp.simulate.scenario import (
    NOISES,
    Recipe,
    draw_scenario,
    mirrored,
    scenario_of,
    targets_of,
)  # fmt: skip
from boxgrasp.simulate.scenes import build_scene

ALL = Recipe(targets_of("all"))
TIGHT = Recipe(targets_of("all"), obstacles=(4, 4))


def test_a_scenario_depends_on_its_seed_and_number_alone() -> None:
    late = draw_scenario(ALL, 3, 5)
    for number in range(5):
        draw_scenario(ALL, 3, number)
    again = draw_scenario(ALL, 3, 5)
    assert late.scene.spec == again.scene.spec
    assert np.array_equal(late.truth.clearance_m, again.truth.clearance_m)
    assert draw_scenario(ALL, 4, 5).scene.spec != late.scene.spec
    one, two = late.capture("xtion")[0], again.capture("xtion")[0]
    assert np.array_equal(one.depth, two.depth)
    assert not np.array_equal(one.depth, late.capture("xtion", run=1)[0].depth)


def test_targets_take_turns() -> None:
    names = [draw_scenario(ALL, 1, number).target for number in range(16)]
    assert names == [*ALL.targets, *ALL.targets]


def test_the_sets_have_the_thesis_s_targets() -> None:
    assert len(targets_of("known")) == 4
    assert len(targets_of("novel")) == 4
    assert len(targets_of("real", "real")) == 5
    with pytest.raises(SceneError, match="real"):
        targets_of("real")


def test_every_number_of_a_pose_is_a_tenth_of_a_millimeter() -> None:
    for number in range(4):
        spec = draw_scenario(ALL, 9, number).scene.spec
        for item in (spec["target"], *spec["obstacles"]):
            for name in ("x", "y", "z", "yaw"):
                assert item[name] == round(item[name], 4)


@pytest.mark.parametrize("number", range(6))
def test_a_feasible_scene_has_an_candidate_that_a_hand_could_take(number: int) -> None:
    truth = draw_scenario(TIGHT, 2, number).truth
    assert any(
        fits and clear >= 0.02 and support > 0 and approach > 0
        for fits, clear, support, approach in zip(
            truth.fits,
            truth.clearance_m,
            truth.plane_clearance_m,
            truth.approach_clearance_m,
            strict=True,
        )
    )


@pytest.mark.parametrize("number", range(4))
def test_the_off_center_need_is_as_the_thesis_words_it(number: int) -> None:
    truth = draw_scenario(replace(TIGHT, wish="off-center"), 2, number).truth
    feasible = {
        (k // 3, k % 3): truth.clearance_m[k]
        for k in range(15)
        if truth.fits[k] and truth.clearance_m[k] >= 0.02
    }
    assert len({face for face, _ in feasible}) == 1
    best = max(feasible, key=lambda candidate: feasible[candidate])
    assert best[1] != 1


@pytest.mark.parametrize("number", range(3))
def test_the_stricter_need_leaves_no_central_line(number: int) -> None:
    truth = draw_scenario(replace(TIGHT, wish="no-central"), 2, number).truth
    valid = truth.valid & (truth.clearance_m >= 0.02)
    assert valid.any()
    assert not valid[1::3].any()


def test_any_scene_may_be_kept() -> None:
    hopeless = replace(TIGHT, wish="any", area_m=0.34)
    best = [draw_scenario(hopeless, 5, number).truth.best_m for number in range(60)]
    assert min(best) < 0.02


def test_a_mirrored_scene_exchanges_left_and_right() -> None:
    scene = draw_scenario(TIGHT, 8, 0)
    other = scenario_of(build_scene(mirrored(scene.scene.spec)), 8, 0)
    clear = scene.truth.clearance_m.reshape(5, 3)
    flipped = other.truth.clearance_m.reshape(5, 3)
    assert np.allclose(flipped[[2, 1, 0, 3]], clear[[0, 1, 2, 3]], atol=1e-6)
    assert np.allclose(flipped[4], clear[4, ::-1], atol=1e-6)
    again = mirrored(mirrored(scene.scene.spec))
    assert json.dumps(again, sort_keys=True) == json.dumps(dict(scene.scene.spec), sort_keys=True)


def test_noises_grow_and_can_be_switched_off() -> None:
    scenario = draw_scenario(ALL, 1, 0)
    exact = scenario.scene.view().depth
    off = {}
    for name in NOISES:
        depth = scenario.capture(name)[0].depth
        assert depth is not None
        both = (depth > 0) & (exact > 0)
        off[name] = float(np.abs(depth - exact)[both].mean())
    assert off["none"] == 0.0
    assert off["none"] < off["xtion"] < off["strong"]


@pytest.mark.parametrize(
    "wrong",
    [{"targets": ()}, {"noise": "loud"}, {"wish": "easy"}],
)
def test_a_wrong_recipe_says_what_is_valid(wrong: dict[str, object]) -> None:
    with pytest.raises(SceneError, match="valid"):
        replace(ALL, **wrong)  # type: ignore[arg-type]


def test_what_cannot_be_drawn_is_said() -> None:
    with pytest.raises(SceneError, match="200 draws"):
        draw_scenario(replace(ALL, obstacles=(0, 0), wish="off-center"), 1, 0)
