"""One version of the algorithm taught and tested under changed conditions, on the same scenes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np

from boxgrasp.arrays import Array, Floats
from boxgrasp.forks import cached_property
from boxgrasp.mapping.local_map import UNSEEN
from boxgrasp.ranking.model_set import ModelSet, Part
from boxgrasp.simulate.scenario import NOISES
from boxgrasp.study.conditions import OrderOf, reordered, rows_under
from boxgrasp.study.curves import Variant, fit
from boxgrasp.study.evaluation import Evaluation, obstacle_counts
from boxgrasp.study.metrics import metrics_of
from boxgrasp.study.study import Study
from boxgrasp.teaching.sets import Rows, SetConfig, make_set, read_set

DRAWS: Final = 5  # of what is random; each scene's scores are averaged over them


class Change(NamedTuple):
    """One cause, what was changed, and what came of it.

    Attributes:
        cause: in a few words.
        what: was changed.
        rows: of the test scenarios, as they were tested.
        picks: (N,) candidate indices of each draw.
        verdict: in place of one by the difference.
    """

    cause: str
    what: str
    rows: Rows
    picks: tuple[Array, ...]
    verdict: str = ""

    def scores(self, *, strict: bool = True) -> Floats:
        """The thesis's scores, averaged over the draws.

        Args:
            strict: as `scores_of` takes it.

        Returns:
            (N,) from 0 to 1, NaN for no answer.
        """
        each = [scores_of(self.rows, picks, strict=strict) for picks in self.picks]
        return np.asarray(np.mean(each, axis=0))


@dataclass(frozen=True, eq=False)
class Scenes:
    """What is taught and tested with, as cast and under every condition.

    Attributes:
        labels: rows that teach.
        tested: the first test scenarios, none of an empty table.
        labels_under: by condition, of the maps' readings.
        tested_under: likewise.
        noisy: the tested ones by the sensor's noise, each that they were not cast with.
        empty: tables with the target alone.
        empty_share: of the tables, where 0 to 4 obstacles are equally likely.
    """

    labels: Rows
    tested: Rows
    labels_under: Mapping[str, Rows]
    tested_under: Mapping[str, Rows]
    noisy: Mapping[str, Rows]
    empty: Rows
    empty_share: float

    @staticmethod
    def of(study: Study) -> Scenes:
        """Cast what a study lacks.

        Args:
            study: whose labels and test scenarios they are.

        Returns:
            All of them.

        Raises:
            ConfigError: the place holds them cast otherwise.
            StoreError: the study's place cannot be read or written.
            WorkError: workers were lost.
        """
        own, count = study.sets()["tested"], min(study.scale.causes, study.rows("tested").count)
        noises = [name for name in NOISES if name != own.rows.recipe.noise]
        noisy = {name: _noisy(study, name, count) for name in noises}
        labels = study.rows("labels").answered
        first = study.rows("tested").take(np.arange(count))
        which = (first["given_error"] == "") & (obstacle_counts(first) > 0)
        tested = first.take(which)
        mixed = study.rows("tested-empty").answered
        empty = obstacle_counts(mixed) == 0
        where = study.store, study.workers
        return Scenes(
            labels,
            tested,
            rows_under(*where, "labels", study.sets()["labels"].rows, labels),
            rows_under(*where, "tested", own.rows, tested),
            {name: rows.take(which) for name, rows in noisy.items()},
            mixed.take(empty),
            float(empty.mean()),
        )


@dataclass(frozen=True, eq=False)
class Trial:
    """One version of the algorithm, taught and tested under conditions.

    Attributes:
        scenes: what it is taught and tested with.
        variant: the version.
        held: C and gamma by part.
        seed: of what is random.
    """

    scenes: Scenes
    variant: Variant
    held: Mapping[Part, tuple[float, float]]
    seed: int

    @cached_property
    def model_set(self) -> ModelSet:
        """The version as it is taught."""
        return self.taught(self.scenes.labels)

    @cached_property
    def usual(self) -> Change:
        """The version, nothing changed."""
        return self.change("the baseline", "", self.scenes.tested)

    def taught(self, labels: Rows) -> ModelSet:
        """The version taught with other rows.

        Args:
            labels: that teach.

        Returns:
            The fitted classifiers.
        """
        return fit(labels, self.variant, self.held)

    def change(
        self, cause: str, what: str, rows: Rows, model_set: ModelSet | None = None
    ) -> Change:
        """What a model set takes.

        Args:
            cause: in a few words.
            what: is changed.
            rows: of the test scenarios.
            model_set: None for the one that is taught as usual.

        Returns:
            The change.
        """
        return Change(cause, what, rows, (picks_of(model_set or self.model_set, rows),))

    def reordered_picks(self, order_of: OrderOf) -> Array:
        """What the version takes when the samples come in another order in testing.

        Args:
            order_of: as `reordered` takes it.

        Returns:
            (N,) candidate indices.
        """
        rows = reordered(self.scenes.tested, self.variant.sampling, order_of)
        return picks_of(self.model_set, rows)

    @cached_property
    def permuted_picks(self) -> tuple[Array, ...]:
        """(N,) candidate indices of each draw of a permutation, the same for every version."""
        found = []
        for k in range(DRAWS):
            rng = np.random.default_rng((self.seed, k))

            def order_of(points: Floats, rng: np.random.Generator = rng) -> Array:
                return rng.permutation(len(points))

            found.append(self.reordered_picks(order_of))
        return tuple(found)

    @cached_property
    def blind_picks(self) -> Array:
        """(N,) candidate indices that the version takes when no sample tells anything."""
        whole = f"given_{self.variant.sampling}"
        unseen = {
            name: np.full_like(self.scenes.tested[name], UNSEEN)
            for name in (whole, f"{whole}_portions")
        }
        return picks_of(self.model_set, Rows({**self.scenes.tested.columns, **unseen}))


def mislabeled(label: Array, share: float, rng: np.random.Generator, candidates: int = 15) -> Array:
    """Labels of which some are replaced by another candidate at random.

    Args:
        label: (N,) from 1.
        share: of the labels, 0 to 1.
        rng: draws which, and by what.
        candidates: how many there are.

    Returns:
        (N,) from 1.
    """
    found = np.array(label)
    which = rng.choice(len(found), round(share * len(found)), replace=False)
    step = rng.integers(1, candidates, len(which))
    found[which] = (found[which] - 1 + step) % candidates + 1
    return found


def picks_of(model_set: ModelSet, rows: Rows) -> Array:
    """The first choices of a model set.

    Args:
        model_set: any.
        rows: of a set.

    Returns:
        (N,) candidate indices, `ASK` for none.
    """
    return Evaluation(rows, {"own": model_set}).picks("own")


def scores_of(rows: Rows, picks: Array, *, strict: bool = True) -> Floats:
    """The thesis's scores by the visible cloud.

    Args:
        rows: of a set.
        picks: (N,) candidate indices, `ASK` for none.
        strict: a face wider than the opening is no grasp, and scores 0.

    Returns:
        (N,) from 0 to 1, NaN for no answer.
    """
    metrics = metrics_of(rows, "given", picks)
    return metrics.score if strict else metrics.clearance_score


def _noisy(study: Study, noise: str, count: int) -> Rows:
    """The first test scenarios by another noise: those of a set of the study, or cast."""
    made = study.sets()
    known = made.get(f"tested-{noise}")
    if known is not None and known.count >= count:
        return study.rows(f"tested-{noise}").take(np.arange(count))
    own = made["tested"].rows
    rows = replace(own, recipe=replace(own.recipe, noise=noise), target_sources=("given",))
    prefix = f"causes/{noise}/"
    config = SetConfig(rows, count)
    make_set(study.store, prefix, config, study.workers, f"cast {noise}", may_grow=False)
    return read_set(study.store, prefix)[1]
