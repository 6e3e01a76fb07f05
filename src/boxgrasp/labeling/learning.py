"""Learn now: models trained from the labels in the background, numbered, switched to and back.

The agreement that is told is cross-validated: what a version that never saw a scene would have
labeled it, against what the operator said.
"""

from __future__ import annotations

import base64
import json
import logging
import os
import re
import shutil
import threading
import time
import uuid
from collections import Counter
from collections.abc import Callable, Generator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import datetime, timezone
from pathlib import Path
from typing import Final, Literal, TypeVar

import numpy as np

from boxgrasp.arrays import Array, Floats
from boxgrasp.config import Config
from boxgrasp.errors import BoxgraspError, ConfigError, WorkError
from boxgrasp.execution import Background, Store, Workers, local_workers
from boxgrasp.grasps.candidates import face_name
from boxgrasp.labeling.captures import CaptureStore
from boxgrasp.labeling.lessons import LessonConfig, Lessons, lessons_of
from boxgrasp.ranking.model_set import SVMS, VERSIONS, help_label
from boxgrasp.strict import build, plain
from boxgrasp.teaching.fitting import Held, answers, fit_version
from boxgrasp.teaching.search import FOLDS, SEARCH, SearchParams, folds_of
from boxgrasp.teaching.sets import Rows, read_set
from boxgrasp.teaching.train import SCENE_KEY, Taught, trained_json, training_task
from boxgrasp.version import __version__

T = TypeVar("T")
R = TypeVar("R")
State = Literal["idle", "running", "done", "failed"]

# A third of the pairs of `boxgrasp train`, over the same range.
QUICK: Final = SearchParams(
    costs=tuple(float(2**k) for k in (-1.0, 1.5, 4.0, 6.5, 9.0)),
    gammas=tuple(float(2**k) for k in (-10.0, -7.5, -5.0, -2.5, 0.0)),
    fine_steps=2,
)
_NUMBER: Final = re.compile(r"\d{4,6}")
_UNFINISHED: Final = ".unfinished-"
_STALE_S: Final = 86400.0  # of what a killed server left; no training takes a day
_TOLD: Final = "learned.json"
_log = logging.getLogger("boxgrasp.labeling")


@dataclass(frozen=True)
class LearningParams:
    """How the page learns.

    Attributes:
        search: the pairs of C and gamma that are tried, those of `boxgrasp train`.
        quick: in place of them where a person would wait too long.
        quick_above: examples above which that is.
        least_scenes: scenes that must be labeled: one for each fold of the cross-validation.
        sizes: how many points the curve has.
        first_size: labels of its first point, where there are more than that.
        held: C and gamma of an SVM whose examples are too few to choose by: the middle of those
            of the thesis (B-1).
        niceness: how far the training stands back behind the page on a busy machine; Windows has
            no such thing.
    """

    search: SearchParams = SEARCH
    quick: SearchParams = QUICK
    quick_above: int = 200
    least_scenes: int = FOLDS
    sizes: int = 6
    first_size: int = 10
    held: tuple[float, float] = (8.0, 0.03)
    niceness: int = 10


@dataclass(frozen=True)
class VersionLearned:
    """What one of the four versions learned.

    Attributes:
        version: its name, as a ranker's.
        agreement: share of the labels that it would have given, cross-validated, 0 to 1.
        spread: standard deviation of that over the folds.
        balanced: mean over the answers of the share of each that it would have given, 0 to 1.
        sizes: labels learned from, for each point of the curve, rising.
        means: agreement at each size, over the folds.
        spreads: standard deviation at each size, over the folds.
        usable: whether its models are there to be switched to.
        why: what is missing where they are not.
    """

    version: str
    agreement: float
    spread: float
    balanced: float
    sizes: tuple[int, ...]
    means: tuple[float, ...]
    spreads: tuple[float, ...]
    usable: bool
    why: str = ""


