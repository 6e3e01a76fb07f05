"""Choices made from rows alone are the selector's, and their scores the thesis's."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("sklearn", reason="extra train")
pytest.importorskip("onnxruntime", reason="extra svm")
pytest.importorskip("pyarrow", reason="extra train")

import boxgrasp.teaching.train as training
from boxgrasp import GraspSelector
from boxgrasp.errors import BoxgraspError, ConfigError
from boxgrasp.execution import Store, local_workers
from boxgrasp.grasps.scoring import THESIS_SCORE
from boxgrasp.perception.target import Target
from boxgrasp.ranking.model_set import SVMS
from boxgrasp.ranking.onnx.model import load_model, ranked
from boxgrasp.simulate.scenario import Recipe, targets_of
from boxgrasp.study.evaluation import RANKERS, Evaluation, model_sets_in
from boxgrasp.study.metrics import SCORE_FUNCTIONS, category_counts, chance_of, metrics_of
from boxgrasp.teaching.rows import RowConfig, scenario_of_row
from boxgrasp.teaching.samples import largest_edge_m
from boxgrasp.teaching.search import Grid, Search, train
from boxgrasp.teaching.sets import Rows, SetConfig, make_set, read_set
from boxgrasp.teaching.train import examples, taught_by_set, train_svms

COUNT = 60
TRIED = Grid((4.0,), (0.05,), np.array([[0.5]]), np.array([[0.4]]), np.array([[False]]))
FOUND = Search(4.0, 0.05, 0.5, 0.4, 0.3, TRIED, TRIED)
TESTED = SetConfig(RowConfig(Recipe(targets_of("all"), obstacles=(2, 4), noise="xtion"), 22), 16)


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small set, tested scenarios, and models trained on the one with C and gamma held."""
    folder = tmp_path_factory.mktemp("study")
    store = Store(folder)
    labels = SetConfig(RowConfig(Recipe(targets_of("known")), 21), COUNT)
    with local_workers(1) as workers:
        make_set(store, "labels/", labels, workers, "")
        make_set(store, "tested/", TESTED, workers, "")
        with pytest.MonkeyPatch.context() as patch:  # the search has tests of its own
            patch.setattr(training, "search", lambda X, y, **_: FOUND)
            train_svms(store, "models/", taught_by_set(*read_set(store, "labels/")), workers)
    return folder


@pytest.fixture(scope="module")
def evaluation(place: Path) -> Evaluation:
    store = Store(place)
    return Evaluation(read_set(store, "tested/")[1], model_sets_in(store, "models/"))


@pytest.mark.parametrize("ranker", RANKERS)
@pytest.mark.parametrize("target_source", ["given", "found"])
def test_a_row_s_pick_is_the_selector_s_answer(
    ranker: str, target_source: str, evaluation: Evaluation, place: Path
) -> None:
    for checked in (False, True):
        config = {
            "ranker": ranker,
            "unchecked": not checked,
            "models": str(place / "models"),
            "box": {"fit": "aligned" if target_source == "given" else "yaw"},
        }
        selector = GraspSelector(config)
        picks = evaluation.picks(ranker, target_source, checked=checked)
        for k in range(0, TESTED.count, 5):
            scenario = scenario_of_row(TESTED.rows, k)
            capture, object_ids = scenario.capture("xtion")
            mask = Target(mask=object_ids == scenario.scene.target_id)
            try:
                answer = selector.select(capture, mask if target_source == "given" else None)
            except BoxgraspError:
                assert evaluation.rows[f"{target_source}_error"][k]
                continue
            first = next(item.label for item in answer.candidates if item.rank == 1)
            label = 0 if answer.grasp is None else answer.grasp.label
            assert picks[k] + 1 == label
            assert checked or label == first


def test_every_order_holds_every_candidate_once(evaluation: Evaluation) -> None:
    for ranker in RANKERS:
        assert (np.sort(evaluation.order(ranker)) == np.arange(15)).all()


