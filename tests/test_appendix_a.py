"""Appendix A's stages against naive versions, and what the study counts of them."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("scipy", reason="extra train")
pytest.importorskip("pyarrow", reason="extra train")

from boxgrasp.errors import SceneError
from boxgrasp.simulate.scenario import Recipe
from boxgrasp.study import appendix_a, appendix_rows
from boxgrasp.study.appendix_a import AppendixParams
from boxgrasp.study.sections import appendix_a as section
from boxgrasp.teaching.rows import RowConfig, row_of, scenario_of_row
from boxgrasp.teaching.sets import Rows

PARAMS = AppendixParams()


def cloud(count, seed, reach_m):
    """Points on a coarse lattice, so that some are the same and many are as far apart."""
    cells = np.random.default_rng(seed).integers(-12, 13, (count, 3))
    return (cells * (reach_m / 12)).astype(np.float32)


SEEDS = st.integers(0, 2**32 - 1)
CLOUDS = st.builds(cloud, st.integers(1, 40), SEEDS, st.just(0.125))


def block(low, high, step=0.004):
    """Points on the upper and the near side of an upright block; z up, the robot at x < 0."""
    x, y, z = (np.arange(a, b, step) for a, b in zip(low, high, strict=True))
    top = np.stack([a.ravel() for a in np.meshgrid(x, y, [high[2]])], axis=1)
    near = np.stack([a.ravel() for a in np.meshgrid([low[0]], y, z)], axis=1)
    return np.concatenate((top, near))


def looked_down_on(points, distance_m=0.9):
    """The same in a camera's frame that looks straight down from over the middle."""
    return np.column_stack((points[:, 1], points[:, 0], distance_m - points[:, 2])).astype("f4")


TABLE = np.array(
    [(x, y, 0.0) for x in np.arange(-0.2, 0.2, 0.005) for y in np.arange(-0.2, 0.2, 0.005)]
)
FIRST, SECOND = block((0, 0, 0.02), (0.05, 0.05, 0.1)), block((0.09, 0, 0.02), (0.14, 0.05, 0.1))
STRAY, FLOOR = (
    np.array([[0.0, -0.15, 0.3]]),
    np.array([[0.6, y, -0.75] for y in np.arange(0, 0.5, 0.01)]),
)
PARTS = (TABLE, FIRST, SECOND, STRAY, FLOOR)
OF = np.repeat(np.arange(len(PARTS)), [len(part) for part in PARTS])
SCENE = looked_down_on(np.concatenate(PARTS))


@given(st.builds(cloud, st.just(40), SEEDS, st.just(1.5)))
def test_pass_through_is_by_distance(points):
    naive = [0.4 <= sum(float(v) ** 2 for v in p) ** 0.5 <= 1.6 for p in points]
    assert appendix_a.passed_through(points, PARAMS).tolist() == naive


def test_pass_through_is_not_by_depth():
    aside = np.array([[0.3, 0.0, 0.35], [1.2, 0.0, 1.2]], np.float32)
    assert appendix_a.passed_through(aside, PARAMS).tolist() == [True, False]


@settings(deadline=None, max_examples=40)
@given(CLOUDS, st.integers(1, 50), st.floats(0.5, 3.0))
def test_trimming_is_pcls_rule(points, neighbors, deviations):
    if len(points) < 3:
        assert appendix_a.inliers(points, neighbors, deviations).all()
        return
    means = []
    for k, point in enumerate(points.astype(float)):
        others = np.delete(points.astype(float), k, axis=0)
        away = sorted(float(np.linalg.norm(other - point)) for other in others)[:neighbors]
        means.append(sum(away) / len(away))
    middle = sum(means) / len(means)
    deviation = (sum((m - middle) ** 2 for m in means) / (len(means) - 1)) ** 0.5
    limit = middle + deviations * deviation
    clear = np.abs(np.array(means) - limit) > 1e-9
    found = appendix_a.inliers(points, neighbors, deviations)
    assert (found == (np.array(means) <= limit))[clear].all()


@settings(deadline=None, max_examples=40)
@given(CLOUDS, st.integers(1, 4))
def test_clusters_are_what_a_walk_from_point_to_point_reaches(points, fewest):
    params = AppendixParams(tolerance_m=0.03, fewest=fewest)
    gaps = np.linalg.norm(points[:, None].astype(float) - points[None].astype(float), axis=2)
    if (np.abs(gaps - params.tolerance_m) < 1e-6).any():
        return
    naive = np.full(len(points), -1)
    for start in range(len(points)):
        reached, edge = {start}, [start]
        while edge:
            near = set(np.flatnonzero(gaps[edge.pop()] < params.tolerance_m).tolist()) - reached
            reached |= near
            edge += near
        naive[start] = min(reached) if len(reached) >= fewest else -1
    found = appendix_a.clusters_of(points, params)
    assert ((found == -1) == (naive == -1)).all()
    kept = found >= 0
    same = found[kept][:, None] == found[kept][None]
    assert (same == (naive[kept][:, None] == naive[kept][None])).all()


