"""Rankers order the candidates, best first; each is found by its name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Floats
from boxgrasp.errors import ConfigError
from boxgrasp.geometry.box import Box
from boxgrasp.grasps.candidates import Candidates
from boxgrasp.grasps.checks import Numbers
from boxgrasp.grasps.gripper import Gripper
from boxgrasp.mapping.local_map import LocalMap

NAMES = {
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

    models: folder of ONNX files, None for the shipped ones; lines: lines a face.
    """

    models: str | None = None
    gripper: Gripper = Gripper()
    lines: int = 3


@dataclass(frozen=True, eq=False)
class RankingContext:
    """All that a ranker may look at; maps: local maps by their cell size, m."""

    box: Box
    candidates: Candidates
    numbers: Numbers
    local_maps: Mapping[float, LocalMap]


@dataclass(frozen=True, eq=False)
class Ranking:
    """order: (M,) candidate rows, best first; confidence: (M,) in [0, 1] of each candidate row."""

    order: NDArray[np.int64]
    confidence: Floats


class Ranker(Protocol):
    """Orders the candidates of a scene and says how sure it is of each.

    resolutions_m: cell sizes of the local maps that it reads, beside the check's own; notes: what
    the user should know of it, shown among the answer's warnings. Who inherits has neither.
    """

    resolutions_m: tuple[float, ...] = ()
    notes: tuple[str, ...] = ()

    def prepared(self, setup: RankerSetup) -> Ranker:
        """The ranker ready for a setup; who needs no model is ready as it is."""
        return self

    def rank(self, context: RankingContext) -> Ranking:
        """Every candidate exactly once, best first."""


def ranker_named(name: str, setup: RankerSetup | None = None) -> Ranker:
    """The ranker of that name, prepared for a setup, or for the default one.

    Raises:
        ConfigError: no ranker has it, or its models are for another number of lines.
        ModelError: its models are missing, damaged, or do not fit the code's features.
        MissingExtraError: it needs onnxruntime, which is not installed.
    """
    if name not in NAMES:
        raise ConfigError(f"unknown ranker: {name}; valid: {', '.join(NAMES)}")
    module, kind = NAMES[name].split(":")
    ranker: Ranker = getattr(import_module(module), kind)()
    return ranker.prepared(setup or RankerSetup())
