"""Every ranker, bare and checked, by every measure; which one is the default, and why."""

from __future__ import annotations

import numpy as np

from boxgrasp.config import Config
from boxgrasp.study.evaluation import RANKERS, Evaluation
from boxgrasp.study.intervals import Estimate, mean, share
from boxgrasp.study.plots import ranker_points
from boxgrasp.study.report import Picture, Row, Section, Table
from boxgrasp.study.study import Study

SOLVABLE_M = 0.025
COLUMNS = (
    "ranker", "answered", "score, visible", "score, exact", "strict score",
    "unobstructed, visible", "clear, exact", "good, exact", "into the table", "too wide",
)  # fmt: skip
SEEN = {
    "given": "target points and aligned box given",
    "found": "found by the package, its own box",
}


def rankers_section(study: Study) -> Section:
    """All rankers on the test scenarios, and the bars on the solvable ones."""
    evaluation = study.evaluation("tested")
    solvable = evaluation.take(evaluation.rows["best_m"] >= SOLVABLE_M)
    best = best_checked(evaluation)
    metrics = solvable.metrics(best, "found", check=True)
    done, of = int(metrics.answered.sum()), solvable.rows.count
    need = study.evaluation("need").metrics(best, "given", check=True)
    need_found = study.evaluation("need").metrics(best, "found", check=True)
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
            "An SVM's first candidate that passes may be clear by little more than 2 cm; most room "
            "is what the score rewards.",
        ),
        rows=(
            Row(
                f"{best}, checked: answered, of {of} with a grasp clear by 2.5 cm",
                None,
                share(done, of),
            ),
            Row(
                f"{best}, checked: unobstructed", None, share(int(metrics.unobstructed.sum()), done)
            ),
            Row(
                f"{best}, checked: clear by 2 cm, exact",
                None,
                share(int(metrics.clear.sum()), done),
            ),
            Row(f"{best}, checked: good, exact", None, share(int(metrics.good.sum()), done)),
            Row(f"{best}, checked: score", None, mean(metrics.score[metrics.answered])),
            Row(
                f"{best}, checked: score, exact", None, mean(metrics.exact_score[metrics.answered])
            ),
            Row(
                f"{best}, checked: strict score", None, mean(metrics.strict_score[metrics.answered])
            ),
            Row(f"{best}, checked: into the table", None, int(metrics.into_table.sum())),
            Row(
                f"{best}, checked: score, out-of-bias need, target given",
                "0.45 to 0.61 (cascade grid)",
                mean(need.score[need.answered]),
                f"{int(need.answered.sum())} of {len(need.answered)} answered",
            ),
            Row(
                f"{best}, checked: score, out-of-bias need, target found",
                None,
                mean(need_found.score[need_found.answered]),
                f"{int(need_found.answered.sum())} of {len(need_found.answered)} answered",
            ),
            Row(
                f"{best}, checked: the same, a request for help counted as 0",
                "0.45 to 0.61 (cascade grid)",
                mean(np.nan_to_num(need_found.score)),
            ),
        ),
        tables=tuple(
            Table(
                f"{'Checked' if check else 'Bare'}, {words}",
                COLUMNS,
                ranker_table(evaluation, target_source, check),
            )
            for target_source, words in SEEN.items()
            for check in (False, True)
        ),
        pictures=(
            Picture(
                "rankers",
                "Strict score of every ranker, bare and checked, target found by the package.",
                svg=ranker_points(RANKERS, _strict(evaluation, False), _strict(evaluation, True)),
                alt="Points with intervals, two for each ranker",
            ),
        ),
    )


def best_checked(evaluation: Evaluation) -> str:
    """The ranker with the best strict score, checked, among those that never enter the table."""
    found = {name: evaluation.metrics(name, "found", check=True) for name in RANKERS}
    clean = [name for name in RANKERS if not found[name].into_table.any()] or list(RANKERS)
    return max(clean, key=lambda name: _of_all(found[name].strict_score))


def ranker_table(
    evaluation: Evaluation, target_source: str, check: bool, rankers: tuple[str, ...] = RANKERS
) -> tuple[tuple[str | int | Estimate, ...], ...]:
    """A line a ranker, in the order of COLUMNS."""
    lines: list[tuple[str | int | Estimate, ...]] = []
    for name in rankers:
        metrics = evaluation.metrics(name, target_source, check)
        done = metrics.answered
        count = int(done.sum())
        lines.append(
            (
                name,
                share(count, len(done)),
                mean(metrics.score[done]),
                mean(metrics.exact_score[done]),
                mean(metrics.strict_score[done]),
                share(int(metrics.unobstructed.sum()), count),
                share(int(metrics.clear.sum()), count),
                share(int(metrics.good.sum()), count),
                int(metrics.into_table.sum()),
                int(metrics.too_wide.sum()),
            )
        )
    return tuple(lines)


def _strict(evaluation: Evaluation, check: bool) -> tuple[Estimate, ...]:
    found = [evaluation.metrics(name, "found", check) for name in RANKERS]
    return tuple(mean(np.nan_to_num(metrics.strict_score)) for metrics in found)


def _of_all(score: np.ndarray) -> float:
    """The average with 0 for what was not answered."""
    return float(np.nan_to_num(score).mean())
