"""What a clearance is called, and the score of a grasp by it (section 3-4)."""

from __future__ import annotations

from typing import Any

import numpy as np

RED_BELOW_M = 0.02
GREEN_FROM_M = 0.06


def category(clearance_m: float) -> str:
    """`red` under 2 cm, `yellow` under 6 cm, else `green` (section 3-4)."""
    if clearance_m < RED_BELOW_M:
        return "red"
    return "yellow" if clearance_m < GREEN_FROM_M else "green"


def score(clearance_m: float, best_m: float, red_m: float = RED_BELOW_M) -> float:
    """Score of a grasp, 0 to 1, by its clearance and the scene's largest (section 3-4).

    With u = min(6 cm, best): 0 under 2 cm, ((d - 2) / (u - 2))^2 up to u, 1 from u on; 0 where
    no candidate is feasible.
    """
    u = min(GREEN_FROM_M, best_m)
    if clearance_m < red_m or best_m < red_m:
        return 0.0
    if clearance_m >= u:
        return 1.0
    return float(((clearance_m - red_m) / (u - red_m)) ** 2)


def thesis_score(clearances_m: Any, chosen: int) -> float:
    """Score of candidate `chosen` against the largest clearance of all candidates (section 3-4)."""
    values = np.asarray(clearances_m, dtype=np.float64)
    return score(float(values[chosen]), float(values.max()))


def strict_score(clearances_m: Any, valid: Any, chosen: int) -> float:
    """The same against the candidates that are `valid` (fit, off the plane, free approach)."""
    values = np.asarray(clearances_m, dtype=np.float64)
    allowed = np.asarray(valid, dtype=bool)
    if not allowed[chosen]:
        return 0.0
    return score(float(values[chosen]), float(values[allowed].max()))
