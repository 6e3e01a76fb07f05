"""What several answers are made of: sets, flags of picks, and figures of groups."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from boxgrasp.arrays import Array, Bools, Floats
from boxgrasp.forks import cached_property
from boxgrasp.grasps.candidates import LINES
from boxgrasp.grasps.scoring import GREEN_FROM_M
from boxgrasp.study.evaluation import Evaluation
from boxgrasp.study.intervals import NOTHING, Estimate, difference, mean, share
from boxgrasp.study.metrics import largest_visible_m
from boxgrasp.study.study import Study
from boxgrasp.study.verdicts import Ours

CENTRAL = LINES // 2  # the index of the middle line


class Answer(NamedTuple):
    """What came out here.

    Attributes:
        ours: our count, or our figure with its interval.
        reason: how it was found, and why it is so as far as can be seen.
    """

    ours: Ours
    reason: str = ""


@dataclass(frozen=True, eq=False)
class Figures:
    """A study's sets, evaluated once.

    Attributes:
        study: whose they are.
    """

    study: Study

    @cached_property
    def tested(self) -> Evaluation:
        """The test scenarios."""
        return self.study.evaluation("tested")

    @cached_property
    def labels(self) -> Evaluation:
        """What the operator labeled."""
        return self.study.evaluation("labels")

    @cached_property
    def need(self) -> Evaluation:
        """Scenes that need a line off the center."""
        return self.study.evaluation("need")

    @cached_property
    def real(self) -> Evaluation:
        """The stand-in for the robot's scenes, each seen several times."""
        return self.study.evaluation("real")

    @cached_property
    def real_clean(self) -> Evaluation:
        """The same scenes without noise, each seen once."""
        return self.study.evaluation("real-clean")

    @cached_property
    def real_once(self) -> Evaluation:
        """One run of each scene of the stand-in; more scenes in a full study."""
        if self.study.scale.full:
            return self.study.evaluation("real-once")
        return self.real.take(self.real.rows["run"] == 0)

    def by_scene(self, values: Array) -> Floats:
        """Means of each scene's runs: the runs of a scene are no scenes of their own.

        Args:
            values: (scenes * runs,) in the order of the rows.

        Returns:
            (scenes,).
        """
        runs = self.study.scale.runs
        return np.asarray(np.asarray(values, np.float64).reshape(-1, runs).mean(axis=1))


Answers = dict[str, Callable[[Figures], Answer]]


def share_of(flags: Array, among: Array | slice = slice(None)) -> Estimate:
    """How often a flag is set.

    Args:
        flags: (N,) bool.
        among: (N,) bool, which count.

    Returns:
        The share.
    """
    kept = np.asarray(flags)[among]
    return share(int(kept.sum()), len(kept))


def more_often(a: Array, b: Array) -> Estimate:
    """How much more often one flag is set than another, on the same scenes.

    Args:
        a: (N,) bool or shares; NaN for a scene that does not count.
        b: (N,).

    Returns:
        The difference.
    """
    return difference(np.asarray(a, np.float64), np.asarray(b, np.float64))


def exact(value: float) -> Estimate:
    """A figure without chance.

    Args:
        value: any.

    Returns:
        The figure with itself as its interval.
    """
    return Estimate(value, value, value, 1)


def green(evaluation: Evaluation, version: str) -> Bools:
    """Which picks are feasible and safe (3-4).

    Args:
        evaluation: of a set.
        version: of the thesis, or `operator`.

    Returns:
        (N,).
    """
    metrics = evaluation.metrics(version)
    safe_m = np.minimum(GREEN_FROM_M, largest_visible_m(evaluation.rows, "given"))
    found: Bools = metrics.unobstructed & (metrics.visible_m >= safe_m)
    return found


def off_center(evaluation: Evaluation, version: str) -> Bools:
    """Which picks are on line 1 or 3.

    Args:
        evaluation: of a set.
        version: of the thesis.

    Returns:
        (N,).
    """
    found: Bools = evaluation.picks(version) % LINES != CENTRAL
    return found


def mean_like(values: Array, counts: Array, wanted: Array) -> Estimate:
    """A mean as it would be with other numbers of obstacles.

    Args:
        values: (N,) of scenes, 0 to 1.
        counts: (N,) their numbers of obstacles.
        wanted: (M,) numbers of obstacles of other scenes.

    Returns:
        The mean, each number of obstacles weighted as it is wanted; nothing where one is wanted
        that no scene has.
    """
    parts, count = [], 0
    for number, times in zip(*np.unique(wanted, return_counts=True), strict=True):
        part = mean(np.asarray(values, np.float64)[counts == number])
        if part.value is None or part.low is None or part.high is None:
            return NOTHING
        count += part.count
        parts.append((times / len(wanted), part.value, part.low, part.high))
    if not parts:
        return NOTHING
    weight, value, low, high = np.array(parts).T
    middle = float(weight @ value)
    down = float(np.linalg.norm(weight * (value - low)))
    up = float(np.linalg.norm(weight * (high - value)))
    return Estimate(middle, middle - down, middle + up, count)
