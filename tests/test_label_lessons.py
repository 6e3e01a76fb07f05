"""What labels teach: rows, examples and models, against scenario sets and scikit-learn."""

from __future__ import annotations

import shutil
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("sqlalchemy", reason="extra label")
pytest.importorskip("alembic", reason="extra label")
pytest.importorskip("sklearn", reason="extra train")
pytest.importorskip("onnx", reason="extra train")
pytest.importorskip("pyarrow", reason="extra train")

from helpers import drawn, seen
from label_lessons import captures_in, database, opener, said

import boxgrasp.teaching.train as training
from boxgrasp.cli import main
from boxgrasp.config import Config
from boxgrasp.errors import ConfigError, StoreError
from boxgrasp.execution import Store, Workers, local_workers
from boxgrasp.labeling.lessons import LessonConfig, Lessons, kept_rows, lessons_of, scene_config
from boxgrasp.labeling.sources import capture_scene, load_scene, source_at
from boxgrasp.labeling.words import LabelScene
from boxgrasp.selector import GraspSelector
from boxgrasp.sensing.capture import Capture
from boxgrasp.simulate.scenario import Recipe, targets_of
from boxgrasp.strict import build
from boxgrasp.teaching.rows import MAP_RESOLUTIONS_M, RowConfig, selector
from boxgrasp.teaching.search import SEARCH, Grid, Search, SearchParams, folds_of
from boxgrasp.teaching.sets import Rows, SetConfig, from_parquet, make_set, read_set, to_parquet
from boxgrasp.teaching.train import SCENE_KEY, taught_by_set, train_svms

COUNT = 16
TRIED = Grid((4.0,), (0.05,), np.array([[0.5]]), np.array([[0.4]]), np.array([[False]]))
FOUND = Search(4.0, 0.05, 0.5, 0.4, 0.3, TRIED, TRIED)  # the search has tests of its own


@dataclass(frozen=True)
class Place:
    """A set with its scenes, a folder for captures, and workers."""

    folder: Path
    made: SetConfig
    rows: Rows
    scenes: tuple[LabelScene, ...]
    workers: Workers


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Any:
    folder = tmp_path_factory.mktemp("lessons")
    recipe = Recipe(targets_of("known"), obstacles=(3, 6), area_m=0.42, wish="any")
    made = SetConfig(RowConfig(recipe, 4, target_sources=("given",)), COUNT)
    with local_workers(1) as workers:
        make_set(Store(folder / "set"), "", made, workers, "")
        rows = read_set(Store(folder / "set"))[1]
        scenes = tuple(source_at(str(folder / "set"), captures_in(folder)).scenes())
        yield Place(folder, made, rows, scenes, workers)


def stand_in_labels(place: Place) -> list[Any]:
    """The set's own labels, as somebody would import them; not in their order."""
    labels = place.rows["label"].tolist()
    found = []
    for k, scene in enumerate(place.scenes):
        label = labels[k] if labels[k] < 16 else None
        found.append(said(scene, label, "stand-in", k, origin="import", seconds=None))
    return found[::-1]


def learned(place: Place, folder: Path, labels: list[Any], **options: Any) -> Lessons:
    path = database(folder, place.scenes, labels)
    lesson = options.pop("lesson", LessonConfig())
    with opener(path)() as record:
        captures = captures_in(place.folder)
        return lessons_of(record, captures, place.workers, lesson, title="", **options)


@pytest.fixture(scope="module")
def lessons(place: Place, tmp_path_factory: pytest.TempPathFactory) -> Lessons:
    return learned(place, tmp_path_factory.mktemp("imported"), stand_in_labels(place))


def test_rows_of_labeled_scenarios_are_the_sets_byte_for_byte(
    place: Place, lessons: Lessons
) -> None:
    assert set(lessons.taught.rows) == {*place.rows, SCENE_KEY}
    for name, column in place.rows.columns.items():
        own = lessons.taught.rows[name]
        assert own.dtype.kind == column.dtype.kind and own.tobytes() == column.tobytes(), name
    file = next((place.folder / "rows").rglob("*.parquet")).read_bytes()
    kept = from_parquet(file)
    k = int(kept["number"][0])
    one = {name: column[k] for name, column in place.rows.columns.items()}
    nothing = {"label": None, "label_source": None, "given_error": None}
    assert to_parquet([{**one, **nothing}], place.made.rows) == file


