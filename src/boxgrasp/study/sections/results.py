"""The four versions on simulated scenes: figures 4-3, 4-4, table 4-1, agreement, scores (3-4)."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from boxgrasp.arrays import Array
from boxgrasp.ranking.model_set import VERSIONS
from boxgrasp.study.evaluation import Evaluation
from boxgrasp.study.intervals import Estimate, difference, mean, share
from boxgrasp.study.metrics import SCORE_FUNCTIONS, metrics_of
from boxgrasp.study.plots import category_shares, forest, score_functions
from boxgrasp.study.report import Cell, Picture, Row, Section, Table
from boxgrasp.study.study import Study

GROUPS = ("known", "novel", "total")
# Table 4-1: average score by version and group.
TABLE_4_1 = {
    "single-spiral": (0.60, 0.50, 0.55),
    "cascade-spiral": (0.64, 0.48, 0.56),
    "single-grid": (0.78, 0.84, 0.81),
    "cascade-grid": (0.84, 0.84, 0.84),
}
# Section 4-2: share of decisions in which single and cascade differ.
DIFFERENT = {"spiral": (4 / 60, 5 / 60, 0.08), "grid": (10 / 60, 4 / 60, 0.12)}


def results_section(study: Study, count: int | None = None) -> Section:
    """Table 4-1 on the test scenarios.

    Args:
        study: whose scenarios they are.
        count: of the first ones; None for all.

    Returns:
        The section.
    """
    evaluation = study.evaluation("tested")
    if count is not None:
        evaluation = evaluation.take(np.arange(evaluation.rows.count) < count)
    size = evaluation.rows.count
    table_4_1 = _score_rows(evaluation)
    return Section(
        key=f"results-{size}",
        title=f"Four versions, {size} scenarios",
        place="section 4-2; figures 4-3 and 4-4, table 4-1",
        words=(
            f"{size} test scenarios, {size // 8} for each of the eight targets, the SVM's first "
            "choice, target points and aligned box given. The thesis had 120 of its own.",
        ),
        rows=(
            *table_4_1,
            *_unobstructed_rows(evaluation),
            *_order_rows(evaluation),
            *_operator_rows(evaluation),
            *_exact_rows(evaluation),
        ),
        pictures=_pictures(evaluation, table_4_1),
    )


def _score_rows(evaluation: Evaluation) -> list[Row]:
    return [
        Row(
            f"score, {version}, {group}",
            theirs,
            mean(evaluation.metrics(version).score[group_of(evaluation, group)]),
        )
        for version in VERSIONS
        for group, theirs in zip(GROUPS, TABLE_4_1[version], strict=True)
    ]


def _unobstructed_rows(evaluation: Evaluation) -> list[Row]:
    rows = []
    for version in VERSIONS:
        clear = evaluation.metrics(version).unobstructed
        bar = "more than 0.90" if version == "cascade-grid" else None
        rows.append(Row(f"unobstructed, {version}", bar, share(int(clear.sum()), len(clear))))
    return rows


def _order_rows(evaluation: Evaluation) -> list[Row]:
    return [
        Row(f"score, {a} less {b}", round(TABLE_4_1[a][2] - TABLE_4_1[b][2], 2), gap)
        for a, b, gap in orders(evaluation)
    ]


def _operator_rows(evaluation: Evaluation) -> list[Row]:
    own = evaluation.picks("operator")
    score = mean(evaluation.metrics("operator").score)
    rows = [Row("score of the operator on the same scenes", None, score)]
    for version in VERSIONS:
        same = evaluation.picks(version) == own
        agree = share(int(same.sum()), len(same))
        rows.append(Row(f"same candidate as the operator, {version}", None, agree))
    return rows


def _exact_rows(evaluation: Evaluation) -> list[Row]:
    return [
        Row(
            f"score by exact surfaces, {version}",
            None,
            mean(evaluation.metrics(version).exact_score),
        )
        for version in VERSIONS
    ]


def _pictures(evaluation: Evaluation, table_4_1: list[Row]) -> tuple[Picture, ...]:
    size = evaluation.rows.count
    categories = (
        Picture(
            f"figure-{number}-{group}-{size}",
            f"Categories by version, {group} objects (figure {number}).",
            svg=_categories(evaluation, group),
            alt=f"Shares of red, yellow and green picks, {group} objects",
        )
        for number, group in (("4-3", "total"), ("4-4a", "known"), ("4-4b", "novel"))
    )
    scores = Picture(
        f"table-4-1-{size}",
        "Average scores, the thesis's as a mark, ours with its 95 % interval.",
        svg=forest(table_4_1),
        alt="Scores of four versions beside the thesis's",
    )
    return (*categories, scores)


def orders(evaluation: Evaluation) -> list[tuple[str, str, Estimate]]:
    """The order of table 4-1 as paired differences of scores.

    Args:
        evaluation: of a set.

    Returns:
        Two versions, and the score of the first less that of the second.
    """
    pairs = (
        ("single-grid", "single-spiral"),
        ("cascade-grid", "cascade-spiral"),
        ("cascade-spiral", "single-spiral"),
        ("cascade-grid", "single-grid"),
    )
    return [
        (a, b, difference(evaluation.metrics(a).score, evaluation.metrics(b).score))
        for a, b in pairs
    ]


def group_of(evaluation: Evaluation, group: str) -> Array:
    """The rows of a group of targets.

    Args:
        evaluation: of a set.
        group: one of `GROUPS`.

    Returns:
        (N,) bool.
    """
    everything = np.ones(evaluation.rows.count, dtype=bool)
    return {"known": evaluation.known, "novel": ~evaluation.known, "total": everything}[group]


def _categories(evaluation: Evaluation, group: str) -> str:
    which = group_of(evaluation, group)
    names = (*VERSIONS, "operator")
    return category_shares(names, tuple(evaluation.category_counts(n, which) for n in names))


def agreement_section(study: Study) -> Section:
    """How often single and cascade decide alike.

    Args:
        study: whose scenarios they are.

    Returns:
        The section.
    """
    evaluation = study.evaluation("tested")
    rows = []
    for name, theirs in DIFFERENT.items():
        apart = evaluation.picks(f"single-{name}") != evaluation.picks(f"cascade-{name}")
        for group, value in zip(GROUPS, theirs, strict=True):
            which = group_of(evaluation, group)
            rows.append(
                Row(
                    f"single and cascade {name} differ, {group}",
                    round(value, 3),
                    share(int(apart[which].sum()), int(which.sum())),
                )
            )
    return Section(
        key="agreement",
        title="Where single and cascade differ",
        place="section 4-2",
        words=(
            "Share of scenarios in which the two take different candidates, in face or in line.",
        ),
        rows=tuple(rows),
    )


def scores_section(study: Study) -> Section:
    """Other scores: does the order of the versions change?

    Args:
        study: whose scenarios they are.

    Returns:
        The section.
    """
    same, exchanged, table = _compared(study.evaluation("tested"))
    changed = f"; exchanged: {', '.join(exchanged)}" if exchanged else ""
    return Section(
        key="scores",
        title="The score, and others",
        place="section 3-4, figure 3-14",
        words=(
            "The thesis says that linear and exponential scores, and a threshold of 5 cm, change "
            "the figures but not the order of the four versions. It gives no formulas; the "
            "exponential here is (e^3t - 1) / (e^3 - 1).",
        ),
        rows=(
            Row(
                "scores with the order of the quadratic one",
                "all",
                f"{same} of {len(SCORE_FUNCTIONS)}{changed}",
            ),
        ),
        tables=(table,),
        pictures=(
            Picture(
                "figure-3-14",
                "The score by clearance (figure 3-14), and the other shapes.",
                svg=score_functions(),
                alt="Curves of scores over clearance",
            ),
        ),
    )


def _compared(evaluation: Evaluation) -> tuple[int, list[str], Table]:
    """How many scores keep the first one's order, which versions change places, and the table."""
    lines: list[tuple[Cell, ...]] = []
    found: list[list[str]] = []
    for function in SCORE_FUNCTIONS:
        scores = {
            v: metrics_of(evaluation.rows, "given", evaluation.picks(v), function).score
            for v in VERSIONS
        }
        order = sorted(VERSIONS, key=lambda v: -float(scores[v].mean()))
        found.append(order)
        lines.append((function.name, *map(mean, scores.values()), " > ".join(order)))
    first = found[0]
    exchanged = {
        f"{a} and {b}"
        for order in found
        for a, b in combinations(VERSIONS, 2)
        if order.index(a) > order.index(b) and first.index(a) < first.index(b)
    }
    table = Table("Average score by shape", ("shape", *VERSIONS, "order"), tuple(lines))
    return sum(order == first for order in found), sorted(exchanged), table
