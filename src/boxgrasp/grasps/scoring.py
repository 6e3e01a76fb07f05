"""What a clearance is called, and the score of a grasp by it (section 3-4)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from boxgrasp.arrays import Floats

RED_BELOW_M: Final = 0.02
GREEN_FROM_M: Final = 0.06
CATEGORIES: Final = ("red", "yellow", "green")


def category(clearance_m: float) -> str:
    """The name of a clearance (section 3-4).

    Args:
        clearance_m: m.

    Returns:
        `red` (infeasible) under 2 cm, `yellow` (feasible) under 6 cm, else `green` (safe).
    """
    if clearance_m < RED_BELOW_M:
        return "red"
    return "yellow" if clearance_m < GREEN_FROM_M else "green"


@dataclass(frozen=True)
class ScoreFunction:
    """A score from 0 to 1 by the clearance d of a grasp and the scene's largest (section 3-4).

    With u = min(green_m, largest): 0 below red_m, 1 from u on, and between them `rise` of
    (d - red_m) / (u - red_m); 0 where the largest is below red_m too.

    Attributes:
        name: what tables call it.
        rise: (N,) from 0 to 1, to (N,) from 0 to 1.
        green_m: m.
        red_m: m.
    """

    name: str
    rise: Callable[[Floats], Floats]
    green_m: float = GREEN_FROM_M
    red_m: float = RED_BELOW_M

    def __call__(self, clearance_m: ArrayLike, largest_m: ArrayLike) -> Floats:
        """The scores of N grasps.

        Args:
            clearance_m: (N,) of the grasps, m.
            largest_m: (N,) the largest clearance of each grasp's scene, m: over all candidates
                (thesis), or over those that fit, stay off the plane and have a free way in.

        Returns:
            (N,) float64.
        """
        d, largest = np.asarray(clearance_m, np.float64), np.asarray(largest_m, np.float64)
        u = np.minimum(self.green_m, largest)
        share = (d - self.red_m) / np.maximum(u - self.red_m, 1e-12)
        risen = np.where(d >= u, 1.0, self.rise(np.clip(share, 0.0, 1.0)))
        return np.where((d < self.red_m) | (largest < self.red_m), 0.0, risen)


def squared(share: Floats) -> Floats:
    """The thesis's rise.

    Args:
        share: (N,) from 0 to 1.

    Returns:
        (N,) from 0 to 1.
    """
    return np.asarray(share**2)


THESIS_SCORE: Final = ScoreFunction("quadratic, 6 cm", squared)