def test_models_from_imported_labels_are_those_of_the_set(
    place: Place, lessons: Lessons, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def found(X: Any, y: Any, *, params: SearchParams, **other: Any) -> Search:
        assert params == SEARCH
        return FOUND

    monkeypatch.setattr(training, "search", found)
    own = taught_by_set(place.made, place.rows)
    of_set = train_svms(Store(tmp_path / "a"), "", own, place.workers)
    of_labels = train_svms(Store(tmp_path / "b"), "", lessons.taught, place.workers)
    assert of_set == of_labels
    names = sorted(path.name for path in (tmp_path / "a").glob("*.onnx"))
    assert len(names) == 8
    for name in names:
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
    with pytest.raises(ConfigError, match="made otherwise"):
        train_svms(Store(tmp_path / "a"), "", lessons.taught, place.workers)


def test_rows_are_made_once(
    place: Place, lessons: Lessons, monkeypatch: pytest.MonkeyPatch
) -> None:
    import boxgrasp.labeling.lessons as module

    def never(task: Any) -> bytes:
        raise AssertionError("made again")

    monkeypatch.setattr(module, "row_bytes", never)
    captures = captures_in(place.folder)
    again = kept_rows(place.scenes, captures, place.workers, Config(), "")
    assert len(again) == COUNT
    other = replace(Config(), box=replace(Config().box, fit="aligned"))  # of captures alone
    assert len(kept_rows(place.scenes, captures, place.workers, other, "")) == COUNT


def test_who_and_what_teaches(place: Place, tmp_path: Path) -> None:
    first, second, third, fourth, fifth = place.scenes[:5]
    taken_back = said(third, 5)
    labels = [
        said(first, 5, "ben", 3),
        said(first, 8, "anna", 4),
        said(second, None, "anna", 1),
        said(fourth, None, "anna", 2, verdict="box_wrong"),
        taken_back,
        said(fifth, 4),
    ]
    path = database(tmp_path, place.scenes, labels)
    with opener(path)() as record:
        record.withdraw(taken_back.id, "anna", said(third, 5).id, taken_back.labeled_at)
        corrected = record.standing()[-1]
        assert corrected.operator in ("anna", "ben")
        found = lessons_of(
            record, captures_in(place.folder), place.workers, LessonConfig(), title=""
        )
    rows = found.taught.rows
    told = list(zip(rows[SCENE_KEY].tolist(), rows["label_source"], rows["label"], strict=True))
    assert told == [
        (first.key, "anna", 8),
        (first.key, "ben", 5),
        (second.key, "anna", 16),
        (fifth.key, "anna", 4),
    ]
    assert (found.labels, found.scenes) == (4, 3)
    assert found.operators == {"anna": 3, "ben": 1}
    assert found.taught.provenance.label_source == "anna, ben"
    assert found.taught.provenance.seeds == (4,)


def test_labels_of_one_scene_are_in_one_fold_and_single_ones_as_ever() -> None:
    r = np.random.default_rng(0)
    y = r.integers(1, 5, 80)
    scenes = np.array([f"s{k // 2}" for k in range(80)])
    fold = folds_of(y, 5, 3, scenes)
    assert all(len(set(fold[scenes == one].tolist())) == 1 for one in scenes)
    assert set(fold.tolist()) == set(range(5))
    names = np.array([f"s{k}" for k in r.permutation(80)])
    assert np.array_equal(folds_of(y, 5, 3, names), folds_of(y, 5, 3))


@pytest.fixture(scope="module")
def capture() -> Capture:
    return seen(drawn(3), 3)


@pytest.mark.parametrize("fit", ["yaw", "aligned"])
def test_a_captures_row_is_what_the_package_saw_and_nothing_is_known_true(
    place: Place, capture: Capture, fit: str
) -> None:
    captures = captures_in(place.folder)
    config = build(Config, {"box": {"fit": fit}}, "", ConfigError)
    target = {"mask": True} if capture.mask is not None else {"pixel": list(capture.target_pixel)}
    scene = capture_scene(captures.add(capture), target, "a thing", config)
    row = kept_rows([scene], captures, place.workers, Config(), "")[scene.key]
    answer = GraspSelector(config, map_resolutions_m=MAP_RESOLUTIONS_M).select(capture)
    assert np.array_equal(row["given_dimensions_m"][0], answer.box.dimensions_m)
    assert np.array_equal(row["given_passes"][0], [c.passed for c in answer.candidates])
    near = [c.checks["visible_clearance"].value for c in answer.candidates]
    assert np.array_equal(row["given_visible_clearance_m"][0], near)
    truths = [name for name in row if "true_" in name or name in ("feasible", "best_m")]
    assert len(truths) > 8
    for name in truths:
        column = row[name]
        assert np.isnan(column).all() if column.dtype.kind == "f" else not column.any(), name
    assert row["target"].tolist() == ["a thing"]
    assert set(row) == set(place.rows)  # the same columns as a scenario's


def test_a_scene_is_shown_as_its_row_is_made(place: Place) -> None:
    scene = place.scenes[0]
    loaded = load_scene(scene, captures_in(place.folder))
    shown = GraspSelector(scene_config(scene, Config())).analyze(loaded.capture, loaded.target)
    of_set = selector("given", 3).analyze(loaded.capture, loaded.target)
    for one, other in ((shown.context, of_set.context),):
        assert np.array_equal(one.box.T_base_box, other.box.T_base_box)
        assert np.array_equal(one.candidates.T_base_gripper, other.candidates.T_base_gripper)


def test_captures_and_scenarios_are_learned_from_together_and_it_is_told(
    place: Place, capture: Capture, tmp_path: Path
) -> None:
    captures = captures_in(place.folder)
    target = {"mask": True} if capture.mask is not None else {"pixel": list(capture.target_pixel)}
    real = capture_scene(captures.add(capture), target, "real")
    path = database(tmp_path, [*place.scenes, real], [said(place.scenes[3], 5), said(real, 8)])
    with opener(path)() as record:
        found = lessons_of(record, captures, place.workers, LessonConfig(), title="")
    assert found.box_kinds == {"aligned": 1, "yaw": 1}
    assert any("both kinds" in note for note in found.notes)
    assert found.taught.provenance.object_set.endswith("; captures")
    assert found.taught.rows[SCENE_KEY].tolist() == [place.scenes[3].key, real.key]
    shutil.rmtree(place.folder / "captures")  # rows are kept: the capture is not asked for again
    with opener(path)() as record:
        again = lessons_of(record, captures, place.workers, LessonConfig(), title="")
        assert again.taught.made == found.taught.made
        nowhere = captures_in(tmp_path / "nowhere")
        with pytest.raises(StoreError, match="keeps no capture"):
            lessons_of(record, nowhere, place.workers, LessonConfig(), title="")


def test_a_simulated_set_is_mixed_in(place: Place, tmp_path: Path) -> None:
    labels = [said(scene, 5, "anna", k) for k, scene in enumerate(place.scenes[:3])]
    found = learned(place, tmp_path, labels, mix=(place.made, place.rows))
    rows = found.taught.rows
    assert rows["label_source"].tolist() == ["anna"] * 3 + ["stand-in"] * COUNT
    assert rows[SCENE_KEY][:3].tolist() == rows[SCENE_KEY][3:6].tolist()  # the same scenes
    assert np.array_equal(rows["label"][3:], place.rows["label"])
    assert (found.labels, found.taught.provenance.label_source) == (3, "anna, stand-in")


def test_what_cannot_be_learned_from_is_told(place: Place, tmp_path: Path) -> None:
    def told(name: str, labels: list[Any], **options: Any) -> str:
        (tmp_path / name).mkdir()
        with pytest.raises(ConfigError) as error:
            learned(place, tmp_path / name, labels, **options)
        assert "\n" not in str(error.value) and "valid: " in str(error.value)
        return str(error.value)

    one, other = place.scenes[:2]
    assert "no labels" in told("none", [])
    assert "no labels" in told("wrong", [said(one, None, verdict="box_wrong")])
    wide = {**said(one, 1).gripper, "max_opening_m": 0.2}
    assert "2 hands" in told("hands", [said(one, 5), said(other, 5, gripper=wide)])
    five = replace(other, key="five", lines=5)
    with_five = replace(place, scenes=(one, five))
    (tmp_path / "lines").mkdir()
    with pytest.raises(ConfigError, match="3 and 5 lines a face"):
        learned(with_five, tmp_path / "lines", [said(one, 5), said(five, 5)])
    (tmp_path / "three").mkdir()
    found = learned(with_five, tmp_path / "three", [said(one, 5), said(five, 5)],
                    lesson=LessonConfig(lines=3))  # fmt: skip
    assert found.labels == 1 and "1 labels of another number of lines" in found.notes[0]


def test_the_command_trains_from_a_database(
    place: Place,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(training, "search", lambda X, y, **_: FOUND)
    labels = stand_in_labels(place)
    path = database(tmp_path, place.scenes, labels)
    out, own = tmp_path / "models", str(place.folder)
    options = ["--captures", own, "--processes", "1"]
    assert main(["train", "--labels", str(path), str(out), *options]) == 0
    printed = capsys.readouterr().out
    assert f"{COUNT} labels of {COUNT} scenes by stand-in" in printed
    assert len(list(out.glob("*.onnx"))) == 8
    assert main(["train", "--labels", str(tmp_path / "no.db"), str(out), *options]) == 2
    assert main(["train", str(path), str(out), "--mix", own]) == 2
    assert "--labels" in capsys.readouterr().err
