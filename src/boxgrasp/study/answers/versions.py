"""Sections 3-4, 4-2 and chapter 6: the four versions on the test scenarios."""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations

import numpy as np

from boxgrasp.arrays import Bools, Floats
from boxgrasp.ranking.model_set import VERSIONS
from boxgrasp.ranking.sampling import sampling
from boxgrasp.study.answers.figures import (
    Answer,
    Answers,
    Figures,
    exact,
    green,
    more_often,
    share_of,
)
from boxgrasp.study.intervals import Estimate, difference, less, mean
from boxgrasp.study.metrics import SCORE_FUNCTIONS, metrics_of
from boxgrasp.study.sections.need import CASCADE, SINGLE
from boxgrasp.study.sections.results import GROUPS, group_of


def _score(version: str, group: str) -> Callable[[Figures], Answer]:
    def answer(figures: Figures) -> Answer:
        metrics, which = figures.tested.metrics(version), group_of(figures.tested, group)
        alone = mean(metrics.clearance_score[which])
        value = "none" if alone.value is None else f"{alone.value:.3f}"
        return Answer(mean(metrics.score[which]), f"by distance alone, however wide: {value}")

    return answer


def score_gap(figures: Figures, a: str, b: str, group: str = "total") -> Estimate:
    """Score of one version less that of another on the test scenarios.

    Args:
        figures: of the study.
        a: a version.
        b: another.
        group: of targets.

    Returns:
        The difference.
    """
    which = group_of(figures.tested, group)
    first, second = (figures.tested.metrics(version).score[which] for version in (a, b))
    return difference(first, second)


def _less(a: str, b: str, group: str = "total") -> Callable[[Figures], Answer]:
    return lambda figures: Answer(score_gap(figures, a, b, group))


def _degrades(version: str) -> Callable[[Figures], Answer]:
    def answer(figures: Figures) -> Answer:
        known, novel = (
            mean(figures.tested.metrics(version).score[group_of(figures.tested, group)])
            for group in ("known", "novel")
        )
        return Answer(less(known, novel), "score with known objects less that with novel ones")

    return answer


def _differ(name: str, group: str) -> Callable[[Figures], Answer]:
    return lambda figures: Answer(share_of(_apart(figures, name), group_of(figures.tested, group)))


def _apart(figures: Figures, name: str) -> Bools:
    picks = (figures.tested.picks(f"{kind}-{name}") for kind in ("single", "cascade"))
    a, b = picks
    found: Bools = a != b
    return found


def _differ_more_known(figures: Figures) -> Answer:
    differs, known = _apart(figures, "grid"), group_of(figures.tested, "known")
    return Answer(less(share_of(differs, known), share_of(differs, ~known)), "grid")


def _known_bigger(figures: Figures) -> Answer:
    rows = figures.tested.rows
    edge_m = rows["given_dimensions_m"].mean(axis=1)
    known = group_of(figures.tested, "known")
    inside, outside = (100 * float(np.nanmean(edge_m[which])) for which in (known, ~known))
    return Answer(
        "bigger" if inside > outside else "smaller",
        f"average edge of the boxes {inside:.1f} cm against {outside:.1f} cm",
    )


def _scores_order(figures: Figures) -> Answer:
    """Whether a difference between two versions turns round by another score, beyond chance."""
    turned, whole, first = [], 0, None
    sides: dict[tuple[str, str], set[int]] = {pair: set() for pair in combinations(VERSIONS, 2)}
    for function in SCORE_FUNCTIONS:
        scores = {version: _by(figures, version, function) for version in VERSIONS}
        order = sorted(VERSIONS, key=lambda version: -float(np.nanmean(scores[version])))
        first = first or order
        whole += order == first
        for a, b in sides:
            gap = difference(scores[a], scores[b])
            if gap.low is not None and gap.high is not None:
                sides[a, b] |= {1} if gap.low > 0 else {-1} if gap.high < 0 else set()
    turned = [f"{a} and {b}" for (a, b), found in sides.items() if len(found) == 2]
    return Answer(
        f"turned round: {', '.join(turned)}" if turned else "no difference turned round",
        f"{whole} of {len(SCORE_FUNCTIONS)} scores keep the order of all four; versions whose "
        "difference is within chance may change places",
    )