@dataclass(frozen=True)
class Learned:
    """Models in a numbered folder, and what they came from.

    Attributes:
        number: of the folder; 0 before it has one.
        made_at: when, ISO 8601 with a time zone.
        labels: of people that they learned from.
        scenes: that these are of.
        mixed: labels of a simulated set among the examples.
        nones: how many examples are requests for help.
        operators: examples by who labeled.
        box_kinds: examples by how the box was fitted.
        commonest: share of the commonest answer: what to give it always would be worth, 0 to 1.
        versions: what each of the four learned.
        notes: what the user should know, a sentence each.
        seconds: that the learning took, s.
        boxgrasp: version of the package.
    """

    number: int
    made_at: str
    labels: int
    scenes: int
    mixed: int
    nones: int
    operators: dict[str, int]
    box_kinds: dict[str, int]
    commonest: float
    versions: tuple[VersionLearned, ...]
    notes: tuple[str, ...]
    seconds: float
    boxgrasp: str = __version__

    @property
    def best(self) -> str | None:
        """The usable version with most agreement; None where none is usable."""
        usable = [item for item in self.versions if item.usable]
        return max(usable, key=lambda item: item.agreement).version if usable else None


@dataclass(frozen=True)
class LearningStatus:
    """How far the learning is.

    Attributes:
        state: `idle`, `running`, `done` or `failed`.
        fraction: done of it, 0 to 1.
        message: one sentence: what it does, came to, or failed at.
        results: of the last learning that was done since the server started; None before.
    """

    state: State
    fraction: float = 0.0
    message: str = ""
    results: Learned | None = None


@dataclass(frozen=True)
class LearningTask:
    """All that the process needs, picklable.

    Attributes:
        database: of the labels, as `Record.open` takes it.
        captures: place of the captures.
        folder: where the models go, made by the process and renamed by the caller.
        lesson: how labels are made into rows.
        mix: place of a set whose labels are added; None for none.
        params: how it learns.
    """

    database: str
    captures: str
    folder: Path
    lesson: LessonConfig = LessonConfig()
    mix: str | None = None
    params: LearningParams = LearningParams()


