"""What picks are worth, many at once: thesis score, strict score, other shapes of it (3-4)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Array, Floats
from boxgrasp.grasps.scoring import GREEN_FROM_M, RED_BELOW_M

Bools = NDArray[np.bool_]

ASK = -1


@dataclass(frozen=True)
class Shape:
    """A score: 0 below red_m, 1 from green_m (or the scene's best), between them by `rise`."""

    name: str
    rise: Callable[[Floats], Floats]
    green_m: float = GREEN_FROM_M
    red_m: float = RED_BELOW_M

    def __call__(self, clearance_m: Floats, best_m: Floats) -> Floats:
        """(N,) score of clearances (N,) in scenes whose largest clearance is best_m (N,)."""
        d, best = np.asarray(clearance_m, np.float64), np.asarray(best_m, np.float64)
        u = np.minimum(self.green_m, best)
        share = (d - self.red_m) / np.maximum(u - self.red_m, 1e-12)
        risen = np.where(d >= u, 1.0, self.rise(np.clip(share, 0.0, 1.0)))
        return np.where((d < self.red_m) | (best < self.red_m), 0.0, risen)


THESIS = Shape("quadratic, 6 cm", lambda t: np.asarray(t**2))
# The thesis tried these kinds (3-4) and gives no formulas; the exponential's steepness is ours.
SHAPES = (
    THESIS,
    Shape("linear, 6 cm", lambda t: t),
    Shape("exponential, 6 cm", lambda t: np.asarray(np.expm1(3.0 * t) / np.expm1(3.0))),
    Shape("quadratic, 5 cm", lambda t: np.asarray(t**2), green_m=0.05),
    Shape("linear, 5 cm", lambda t: t, green_m=0.05),
    Shape("exponential, 5 cm", lambda t: np.asarray(np.expm1(3.0 * t) / np.expm1(3.0)), 0.05),
)


@dataclass(frozen=True, eq=False)
class Metrics:
    """Each (N,), for the picks of N rows; NaN or False where nothing was picked.

    visible_m: to the visible cloud, as the thesis measured; exact_m: to exact surfaces. score,
    exact_score: the thesis's score by the one and the other; strict_score: by exact surfaces, over
    the candidates that fit, stay off the table and have a free approach, 0 for a pick that does not.
    """

    answered: Bools
    visible_m: Floats
    exact_m: Floats
    valid: Bools
    into_table: Bools
    too_wide: Bools
    score: Floats
    exact_score: Floats
    strict_score: Floats

    @property
    def unobstructed(self) -> Bools:
        """Clear by 2 cm to the visible cloud (thesis)."""
        return self.visible_m >= RED_BELOW_M

    @property
    def clear(self) -> Bools:
        """Clear by 2 cm to exact surfaces, hidden sides included."""
        return self.exact_m >= RED_BELOW_M

    @property
    def good(self) -> Bools:
        """Clear by 2 cm to exact surfaces, fits, off the table, approach free."""
        return self.clear & self.valid


def metrics_of(
    rows: Mapping[str, Array], target_source: str, picks: Array, shape: Shape = THESIS
) -> Metrics:
    """What the picked candidates are worth: picks (N,) candidate indices, -1 for a request for help."""
    answered = picks != ASK
    at = np.arange(len(picks)), np.where(answered, picks, 0)

    def of(name: str) -> Array:
        return rows[f"{target_source}_{name}"][at]

    def numbers(values: Array) -> Floats:
        return np.where(answered, values, np.nan)

    visible, exact = of("visible_m"), of("true_clearance_m")
    fits, off = of("true_fits") & answered, of("true_plane_clearance_m") > 0
    valid = fits & off & (of("true_approach_clearance_m") > 0)
    strict = np.where(valid, shape(exact, rows["best_m"]), 0.0)
    return Metrics(
        answered=answered,
        visible_m=numbers(visible),
        exact_m=numbers(exact),
        valid=valid,
        into_table=answered & ~off,
        too_wide=answered & ~fits,
        score=numbers(shape(visible, rows[f"{target_source}_visible_m"].max(axis=1))),
        exact_score=numbers(shape(exact, rows["true_clearance_m"].max(axis=1))),
        strict_score=numbers(strict),
    )


def categories(clearance_m: Floats, best_m: Floats) -> tuple[int, int, int]:
    """How many are red, yellow, green; green from the scene's best where that is under 6 cm."""
    d = clearance_m[~np.isnan(clearance_m)]
    u = np.minimum(GREEN_FROM_M, best_m[~np.isnan(clearance_m)])
    red = d < RED_BELOW_M
    green = ~red & (d >= u)
    return int(red.sum()), int((~red & ~green).sum()), int(green.sum())
