"""What picks come to, many at once: clearances, scores, categories (thesis 3-4).

A face wider than the opening is no grasp: the thesis calls it unfeasible (5-2-1, figure 5-2), so
such a pick is red and scores 0. Its distance alone, which 3-4 scores by, is kept beside it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from boxgrasp.arrays import Array, Bools, Floats
from boxgrasp.grasps.scoring import (
    GREEN_FROM_M,
    RED_BELOW_M,
    THESIS_SCORE,
    ScoreFunction,
    squared,
)

ASK: Final = -1  # in place of a candidate's index


def _as_it_is(share: Floats) -> Floats:
    return share


def _exponential(share: Floats) -> Floats:
    return np.asarray(np.expm1(3.0 * share) / np.expm1(3.0))


# The thesis tried these kinds (3-4) and gives no formulas; the exponential's steepness is ours.
SCORE_FUNCTIONS: Final = (
    THESIS_SCORE,
    ScoreFunction("linear, 6 cm", _as_it_is),
    ScoreFunction("exponential, 6 cm", _exponential),
    ScoreFunction("quadratic, 5 cm", squared, green_m=0.05),
    ScoreFunction("linear, 5 cm", _as_it_is, green_m=0.05),
    ScoreFunction("exponential, 5 cm", _exponential, green_m=0.05),
)


@dataclass(frozen=True, eq=False)
class Metrics:
    """What the picks of N rows come to; each (N,), NaN or False where nothing was picked.

    Attributes:
        answered: whether something was picked.
        visible_m: clearance to the visible cloud, as the thesis measured, m.
        exact_m: clearance to exact surfaces, hidden sides included, m.
        valid: fits, stays off the table and has a free way in.
        into_table: goes into the table.
        too_wide: the target does not go between the fingers.
        score: the thesis's, by visible_m; 0 where too wide.
        clearance_score: the thesis's, by visible_m alone, however wide the face.
        exact_score: the thesis's, by exact_m; 0 where too wide.
        strict_score: by exact_m over the candidates that are valid; 0 for a pick that is not.
    """

    answered: Bools
    visible_m: Floats
    exact_m: Floats
    valid: Bools
    into_table: Bools
    too_wide: Bools
    score: Floats
    clearance_score: Floats
    exact_score: Floats
    strict_score: Floats

    @property
    def unobstructed(self) -> Bools:
        """Feasible (thesis): clear by 2 cm to the visible cloud, and goes between the fingers."""
        return (self.visible_m >= RED_BELOW_M) & ~self.too_wide

    @property
    def distant(self) -> Bools:
        """Clear by 2 cm to the visible cloud, however wide the face."""
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
    rows: Mapping[str, Array],
    target_source: str,
    picks: Array,
    score: ScoreFunction = THESIS_SCORE,
) -> Metrics:
    """What picked candidates come to.

    Args:
        rows: columns by name.
        target_source: `given` or `found`.
        picks: (N,) candidate indices, `ASK` for a request for help.
        score: in place of the thesis's.

    Returns:
        The numbers of each row.
    """
    answered = picks != ASK
    at = np.arange(len(picks)), np.where(answered, picks, 0)

    def of(name: str) -> Array:
        picked: Array = rows[f"{target_source}_{name}"][at]
        return picked

    def numbers(values: Array) -> Floats:
        return np.where(answered, values, np.nan)

    visible, exact = of("thesis_clearance_m"), of("true_clearance_m")
    fits, off = of("true_fits") & answered, of("true_plane_clearance_m") > 0
    valid = fits & off & (of("true_approach_clearance_m") > 0)
    every = rows[f"{target_source}_thesis_clearance_m"]
    largest_exact = fitting(rows["true_clearance_m"], rows["true_fits"]).max(axis=1)

    def where_fits(found: Floats) -> Floats:
        return numbers(np.where(fits, found, 0.0))

    return Metrics(
        answered=answered,
        visible_m=numbers(visible),
        exact_m=numbers(exact),
        valid=valid,
        into_table=answered & ~off,
        too_wide=answered & ~fits,
        score=where_fits(score(visible, largest_visible_m(rows, target_source))),
        clearance_score=numbers(score(visible, every.max(axis=1))),
        exact_score=where_fits(score(exact, largest_exact)),
        strict_score=numbers(np.where(valid, score(exact, rows["best_m"]), 0.0)),
    )


def largest_visible_m(rows: Mapping[str, Array], target_source: str) -> Floats:
    """The largest clearance of each scene to the visible cloud (3-4), over what fits.

    Args:
        rows: columns by name.
        target_source: `given` or `found`.

    Returns:
        (N,) float64, m; -inf where nothing goes between the fingers.
    """
    visible = rows[f"{target_source}_thesis_clearance_m"]
    return np.asarray(fitting(visible, rows[f"{target_source}_true_fits"]).max(axis=1))


def fitting(clearance_m: Floats, fits: Bools) -> Floats:
    """Clearances of what goes between the fingers.

    Args:
        clearance_m: (N, 5 l), m.
        fits: (N, 5 l).

    Returns:
        (N, 5 l) float64, m; -inf for the rest.
    """
    return np.where(fits, clearance_m, -np.inf)


@dataclass(frozen=True, eq=False)
class Chance:
    """What a candidate drawn at random comes to, on average; each (N,).

    Attributes:
        score: as `Metrics.score`.
        clearance_score: as `Metrics.clearance_score`.
        unobstructed: the share that is, 0 to 1.
        too_wide: the share that is, 0 to 1.
    """

    score: Floats
    clearance_score: Floats
    unobstructed: Floats
    too_wide: Floats


def chance_of(rows: Mapping[str, Array], target_source: str = "given") -> Chance:
    """What every candidate of each row comes to, averaged: exact, nothing is drawn.

    Args:
        rows: columns by name.
        target_source: `given` or `found`.

    Returns:
        The averages of each row, NaN where nothing was answered.
    """
    count, candidates = rows[f"{target_source}_passes"].shape
    answered = rows[f"{target_source}_error"] == ""
    every = [metrics_of(rows, target_source, np.full(count, k)) for k in range(candidates)]

    def average(name: str) -> Floats:
        means = np.mean([np.asarray(getattr(m, name), np.float64) for m in every], axis=0)
        return np.where(answered, means, np.nan)

    return Chance(*map(average, ("score", "clearance_score", "unobstructed", "too_wide")))


def category_counts(clearance_m: Floats, largest_m: Floats) -> tuple[int, int, int]:
    """How many picks are of each category (3-4); green from the scene's largest where under 6 cm.

    Args:
        clearance_m: (N,) of the picks, m, NaN for none.
        largest_m: (N,) the largest of each scene, m.

    Returns:
        Red, yellow, green.
    """
    d = clearance_m[~np.isnan(clearance_m)]
    u = np.minimum(GREEN_FROM_M, largest_m[~np.isnan(clearance_m)])
    red = d < RED_BELOW_M
    green = ~red & (d >= u)
    return int(red.sum()), int((~red & ~green).sum()), int(green.sum())
