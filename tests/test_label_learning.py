"""Learn now: in the background, cancelled, failing, numbered, switched; and `none` is learned."""

from __future__ import annotations

import json
import os
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("sqlalchemy", reason="extra label")
pytest.importorskip("alembic", reason="extra label")
pytest.importorskip("sklearn", reason="extra train")
pytest.importorskip("onnx", reason="extra train")
pytest.importorskip("onnxruntime", reason="extra svm")
pytest.importorskip("pyarrow", reason="extra train")

from label_lessons import captures_in, database, said

from boxgrasp import GraspSelector
from boxgrasp.config import Config
from boxgrasp.errors import ConfigError
from boxgrasp.execution import Store, local_workers
from boxgrasp.labeling.learning import (
    Learned,
    Learner,
    LearningParams,
    LearningTask,
    VersionLearned,
    learn,
)
from boxgrasp.labeling.lessons import scene_config
from boxgrasp.labeling.record import Record
from boxgrasp.labeling.sources import load_scene, source_at
from boxgrasp.labeling.words import LabelScene
from boxgrasp.ranking.model_set import VERSIONS
from boxgrasp.simulate.scenario import Recipe
from boxgrasp.study.evaluation import model_sets_in
from boxgrasp.teaching.fitting import answers, fit_version
from boxgrasp.teaching.rows import RowConfig
from boxgrasp.teaching.search import SearchParams
from boxgrasp.teaching.sets import Rows, SetConfig, make_set, read_set

COUNT = 48
PARAMS = LearningParams(
    search=SearchParams(costs=(2.0, 16.0), gammas=(0.004, 0.02, 0.1), fine_steps=0), sizes=3
)


class Crowd:
    """Scenes so crowded that in every third no candidate passes, and one who labels them.

    The operator says `none` exactly where nothing passes, else takes what passes and has most room
    of two lines of the front and two of the top.
    """

    def __init__(self, folder: Path) -> None:
        recipe = Recipe(("beans_can",), obstacles=(0, 9), area_m=0.40, wish="any")
        made = SetConfig(RowConfig(recipe, 9, target_sources=("given",)), COUNT)
        with local_workers(1) as workers:
            make_set(Store(folder / "set"), "", made, workers, "")
        self.folder, self.set = folder, str(folder / "set")
        self.rows: Rows = read_set(Store(self.set))[1]
        self.scenes: tuple[LabelScene, ...] = tuple(
            source_at(self.set, captures_in(folder)).scenes()
        )
        passes, room = self.rows["given_passes"], self.rows["given_visible_clearance_m"]
        liked = np.array([4, 5, 11, 12])
        best = np.where(passes, room.round(3), -9.0)[:, liked - 1].argmax(axis=1)
        self.labels = np.where(passes.any(axis=1), liked[best], 16)
        told = [
            said(scene, None if self.labels[k] == 16 else int(self.labels[k]), after_s=k)
            for k, scene in enumerate(self.scenes)
        ]
        self.database = str(database(folder, self.scenes, told))

    def learner(self, folder: Path, **options: Any) -> Learner:
        params = options.pop("params", PARAMS)
        where = options.pop("database", self.database)
        return Learner(where, str(self.folder), folder, params=params, **options)


@pytest.fixture(scope="module")
def crowd(tmp_path_factory: pytest.TempPathFactory) -> Crowd:
    return Crowd(tmp_path_factory.mktemp("crowd"))


@pytest.fixture(scope="module")
def learned(crowd: Crowd) -> Learned:
    """What is learned, here and not in another process."""
    folder = crowd.folder / "here"
    task = LearningTask(
        crowd.database, str(crowd.folder), folder, params=replace(PARAMS, niceness=0)
    )
    return learn(task)


def of(learned: Learned, version: str) -> VersionLearned:
    return next(item for item in learned.versions if item.version == version)


def test_none_is_learned(crowd: Crowd, learned: Learned) -> None:
    """Cross-validated and balanced, well above who always says the commonest answer."""
    share = np.bincount(crowd.labels).max() / COUNT
    assert learned.nones == (crowd.labels == 16).sum() > 8
    assert learned.commonest == pytest.approx(share)
    best = max(learned.versions, key=lambda item: item.agreement)
    kinds = len(np.unique(crowd.labels))
    assert best.agreement > share + 0.1
    assert best.balanced > 1 / kinds + 0.1


