"""Causes of the thesis's spiral scores: what changes nothing gives the baseline exactly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("sklearn", reason="extra train")

from boxgrasp.geometry.transforms import make_transform, rotation_z
from boxgrasp.ranking.sampling import portion, sampling
from boxgrasp.simulate.scenario import Recipe, targets_of
from boxgrasp.study.conditions import (
    READINGS,
    Seen,
    default_miss,
    never_cleared,
    on_world_lattice,
    outermost_first,
    over_box_middle,
    reordered,
    seen_in,
    turned,
    usual,
    world_lattice,
)
from boxgrasp.study.curves import Variant
from boxgrasp.study.evaluation import obstacle_counts
from boxgrasp.study.intervals import NOTHING, Estimate, less, scaled, share
from boxgrasp.study.metrics import ASK
from boxgrasp.study.sections.causes import MAPS, changes, verdict
from boxgrasp.study.trials import Scenes, Trial, mislabeled, picks_of, scores_of
from boxgrasp.teaching.rows import RowConfig, box_of, row_of
from boxgrasp.teaching.samples import sample_points
from boxgrasp.teaching.sets import Rows

FREE, UNSEEN, OCCUPIED = 0, 1, 2
CONFIG = RowConfig(
    Recipe(targets_of("known"), obstacles=(3, 4), noise="none"), 91, target_sources=("given",)
)
POINTS = np.concatenate(sample_points("spiral"))
HELD = {part: (4.0, 0.05) for part in ("single", "face", "side", "top")}


def drawn_rows(count: int, seed: int) -> Rows:
    """Rows whose label follows from the first sample and the height, and clearances from it."""
    rng = np.random.default_rng(seed)
    label = rng.integers(1, 16, count)
    clearance_m = rng.uniform(0.0, 0.1, (count, 15))
    fits = rng.random((count, 15)) < 0.7
    columns = {
        "number": np.arange(count),
        "label": label,
        "target": rng.choice([*targets_of("known"), *targets_of("novel")], count),
        "given_error": np.full(count, ""),
        "given_dimensions_m": np.full((count, 3), 0.1),
        "given_passes": np.ones((count, 15), bool),
        "given_thesis_clearance_m": clearance_m,
        "given_true_fits": fits,
        "true_fits": fits,
        "given_true_plane_clearance_m": np.ones((count, 15)),
        "given_true_approach_clearance_m": np.ones((count, 15)),
        "given_true_clearance_m": clearance_m,
        "true_clearance_m": clearance_m,
        "best_m": clearance_m.max(axis=1),
    }
    for name in ("spiral", "grid"):
        for column, points in zip(("", "_portions"), sample_points(name), strict=True):
            states = rng.choice(3, (count, len(points)), p=(0.8, 0.1, 0.1))
            near = np.arange(len(points)) % 15 == label[:, None] - 1
            columns[f"given_{name}{column}"] = np.where(near, OCCUPIED, states).astype(np.uint8)
    return Rows(columns)


@pytest.fixture(scope="module")
def scenes() -> Scenes:
    """Scenes under conditions that change nothing."""
    labels, tested = drawn_rows(120, 1), drawn_rows(40, 2)
    return Scenes(
        labels, tested, dict.fromkeys(READINGS, labels), dict.fromkeys(READINGS, tested),
        {"strong": tested}, drawn_rows(10, 3), 0.2,
    )  # fmt: skip


@pytest.fixture(scope="module", params=["single", "cascade"])
def trial(scenes: Scenes, request: pytest.FixtureRequest) -> Trial:
    return Trial(scenes, Variant(request.param, "spiral"), HELD, 1)


@pytest.fixture(scope="module")
def third() -> tuple[Seen, dict[str, object]]:
    """The third scene of a set, and its row."""
    row = row_of(CONFIG, 2)
    return seen_in(CONFIG, 2, box_of(row["given_box"], row["given_dimensions_m"])), row


# ---- samples and labels


def test_the_identity_gives_the_baseline_exactly(trial: Trial) -> None:
    (baseline,) = trial.usual.picks
    assert np.array_equal(trial.reordered_picks(lambda points: np.arange(len(points))), baseline)
    assert (trial.usual.picks[0] == trial.scenes.tested["label"] - 1).mean() > 0.4  # it learned
    for picks in trial.permuted_picks:
        assert not np.array_equal(picks, baseline)


@pytest.mark.parametrize("name", ["spiral", "grid"])
def test_an_order_moves_each_sample_and_each_portion_s_within_itself(name: str) -> None:
    rows = drawn_rows(4, 5)
    points = sampling(name)
    backwards = reordered(rows, name, lambda p: np.arange(len(p))[::-1])
    assert np.array_equal(backwards[f"given_{name}"], rows[f"given_{name}"][:, ::-1])
    start = 0
    for face in range(1, 6):
        own = slice(start, start + len(portion(points, face)))
        before, after = (r[f"given_{name}_portions"][:, own] for r in (rows, backwards))
        assert np.array_equal(after, before[:, ::-1])
        start = own.stop
    assert start == rows[f"given_{name}_portions"].shape[1]


def test_outermost_first_keeps_a_layer_s_own_order() -> None:
    order = outermost_first(sampling("spiral"))
    assert order.tolist() == [*range(86, 184), *range(31, 86), *range(6, 31), *range(6)]


@given(st.integers(1, 60), st.floats(0.0, 1.0), st.integers(0, 99))
def test_as_many_labels_as_asked_are_wrong(count: int, part: float, seed: int) -> None:
    label = np.random.default_rng(seed).integers(1, 16, count)
    wrong = mislabeled(label, part, np.random.default_rng(seed))
    assert (wrong != label).sum() == round(part * count)
    assert wrong.min() >= 1 and wrong.max() <= 15


def test_what_changes_nothing_gives_the_baseline(trial: Trial) -> None:
    (baseline,) = trial.usual.picks
    labels = trial.scenes.labels
    unharmed = mislabeled(labels["label"], 0.0, np.random.default_rng(0))
    taught = trial.taught(Rows({**labels.columns, "label": unharmed}))
    assert np.array_equal(picks_of(taught, trial.scenes.tested), baseline)
    causes = {cause for cause, _, _ in MAPS.values()} | {"depth noise"}
    seen = set()
    for change in changes(trial):
        if change.cause in causes:
            seen.add(change.cause)
            assert np.array_equal(change.picks[0], baseline), change
    assert seen == causes


def test_a_random_candidate_scores_the_mean_of_all(trial: Trial) -> None:
    *_, blind, random = changes(trial)
    rows = trial.scenes.tested
    clearance_m, fits = rows["given_thesis_clearance_m"], rows["given_true_fits"]
    green_m = np.minimum(0.06, np.where(fits, clearance_m, 0.0).max(axis=1, keepdims=True))
    score = np.clip((clearance_m - 0.02) / (green_m - 0.02), 0.0, 1.0) ** 2 * fits
    assert np.allclose(random.scores(), score.mean(axis=1))
    assert len(np.unique(blind.picks[0])) == 1  # alike dimensions, and nothing else to tell by


def test_a_face_too_wide_scores_nothing() -> None:
    rows = drawn_rows(3, 7)
    clearance_m = np.tile([0.04, 0.10] + [0.0] * 13, (3, 1))
    fits = np.ones((3, 15), bool)
    fits[1, 0] = False
    rows = Rows({**rows.columns, "given_thesis_clearance_m": clearance_m, "given_true_fits": fits})
    picks = np.array([0, 0, ASK])
    assert np.allclose(scores_of(rows, picks), [0.25, 0.0, np.nan], equal_nan=True)
    assert np.allclose(scores_of(rows, picks, strict=False), [0.25, 0.25, np.nan], equal_nan=True)


# ---- maps of the same scenes


def test_the_usual_map_says_what_the_row_does(third: tuple[Seen, dict[str, object]]) -> None:
    seen, row = third
    whole, portions = np.split(usual(seen, POINTS), [184])
    assert np.array_equal(whole, row["given_spiral"])
    assert np.array_equal(portions, row["given_spiral_portions"])


def test_a_box_on_the_lattice_sees_the_same(third: tuple[Seen, dict[str, object]]) -> None:
    seen, _ = third
    assert not np.array_equal(world_lattice(seen, POINTS), usual(seen, POINTS))
    T_base_cells = on_world_lattice(seen.T_base_map, 0.03)
    off = T_base_cells[:3, 3] / 0.03 - (0, 0, 0.5)
    assert np.allclose(off, np.round(off)) and np.array_equal(T_base_cells[:3, :3], np.eye(3))
    assert np.abs(T_base_cells - seen.T_base_map).max() <= 0.015 + 1e-9
    T_base_box = np.array(seen.box.T_base_box)
    T_base_box[:3, 3] += T_base_cells[:3, 3] - seen.T_base_map[:3, 3]
    moved = replace(seen, box=replace(seen.box, T_base_box=T_base_box))
    assert np.allclose(on_world_lattice(moved.T_base_map, 0.03), moved.T_base_map)
    assert np.array_equal(world_lattice(moved, POINTS), usual(moved, POINTS))


def test_the_lattice_of_the_world_does_not_turn_with_the_box() -> None:
    T = make_transform(rotation_z(0.4), (0.851, -0.004, 0.85))
    assert np.allclose(on_world_lattice(T, 0.03), make_transform(np.eye(3), (0.84, 0.0, 0.855)))


def test_seen_free_once_is_uncertain_with_octomap_s_miss(
    third: tuple[Seen, dict[str, object]],
) -> None:
    before = usual(third[0], POINTS)
    assert (before == FREE).any()
    after = default_miss(third[0], POINTS)
    assert np.array_equal(after, np.where(before == FREE, UNSEEN, before))


def test_what_is_not_seen_now_stays_as_it_was_left(third: tuple[Seen, dict[str, object]]) -> None:
    seen, _ = third
    assert len(seen.earlier) == 2
    expected = np.full(len(POINTS), UNSEEN)
    for number in range(3):
        row = row_of(CONFIG, number)
        scene = seen_in(CONFIG, number, box_of(row["given_box"], row["given_dimensions_m"]))
        now = usual(replace(scene, box=seen.box), POINTS)  # that scene round this one's box
        expected = np.where(now == UNSEEN, expected, now)
    assert (expected != now).any()
    assert np.array_equal(never_cleared(seen, POINTS), expected)
    assert np.array_equal(never_cleared(replace(seen, earlier=()), POINTS), usual(seen, POINTS))


def test_samples_are_moved_as_said(third: tuple[Seen, dict[str, object]]) -> None:
    seen, _ = third
    to_left = np.stack((-POINTS[:, 1], POINTS[:, 0], POINTS[:, 2]), axis=1)
    assert np.array_equal(turned(seen, POINTS, np.pi / 2), usual(seen, to_left))
    from_1 = READINGS["counted-from-1"](seen, sampling("spiral")[:6])
    golden, z = np.pi * (3 - np.sqrt(5)), np.linspace(1 - 1 / 12, 1 / 12, 6)  # the first layer
    angle, r = golden * np.arange(1, 7), np.sqrt(1 - z * z)
    printed = 0.075 * np.stack((r * np.cos(angle), r * np.sin(angle), z), axis=1)
    assert np.array_equal(from_1, usual(seen, printed))
    raised = POINTS + (0.0, 0.0, seen.box.dimensions_m[2] / 2)
    assert np.array_equal(over_box_middle(seen, POINTS), usual(seen, raised))
    assert not np.array_equal(usual(seen, raised), usual(seen, POINTS))


# ---- what is made of it


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (Estimate(-0.05, -0.08, -0.02, 9), "rejected"),
        (Estimate(0.05, 0.01, 0.09, 9), "rejected"),
        (Estimate(-0.06, -0.09, -0.03, 9), "possible"),
        (Estimate(-0.06, -0.14, 0.02, 9), "not clear"),
        (Estimate(0.06, 0.03, 0.09, 9), "the other way"),
        (NOTHING, ""),
    ],
)
def test_verdicts(change: Estimate, said: str) -> None:
    assert verdict(change) == said


def test_a_difference_of_shares_has_newcombe_s_interval() -> None:
    found = less(share(56, 70), share(48, 80))  # Newcombe 1998, table II, example a, method 10
    assert np.allclose((found.value, found.low, found.high), (0.2, 0.0524, 0.3339), atol=5e-5)
    assert less(share(1, 2), NOTHING) == NOTHING == scaled(NOTHING, 0.5)
    half = scaled(share(56, 70), 0.5)
    assert half.value == 0.4 and half.high == share(56, 70).high / 2
    taken = scaled(share(56, 70), -1.0)
    assert (taken.low, taken.high) == (-share(56, 70).high, -share(56, 70).low)


def test_obstacles_are_counted_from_the_scene() -> None:
    scenes = ['{"obstacles": []}', '{"obstacles": [{"name": "a"}, {"name": "b"}]}']
    assert obstacle_counts(Rows({"scene": np.array(scenes)})).tolist() == [0, 2]
