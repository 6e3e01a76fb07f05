"""Who says which candidate to take: a person, or the stand-in for one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from boxgrasp.arrays import Points
from boxgrasp.geometry.box import Box
from boxgrasp.grasps.candidates import Candidates
from boxgrasp.grasps.gripper import Gripper


@dataclass(frozen=True, eq=False)
class Shown:
    """What an operator is shown of a scene (thesis 3-3-1): the visible cloud and the target's box.

    points: (N, 3) float32, base frame, m: what is in the way, seen once. table_m: the support
    plane's height at the target; gripper: the hand. No truth.
    """

    box: Box
    candidates: Candidates
    points: Points
    table_m: float
    gripper: Gripper


@dataclass(frozen=True)
class Label:
    """label: (face - 1) * l + line, or None for a request for help; source: who said it."""

    label: int | None
    source: str


class Operator(Protocol):
    """Labels scenes. A person behind a page and the stand-in are both one."""

    def label(self, shown: Shown, rng: np.random.Generator) -> Label:
        """The candidate to take; rng is the scenario's own, for who is not perfectly steady."""


__all__ = ["Label", "Operator", "Shown"]
