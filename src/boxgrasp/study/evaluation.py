"""What every ranker picks in every row, bare and checked, without casting anything again."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Protocol

import numpy as np

from boxgrasp.arrays import Array, Floats, Points
from boxgrasp.errors import ModelError
from boxgrasp.grasps.candidates import candidates_of
from boxgrasp.grasps.checks import Numbers
from boxgrasp.grasps.gripper import Gripper
from boxgrasp.ranking.onnx.model import Model, cascaded, load_model, ranked
from boxgrasp.ranking.onnx.record import validate_fits
from boxgrasp.ranking.ranker import RankerSetup, RankingContext, ranker_named
from boxgrasp.ranking.sampling import is_side
from boxgrasp.simulate.scenario import targets_of
from boxgrasp.study.metrics import ASK, Metrics, categories, metrics_of
from boxgrasp.teaching.matrices import FACES, line_matrix, single_matrix
from boxgrasp.teaching.rows import box_of
from boxgrasp.teaching.sets import Rows
from boxgrasp.teaching.train import SVMS, Part, Svm

VERSIONS = ("single-spiral", "cascade-spiral", "single-grid", "cascade-grid")
PLAIN = ("clearance", "top-down", "random")


class Decider(Protocol):
    """A trained classifier: its classes, and for each row a prediction and a value a class."""

    @property
    def classes(self) -> tuple[int, ...]:
        """Classes as trained."""

    def decide(self, X: Points) -> tuple[Array, Floats]:
        """(N,) predictions and (N, K) decision values."""


class Reader(Protocol):
    """Where files are read from."""

    def read(self, name: str) -> bytes:
        """Bytes by name."""


@dataclass(frozen=True)
class ModelSet:
    """The deciders of one version by part (single, or face, side and top), and how it was made."""

    sampling: str
    edge_m: float | None
    parts: Mapping[Part, Decider]
    lines: int = 3


def model_set_of(version: str, store: Reader, prefix: str = "") -> ModelSet:
    """The version's models from a place.

    Raises:
        ModelError: a file that is no such model, or does not fit the features or the other parts.
        StoreError: one that is not there.
    """
    svms = [svm for svm in SVMS if svm.version == version]
    models = [_model(store.read(f"{prefix}{svm.name}.onnx"), svm) for svm in svms]
    parts: dict[Part, Decider] = {svm.part: model for svm, model in zip(svms, models, strict=True)}
    made = sorted({(model.record.lines, model.record.largest_edge_m or 0.0) for model in models})
    if len(made) > 1:
        raise ModelError(
            f"parts of {version} were trained apart (lines and longest edge: {made}); valid: parts "
            "of one training"
        )
    record = models[0].record
    return ModelSet(svms[0].sampling, record.largest_edge_m, parts, record.lines)


def _model(data: bytes, svm: Svm) -> Model:
    try:
        model = load_model(data)
        if model.record.name != svm.name:
            raise ModelError(f"holds {model.record.name}; valid: {svm.name}")
        validate_fits(model.record, svm.schema)
    except ModelError as error:
        raise ModelError(f"{svm.name}.onnx: {error}") from None
    return model


def order(model_set: ModelSet, rows: Mapping[str, Array], target_source: str) -> Array:
    """(N, 5 l) candidate indices, best first, as the SVM rankers order them."""
    every = single_matrix(rows, target_source, model_set.sampling, model_set.edge_m)
    if "single" in model_set.parts:
        return _ranks(model_set.parts["single"], every, 5 * model_set.lines) - 1
    faces = _ranks(model_set.parts["face"], every, 5)
    lines = np.stack([_lines(model_set, rows, target_source, face) for face in FACES], axis=1)
    return cascaded(faces, lines) - 1


def _lines(model_set: ModelSet, rows: Mapping[str, Array], target_source: str, face: int) -> Array:
    """(N, l) lines of one face, best first."""
    X = line_matrix(rows, target_source, model_set.sampling, model_set.edge_m, face)
    return _ranks(model_set.parts["side" if is_side(face) else "top"], X, model_set.lines)


def _ranks(decider: Decider, X: Points, count: int) -> Array:
    return ranked(*decider.decide(X), decider.classes, range(1, count + 1))


def plain_order(name: str, rows: Mapping[str, Array], target_source: str, lines: int = 3) -> Array:
    """(N, 5 l) candidate indices of a ranker that needs no model."""
    ranker = ranker_named(name, RankerSetup())
    return np.array(
        [
            ranker.rank(_situation(rows, target_source, k, lines)).order
            for k in range(len(rows["number"]))
        ]
    )


def bare(ordered: Array) -> Array:
    """(N,) the first of each order: the thesis."""
    return np.asarray(ordered[:, 0])


def checked(ordered: Array, passes: Array) -> Array:
    """(N,) the first of each order that passes the check, -1 where none does."""
    passing = np.take_along_axis(passes, ordered, axis=1)
    first = ordered[np.arange(len(ordered)), passing.argmax(axis=1)]
    return np.where(passing.any(axis=1), first, ASK)


_HAND = Gripper()  # the one that every row was made with
RANKERS = (*PLAIN, *VERSIONS)


@dataclass(frozen=True, eq=False)
class Evaluation:
    """A set's rows, what every ranker picks in them, and what that is worth; kept once found."""

    rows: Rows
    model_sets: Mapping[str, ModelSet]
    _orders: dict[tuple[str, str], Array] = field(default_factory=dict)

    def order(self, ranker: str, target_source: str = "given") -> Array:
        """(N, 5 l) candidate indices, best first; rows that were not seen are in label order.

        Raises:
            ModelError: models trained for another number of lines.
        """
        key = ranker, target_source
        if key not in self._orders:
            seen = self.rows.take(self.seen(target_source))
            count = self.rows[f"{target_source}_passes"].shape[1]
            model_set = self.model_sets.get(ranker)
            if model_set is not None and 5 * model_set.lines != count:
                raise ModelError(
                    f"{ranker} was trained for {model_set.lines} lines a face, the set has "
                    f"{count // 5}; valid: models trained for as many (--models DIR)"
                )
            every = np.tile(np.arange(count), (self.rows.count, 1))
            if model_set is not None:
                every[self.seen(target_source)] = order(model_set, seen, target_source)
            elif ranker == "operator":
                every[:, 0] = self.rows["label"] - 1
            else:
                every[self.seen(target_source)] = plain_order(
                    ranker, seen, target_source, count // 5
                )
            self._orders[key] = every
        return self._orders[key]

    def seen(self, target_source: str) -> Array:
        """(N,) whether the target_source found its target."""
        return np.asarray(self.rows[f"{target_source}_error"] == "")

    def picks(self, ranker: str, target_source: str = "given", check: bool = False) -> Array:
        """(N,) the candidate that a ranker takes, bare or checked; -1 for none."""
        ordered = self.order(ranker, target_source)
        found = checked(ordered, self.rows[f"{target_source}_passes"]) if check else bare(ordered)
        return np.where(self.seen(target_source), found, ASK)

    def metrics(self, ranker: str, target_source: str = "given", check: bool = False) -> Metrics:
        """What the picks are metrics."""
        return metrics_of(self.rows, target_source, self.picks(ranker, target_source, check))

    def categories(self, ranker: str, which: Array | slice = slice(None)) -> tuple[int, int, int]:
        """How many bare picks of some rows are red, yellow, green by the visible cloud (3-4)."""
        best = self.rows["given_visible_m"].max(axis=1)
        return categories(self.metrics(ranker).visible_m[which], best[which])

    def take(self, which: Array) -> Evaluation:
        """The evaluation of some rows."""
        return Evaluation(self.rows.take(which), self.model_sets)

    @cached_property
    def known(self) -> Array:
        """(N,) whether the target is one of the training's."""
        return np.isin(self.rows["target"], targets_of("known"))


def _situation(rows: Mapping[str, Array], target_source: str, k: int, lines: int) -> RankingContext:
    box = box_of(rows[f"{target_source}_box"][k], rows[f"{target_source}_dimensions_m"][k])
    count = 5 * lines
    unknown = np.full(count, -1)

    def of(name: str) -> Array:
        return np.asarray(rows[f"{target_source}_{name}"][k])

    numbers = Numbers(
        visible_clearance_m=of("visible_clearance_m"),
        occluded_clearance_m=of("occluded_clearance_m"),
        unseen_distance_m=of("unseen_distance_m"),
        unseen_fraction=of("unseen_fraction"),
        plane_clearance_m=of("plane_clearance_m"),
        approach_clearance_m=of("approach_clearance_m"),
        fits=of("fits"),
        known=of("known"),
        nearest=unknown,
        nearest_on_way=unknown,
    )
    return RankingContext(box, candidates_of(box, _HAND, lines), numbers, {})