def score(d: float, largest: float) -> float:
    """The thesis's words (3-4), one grasp at a time."""
    u = min(0.06, largest)
    if d < 0.02 or largest < 0.02:
        return 0.0
    return 1.0 if d >= u else ((d - 0.02) / (u - 0.02)) ** 2


def thesis_score(clearances_m: np.ndarray, chosen: int) -> float:
    """Against the largest clearance of all candidates."""
    return score(float(clearances_m[chosen]), float(clearances_m.max()))


def strict_score(clearances_m: np.ndarray, valid: np.ndarray, chosen: int) -> float:
    """Against the candidates that fit, stay off the plane and have a free way in."""
    if not valid[chosen]:
        return 0.0
    return score(float(clearances_m[chosen]), float(clearances_m[valid].max()))


def test_the_naive_scores_by_hand() -> None:
    clearances = np.array([0.083, 0.028, 0.05, 0.0])
    assert [thesis_score(clearances, k) for k in (0, 1, 3)] == pytest.approx([1.0, 0.04, 0.0])
    valid = np.array([False, True, True, True])  # the best goes into the table
    strict = [strict_score(clearances, valid, k) for k in (0, 2, 1)]
    assert strict == pytest.approx([0.0, 1.0, (0.8 / 3.0) ** 2])


def test_metrics_are_the_scores_of_the_thesis(evaluation: Evaluation) -> None:
    rows = evaluation.rows
    for name in RANKERS:
        picks = evaluation.picks(name)
        found = metrics_of(rows, "given", picks)
        for k, pick in enumerate(picks.tolist()):
            visible, fits = rows["given_thesis_clearance_m"][k], rows["given_true_fits"][k]
            assert found.clearance_score[k] == pytest.approx(thesis_score(visible, pick))
            narrow = score(visible[pick], max(visible[fits])) if fits[pick] else 0.0
            assert found.score[k] == pytest.approx(narrow)
            assert found.unobstructed[k] == (fits[pick] and visible[pick] >= 0.02)
            own, true_fits = rows["given_true_clearance_m"][k][pick], rows["true_fits"][k]
            exact = score(own, max(rows["true_clearance_m"][k][true_fits])) if fits[pick] else 0.0
            assert found.exact_score[k] == pytest.approx(exact)
            if not found.valid[k]:
                assert found.strict_score[k] == 0.0


def test_strict_scores_are_the_naive_ones_where_the_box_is_the_true_one(
    evaluation: Evaluation,
) -> None:
    rows = dict(evaluation.rows)
    for name in ("clearance_m", "plane_clearance_m", "approach_clearance_m", "fits"):
        rows[f"given_true_{name}"] = rows[f"true_{name}"]
    found = metrics_of(rows, "given", evaluation.picks("random"))
    valid = (
        rows["true_fits"]
        & (rows["true_plane_clearance_m"] > 0)
        & (rows["true_approach_clearance_m"] > 0)
    )
    for k, pick in enumerate(evaluation.picks("random").tolist()):
        expected = strict_score(rows["true_clearance_m"][k], valid[k], pick)
        assert found.strict_score[k] == pytest.approx(expected)


def test_chance_is_the_average_of_every_candidate(evaluation: Evaluation) -> None:
    rows = evaluation.rows
    found = chance_of(rows)
    for k in range(rows.count):
        visible, fits = rows["given_thesis_clearance_m"][k], rows["given_true_fits"][k]
        each = [
            score(d, max(visible[fits])) if f else 0.0 for d, f in zip(visible, fits, strict=True)
        ]
        assert found.score[k] == pytest.approx(np.mean(each))
        alone = [thesis_score(visible, pick) for pick in range(15)]
        assert found.clearance_score[k] == pytest.approx(np.mean(alone))
        assert found.too_wide[k] == pytest.approx(1 - np.mean(fits))