class Learner:
    """Trains in a process of its own, one training at a time, and keeps what came of each.

    Safe from several threads.

    Args:
        database: of the labels, as `Record.open` takes it.
        captures: place of the captures.
        folder: on this machine, where models are kept.
        lesson: how labels are made into rows; their lines are those of its configuration, unless
            it says others.
        params: how it learns.
    """

    def __init__(
        self,
        database: str,
        captures: str,
        folder: str | os.PathLike[str],
        lesson: LessonConfig | None = None,
        params: LearningParams | None = None,
    ) -> None:
        self.folder = Path(folder)
        lesson = LessonConfig() if lesson is None else lesson
        lines = lesson.config.candidates.lines if lesson.lines is None else lesson.lines
        self._task = LearningTask(
            database, captures, self.folder, replace(lesson, lines=lines), None,
            params or LearningParams(),
        )  # fmt: skip
        self._lock = threading.RLock()
        self._running: tuple[Background, Path] | None = None
        self._status = LearningStatus("idle")
        _remove_stale(self.folder)

    def start(self, mix: str | None = None) -> None:
        """Begin to learn; the status tells how far it is.

        Args:
            mix: place of a simulated set whose labels are added; None for none.

        Raises:
            ConfigError: it is learning already.
            MissingExtraError: an extra that training needs is not installed.
        """
        with self._lock:
            if self.status().state == "running":
                raise ConfigError("it is learning already; valid: wait for it, or cancel it")
            folder = self.folder / f"{_UNFINISHED}{uuid.uuid4().hex}"
            task = replace(self._task, folder=folder, mix=mix)
            self._running = Background(learn, task), folder
            self._status = replace(self._status, state="running", fraction=0.0, message="starting")

    def status(self) -> LearningStatus:
        """How far it is; quick, to be asked often.

        Returns:
            The status.
        """
        with self._lock:
            if self._running is None:
                return self._status
            running, folder = self._running
            if running.finished():
                self._running = None
                self._status = self._finished(running, folder)
                shutil.rmtree(folder, ignore_errors=True)
            else:
                fraction, message = _progress_in(folder)
                self._status = replace(self._status, fraction=fraction, message=message)
            return self._status

    def cancel(self) -> None:
        """End the learning at once; what was learned before stays."""
        with self._lock:
            if self._running is None:
                return
            running, folder = self._running
            self._running = None
            running.end()
            shutil.rmtree(folder, ignore_errors=True)
            said = "the learning was cancelled"
            self._status = replace(self._status, state="idle", fraction=0.0, message=said)

    def models(self) -> list[Learned]:
        """What was learned so far.

        Returns:
            By number; a damaged folder is passed over with a line in the log.
        """
        found = []
        for number in self._numbers():
            try:
                told = json.loads((self.folder_of(number) / _TOLD).read_bytes())
                found.append(build(Learned, told, f"{self.folder_of(number)}", ConfigError))
            except (OSError, ValueError, BoxgraspError) as error:
                _log.warning("passed over (damaged_models): %s: %s", self.folder_of(number), error)
        return found

    def folder_of(self, number: int) -> Path:
        """Where the models of a number are.

        Args:
            number: from 1.

        Returns:
            A folder as `models` of the configuration takes it.
        """
        return self.folder / f"{number:04d}"

    @property
    def active(self) -> int | None:
        """The number of the models in use; None for the shipped ones."""
        try:
            told = json.loads((self.folder / "active.json").read_bytes())
            number = told["number"]
        except (OSError, ValueError, KeyError, TypeError):
            return None
        known = isinstance(number, int) and (self.folder_of(number) / _TOLD).is_file()
        return number if known else None

    def activate(self, number: int | None) -> None:
        """Switch to other models, for every process that asks `active`, wholly or not at all.

        Args:
            number: of the models; None for the shipped ones.

        Raises:
            ConfigError: no usable models have that number.
            StoreError: the switch cannot be written.
        """
        usable = [item.number for item in self.models() if item.best is not None]
        if number is not None and number not in usable:
            there = ", ".join(map(str, usable)) or "none yet"
            raise ConfigError(f"no models {number}; valid: {there}, or the shipped ones")
        told = json.dumps({"number": number}).encode()
        Store(self.folder).write("active.json", told)

    def config_with(self, config: Config) -> Config:
        """A configuration that proposes by the models in use.

        Args:
            config: the user's own.

        Returns:
            With the best version of these models as ranker; the user's own where the shipped ones
            are in use.
        """
        number = self.active
        learned = next((item for item in self.models() if item.number == number), None)
        if learned is None or learned.best is None:
            return config
        return replace(config, ranker=learned.best, models=str(self.folder_of(learned.number)))

    def _numbers(self) -> list[int]:
        try:
            names = os.listdir(self.folder)
        except OSError:
            return []
        return sorted(int(name) for name in names if _NUMBER.fullmatch(name))

    def _finished(self, running: Background, folder: Path) -> LearningStatus:
        try:
            learned = self._kept(running.result(), folder)
        except (BoxgraspError, OSError) as error:
            return replace(self._status, state="failed", message=_one_line(error))
        except Exception as error:  # a fault of ours must not end the page
            _log.error("learning failed", exc_info=True)
            said = f"learning failed by a fault of boxgrasp: {_one_line(error)}"
            return replace(self._status, state="failed", message=said)
        return LearningStatus("done", 1.0, _came_to(learned), learned)

    def _kept(self, learned: Learned, folder: Path) -> Learned:
        """The folder under the next number that is free, which another server may take first."""
        for number in range(max(self._numbers(), default=0) + 1, 10**6):
            told = replace(learned, number=number)
            Store(folder).write(_TOLD, (json.dumps(plain(told), indent=1) + "\n").encode())
            (folder / "progress.json").unlink(missing_ok=True)
            try:
                os.rename(folder, self.folder_of(number))
            except OSError:
                if not self.folder_of(number).exists():
                    raise
                continue
            return told
        raise WorkError("no number is left for models; valid: 999999 at most")


def learn(task: LearningTask) -> Learned:
    """Learn from all labels that stand; in a process of its own.

    Args:
        task: what from and where to.

    Returns:
        What was learned; the models are in the task's folder.

    Raises:
        ConfigError: too few labels, or some that cannot be learned from together.
        StoreError: a capture is missing, or the models cannot be written.
        MissingExtraError: scikit-learn, onnx or pyarrow is not installed.
    """
    start = time.monotonic()
    if hasattr(os, "nice"):
        os.nice(task.params.niceness)
    progress = _Progress(task.folder)
    progress.tell("reading the labels")
    lessons = _lessons(task, progress)
    _refuse_too_few(lessons, task.params)
    held, whys = _models(lessons.taught, task, progress)
    versions = []
    for k, version in enumerate(VERSIONS):
        share = _SVMS_DONE + (1.0 - _SVMS_DONE) * k / len(VERSIONS)
        progress.tell(f"asking {version} of scenes that it never saw", share)
        parts = {svm.part: held[svm.name] for svm in SVMS if svm.version == version}
        why = whys.get(version, "")
        versions.append(_version_learned(lessons.taught, version, parts, task.params, why))
    label, lines = lessons.taught.rows["label"], lessons.taught.provenance.lines
    return Learned(
        number=0,
        made_at=datetime.now(timezone.utc).isoformat(timespec="seconds"),
        labels=lessons.labels,
        scenes=lessons.scenes,
        mixed=len(label) - lessons.labels,
        nones=int((label == help_label(lines)).sum()),
        operators=dict(lessons.operators),
        box_kinds=dict(lessons.box_kinds),
        commonest=float(np.bincount(label).max() / len(label)),
        versions=tuple(versions),
        notes=_notes(lessons, task.params),
        seconds=round(time.monotonic() - start, 1),
    )