def _by(figures: Figures, version: str, function: object) -> Floats:
    rows, picks = figures.tested.rows, figures.tested.picks(version)
    return metrics_of(rows, "given", picks, function).score  # type: ignore[arg-type]


def _scores_change(figures: Figures) -> Answer:
    gap = difference(
        _by(figures, CASCADE, SCORE_FUNCTIONS[1]), figures.tested.metrics(CASCADE).score
    )
    return Answer(gap, "linear less quadratic score of cascade grid")


def _scores_exponential(figures: Figures) -> Answer:
    gap = difference(
        figures.tested.metrics(CASCADE).score, _by(figures, CASCADE, SCORE_FUNCTIONS[2])
    )
    return Answer(gap, "quadratic less exponential score of cascade grid; its steepness is ours")


def _novel_green(figures: Figures) -> Answer:
    novel = group_of(figures.tested, "novel")
    flags = (green(figures.tested, version)[novel] for version in (SINGLE, CASCADE))
    return Answer(more_often(*flags), "green picks of single grid less those of cascade grid")


def _novel_yellow(figures: Figures) -> Answer:
    novel = group_of(figures.tested, "novel")
    found = []
    for version in (CASCADE, SINGLE):
        metrics = figures.tested.metrics(version)
        yellow = metrics.unobstructed & ~green(figures.tested, version) & novel
        found.append(mean(metrics.score[yellow]))
    return Answer(less(*found), "average score of the yellow picks, cascade less single grid")


def _clear(group: str) -> Callable[[Figures], Answer]:
    def answer(figures: Figures) -> Answer:
        metrics, which = figures.tested.metrics(CASCADE), group_of(figures.tested, group)
        return Answer(
            share_of(metrics.unobstructed, which),
            "cascade grid; clear by 2 cm and not too wide. By distance alone "
            f"{float(metrics.distant[which].mean()) if which.any() else 0.0:.3f}",
        )

    return answer


def _twenty_percent(figures: Figures) -> Answer:
    def both(name: str) -> Floats:
        kinds = ("single", "cascade")
        scores = [figures.tested.metrics(f"{k}-{name}").score for k in kinds]
        return np.asarray(np.mean(scores, axis=0))

    grid, spiral = both("grid"), both("spiral")
    ratio = float(np.nanmean(grid)) / max(float(np.nanmean(spiral)), 1e-9)
    return Answer(
        difference(grid, spiral),
        f"score of the two grid versions less that of the two spiral ones; {ratio:.2f} times it",
    )


def _few_features(_: Figures) -> Answer:
    features = len(sampling("grid")) + 3
    return Answer(
        exact(1 - features / (480 * 360)),
        f"{features} features in place of 172,800 values; that they suffice is `clear-simulation`",
    )


ANSWERS: Answers = {
    "scores-order": _scores_order,
    "scores-change": _scores_change,
    "scores-exponential": _scores_exponential,
    **{f"score-{v}-{group}": _score(v, group) for v in VERSIONS for group in GROUPS},
    "novel-green": _novel_green,
    "novel-yellow": _novel_yellow,
    "grid-better-single": _less(SINGLE, "single-spiral"),
    "grid-better-cascade": _less(CASCADE, "cascade-spiral"),
    "spiral-degrades-single": _degrades("single-spiral"),
    "spiral-degrades-cascade": _degrades("cascade-spiral"),
    "comparable-spiral-novel": _less("cascade-spiral", "single-spiral", "novel"),
    "comparable-grid-novel": _less(CASCADE, SINGLE, "novel"),
    "comparable-spiral-total": _less("cascade-spiral", "single-spiral"),
    "comparable-grid-total": _less(CASCADE, SINGLE),
    "cascade-known-spiral": _less("cascade-spiral", "single-spiral", "known"),
    "cascade-known-grid": _less(CASCADE, SINGLE, "known"),
    **{f"differ-{name}-{g}": _differ(name, g) for name in ("spiral", "grid") for g in GROUPS},
    "differ-more-known": _differ_more_known,
    "known-bigger": _known_bigger,
    "few-features": _few_features,
    "clear-simulation": _clear("total"),
    "clear-novel": _clear("novel"),
    "safe-simulation": lambda f: Answer(share_of(green(f.tested, CASCADE)), "cascade grid, green"),
    "grid-20-percent": _twenty_percent,
}