@settings(deadline=None, max_examples=30)
@given(st.floats(-0.5, 0.5), st.floats(0.2, 1.0), SEEDS)
def test_main_plane_is_the_one_that_holds_most(tilt, distance_m, seed):
    rng = np.random.default_rng(seed)
    across = rng.uniform(-0.4, 0.4, (600, 2))
    normal = np.array([0.0, np.sin(tilt), -np.cos(tilt)])  # towards the camera
    along = np.cross(normal, (1.0, 0.0, 0.0))
    on = across[:, :1] * (1.0, 0.0, 0.0) + across[:, 1:] * along - distance_m * normal
    on += rng.normal(0.0, 0.002, (600, 1)) * normal
    points = np.concatenate((on, rng.uniform(-1, 1, (250, 3)))).astype(np.float32)
    plane = appendix_a.main_plane(points, PARAMS)
    assert plane.normal @ normal > np.cos(np.deg2rad(1.0))
    assert plane.offset_m == pytest.approx(distance_m, abs=0.004)


@pytest.mark.parametrize(
    "points",
    [np.zeros((5, 3)), np.linspace((0, 0, 0.5), (0, 0, 1), 40)],
    ids=["one place", "one line"],
)
def test_no_plane_through_a_place_or_a_line(points):
    with pytest.raises(SceneError, match="^no plane in range holds enough points; valid: "):
        appendix_a.main_plane(points.astype(np.float32), PARAMS)


def test_stages_of_a_scene_that_was_laid_out():
    stages = appendix_a.segmented(SCENE)
    assert (stages.voxel_of[OF == 4] == -1).all()  # the floor is beyond 1.6 m
    assert (stages.voxel_of[OF < 4] >= 0).all()
    for k in range(0, len(stages.points), 9):
        mean = SCENE[stages.voxel_of == k].astype(float).mean(axis=0)
        assert stages.points[k] == pytest.approx(mean, abs=1e-6)
        assert np.ptp(SCENE[stages.voxel_of == k], axis=0).max() <= PARAMS.voxel_m + 1e-6
    part_of = np.zeros(len(stages.points), int)
    part_of[stages.voxel_of[OF < 4]] = OF[OF < 4]
    assert stages.on_plane[part_of == 0].all() and not stages.on_plane[part_of > 0].any()
    assert not stages.kept[part_of == 3].any() and not stages.kept[part_of == 0].any()
    assert 0 < stages.table_kept.sum() < (part_of == 0).sum()
    assert not stages.table_kept[part_of > 0].any()
    kept = stages.clusters >= 0
    first, second = (set(stages.clusters[kept & (part_of == k)].tolist()) for k in (1, 2))
    assert len(first) == len(second) == 1 and first != second
    chosen = appendix_a.cluster_with(stages.clusters, part_of == 1)
    assert chosen.any() and (part_of[chosen] == 1).all()


def test_things_nearer_than_the_tolerance_come_out_as_one():
    near = SCENE[OF != 2]
    moved = looked_down_on(block((0.06, 0, 0.02), (0.11, 0.05, 0.1)))
    stages = appendix_a.segmented(np.concatenate((near, moved)))
    assert set(stages.clusters[stages.clusters >= 0].tolist()) == {0}


def test_nothing_in_range_is_said_in_one_line():
    with pytest.raises(SceneError, match=r"^no point lies 0\.4 to 1\.6 m from the camera; valid: "):
        appendix_a.segmented(np.full((4, 3), 2.0, np.float32))


def test_no_cluster_is_chosen_where_none_has_the_target():
    clusters = np.array([-1, 0, 0, 1, 1, 1])
    wanted = np.array([True, False, False, False, False, False])
    assert not appendix_a.cluster_with(clusters, wanted).any()
    wanted[[2, 3, 4]] = True
    assert appendix_a.cluster_with(clusters, wanted).tolist() == [False] * 3 + [True] * 3


CONFIG = RowConfig(Recipe(("cereal_y",), noise="none", obstacles=(1, 1)), 5, runs=2)


