"""Every ranker, bare and checked, by every measure; which one is the default, and why."""

from __future__ import annotations

import numpy as np

from boxgrasp.arrays import Floats
from boxgrasp.config import Config
from boxgrasp.study.evaluation import RANKERS, Evaluation
from boxgrasp.study.intervals import Estimate, mean, share
from boxgrasp.study.metrics import Metrics
from boxgrasp.study.plots import ranker_points
from boxgrasp.study.report import Picture, Row, Section, Table
from boxgrasp.study.study import Study

SOLVABLE_M = 0.025
COLUMNS = (
    "ranker", "answered", "score, visible", "the same by clearance alone", "score, exact",
    "strict score", "unobstructed, visible", "clear, exact", "good, exact", "into the table",
    "too wide",
)  # fmt: skip
SOURCES = {
    "given": "target points and aligned box given",
    "found": "found by the package, its own box",
}
THESIS_NEED = "0.45 to 0.61 (cascade grid)"
Line = tuple[str | int | Estimate, ...]


def rankers_section(study: Study) -> Section:
    """All rankers on the test scenarios, and the bars on the solvable ones.

    Args:
        study: whose scenarios they are.

    Returns:
        The section.
    """
    evaluation = study.evaluation("tested")
    best = best_checked(evaluation)
    return Section(
        key="rankers",
        title="Every ranker, bare and checked",
        place="beyond the thesis",
        words=(
            "`visible` measures clearance to the visible cloud, as the thesis did; `exact` to "
            "exact surfaces, hidden sides included. The strict score counts only picks that fit, "
            "stay off the table and have a free approach, against the best there is; good ones are "
            "clear by 2 cm too. Scores and shares are of the answers.",
            f"Best without a grasp into the table (strict score over all scenarios, checked, "
            f"target found by the package): {best}. The package's default is {Config().ranker}. "
            "An SVM's first candidate that passes may be clear by little more than 2 cm; the "
            "score rewards the largest clearance.",
        ),
        rows=(*_best_rows(evaluation, best), *_need_rows(study.evaluation("need"), best)),
        tables=_tables(evaluation),
        pictures=(
            Picture(
                "rankers",
                "Strict score of every ranker, bare and checked, target found by the package.",
                svg=ranker_points(
                    RANKERS, _strict(evaluation, checked=False), _strict(evaluation, checked=True)
                ),
                alt="Points with intervals, two for each ranker",
            ),
        ),
    )


def _best_rows(evaluation: Evaluation, best: str) -> list[Row]:
    """The best ranker on the scenes that have a good grasp."""
    solvable = evaluation.take(evaluation.rows["best_m"] >= SOLVABLE_M)
    metrics = solvable.metrics(best, "found", checked=True)
    done, of = int(metrics.answered.sum()), solvable.rows.count

    def part(hits: int) -> Estimate:
        return share(hits, done)

    def average(score: Floats) -> Estimate:
        return mean(score[metrics.answered])

    found: tuple[tuple[str, Estimate | int], ...] = (
        (f"answered, of {of} with a grasp clear by 2.5 cm", share(done, of)),
        ("unobstructed", part(int(metrics.unobstructed.sum()))),
        ("clear by 2 cm, exact", part(int(metrics.clear.sum()))),
        ("good, exact", part(int(metrics.good.sum()))),
        ("score", average(metrics.score)),
        ("score, exact", average(metrics.exact_score)),
        ("strict score", average(metrics.strict_score)),
        ("into the table", int(metrics.into_table.sum())),
    )
    return [Row(f"{best}, checked: {name}", None, value) for name, value in found]


def _need_rows(evaluation: Evaluation, best: str) -> list[Row]:
    """The best ranker on the scenes that need a line off the center."""
    given, found = (evaluation.metrics(best, source, checked=True) for source in SOURCES)
    name = f"{best}, checked: score, out-of-bias need, target"
    return [
        Row(f"{name} given", THESIS_NEED, mean(given.score[given.answered]), _answered(given)),
        Row(f"{name} found", None, mean(found.score[found.answered]), _answered(found)),
        Row(
            f"{best}, checked: the same, a request for help counted as 0",
            THESIS_NEED,
            mean(np.nan_to_num(found.score)),
        ),
    ]


def _answered(metrics: Metrics) -> str:
    return f"{int(metrics.answered.sum())} of {len(metrics.answered)} answered"


def _tables(evaluation: Evaluation) -> tuple[Table, ...]:
    return tuple(
        Table(
            f"{'Checked' if checked else 'Bare'}, {words}",
            COLUMNS,
            ranker_table(evaluation, source, checked=checked),
        )
        for source, words in SOURCES.items()
        for checked in (False, True)
    )


def best_checked(evaluation: Evaluation) -> str:
    """The ranker with the best strict score, checked, among those that never enter the table.

    Args:
        evaluation: of a set.

    Returns:
        Its name.
    """
    found = {name: evaluation.metrics(name, "found", checked=True) for name in RANKERS}
    clean = [name for name in RANKERS if not found[name].into_table.any()] or list(RANKERS)
    return max(clean, key=lambda name: _of_all(found[name].strict_score))


def ranker_table(evaluation: Evaluation, target_source: str, *, checked: bool) -> tuple[Line, ...]:
    """Every ranker by every measure.

    Args:
        evaluation: of a set.
        target_source: `given` or `found`.
        checked: the first candidates that pass every check, in place of first choices.

    Returns:
        A line a ranker, in the order of `COLUMNS`.

    Raises:
        ModelError: models trained for another number of lines.
    """
    return tuple(
        (name, *_measures(evaluation.metrics(name, target_source, checked=checked)))
        for name in RANKERS
    )


def _measures(metrics: Metrics) -> Line:
    done = metrics.answered
    count = int(done.sum())
    return (
        share(count, len(done)),
        mean(metrics.score[done]),
        mean(metrics.clearance_score[done]),
        mean(metrics.exact_score[done]),
        mean(metrics.strict_score[done]),
        share(int(metrics.unobstructed.sum()), count),
        share(int(metrics.clear.sum()), count),
        share(int(metrics.good.sum()), count),
        int(metrics.into_table.sum()),
        int(metrics.too_wide.sum()),
    )


def _strict(evaluation: Evaluation, *, checked: bool) -> tuple[Estimate, ...]:
    found = [evaluation.metrics(name, "found", checked=checked) for name in RANKERS]
    return tuple(mean(np.nan_to_num(metrics.strict_score)) for metrics in found)


def _of_all(score: Floats) -> float:
    """The average with 0 for what was not answered."""
    return float(np.nan_to_num(score).mean())