class _Progress:
    """How far the process is, in a file that the caller reads."""

    def __init__(self, folder: Path) -> None:
        self._store = Store(folder)

    def tell(self, message: str, fraction: float = 0.0) -> None:
        said = {"fraction": round(fraction, 4), "message": message}
        self._store.write("progress.json", json.dumps(said).encode())


def _progress_in(folder: Path) -> tuple[float, str]:
    try:
        told = json.loads((folder / "progress.json").read_bytes())
        return float(told["fraction"]), str(told["message"])
    except (OSError, ValueError, KeyError, TypeError):
        return 0.0, "starting"


_ROWS_DONE: Final = 0.4  # of the whole, when all rows are made
_SVMS_DONE: Final = 0.8  # when all SVMs are trained


@dataclass(frozen=True, eq=False)
class _Telling:
    """Workers that tell of each row."""

    workers: Workers
    progress: _Progress

    def run(
        self, function: Callable[[T], R], tasks: Sequence[T]
    ) -> Generator[tuple[int, R], None, None]:
        for done, found in enumerate(self.workers.run(function, tasks), start=1):
            yield found
            said = f"reading scenes, {done} of {len(tasks)}"
            self.progress.tell(said, _ROWS_DONE * done / len(tasks))


def _lessons(task: LearningTask, progress: _Progress) -> Lessons:
    from boxgrasp.labeling.record import Record  # SQLAlchemy, in the process alone

    mix = None if task.mix is None else read_set(Store(task.mix))
    captures = CaptureStore(Store(task.captures))
    with local_workers(1) as workers, Record.open(task.database, create=False) as labels:
        telling = _Telling(workers, progress)
        return lessons_of(labels, captures, telling, task.lesson, mix=mix, title="")


def _refuse_too_few(lessons: Lessons, params: LearningParams) -> None:
    """Say what is missing, before anything fails for it.

    Raises:
        ConfigError: too few scenes, or one answer alone.
    """
    rows, lines = lessons.taught.rows, lessons.taught.provenance.lines
    scenes, answers_given = len(set(rows[SCENE_KEY].tolist())), np.unique(rows["label"])
    if scenes < params.least_scenes:
        missing = params.least_scenes - scenes
        raise ConfigError(
            f"{scenes} scenes are labeled so far; valid: at least {params.least_scenes}, one for "
            f"each part of the cross-validation (label {missing} more)"
        )
    if len(answers_given) < 2:
        name = _answer_name(int(answers_given[0]), lines)
        raise ConfigError(
            f"all {rows.count} labels say {name}; valid: at least two different answers"
        )


def _models(
    taught: Taught, task: LearningTask, progress: _Progress
) -> tuple[dict[str, tuple[float, float]], dict[str, str]]:
    """Train and write the eight; C and gamma by the SVM's name, and by version what it lacks."""
    held: dict[str, tuple[float, float]] = {}
    whys: dict[str, str] = {}
    search = _search(taught, task.params)
    for k, svm in enumerate(SVMS):
        share = _ROWS_DONE + (_SVMS_DONE - _ROWS_DONE) * k / len(SVMS)
        progress.tell(f"training {svm.name}, {k + 1} of {len(SVMS)}", share)
        try:
            kept = json.loads(trained_json(training_task(taught, svm, 0, search)))
        except ConfigError as error:
            held[svm.name] = task.params.held
            whys.setdefault(svm.version, str(error))
            continue
        held[svm.name] = kept["record"]["C"], kept["record"]["gamma"]
        Store(task.folder).write(f"{svm.name}.onnx", base64.b64decode(kept["onnx"]))
    return held, whys


def _search(taught: Taught, params: LearningParams) -> SearchParams:
    return params.search if taught.rows.count <= params.quick_above else params.quick


