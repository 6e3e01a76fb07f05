"""What every ranker picks in every row, without casting anything again.

Bare is the thesis's answer: the first choice of a ranker. Checked is the package's: the first that
passes every check.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from boxgrasp.arrays import Array
from boxgrasp.errors import ModelError
from boxgrasp.forks import cached_property
from boxgrasp.grasps.candidates import LINES, candidates_of
from boxgrasp.grasps.checks import CheckResult
from boxgrasp.grasps.gripper import Gripper
from boxgrasp.ranking.model_set import VERSIONS, ModelSet, help_label, model_set_of, read_models
from boxgrasp.ranking.ranker import SHIPPED, RankingContext, ranker_named
from boxgrasp.simulate.scenario import targets_of
from boxgrasp.study.metrics import (
    ASK,
    Chance,
    Metrics,
    category_counts,
    chance_of,
    largest_visible_m,
    metrics_of,
)
from boxgrasp.teaching.rows import CHECK_FLAGS, CHECK_VALUES, box_of
from boxgrasp.teaching.samples import sampled_scenes
from boxgrasp.teaching.sets import Rows

PLAIN = tuple(name for name in SHIPPED if name not in VERSIONS)  # need no model
RANKERS = (*PLAIN, *VERSIONS)
_HAND = Gripper()  # the one that every row was made with


class Reader(Protocol):
    """Where files are read from."""

    def read(self, name: str) -> bytes:
        """What is kept under a name.

        Args:
            name: relative path.

        Returns:
            Its bytes.
        """


def model_sets_in(store: Reader, prefix: str = "") -> dict[str, ModelSet]:
    """The models of the four versions from a place.

    Args:
        store: where it is.
        prefix: of the names there.

    Returns:
        By version.

    Raises:
        ModelError: a file that is no such model, or does not fit the features or the other parts.
        StoreError: one that is not there.
        MissingExtraError: onnxruntime is not installed.
    """

    def read(name: str) -> bytes:
        return store.read(prefix + name)

    return {version: model_set_of(read_models(version, read)) for version in VERSIONS}


def model_order(model_set: ModelSet, rows: Mapping[str, Array], target_source: str) -> Array:
    """The order that trained models give.

    Args:
        model_set: of one version.
        rows: columns by name.
        target_source: `given` or `found`.

    Returns:
        (N, 5 l) candidate indices, best first.
    """
    return model_set.order(sampled_scenes(rows, target_source, model_set.sampling)).labels - 1


def plain_order(
    name: str, rows: Mapping[str, Array], target_source: str, lines: int = LINES
) -> Array:
    """The order of a ranker that needs no model.

    Args:
        name: of the ranker.
        rows: columns by name.
        target_source: `given` or `found`.
        lines: l, lines a face.

    Returns:
        (N, 5 l) candidate indices, best first.

    Raises:
        ConfigError: no ranker has the name.
    """
    ranker = ranker_named(name)
    contexts = (_context(rows, target_source, k, lines) for k in range(len(rows["number"])))
    return np.array([ranker.rank(context).order for context in contexts])


def first_choice(ordered: Array) -> Array:
    """The first of each order: the thesis.

    Args:
        ordered: (N, 5 l) candidate indices, best first.

    Returns:
        (N,) candidate indices.
    """
    return np.asarray(ordered[:, 0])


def first_passing(ordered: Array, passes: Array) -> Array:
    """The first of each order that passes every check.

    Args:
        ordered: (N, 5 l) candidate indices, best first.
        passes: (N, 5 l) bool, in the order of the labels.

    Returns:
        (N,) candidate indices, `ASK` where none passes.
    """
    passing = np.take_along_axis(passes, ordered, axis=1)
    first = ordered[np.arange(len(ordered)), passing.argmax(axis=1)]
    return np.where(passing.any(axis=1), first, ASK)


def obstacle_counts(rows: Rows) -> Array:
    """How many obstacles stand in each row's scene.

    Args:
        rows: of a set.

    Returns:
        (N,) int64.
    """
    return np.array([len(json.loads(str(scene))["obstacles"]) for scene in rows["scene"]], np.int64)


@dataclass(frozen=True, eq=False)
class Evaluation:
    """A set's rows, and what every ranker picks in them; kept once found.

    Attributes:
        rows: of the set.
        model_sets: trained models by the ranker's name.
        commonest: the candidate that the operator took most often in training, which `picks`
            knows as `commonest`; None where it is not asked for.
    """

    rows: Rows
    model_sets: Mapping[str, ModelSet]
    commonest: int | None = None
    _orders: dict[tuple[str, str], tuple[Array, Array]] = field(default_factory=dict)

    def order(self, ranker: str, target_source: str = "given") -> Array:
        """What a ranker prefers.

        Args:
            ranker: its name; `operator` for the labels, `commonest` for the most common class.
            target_source: `given` or `found`.

        Returns:
            (N, 5 l) candidate indices, best first; rows without an answer are in label order.

        Raises:
            ModelError: models trained for another number of lines.
        """
        return self._answers(ranker, target_source)[0]

    def _answers(self, ranker: str, target_source: str) -> tuple[Array, Array]:
        """The order of each row, and whether help is asked for in place of it."""
        key = ranker, target_source
        if key not in self._orders:
            self._orders[key] = self._ordered(ranker, target_source)
        return self._orders[key]

    def _ordered(self, ranker: str, target_source: str) -> tuple[Array, Array]:
        count = self.rows[f"{target_source}_passes"].shape[1]
        every = np.tile(np.arange(count), (self.rows.count, 1))
        asks = np.zeros(self.rows.count, dtype=np.bool_)
        if ranker == "operator":
            asks = self.rows["label"] == help_label(count // 5)
            every[:, 0] = np.where(asks, 0, self.rows["label"] - 1)
            return every, asks
        if ranker == "commonest" and self.commonest is not None:
            every[:, 0] = self.commonest
            return every, asks
        answered = self.answered(target_source)
        rows = self.rows.take(answered)
        model_set = self.model_sets.get(ranker)
        if model_set is None:
            every[answered] = plain_order(ranker, rows, target_source, count // 5)
            return every, asks
        if 5 * model_set.lines != count:
            raise ModelError(
                f"{ranker} was trained for {model_set.lines} lines a face, the set has "
                f"{count // 5}; valid: models trained for as many (--models DIR)"
            )
        found = model_set.order(sampled_scenes(rows, target_source, model_set.sampling))
        every[answered], asks[answered] = found.labels - 1, found.asks
        return every, asks

    def answered(self, target_source: str) -> Array:
        """Which rows have an answer.

        Args:
            target_source: `given` or `found`.

        Returns:
            (N,) bool, whether the target was found.
        """
        return np.asarray(self.rows[f"{target_source}_error"] == "")

    def picks(self, ranker: str, target_source: str = "given", *, checked: bool = False) -> Array:
        """The candidate that a ranker takes.

        Args:
            ranker: as `order` takes it.
            target_source: `given` or `found`.
            checked: the first that passes every check, in place of the first choice.

        Returns:
            (N,) candidate indices, `ASK` for none.

        Raises:
            ModelError: models trained for another number of lines.
        """
        ordered, asks = self._answers(ranker, target_source)
        passes = self.rows[f"{target_source}_passes"]
        found = first_passing(ordered, passes) if checked else first_choice(ordered)
        return np.where(self.answered(target_source) & ~asks, found, ASK)

    def metrics(
        self, ranker: str, target_source: str = "given", *, checked: bool = False
    ) -> Metrics:
        """What a ranker's picks come to.

        Args:
            ranker: as `picks` takes it.
            target_source: as `picks` takes it.
            checked: as `picks` takes it.

        Returns:
            The numbers of each row.

        Raises:
            ModelError: models trained for another number of lines.
        """
        picks = self.picks(ranker, target_source, checked=checked)
        return metrics_of(self.rows, target_source, picks)

    def category_counts(
        self, ranker: str, which: Array | slice = slice(None), *, any_width: bool = False
    ) -> tuple[int, int, int]:
        """How many first choices are of each category by the visible cloud (3-4).

        Args:
            ranker: as `picks` takes it.
            which: (N,) bool, or indices of rows; all of them unless told.
            any_width: by distance alone; else a face that is too wide is red.

        Returns:
            Red, yellow, green.

        Raises:
            ModelError: models trained for another number of lines.
        """
        metrics = self.metrics(ranker)
        if any_width:
            clearance_m = metrics.visible_m
            largest_m = self.rows["given_thesis_clearance_m"].max(axis=1)
        else:
            clearance_m = np.where(metrics.too_wide, 0.0, metrics.visible_m)
            largest_m = largest_visible_m(self.rows, "given")
        return category_counts(clearance_m[which], largest_m[which])

    def take(self, which: Array) -> Evaluation:
        """The evaluation of some rows.

        Args:
            which: (N,) bool, or indices.

        Returns:
            Another one.
        """
        return Evaluation(self.rows.take(which), self.model_sets, self.commonest)

    @cached_property
    def chance(self) -> Chance:
        """What a candidate drawn at random comes to, the target's points given."""
        return chance_of(self.rows)

    @cached_property
    def known(self) -> Array:
        """(N,) whether the target is one of the training's."""
        return np.isin(self.rows["target"], targets_of("known"))


def _context(rows: Mapping[str, Array], target_source: str, k: int, lines: int) -> RankingContext:
    """What a ranker that needs no model reads of row k; limits are not kept, so 0 stands there."""

    def of(name: str) -> Array:
        return np.asarray(rows[f"{target_source}_{name}"][k])

    box = box_of(of("box"), of("dimensions_m"))
    results = {check: CheckResult.at_least(of(name), 0.0) for name, check in CHECK_VALUES.items()}
    results |= {check: CheckResult.yes_no(of(name)) for name, check in CHECK_FLAGS.items()}
    return RankingContext(box, candidates_of(box, _HAND, lines), results, {})
