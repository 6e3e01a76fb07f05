"""The thesis's study: which sets are cast, which SVMs are trained, and where each is kept.

Sets of different scenes have streams of their own, `seed * 1000 + k`: none tests on what it
learned from. Variants of a set (noise, runs, lines) show the same scenes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from boxgrasp.arrays import Array
from boxgrasp.errors import ConfigError
from boxgrasp.execution import Store, Workers, finish
from boxgrasp.forks import cached_property
from boxgrasp.ranking.model_set import SVMS, ModelSet
from boxgrasp.simulate.scenario import Recipe, targets_of
from boxgrasp.study.again import again_part, read_again
from boxgrasp.study.evaluation import Evaluation, model_sets_in
from boxgrasp.teaching.rows import RowConfig
from boxgrasp.teaching.sets import Rows, SetConfig, make_set, read_set
from boxgrasp.teaching.train import taught_by_set, train_svms

STREAMS = 1000
AGAIN_ROWS = 40  # scenes a task


@dataclass(frozen=True)
class Scale:
    """How much is cast; the defaults are the thesis's counts and the larger ones beside them.

    Attributes:
        labels: rows that teach.
        tested: test scenarios.
        first: of them, as many as the thesis had.
        need: scenes that need a line off the center.
        central: scenes without a valid candidate on a central line.
        real: scenes of the stand-in for the real world.
        ad_hoc: of them, scenes that need a line off the center.
        causes: test scenarios that causes of the thesis's spiral scores are tried on.
        runs: how often each scene of the stand-in is seen.
        fused: frames in the map of the fused ones.
        full: the parts below too.
        real_once: scenes of the stand-in that are seen once.
        most_labels: rows that teach at most.
        curve_tested: test scenarios of the curves and of the variants of the test set.
    """

    labels: int = 800
    tested: int = 2000
    first: int = 120
    need: int = 200
    central: int = 100
    real: int = 42
    ad_hoc: int = 10
    runs: int = 10
    causes: int = 400
    fused: int = 10
    full: bool = False
    real_once: int = 2000
    most_labels: int = 3200
    curve_tested: int = 500

    def fully(self, full: bool) -> Scale:
        """The same with or without what `full` adds.

        Args:
            full: as `Scale.full`.

        Returns:
            Another one.
        """
        return replace(self, full=full)


SMALL = Scale(
    labels=80, tested=96, first=24, need=12, central=8, real=4, ad_hoc=2, runs=3, fused=2,
    causes=48, real_once=20, most_labels=160, curve_tested=48,
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Study:
    """A study at a place; what is finished there is not made again.

    Attributes:
        store: the place.
        workers: who works.
        seed: of all its sets.
        scale: how much is cast.

    Raises:
        ConfigError: a negative seed.
    """

    store: Store
    workers: Workers
    seed: int = 1
    scale: Scale = Scale()
    _rows: dict[str, Rows] = field(default_factory=dict)
    _evaluations: dict[str, Evaluation] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise ConfigError(f"seed is {self.seed}; valid: 0 or more")

    def sets(self) -> dict[str, SetConfig]:
        """Every set of the study.

        Returns:
            By name.
        """
        n = self.scale
        known, every = targets_of("known"), targets_of("all")
        real = targets_of("real", "real")
        tight = (4, 4)
        taught, asked = Recipe(known), Recipe(every)
        robot = Recipe(real, objects="real", noise="strong")
        ad_hoc = replace(robot, obstacles=tight, wish="off-center")
        given = ("given",)
        found = {
            "labels": self._set(1, taught, n.labels),
            "tested": self._set(2, asked, n.tested),
            "tested-xtion": self._set(
                2, replace(asked, noise="xtion"), n.curve_tested, target_sources=given
            ),
            "tested-empty": self._set(
                9, replace(asked, obstacles=(0, 4)), n.curve_tested, target_sources=given
            ),
            "need": self._set(3, replace(asked, obstacles=tight, wish="off-center"), n.need),
            "central": self._set(4, replace(asked, obstacles=tight, wish="no-central"), n.central),
            "real": self._set(5, robot, n.real, runs=n.runs, stride=2),
            "real-clean": self._set(5, replace(robot, noise="none"), n.real, stride=2),
            "real-every-point": self._set(5, robot, n.real, runs=n.runs, stride=1),
            "real-fused": self._set(
                5, robot, n.real, runs=n.runs, stride=2, frames=n.fused, target_sources=given
            ),
            "ad-hoc": self._set(6, ad_hoc, n.ad_hoc, runs=n.runs, stride=2),
        }
        if n.full:
            more = n.most_labels - n.labels
            found |= {
                "real-once": self._set(7, robot, n.real_once, stride=2),
                "more-labels": self._set(8, taught, more, target_sources=given),
                "mirrored": self._set(
                    1, replace(taught, mirrored=True), n.labels, target_sources=given
                ),
            }
            for lines in (1, 5, 7):
                found[f"labels-{lines}"] = self._set(
                    1, taught, n.labels, lines=lines, target_sources=given
                )
                found[f"tested-{lines}"] = self._set(
                    2, asked, n.curve_tested, lines=lines, target_sources=given
                )
        return found

    def _set(self, stream: int, recipe: Recipe, count: int, **how: Any) -> SetConfig:
        rows = RowConfig(recipe, self.seed * STREAMS + stream, **how)
        return SetConfig(rows, count * rows.runs)

    def cast(self) -> None:
        """Cast every set that is not there yet.

        Raises:
            ConfigError: the place holds a study made otherwise.
            StoreError: the place cannot be read or written.
            WorkError: workers were lost.
        """
        for name, config in self.sets().items():
            make_set(
                self.store, f"sets/{name}/", config, self.workers, f"cast {name}", may_grow=False
            )

    def rows(self, name: str) -> Rows:
        """The rows of a set.

        Args:
            name: of the set.

        Returns:
            Its rows.

        Raises:
            ConfigError: it is not cast yet.
            StoreError: the place cannot be read.
        """
        if name not in self._rows:
            self._rows[name] = read_set(self.store, f"sets/{name}/")[1]
        return self._rows[name]

    @cached_property
    def trained(self) -> Mapping[str, Mapping[str, Any]]:
        """What is kept of the eight SVMs' training by their names; trained where it is not yet."""
        taught = taught_by_set(self.sets()["labels"], self.rows("labels"))
        kept = train_svms(self.store, "models/", taught, self.workers, self.seed)
        return {svm.name: item for svm, item in zip(SVMS, kept, strict=True)}

    @cached_property
    def model_sets(self) -> Mapping[str, ModelSet]:
        """The trained deciders of the four versions."""
        _ = self.trained  # trains what is not there yet
        return model_sets_in(self.store, "models/")

    def evaluation(self, name: str) -> Evaluation:
        """A set's rows with what every ranker picks in them.

        Args:
            name: of the set.

        Returns:
            One a set, kept.

        Raises:
            ConfigError: it is not cast yet.
            StoreError: the place cannot be read.
        """
        if name not in self._evaluations:
            self._evaluations[name] = Evaluation(self.rows(name), self.model_sets, self.commonest)
        return self._evaluations[name]

    @cached_property
    def commonest(self) -> int:
        """The candidate's index that the operator took most often in training."""
        return int(np.bincount(self.rows("labels")["label"]).argmax()) - 1

    @cached_property
    def again(self) -> Array:
        """(N,) what the operator takes in the first test scenes on another day, -1 for none."""
        config = self.sets()["tested"].rows
        count = min(self.scale.curve_tested, self.scale.tested)
        tasks = {
            f"again/{k:05d}.json": (config, range(k, min(k + AGAIN_ROWS, count)))
            for k in range(0, count, AGAIN_ROWS)
        }
        finish(self.store, tasks, again_part, self.workers, "operator again")
        return read_again([self.store.read(name) for name in tasks])
