"""Drawn scenes are the rows' own, found by the rules they state, and no picture stands for none."""

from __future__ import annotations

import io
import re
from collections.abc import Mapping

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("onnxruntime", reason="extra svm")
pytest.importorskip("pyarrow", reason="extra train")
pytest.importorskip("PIL", reason="extra draw")

from boxgrasp.draw.shapes import corners
from boxgrasp.execution import Store, local_workers
from boxgrasp.geometry.transforms import invert, make_transform, transform
from boxgrasp.grasps.gripper import Gripper
from boxgrasp.grasps.scoring import CATEGORIES
from boxgrasp.mapping.local_map import OCCUPIED, LocalMap
from boxgrasp.ranking.model_set import ModelSet
from boxgrasp.ranking.onnx import model
from boxgrasp.ranking.sampling import RESOLUTION_M, sampling
from boxgrasp.study.evaluation import Evaluation, model_sets_in
from boxgrasp.study.plots import scenes
from boxgrasp.study.plots.scenes import Heading, Panel, stacked
from boxgrasp.study.report import Picture
from boxgrasp.study.sections import alike, figures_method
from boxgrasp.study.sections.drawn import Found, category_of, drawn, pick_panel
from boxgrasp.study.sections.figures_discussion import discussion_section
from boxgrasp.study.sections.figures_method import three_categories
from boxgrasp.study.sections.figures_results import decisions_section
from boxgrasp.study.seen import Seen, counted, see_row
from boxgrasp.study.study import Scale, Study
from boxgrasp.teaching.samples import states_at
from boxgrasp.teaching.sets import make_set

FIGURES = (
    "2-1", "2-2", "2-3", "2-4", "2-5-scene", "2-15", "3-6", "3-11", "3-13", "4-5", "4-7", "5-1",
    "5-2a", "5-2b", "5-4", "5-5", "5-7", "5-8",
)  # fmt: skip
STAGES = FIGURES[:7]
SCALE = Scale(
    labels=8, tested=8, first=8, need=1, central=1, real=2, ad_hoc=1, runs=2, fused=1
)  # fmt: skip


class Shipped(Study):
    """A study that decides with the models that ship, so that nothing is trained."""

    @property
    def model_sets(self) -> Mapping[str, ModelSet]:  # type: ignore[override]
        return model_sets_in(Store(model.SHIPPED))


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Study:
    """A tiny study, cast without the sets that no picture is of."""
    store = Store(tmp_path_factory.mktemp("figures"))
    with local_workers(1) as workers:
        found = Shipped(store, workers, 3, SCALE)
        for name in ("labels", "tested", "need", "ad-hoc", "real"):
            make_set(store, f"sets/{name}/", found.sets()[name], workers, "")
    return found


@pytest.fixture(scope="module")
def evaluation(study: Study) -> Evaluation:
    return study.evaluation("tested")


@pytest.fixture(scope="module")
def seen(study: Study) -> Seen:
    return see_row(study, "real", 3)


def brute_m(seen: Seen, T_base_gripper: np.ndarray) -> float:
    """Distance of the hand's box to the visible obstacles by numpy, m."""
    local = transform(invert(T_base_gripper), seen.obstacle_points)
    beyond = np.maximum(np.abs(local) - Gripper().half_m, 0.0)
    return float(np.linalg.norm(beyond, axis=1).min())


def pixels(png: bytes) -> np.ndarray:
    from PIL import Image

    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB"))


def test_a_scene_cast_again_is_the_row_s_own(study: Study) -> None:
    rows = study.rows("real")
    depths = []
    for k in range(rows.count):
        seen = see_row(study, "real", k)
        depths.append(seen.capture.depth)
        for name in ("grid", "spiral"):
            states = states_at(seen.local_map(RESOLUTION_M[name]), sampling(name))
            assert np.array_equal(states, rows[f"given_{name}"][k])
        for candidate in seen.candidates():
            distance_m, point = seen.nearest_obstacle(candidate)
            assert distance_m == rows["given_thesis_clearance_m"][k, candidate.label - 1]
            least_m = min(0.5, brute_m(seen, candidate.T_base_gripper))
            assert distance_m == pytest.approx(least_m, abs=1e-6)
            assert (point is None) == (distance_m == 0.5)
    assert len(depths) == 4
    assert not np.array_equal(depths[0], depths[1])  # one scene, its noise drawn anew


