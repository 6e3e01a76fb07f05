"""Choosers order the options, best first; each is found by its name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from boxgrasp.box import Box
from boxgrasp.check import Numbers
from boxgrasp.errors import ConfigError
from boxgrasp.frames import Floats
from boxgrasp.occupancy import LocalMap
from boxgrasp.options import Options

NAMES = {"clearance": "boxgrasp.choosers.clearance:ByClearance"}


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

    def prefer(self, situation: Situation) -> Preference:
        """Every option exactly once, best first."""


def chooser_named(name: str) -> Chooser:
    """The chooser of that name.

    Raises:
        ConfigError: no chooser has it.
    """
    if name not in NAMES:
        raise ConfigError(f"unknown chooser: {name}; valid: {', '.join(NAMES)}")
    module, kind = NAMES[name].split(":")
    chooser: Chooser = getattr(import_module(module), kind)()
    return chooser
