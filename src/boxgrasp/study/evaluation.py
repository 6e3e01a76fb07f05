"""What every chooser picks in every row, bare and checked, without casting anything again."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Protocol

import numpy as np

from boxgrasp.arrays import Array, Floats, Points
from boxgrasp.errors import ModelError
from boxgrasp.grasps.candidates import options_of
from boxgrasp.grasps.checks import Numbers
from boxgrasp.grasps.gripper import Gripper
from boxgrasp.ranking.onnx.model import Model, cascaded, load_model, ranked
from boxgrasp.ranking.onnx.record import check_fits
from boxgrasp.ranking.ranker import Setup, Situation, chooser_named
from boxgrasp.ranking.sampling import is_side
from boxgrasp.simulate.scenario import targets_of
from boxgrasp.study.metrics import ASK, Worth, categories, worth
from boxgrasp.teaching.matrices import FACES, line_matrix, single_matrix
from boxgrasp.teaching.rows import box_of
from boxgrasp.teaching.sets import Rows
from boxgrasp.teaching.train import EIGHT, Part, Svm

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
class Brain:
    """The deciders of one version by part (single, or face, side and top), and how it was made."""

    sampling: str
    edge_m: float | None
    parts: Mapping[Part, Decider]
    lines: int = 3


def brain_of(version: str, store: Reader, prefix: str = "") -> Brain:
    """The version's models from a place.

    Raises:
        ModelError: a file that is no such model, or does not fit the features or the other parts.
        StoreError: one that is not there.
    """
    svms = [svm for svm in EIGHT if svm.version == version]
    models = [_model(store.read(f"{prefix}{svm.name}.onnx"), svm) for svm in svms]
    parts: dict[Part, Decider] = {svm.part: model for svm, model in zip(svms, models, strict=True)}
    made = sorted({(model.record.lines, model.record.largest_edge_m or 0.0) for model in models})
    if len(made) > 1:
        raise ModelError(
            f"parts of {version} were trained apart (lines and longest edge: {made}); valid: parts "
            "of one training"
        )
    record = models[0].record
    return Brain(svms[0].sampling, record.largest_edge_m, parts, record.lines)


def _model(data: bytes, svm: Svm) -> Model:
    try:
        model = load_model(data)
        if model.record.name != svm.name:
            raise ModelError(f"holds {model.record.name}; valid: {svm.name}")
        check_fits(model.record, svm.schema)
    except ModelError as error:
        raise ModelError(f"{svm.name}.onnx: {error}") from None
    return model


def order(brain: Brain, rows: Mapping[str, Array], sight: str) -> Array:
    """(N, 5 l) option indices, best first, as the SVM choosers order them."""
    every = single_matrix(rows, sight, brain.sampling, brain.edge_m)
    if "single" in brain.parts:
        return _ranks(brain.parts["single"], every, 5 * brain.lines) - 1
    faces = _ranks(brain.parts["face"], every, 5)
    lines = np.stack([_lines(brain, rows, sight, face) for face in FACES], axis=1)
    return cascaded(faces, lines) - 1


def _lines(brain: Brain, rows: Mapping[str, Array], sight: str, face: int) -> Array:
    """(N, l) lines of one face, best first."""
    X = line_matrix(rows, sight, brain.sampling, brain.edge_m, face)
    return _ranks(brain.parts["side" if is_side(face) else "top"], X, brain.lines)


def _ranks(decider: Decider, X: Points, count: int) -> Array:
    return ranked(*decider.decide(X), decider.classes, range(1, count + 1))


def plain_order(name: str, rows: Mapping[str, Array], sight: str, lines: int = 3) -> Array:
    """(N, 5 l) option indices of a chooser that needs no model."""
    chooser = chooser_named(name, Setup())
    return np.array(
        [
            chooser.prefer(_situation(rows, sight, k, lines)).order
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
CHOOSERS = (*PLAIN, *VERSIONS)


@dataclass(frozen=True, eq=False)
class Board:
    """A set's rows, what every chooser picks in them, and what that is worth; kept once found."""

    rows: Rows
    brains: Mapping[str, Brain]
    _orders: dict[tuple[str, str], Array] = field(default_factory=dict)

    def order(self, chooser: str, sight: str = "given") -> Array:
        """(N, 5 l) option indices, best first; rows that were not seen are in label order.

        Raises:
            ModelError: models trained for another number of lines.
        """
        key = chooser, sight
        if key not in self._orders:
            seen = self.rows.take(self.seen(sight))
            count = self.rows[f"{sight}_passes"].shape[1]
            brain = self.brains.get(chooser)
            if brain is not None and 5 * brain.lines != count:
                raise ModelError(
                    f"{chooser} was trained for {brain.lines} lines a face, the set has "
                    f"{count // 5}; valid: models trained for as many (--models DIR)"
                )
            every = np.tile(np.arange(count), (self.rows.count, 1))
            if brain is not None:
                every[self.seen(sight)] = order(brain, seen, sight)
            elif chooser == "operator":
                every[:, 0] = self.rows["label"] - 1
            else:
                every[self.seen(sight)] = plain_order(chooser, seen, sight, count // 5)
            self._orders[key] = every
        return self._orders[key]

    def seen(self, sight: str) -> Array:
        """(N,) whether the sight found its target."""
        return np.asarray(self.rows[f"{sight}_error"] == "")

    def picks(self, chooser: str, sight: str = "given", check: bool = False) -> Array:
        """(N,) the option that a chooser takes, bare or checked; -1 for none."""
        ordered = self.order(chooser, sight)
        found = checked(ordered, self.rows[f"{sight}_passes"]) if check else bare(ordered)
        return np.where(self.seen(sight), found, ASK)

    def worth(self, chooser: str, sight: str = "given", check: bool = False) -> Worth:
        """What the picks are worth."""
        return worth(self.rows, sight, self.picks(chooser, sight, check))

    def categories(self, chooser: str, which: Array | slice = slice(None)) -> tuple[int, int, int]:
        """How many bare picks of some rows are red, yellow, green by the visible cloud (3-4)."""
        best = self.rows["given_visible_m"].max(axis=1)
        return categories(self.worth(chooser).visible_m[which], best[which])

    def take(self, which: Array) -> Board:
        """The board of some rows."""
        return Board(self.rows.take(which), self.brains)

    @cached_property
    def known(self) -> Array:
        """(N,) whether the target is one of the training's."""
        return np.isin(self.rows["target"], targets_of("known"))


def _situation(rows: Mapping[str, Array], sight: str, k: int, lines: int) -> Situation:
    box = box_of(rows[f"{sight}_box"][k], rows[f"{sight}_dimensions_m"][k])
    count = 5 * lines
    unknown = np.full(count, -1)

    def of(name: str) -> Array:
        return np.asarray(rows[f"{sight}_{name}"][k])

    numbers = Numbers(
        seen_m=of("seen_m"),
        body_m=of("body_m"),
        unseen_m=of("unseen_m"),
        unseen_share=of("unseen_share"),
        support_m=of("support_m"),
        approach_m=of("approach_m"),
        fits=of("fits"),
        known=of("known"),
        nearest=unknown,
        nearest_on_way=unknown,
    )
    return Situation(box, options_of(box, _HAND, lines), numbers, {})
