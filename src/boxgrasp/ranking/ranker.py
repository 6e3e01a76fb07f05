"""Choosers order the options, best first; each is found by its name."""

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
from boxgrasp.grasps.candidates import Options
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
class Setup:
    """What a chooser is prepared for.

    models: folder of ONNX files, None for the shipped ones; lines: lines a face.
    """

    models: str | None = None
    gripper: Gripper = Gripper()
    lines: int = 3


@dataclass(frozen=True, eq=False)
class Situation:
    """All that a chooser may look at; maps: local maps by their cell size, m."""

    box: Box
    options: Options
    numbers: Numbers
    maps: Mapping[float, LocalMap]


@dataclass(frozen=True, eq=False)
class Preference:
    """order: (M,) option rows, best first; sureness: (M,) in [0, 1] of each option row."""

    order: NDArray[np.int64]
    sureness: Floats


class Chooser(Protocol):
    """Orders the options of a situation and says how sure it is of each.

    resolutions_m: cell sizes of the local maps that it reads, beside the check's own; notes: what
    the user should know of it, shown among the answer's warnings. Who inherits has neither.
    """

    resolutions_m: tuple[float, ...] = ()
    notes: tuple[str, ...] = ()

    def prepared(self, setup: Setup) -> Chooser:
        """The chooser ready for a setup; who needs no model is ready as it is."""
        return self

    def prefer(self, situation: Situation) -> Preference:
        """Every option exactly once, best first."""


def chooser_named(name: str, setup: Setup | None = None) -> Chooser:
    """The chooser of that name, prepared for a setup, or for the default one.

    Raises:
        ConfigError: no chooser has it, or its models are for another number of lines.
        ModelError: its models are missing, damaged, or do not fit the code's features.
        MissingExtraError: it needs onnxruntime, which is not installed.
    """
    if name not in NAMES:
        raise ConfigError(f"unknown chooser: {name}; valid: {', '.join(NAMES)}")
    module, kind = NAMES[name].split(":")
    chooser: Chooser = getattr(import_module(module), kind)()
    return chooser.prepared(setup or Setup())