def test_every_figure_of_a_scene_is_drawn_or_says_why_not(
    study: Study, monkeypatch: pytest.MonkeyPatch
) -> None:
    # So few scenes may have no lamp; a scene without one has the same steps.
    monkeypatch.setattr(
        figures_method, "lamps_and_obstacles", lambda rows: (np.ones(rows.count, bool), 3)
    )
    sections = [
        figures_method.method_section(study), decisions_section(study), discussion_section(study),
    ]  # fmt: skip
    pictures = [picture for section in sections for picture in section.pictures]
    words = " ".join(text for section in sections for text in section.words)
    for figure in FIGURES:
        shown = any(re.fullmatch(f"figure-{figure}[ab]?", item.name) for item in pictures)
        explained = f"Figure {figure} is not drawn: " in words
        assert shown != explained, figure
    for picture in pictures:
        assert re.search(r"\d of \d|As figure 2-1|boxes of", picture.caption), picture.name
        assert pixels(picture.png or b"").shape[1] == scenes.WIDTH_PX
    assert {f"figure-{figure}" for figure in STAGES} <= {item.name for item in pictures}


def test_the_ring_of_d_lies_on_the_obstacle_that_is_nearest(seen: Seen) -> None:
    candidate = max(seen.candidates(), key=lambda item: seen.nearest_obstacle(item)[0])
    point = seen.nearest_obstacle(candidate)[1]
    assert point is not None
    panel = Panel(seen, Heading("d"), [point[None]])
    at = panel.view.point(point)
    assert at is not None and 0 <= at[0] < scenes.WIDTH_PX and 0 <= at[1] < scenes.HEIGHT_PX
    before = np.asarray(panel.canvas.finish()).astype(int)
    after = np.asarray(panel.gap(candidate).canvas.finish()).astype(int)
    changed = np.argwhere(np.abs(after - before).sum(axis=2) > 60)
    ring = changed[np.hypot(changed[:, 1] - at[0], changed[:, 0] - at[1]) < 14]
    assert ring.mean(axis=0) == pytest.approx((at[1], at[0]), abs=4)


def test_a_near_cell_hides_a_far_one_and_sides_are_darker(seen: Seen) -> None:
    values = np.zeros((2, 1, 2), np.float32)
    values[:, 0, 0] = 3.0  # two low cells, the nearer before the other one
    local_map = LocalMap(
        make_transform(np.eye(3), seen.box.base_center_m), 0.1, np.array((-0.1, -0.05, 0.0)),
        values, values > 0,
    )  # fmt: skip
    panel = Panel(seen, Heading("cells"))
    centers = local_map.cells(OCCUPIED)
    red, blue = (200.0, 0.0, 0.0), (0.0, 0.0, 200.0)
    scenes.cubes(panel.canvas, panel.view, local_map, (centers, np.array((red, blue))), 255)
    image = np.asarray(panel.canvas.finish()).astype(int)
    front = transform(local_map.T_base_map, centers[:1] - (0.05, 0.0, 0.0))[0]
    x, y = panel.view.point(front) or (0.0, 0.0)
    side = image[round(y), round(x)]
    top = panel.view.point(transform(local_map.T_base_map, centers[:1] + (0, 0, 0.05))[0]) or (0, 0)
    lid = image[round(top[1]), round(top[0])]
    assert side[0] > 100 and side[2] < 60 and lid[0] > side[0]


def test_panels_lie_under_each_other_and_marks_keep_their_colors(seen: Seen) -> None:
    panels = [Panel(seen, Heading(f"one {word}\ntwo", word), height_px=100) for word in CATEGORIES]
    found = pixels(stacked(panels))
    assert found.shape[1] == scenes.WIDTH_PX and found.shape[0] > 3 * 160
    for word in CATEGORIES:
        assert (found == scenes.CATEGORY[word]).all(axis=2).sum() > 100
    assert stacked(panels) == stacked(panels)


def test_categories_of_picks_are_those_that_the_bars_count(evaluation: Evaluation) -> None:
    for version in ("single-grid", "cascade-spiral", "operator"):
        picks = evaluation.picks(version)
        found = [category_of(evaluation, k, int(pick)) for k, pick in enumerate(picks)]
        counts = tuple(found.count(word) for word in ("red", "yellow", "green"))
        assert counts == evaluation.category_counts(version)