@dataclass(frozen=True, eq=False)
class _Folds:
    """Labeled rows in parts, of which each is asked of models that saw the others alone."""

    rows: Rows
    lines: int
    fold: Array

    @staticmethod
    def of(taught: Taught, sampling: str) -> _Folds:
        used = ("label", "given_dimensions_m", f"given_{sampling}", f"given_{sampling}_portions")
        rows = Rows({name: taught.rows[name] for name in used})
        fold = folds_of(rows["label"], FOLDS, 0, taught.rows[SCENE_KEY])
        return _Folds(rows, taught.provenance.lines, fold)

    def sizes(self, params: LearningParams) -> tuple[int, ...]:
        """How many rows are learned from, at each point of the curve."""
        most = int((len(self.fold) - np.bincount(self.fold)).min())
        least = min(params.first_size, max(most // 2, 2))
        steps = np.geomspace(least, most, params.sizes)
        return tuple(sorted({round(float(step)) for step in steps}))

    def said(self, version: str, held: Held, size: int | None) -> Array:
        """(N,) what models that learned from so many rows of the other parts answer."""
        label = self.rows["label"]
        found = np.zeros_like(label)
        for k in range(FOLDS):
            rest, asked = np.flatnonzero(self.fold != k), np.flatnonzero(self.fold == k)
            seen = rest if size is None else rest[_spread(label[rest], k)[:size]]
            models = fit_version(self.rows.take(seen), version, self.lines, held)
            found[asked] = answers(models, self.rows.take(asked))
        return found

    def shares(self, same: Array) -> Floats:
        """(FOLDS,) the share of each part that is the same."""
        return np.array([same[self.fold == k].mean() for k in range(FOLDS)])


def _spread(label: Array, seed: int) -> Array:
    """(N,) an order of rows of which every beginning has each class in its share."""
    order = np.random.default_rng(seed).permutation(len(label))
    place = np.empty(len(label))
    for one in np.unique(label):
        own = order[label[order] == one]
        place[own] = (np.arange(len(own)) + 0.5) / len(own)
    return order[np.argsort(place[order], kind="stable")]


def _version_learned(
    taught: Taught, version: str, held: Held, params: LearningParams, why: str
) -> VersionLearned:
    folds = _Folds.of(taught, version.split("-")[1])
    label, sizes = folds.rows["label"], folds.sizes(params)
    curve = [folds.shares(folds.said(version, held, size) == label) for size in sizes[:-1]]
    same = folds.said(version, held, None) == label
    curve.append(folds.shares(same))
    return VersionLearned(
        version=version,
        agreement=float(same.mean()),
        spread=float(curve[-1].std()),
        balanced=float(np.mean([same[label == one].mean() for one in np.unique(label)])),
        sizes=sizes,
        means=tuple(float(shares.mean()) for shares in curve),
        spreads=tuple(float(shares.std()) for shares in curve),
        usable=not why,
        why=why,
    )


def _notes(lessons: Lessons, params: LearningParams) -> tuple[str, ...]:
    """What the user should know: what has few labels, and where the search was coarser."""
    taught, notes = lessons.taught, list(lessons.notes)
    counts = Counter(taught.rows["label"].tolist())
    thin = [
        f"{_answer_name(one, taught.provenance.lines)} ({count})"
        for one, count in sorted(counts.items())
        if count < FOLDS
    ]
    if thin:
        each = ", ".join(thin)
        notes.append(f"answers with fewer than {FOLDS} labels are hardly learned: {each}")
    if _search(taught, params) != params.search:
        notes.append(
            "C and gamma were searched in coarser steps than `boxgrasp train --labels` does"
        )
    return tuple(notes)


def _answer_name(label: int, lines: int) -> str:
    if label == help_label(lines):
        return "none"
    return f"{face_name((label - 1) // lines + 1)} line {(label - 1) % lines + 1}"


def _came_to(learned: Learned) -> str:
    told = f"learned from {learned.labels} labels of {learned.scenes} scenes"
    if learned.mixed:
        told = f"learned from {learned.labels} labels and {learned.mixed} of a set"
    best = max(learned.versions, key=lambda item: (item.usable, item.agreement))
    return (
        f"{told}: {best.version} agrees with {best.agreement:.0%} of them "
        f"(the commonest answer alone: {learned.commonest:.0%})"
    )


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__


def _remove_stale(folder: Path) -> None:
    """What a server that was killed while it learned left behind."""
    for left in folder.glob(f"{_UNFINISHED}*"):
        with suppress(OSError):
            if time.time() - left.stat().st_mtime > _STALE_S:
                shutil.rmtree(left, ignore_errors=True)
