"""The request for help as the thesis's sixth face: learned, predicted, asked, told."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
from helpers import drawn, item, laid, seen
from tiny_models import record_of, rows, schema_of, trained

from boxgrasp import GraspSelector, Selection
from boxgrasp.draw import selection_png
from boxgrasp.draw.words import facts_of
from boxgrasp.errors import BoxgraspError, ConfigError, ModelError
from boxgrasp.ranking.model_set import SVMS, ModelSet, SampledScenes, help_label
from boxgrasp.ranking.ranker import Ranker, RankerSetup, Ranking, RankingContext, ranker_named
from boxgrasp.ranking.rankers.clearance import ByClearance
from boxgrasp.ranking.sampling import portion, sampling
from boxgrasp.result import JSON_SCHEMA_PATH
from boxgrasp.simulate.scenario import Recipe
from boxgrasp.study.evaluation import ASK, Evaluation
from boxgrasp.teaching.operators import Label
from boxgrasp.teaching.rows import RowConfig, row_of
from boxgrasp.teaching.sets import Rows, from_parquet, to_parquet
from boxgrasp.teaching.train import examples

LINES = 3


class Asking(Ranker):
    """By clearance, and it asks."""

    name = "asking"

    def __init__(self, asks: Any = True) -> None:
        self.asks = asks

    def rank(self, context: RankingContext) -> Ranking:
        return replace(ByClearance().rank(context), asks=self.asks)


@pytest.fixture(scope="module")
def usual() -> Selection:
    found = GraspSelector().select(seen(drawn(3), 3))
    assert found.passing
    return found


@pytest.mark.parametrize("unchecked", [False, True])
def test_a_ranker_that_asks_is_obeyed_though_candidates_pass(
    usual: Selection, unchecked: bool
) -> None:
    selector = GraspSelector({"unchecked": unchecked}, ranker=Asking())
    found = selector.select(seen(drawn(3), 3))
    assert found.status == "ask" and found.grasp is None
    assert [c.label for c in found.passing] == [c.label for c in usual.passing]
    refusal = found.refusal
    assert refusal is not None and refusal.code == "ranker_asks"
    assert refusal.nearest_label == found.passing[0].label and refusal.violations == ()
    assert found.passing[0].name in refusal.message and "\n" not in refusal.message
    for one, other in zip(found.candidates, usual.candidates, strict=True):
        assert one.checks == other.checks  # every number is there


def test_a_ranker_that_asks_where_nothing_passes_names_what_came_nearest() -> None:
    hand = {"max_opening_m": 0.05}
    capture = seen(laid(item("green_cube", 0.85, 0.0)), 0)
    usual = GraspSelector({"gripper": hand}).select(capture).refusal
    asked = GraspSelector({"gripper": hand}, ranker=Asking()).select(capture).refusal
    assert usual is not None and asked is not None
    assert (usual.code, asked.code) == ("no_candidate_passes", "ranker_asks")
    assert (usual.nearest_label, usual.violations) == (asked.nearest_label, asked.violations)
    assert usual.message in asked.message


def test_what_the_ranker_asks_goes_through_json_and_back() -> None:
    found = GraspSelector(ranker=Asking()).select(seen(drawn(3), 3))
    line = found.to_json()
    jsonschema.validate(json.loads(line), json.loads(JSON_SCHEMA_PATH.read_text("utf-8")))
    again = Selection.from_json(line)
    assert again.to_json() == line
    assert again.refusal is not None and again.refusal.code == "ranker_asks"
    assert again.shown is not None and again.shown.passed


def test_pictures_and_words_do_not_call_what_passes_rejected() -> None:
    from boxgrasp.cli._report import candidates_table

    capture = seen(drawn(3), 3)
    found = GraspSelector(ranker=Asking()).select(capture)
    assert found.refusal is not None
    (told,) = [line for line in candidates_table(found).splitlines() if "not taken" in line]
    assert told.split()[0] == str(found.refusal.nearest_label)
    assert selection_png(capture, found).startswith(b"\x89PNG")
    facts = dict(facts_of(found))
    assert "Best" in facts and not {"Nearest", "Rejected"} & set(facts)


def test_a_ranker_of_before_asks_nothing_and_an_odd_one_is_refused(usual: Selection) -> None:
    assert not Ranking(np.arange(15), np.ones(15)).asks
    assert usual.status == "grasp"
    with pytest.raises(BoxgraspError, match="asks is 'yes'; valid: True or False"):
        GraspSelector(ranker=Asking("yes")).select(seen(drawn(3), 3))


@pytest.mark.parametrize(
    ("part", "classes", "said"),
    [
        ("single", (1, 16), ""),
        ("single", (1, 17), "from 1 to 16"),
        ("face", (2, 6), ""),
        ("face", (2, 7), "from 1 to 6"),
        ("side", (1, 4), "from 1 to 3"),
        ("top", (1, 4), "from 1 to 3"),
    ],
)
def test_records_know_the_class_where_there_is_one(
    part: str, classes: tuple[int, ...], said: str
) -> None:
    pytest.importorskip("sklearn")
    version = "single-grid" if part == "single" else "cascade-grid"
    _, record = trained(version, part)
    if not said:
        assert replace(record, classes=classes).classes == classes
        return
    with pytest.raises(ModelError, match=said):
        replace(record, classes=classes)


class Said:
    """A classifier that says what it is told to."""

    def __init__(self, classes: tuple[int, ...], predicted: int, won: tuple[float, ...]) -> None:
        self.classes, self._said, self._won = classes, predicted, won

    def decide(self, X: Any) -> tuple[Any, Any]:
        return np.full(len(X), self._said), np.tile(np.array(self._won), (len(X), 1))


def a_scene() -> SampledScenes:
    points = sampling("grid")
    portions = {face: np.zeros((1, len(portion(points, face))), np.float32) for face in range(1, 6)}
    return SampledScenes(np.zeros((1, len(points)), np.float32), portions, np.full((1, 3), 0.1))


def test_a_single_svm_that_predicts_help_still_orders_every_candidate() -> None:
    models = ModelSet("grid", 0.25, {"single": Said((2, 5, 16), 16, (0.2, 1.1, 2.2))}, LINES)
    labels, confidence, asks = models.order(a_scene())
    assert asks.tolist() == [True]
    assert labels[0, :2].tolist() == [5, 2]  # by what they won
    assert sorted(labels[0].tolist()) == list(range(1, 16))
    assert np.allclose(confidence[0, :2], [1.1 / 2, 0.2 / 2])
    assert (np.diff(confidence[0]) <= 0).all() and (confidence[0] >= 0).all()
    other = ModelSet("grid", 0.25, {"single": Said((2, 5, 16), 2, (1.2, 1.1, 0.2))}, LINES)
    assert other.order(a_scene()).asks.tolist() == [False]


def test_a_cascade_whose_face_is_the_sixth_asks_and_orders_faces_by_the_rest() -> None:
    parts = {
        "face": Said((1, 4, 6), 6, (0.1, 1.0, 2.2)),
        "side": Said((1, 2), 2, (-1.0, 1.0)),
        "top": Said((1, 3), 3, (-1.0, 1.0)),
    }
    labels, confidence, asks = ModelSet("grid", 0.25, parts, LINES).order(a_scene())  # type: ignore[arg-type]
    assert asks.tolist() == [True]
    assert labels[0, :4].tolist() == [12, 10, 11, 2]  # line 3 of top-parallel, then of left line 2
    assert sorted(labels[0].tolist()) == list(range(1, 16))
    assert (np.diff(confidence[0]) <= 1e-12).all()


@pytest.mark.parametrize("version", ["single-grid", "cascade-spiral"])
def test_trained_models_ask_where_scikit_learn_says_so(version: str, tmp_path: Path) -> None:
    for name in ("sklearn", "onnx", "onnxruntime"):
        pytest.importorskip(name)
    from boxgrasp.teaching.export import to_onnx
    from boxgrasp.teaching.search import train

    first = None
    for svm in (svm for svm in SVMS if svm.version == version):
        svc, record = trained(version, svm.part)
        if svm.part in ("single", "face"):
            r, schema = np.random.default_rng(7), schema_of(version, svm.part)
            X = rows(r, 90, len(schema))
            help_class = 16 if svm.part == "single" else 6
            y = np.where(X[:, :40].mean(axis=1) > 0.5, help_class, 1 + np.arange(90) % 3)
            first = svc = train(X, y, 4.0, 0.02)
            told = {name: getattr(record, name) for name in ("version", "part", "sampling")}
            told |= {"resolution_m": record.resolution_m, "lines": 3}
            record = record_of(svc, schema, **told)
        (tmp_path / f"{record.name}.onnx").write_bytes(to_onnx(svc, record))
    ranker: Any = ranker_named(version, RankerSetup(models=str(tmp_path)))
    name = version.split("-")[1]
    r, points = np.random.default_rng(8), sampling(name)
    whole = r.choice([0, 0.5, 1], (60, len(points))).astype(np.float32)
    portions = {
        face: np.zeros((60, len(portion(points, face))), np.float32) for face in range(1, 6)
    }
    dimensions = r.uniform(0.05, 0.25, (60, 3))
    found = ranker._models.order(SampledScenes(whole, portions, dimensions))
    X = np.concatenate([whole, dimensions / 0.25], axis=1).astype(np.float32)
    assert first is not None
    expected = first.predict(X) == max(first.classes_)
    assert 0 < expected.sum() < 60
    assert np.array_equal(found.asks, expected)


def labeled_rows(labels: list[int]) -> dict[str, Any]:
    """Rows with random maps, of the columns that training reads."""
    r = np.random.default_rng(2)
    found: dict[str, Any] = {"label": np.array(labels)}
    for name in ("spiral", "grid"):
        points = sampling(name)
        width = sum(len(portion(points, face)) for face in range(1, 6))
        found[f"given_{name}"] = r.integers(0, 3, (len(labels), len(points)), dtype=np.uint8)
        found[f"given_{name}_portions"] = r.integers(0, 3, (len(labels), width), dtype=np.uint8)
    found["given_dimensions_m"] = r.uniform(0.05, 0.2, (len(labels), 3))
    return found


def test_faces_see_the_request_and_lines_never_do() -> None:
    labels = [1, 5, 16, 10, 12, 16, 3]
    seen_by = {
        part: examples(labeled_rows(labels), svm, LINES, 0.2)[1].tolist()
        for part, svm in ((s.part, s) for s in SVMS if s.sampling == "grid")
    }
    assert seen_by == {
        "single": labels,
        "face": [1, 2, 6, 4, 4, 6, 1],
        "side": [1, 2, 3],
        "top": [1, 3],
    }


@pytest.mark.parametrize("labels", [[1, 17], [0, 3]])
def test_labels_that_there_are_not_are_refused(labels: list[int]) -> None:
    with pytest.raises(ConfigError, match="valid: "):
        examples(labeled_rows(labels), SVMS[0], LINES, 0.2)


class Helper:
    def label(self, shown: Any, rng: np.random.Generator) -> Label:
        return Label(None, "a person")


def test_an_operator_that_would_help_is_a_label_of_a_row_and_a_question_in_the_study() -> None:
    pytest.importorskip("pyarrow")
    config = RowConfig(Recipe(("beans_can",)), 5, target_sources=("given",))
    helped, usual = row_of(config, 0, Helper()), row_of(config, 1)
    assert (helped["label"], helped["label_source"]) == (help_label(LINES), "a person")
    rows_read: Rows = from_parquet(to_parquet([helped, usual], config))
    assert rows_read["label"][0] == 16
    picks = Evaluation(rows_read, {}).picks("operator")
    assert picks.tolist() == [ASK, usual["label"] - 1]
    models = ModelSet("grid", 0.25, {"single": Said((2, 16), 16, (-1.0, 1.0))}, LINES)
    evaluation = Evaluation(rows_read, {"own": models})
    assert evaluation.picks("own").tolist() == [ASK, ASK]
    assert not evaluation.metrics("own").answered.any()
