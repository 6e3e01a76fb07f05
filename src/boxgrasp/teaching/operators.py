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
    """What an operator is shown of a scene (thesis 3-3-1): the visible cloud, the box, no truth.

    Attributes:
        box: the target's.
        candidates: the M candidates.
        points: (N, 3) float32, base frame, m: visible points of what is in the way.
        table_height_m: z of the support plane at the target, base frame, m.
        gripper: the hand.
    """

    box: Box
    candidates: Candidates
    points: Points
    table_height_m: float
    gripper: Gripper


@dataclass(frozen=True)
class Label:
    """What an operator said.

    Attributes:
        label: (face - 1) * l + line, or None for a request for help.
        source: who said it.
    """

    label: int | None
    source: str


class Operator(Protocol):
    """Labels scenes; a person at a page and the stand-in are both one."""

    def label(self, shown: Shown, rng: np.random.Generator) -> Label:
        """The candidate to take.

        Args:
            shown: the scene.
            rng: the scenario's own, for who is not perfectly steady.

        Returns:
            A candidate's label, or a request for help.
        """
