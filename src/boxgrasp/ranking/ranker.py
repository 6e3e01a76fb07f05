"""What a ranker is, and how one is found by its name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Floats
from boxgrasp.errors import BoxgraspError, CodedWarning, ConfigError, shown
from boxgrasp.geometry.box import Box
from boxgrasp.grasps.candidates import LINES, Candidates
from boxgrasp.grasps.checks import CheckResult
from boxgrasp.grasps.gripper import Gripper
from boxgrasp.mapping.local_map import LocalMap
from boxgrasp.strict import plugin, plugin_names

PLUGINS = "boxgrasp.rankers"
SHIPPED = {
    "clearance": "boxgrasp.ranking.rankers.clearance:ByClearance",
    "single-spiral": "boxgrasp.ranking.rankers.svm:SingleSpiral",
    "single-grid": "boxgrasp.ranking.rankers.svm:SingleGrid",
    "cascade-spiral": "boxgrasp.ranking.rankers.svm:CascadeSpiral",
    "cascade-grid": "boxgrasp.ranking.rankers.svm:CascadeGrid",
    "top-down": "boxgrasp.ranking.rankers.baselines:TopDown",
    "random": "boxgrasp.ranking.rankers.baselines:Random",
}


@dataclass(frozen=True)
class RankerSetup:
    """What a ranker is prepared for.

    Attributes:
        models: folder of ONNX files, None for the shipped ones.
        gripper: the hand in use.
        lines: l, lines a face.
    """

    models: str | None = None
    gripper: Gripper = Gripper()
    lines: int = LINES


@dataclass(frozen=True, eq=False)
class RankingContext:
    """All that a ranker may look at.

    Attributes:
        box: the target's.
        candidates: the M candidates.
        check_results: what each check said, by its name.
        local_maps: local maps by their cell size, m.
    """

    box: Box
    candidates: Candidates
    check_results: Mapping[str, CheckResult]
    local_maps: Mapping[float, LocalMap]

    def result(self, check: str) -> CheckResult:
        """What a check said.

        Args:
            check: its name.

        Returns:
            Its result.

        Raises:
            ConfigError: no such check is among those that were made.
        """
        if check not in self.check_results:
            raise ConfigError(
                f"the ranker reads the check {check}, which is not in the list; valid: a list with "
                f"it (there are {', '.join(self.check_results) or 'none'})"
            )
        return self.check_results[check]


@dataclass(frozen=True, eq=False)
class Ranking:
    """An order of M candidates.

    Attributes:
        order: (M,) int64, rows of the candidates, best first.
        confidence: (M,) float64 in [0, 1], of each candidate by its row.
        asks: whether a person should be asked in place of taking any of them.
    """

    order: NDArray[np.int64]
    confidence: Floats
    asks: bool = False


class Ranker(Protocol):
    """Orders the candidates and says how confident it is of each.

    A class that inherits needs a `name` and `rank` alone.

    Attributes:
        name: what answers call it.
        map_resolutions_m: cell sizes, m, of the local maps that it reads beside the default one.
        warnings: what the user should know of it, shown among the answer's warnings.
    """

    name: str
    map_resolutions_m: tuple[float, ...] = ()
    warnings: tuple[CodedWarning, ...] = ()

    def prepared(self, setup: RankerSetup) -> Ranker:
        """The ranker ready for a setup; one that needs no model is ready as it is.

        Args:
            setup: models, hand and lines.

        Returns:
            A ranker.
        """
        return self

    def rank(self, context: RankingContext) -> Ranking:
        """Order every candidate exactly once, best first.

        Args:
            context: the candidates, their check results, and what is round them.

        Returns:
            The order.
        """


def ranker_names() -> tuple[str, ...]:
    """Names that `ranker_named` takes.

    Returns:
        The shipped rankers', then those of installed packages.
    """
    return (*SHIPPED, *(name for name in plugin_names(PLUGINS) if name not in SHIPPED))


def ranker_named(name: str, setup: RankerSetup | None = None) -> Ranker:
    """The ranker of a name, prepared.

    Args:
        name: a shipped ranker's, or an entry point's of the group `boxgrasp.rankers`.
        setup: what it is prepared for; None for the defaults.

    Returns:
        The ranker.

    Raises:
        ConfigError: no ranker has the name, its package cannot be used, or its models are for
            another number of lines.
        ModelError: its models are missing, damaged, or do not fit the code's features.
        MissingExtraError: it needs onnxruntime, which is not installed.
    """
    if name in SHIPPED:
        module, kind = SHIPPED[name].split(":")
        ranker = getattr(import_module(module), kind)()
    else:
        ranker = plugin(PLUGINS, name)
        if ranker is None:
            raise ConfigError(f"unknown ranker: {name}; valid: {', '.join(ranker_names())}")
    return validate_ranker(ranker).prepared(setup or RankerSetup())


def validate_ranker(ranker: Any) -> Ranker:
    """A ranker, refused where it is none.

    Args:
        ranker: what a caller or a package handed over.

    Returns:
        The same ranker.

    Raises:
        ConfigError: it is a class, or lacks a name, `rank` or `prepared`.
    """
    kind = ranker.__name__ if isinstance(ranker, type) else type(ranker).__name__
    if isinstance(ranker, type):
        raise ConfigError(f"ranker {kind} is a class; valid: an object of it, {kind}(...)")
    methods = all(hasattr(ranker, method) for method in ("rank", "prepared"))
    if not isinstance(getattr(ranker, "name", None), str) or not methods:
        raise ConfigError(
            f"{kind} is no ranker; valid: a class that inherits from Ranker, with a name and "
            "rank(context)"
        )
    found: Ranker = ranker
    return found


def validate_ranking(ranker: Ranker, ranking: Ranking, count: int) -> Ranking:
    """A ranking, refused where it does not fit.

    Args:
        ranker: whose it is.
        ranking: what it answered.
        count: number of candidates, M.

    Returns:
        The same ranking.

    Raises:
        BoxgraspError: not every candidate exactly once, no confidence in [0, 1] for each, or
            `asks` that is neither true nor false.
    """
    order, confidence = np.asarray(ranking.order), np.asarray(ranking.confidence)
    if order.shape != (count,) or not np.array_equal(np.sort(order), np.arange(count)):
        raise BoxgraspError(
            f"ranker {ranker.name}: order is no permutation; valid: each row of 0 to {count - 1}"
        )
    if confidence.shape != (count,) or not np.all((confidence >= 0) & (confidence <= 1)):
        raise BoxgraspError(
            f"ranker {ranker.name}: confidence is not {count} numbers from 0 to 1; valid: one a "
            "candidate, by its row"
        )
    if not isinstance(ranking.asks, bool | np.bool_):
        raise BoxgraspError(
            f"ranker {ranker.name}: asks is {shown(ranking.asks)}; valid: True or False"
        )
    return ranking