def test_scenes_never_seen_are_told_apart_by_whether_help_is_needed(crowd: Crowd) -> None:
    """Folds and score by scikit-learn, C and gamma not searched."""
    from sklearn.metrics import balanced_accuracy_score
    from sklearn.model_selection import StratifiedKFold

    rows = Rows({**crowd.rows.columns, "label": crowd.labels})
    helped = crowd.labels == 16
    held = {part: (8.0, 0.03) for part in ("single", "face", "side", "top")}
    for version in ("single-grid", "cascade-grid"):
        asks = np.zeros(COUNT, bool)
        for seen, asked in StratifiedKFold(5, shuffle=True, random_state=0).split(helped, helped):
            models = fit_version(rows.take(seen), version, 3, held)  # type: ignore[arg-type]
            asks[asked] = answers(models, rows.take(asked)) == 16
        assert balanced_accuracy_score(helped, asks) > 0.6  # 0.5: always the commonest


def test_models_that_learned_none_ask_in_the_whole_pipeline(crowd: Crowd, learned: Learned) -> None:
    folder = crowd.folder / "here"
    version = learned.best
    assert version is not None
    found = answers(model_sets_in(Store(folder))[version], crowd.rows)
    asks = found == 16
    assert 0 < asks.sum() < COUNT
    config = {"ranker": version, "models": str(folder)}
    told = {True: 0, False: 0}
    for k in (*np.flatnonzero(asks)[:3], *np.flatnonzero(~asks)[:3]):
        scene = crowd.scenes[int(k)]
        loaded = load_scene(scene, captures_in(crowd.folder))
        settings = replace(scene_config(scene, Config()), **config)
        answer = GraspSelector(settings).select(loaded.capture, loaded.target)
        asked = answer.refusal is not None and answer.refusal.code == "ranker_asks"
        assert asked == asks[k]
        if asked:
            assert len(answer.candidates) == 15 and answer.status == "ask"
        told[bool(asked)] += 1
    assert told == {True: 3, False: 3}