class Table:
    """Rows of drawn columns."""

    def __init__(self, distance_m: np.ndarray, fits: np.ndarray) -> None:
        self.columns = {"given_thesis_clearance_m": distance_m, "given_true_fits": fits}
        self.count = len(distance_m)

    def __getitem__(self, name: str) -> np.ndarray:
        return self.columns[name]


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from((0.1, 0.5, 0.9)))
def test_three_categories_are_found_where_there_are_three(seed: int, most: float) -> None:
    rng = np.random.default_rng(seed)
    distance_m, fits = rng.uniform(0, 0.12 * most, (5, 15)), rng.random((5, 15)) < 0.6
    table = Evaluation(Table(distance_m, fits), {})  # type: ignore[arg-type]
    found = figures_method._of_each_category(table).rows.tolist()
    for k in range(5):
        faces = [
            {p // 3 for p in range(15) if fits[k, p] and low <= distance_m[k, p] < high}
            for low, high in ((0.06, 9.0), (0.02, 0.06), (-1.0, 0.02))
        ]
        there = any(len({a, b, c}) == 3 for a in faces[0] for b in faces[1] for c in faces[2])
        assert (k in found) == there
        if there:
            picks = three_categories(table, k)
            assert [p // 3 in faces[j] and fits[k, p] for j, p in enumerate(picks)] == [True] * 3
            assert len({p // 3 for p in picks}) == 3
            green, yellow, red = (distance_m[k, p] for p in picks)
            assert red < 0.02 <= yellow < 0.06 <= green


def test_a_rule_that_no_scene_meets_gives_words_and_no_picture(
    evaluation: Evaluation, seen: Seen
) -> None:
    def draw(rows: np.ndarray) -> list[Panel]:
        row = int(rows[0])
        pick = int(evaluation.picks("single-grid")[row])
        return [pick_panel(evaluation, row, pick, seen, "")]

    rule = "scenes are so"
    nothing = drawn(Found("9-9", rule, np.array([], int), 6), "A scene", draw)
    assert nothing == "Figure 9-9 is not drawn: 0 of 6 scenes are so."
    one = drawn(Found("9-9", rule, np.array([0]), 6), "A scene", draw)
    assert isinstance(one, Picture) and one.name == "figure-9-9"
    assert "1 of 6 scenes are so" in one.caption


def test_boxes_that_read_the_same_differ_and_are_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    found = alike.find_alike(16)
    assert found is not None and found.alike >= 3
    assert (found.states == found.states[0]).all()
    nothing = alike._states(alike._scene(None), "spiral")
    assert not np.array_equal(found.states[0], nothing)
    for a, b in ((0, 1), (0, 2), (1, 2)):
        assert np.abs(found.boxes[a] - found.boxes[b]).max() > 0.01
    # What the pictures show is read by the whole pipeline, not by the search's short way.
    drawn_states = []
    samples = Panel.samples

    def kept(self: Panel, points: np.ndarray, states: np.ndarray, radius_px: float = 5.0) -> Panel:
        drawn_states.append(states)
        return samples(self, points, states, radius_px)

    monkeypatch.setattr(Panel, "samples", kept)
    solids = [alike._solid(box) for box in found.boxes]
    for box in found.boxes:
        alike._panel(alike._scene(box), box, solids)
    assert all(np.array_equal(states, found.states[0]) for states in drawn_states)
    assert len(drawn_states) == 3
    sizes = [np.ptp(solid, axis=0) for solid in solids]
    assert np.allclose(sizes, found.boxes[:, :3])


def test_no_three_alike_gives_words(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(alike, "find_alike", lambda: None)
    assert str(alike.alike_picture()).startswith("Figure 5-1 is not drawn")


def test_decisions_are_counted_commonest_first() -> None:
    assert counted([4, 7, 7, 1, 4, 7]) == [(7, 3), (4, 2), (1, 1)]
    assert counted([2, 1]) == [(1, 1), (2, 1)]


def test_the_box_of_a_scene_is_where_its_points_are(seen: Seen) -> None:
    low, high = corners(seen.box.T_base_box, seen.box.dimensions_m)[[0, 7]]
    own = seen.analysis.scene.points[seen.analysis.target_points.target_mask]
    inside = ((own >= low - 0.01) & (own <= high + 0.01)).all(axis=1)
    assert inside.mean() > 0.98