def test_a_face_too_wide_is_red(evaluation: Evaluation) -> None:
    wide = ~evaluation.rows["given_true_fits"]
    rows = evaluation.take(wide.any(axis=1))
    worst = Evaluation(rows.rows, {}, commonest=int(wide[wide.any(axis=1)][0].argmax()))
    metrics = worst.metrics("commonest")
    red, _, _ = worst.category_counts("commonest")
    assert metrics.too_wide.any() and red >= metrics.too_wide.sum()
    assert (metrics.score[metrics.too_wide] == 0).all()
    assert not (metrics.unobstructed & metrics.too_wide).any()
    by_distance, _, _ = worst.category_counts("commonest", any_width=True)
    assert by_distance == (~metrics.distant).sum() < red


def test_what_was_not_answered_has_no_score(evaluation: Evaluation) -> None:
    picks = np.full(evaluation.rows.count, -1)
    found = metrics_of(evaluation.rows, "given", picks)
    assert not found.answered.any()
    assert np.isnan(found.score).all()
    assert not (found.unobstructed | found.clear | found.good | found.into_table).any()


def test_every_score_is_0_when_red_and_1_when_green() -> None:
    for function in SCORE_FUNCTIONS:
        d = np.array([0.0, 0.0199, 0.02, 0.035, function.green_m, 0.3])
        values = function(d, np.full(6, 0.4))
        assert values[:2].tolist() == [0, 0]
        assert values[4:].tolist() == [1, 1]
        assert 0 <= values[2] <= values[3] < 1
    for d in np.linspace(0, 0.08, 30):
        for best in (0.01, 0.03, 0.2):
            if d <= best:
                assert THESIS_SCORE([d], [best])[0] == pytest.approx(score(d, best))


def test_categories_follow_the_scene_s_best() -> None:
    counts = category_counts(np.array([0.01, 0.03, 0.04, 0.07]), np.array([0.2, 0.2, 0.04, 0.2]))
    assert counts == (1, 1, 2)


def test_the_operator_s_picks_are_the_labels(evaluation: Evaluation) -> None:
    assert (evaluation.picks("operator") + 1 == evaluation.rows["label"]).all()


def test_examples_are_as_many_as_faces_say(place: Path) -> None:
    rows = read_set(Store(place), "labels/")[1]
    face = (rows["label"] - 1) // 3 + 1
    sizes = {"single": 187, "face": 187}
    for svm in SVMS:
        try:
            X, y = examples(rows, svm, 3, 0.23)
        except ConfigError:
            continue
        side = svm.part == "side"
        width = {"grid": (64, 124), "spiral": (61, 122)}[svm.sampling][0 if side else 1]
        assert X.shape[1] == sizes.get(svm.part, width)
        among = {"side": (face <= 3).sum(), "top": (face > 3).sum()}.get(svm.part, rows.count)
        assert len(X) == len(y) == among
        assert X.min() >= 0.0
        assert X.max() <= 1.0


def test_unlabeled_rows_cannot_teach(evaluation: Evaluation) -> None:
    rows = Rows({**evaluation.rows, "label": np.zeros(evaluation.rows.count, dtype=np.int64)})
    with pytest.raises(ConfigError, match="without a label"):
        examples(rows, SVMS[0], 3, None)


def test_scikit_learn_the_file_and_the_first_rank_agree_on_every_scene(place: Path) -> None:
    store = Store(place)
    labels, tested = read_set(store, "labels/")[1], read_set(store, "tested/")[1]
    edge = largest_edge_m(labels)
    for svm in SVMS:
        model = load_model(store.read(f"models/{svm.name}.onnx"))
        X, y = examples(labels, svm, 3, edge)
        own = train(X, y, model.record.C, model.record.gamma)
        scenes = [X, examples(tested, svm, 3, edge)[0]]
        for rows in scenes:
            label, decision = model.decide(rows)
            assert np.array_equal(own.predict(rows), label)
            first = ranked(label, decision, model.classes, range(1, 16))[:, 0]
            assert np.array_equal(first, label)


def test_other_labels_are_not_taken_for_those_trained_on(place: Path) -> None:
    store = Store(place)
    made, rows = read_set(store, "labels/")
    again = Rows({**rows, "label": rows["label"][::-1].copy()})
    with local_workers(1) as workers, pytest.raises(ConfigError, match="labels_sha256"):
        train_svms(store, "models/", taught_by_set(made, again), workers)