def test_the_curve_ends_at_the_agreement(learned: Learned) -> None:
    assert [item.version for item in learned.versions] == list(VERSIONS)
    for item in learned.versions:
        assert len(item.sizes) == len(item.means) == len(item.spreads) == 3
        assert list(item.sizes) == sorted(set(item.sizes)) and item.sizes[0] == 10
        assert item.sizes[-1] in (COUNT * 4 // 5, COUNT * 4 // 5 - 1)
        assert item.means[-1] == pytest.approx(item.agreement, abs=0.02)
        assert all(0 <= share <= 1 for share in item.means)
        assert item.usable and not item.why


def waited(learner: Learner, limit_s: float = 60.0) -> Any:
    end = time.monotonic() + limit_s
    fractions = [0.0]
    while (status := learner.status()).state == "running":
        assert time.monotonic() < end, status
        fractions.append(status.fraction)
        time.sleep(0.02)
    assert fractions == sorted(fractions)
    return status


def test_in_the_background_numbered_switched_and_back(
    crowd: Crowd, learned: Learned, tmp_path: Path
) -> None:
    learner = crowd.learner(tmp_path / "models")
    assert (learner.status().state, learner.models(), learner.active) == ("idle", [], None)
    mine = Config()
    assert learner.config_with(mine) is mine
    learner.start()
    with pytest.raises(ConfigError, match="learning already"):
        learner.start()
    status = waited(learner)
    assert (status.state, status.fraction) == ("done", 1.0), status
    assert f"{COUNT} labels of {COUNT} scenes" in status.message and "%" in status.message
    kept = learner.models()
    assert kept == [status.results] and kept[0].number == 1
    assert replace(kept[0], number=0, seconds=0, made_at="") == replace(
        learned, seconds=0, made_at=""
    )  # the same in another process
    assert [path.name for path in learner.folder.iterdir()] == ["0001"]
    learner.activate(1)
    again = crowd.learner(tmp_path / "models")  # as after a restart of the server
    used = again.config_with(mine)
    assert again.active == 1 and used.models == str(tmp_path / "models" / "0001")
    assert used.ranker == learned.best
    assert GraspSelector(used).ranker.name == learned.best
    with pytest.raises(ConfigError, match="no models 7; valid: 1, or the shipped ones"):
        again.activate(7)
    again.activate(None)
    assert learner.active is None and learner.config_with(mine) is mine
    (tmp_path / "models" / "0001" / "learned.json").write_text("{")
    assert again.models() == []  # damaged: passed over, told in the log


def test_a_cancelled_learning_leaves_nothing_and_another_can_start(
    crowd: Crowd, tmp_path: Path
) -> None:
    learner = crowd.learner(tmp_path / "models")
    learner.start()
    while learner.status().message == "starting":
        time.sleep(0.02)
    began = time.monotonic()
    learner.cancel()
    assert time.monotonic() - began < 2
    status = learner.status()
    assert (status.state, status.message) == ("idle", "the learning was cancelled")
    assert list((tmp_path / "models").iterdir()) == []
    learner.cancel()  # nothing to cancel
    learner.start()
    learner.cancel()


@pytest.mark.parametrize(
    "fault",
    [
        *("few", "one answer", "no database", "no set"),
        pytest.param("killed", marks=pytest.mark.skipif(os.name == "nt", reason="SIGKILL")),
    ],
)
def test_a_learning_that_fails_says_so_in_a_line(crowd: Crowd, tmp_path: Path, fault: str) -> None:
    some = crowd.scenes[:6]
    labels = {"few": [said(some[0], 5)], "one answer": [said(scene, 5) for scene in some]}
    path = str(database(tmp_path, some, labels.get(fault, [])))
    if fault == "no database":
        path = str(tmp_path / "nowhere" / "labels.db")
    if fault in ("killed", "no set"):
        path = crowd.database
    learner = crowd.learner(tmp_path / "models", database=path)
    learner.start(mix=str(tmp_path / "no") if fault == "no set" else None)
    if fault == "killed":
        running = learner._running
        assert running is not None
        os.kill(running[0]._worker.process.pid or 0, 9)
    status = waited(learner)
    assert status.state == "failed" and "\n" not in status.message
    words = {
        "few": "1 scenes are labeled so far; valid: at least 5",
        "one answer": "all 6 labels say front line 2; valid: at least two different answers",
        "no database": "valid",
        "killed": "ended by SIGKILL",
        "no set": "no set at",
    }
    assert words[fault] in status.message
    assert learner.models() == []
    assert not any((tmp_path / "models").glob(".unfinished*"))


def test_a_few_labels_are_learned_from_and_what_they_lack_is_told(
    crowd: Crowd, tmp_path: Path
) -> None:
    """Seven labels, as of a first try of the page: a curve, and a sentence on what is missing."""
    some = [int(k) for k in [*np.flatnonzero(crowd.labels == 16)[:3],
                             *np.flatnonzero(crowd.labels != 16)[:4]]]  # fmt: skip
    labels = [said(crowd.scenes[k], None if crowd.labels[k] == 16 else 5) for k in some]
    path = database(tmp_path, crowd.scenes, labels)
    task = LearningTask(str(path), str(crowd.folder), tmp_path / "m",
                        params=replace(PARAMS, niceness=0))  # fmt: skip
    found = learn(task)
    assert found.labels == 7 and found.nones == 3
    assert any("front line 2 (4), none (3)" in note for note in found.notes)
    for item in found.versions:
        assert 0 <= item.agreement <= 1 and item.sizes[-1] in (5, 6)
    assert not of(found, "cascade-grid").usable  # lines have one class alone
    assert "valid: at least two classes" in of(found, "cascade-grid").why


def test_a_sets_labels_are_mixed_in(crowd: Crowd, tmp_path: Path) -> None:
    path = database(tmp_path, crowd.scenes, [said(crowd.scenes[0], 5)])
    params = replace(PARAMS, niceness=0)
    task = LearningTask(str(path), str(crowd.folder), tmp_path / "m", mix=crowd.set, params=params)
    found = learn(task)
    assert (found.labels, found.mixed) == (1, COUNT)
    assert set(found.operators) == {"anna", "stand-in"}


def test_the_record_says_who_taught(crowd: Crowd, learned: Learned) -> None:
    from boxgrasp.ranking.onnx.model import load_model

    record = load_model(crowd.folder / "here" / "single-grid.onnx").record
    assert (record.label_source, record.seeds, record.training_examples) == ("anna", (9,), COUNT)
    assert 16 in record.classes
    kept = json.loads(json.dumps(learned.operators))
    assert kept == {"anna": COUNT}
    with Record.open(crowd.database, create=False) as opened:
        assert len(opened.standing()) == COUNT