@pytest.fixture(scope="module")
def columns():
    parts = [appendix_rows.appendix_part((CONFIG, range(k, k + 1))) for k in (0, 1)]
    return appendix_rows.read_appendix(parts)


def test_rows_hold_what_the_stages_and_the_rows_of_a_set_say(columns):
    assert {len(column) for column in columns.values()} == {4}
    counts = columns["appendix_points"]
    view, in_range, voxels, table, table_kept, rest, kept, clustered = counts.T
    assert (view >= in_range).all() and (in_range > voxels).all()
    assert (table + rest == voxels).all() and (rest > kept).all() and (kept >= clustered).all()
    assert (table_kept < table).all() and (table_kept >= 0).tolist() == [True, False] * 2
    for number in (0, 1):
        own = row_of(CONFIG, 2 * number)
        k = 2 * number
        assert columns["exact_dimensions_m"][k] == pytest.approx(own["true_dimensions_m"])
        assert columns["exact_box"][k] == pytest.approx(own["true_box"])
        assert columns["exact_true_clearance_m"][k] == pytest.approx(own["true_clearance_m"])
        # All the target's points, before any stage, make the box of given points.
        seen_m = own["true_dimensions_m"] - columns["appendix_short_m"][k, 0]
        assert seen_m == pytest.approx(own["given_dimensions_m"], abs=0.006)
        last_m = own["true_dimensions_m"] - columns["appendix_short_m"][k, -1]
        assert columns["appendix_dimensions_m"][k] == pytest.approx(last_m)
        # Of nearly the same box in the same view nearly every sample says the same.
        if np.abs(columns["appendix_box"][k] - own["given_box"]).max() < 0.002:
            assert (columns["appendix_grid"][k] == own["given_grid"]).mean() > 0.9


def test_a_box_of_too_few_points_is_none():
    view = appendix_rows.segmented_view(scenario_of_row(CONFIG, 0), "none", 0)
    assert view.box(view.points[:2]) is None
    assert view.box(view.points[view.seen]) is not None


def made_up(short_cm, picks, exact_picks):
    """Views of one scene, R of them, whose box lacks so much along x, and how they are decided."""
    runs = len(picks)
    short_m = np.zeros((runs, 5, 3))
    short_m[:, -1, 0] = np.array(short_cm) / 100
    rows = Rows(
        {
            "number": np.zeros(runs, int),
            "appendix_short_m": short_m,
            "appendix_moved_m": short_m / 2,
            "appendix_foreign": np.zeros(runs),
            "appendix_error": np.full(runs, ""),
        }
    )
    evaluation = SimpleNamespace(
        rows=rows, picks=lambda ranker, source: np.array(picks), model_sets={section.CASCADE: None}
    )
    views = section._Views(evaluation, runs)
    return views, np.array(exact_picks)


@pytest.mark.parametrize(
    ("short_cm", "picks", "exact_picks", "misled", "changed"),
    [
        ((0, 0, 2), (4, 4, 9), (4, 4, 4), [2], [0]),
        ((0, 0, 1), (4, 4, 9), (4, 4, 4), [], []),  # the box is right
        ((0, 0, 2), (4, 4, 9), (4, 4, 9), [], []),  # it is decided so in the true box, too
        ((0, 0, 2), (4, 4, 4), (4, 4, 4), [], []),  # nothing changes
        ((0, 0, 2), (4, 4, 4), (9, 9, 9), [2], []),  # neither does it here
        ((2, 2, 2), (4, 4, 9), (4, 4, 4), [2], []),  # no run's box is right
        ((0, 0, 2), (4, 4, -1), (4, 4, 4), [], []),  # lost
    ],
)
def test_figure_5_6_is_a_decision_that_a_box_too_short_misled(
    monkeypatch, short_cm, picks, exact_picks, misled, changed
):
    views, exact = made_up(short_cm, picks, exact_picks)
    monkeypatch.setattr(section, "model_order", lambda model_set, rows, source: exact[:, None])
    assert np.flatnonzero(section.misled_views(views)).tolist() == misled
    assert section.changed_by_the_box(views) == changed


def test_each_view_has_one_fate():
    views, _ = made_up((0, 1.4, 1.6, -1.6, 5, 2), range(6), range(6))
    views.rows.columns["appendix_foreign"][4] = 0.06
    columns = dict(views.rows.columns)
    columns["appendix_error"] = np.array([""] * 5 + ["no cluster has the target"])
    views = section._Views(SimpleNamespace(rows=Rows(columns)), views.runs)
    names = [section.FATES[k] for k in section.fates(views)]
    assert names == ["whole", "whole", "too short", "otherwise wrong", "merged", "lost"]
