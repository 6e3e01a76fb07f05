"""The four versions on simulated scenes: figures 4-3, 4-4, table 4-1, agreement, scores (3-4)."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from boxgrasp.arrays import Array
from boxgrasp.grasps.candidates import FACES, LINES
from boxgrasp.ranking.model_set import VERSIONS
from boxgrasp.study.evaluation import Evaluation
from boxgrasp.study.intervals import Estimate, difference, mean, share
from boxgrasp.study.metrics import SCORE_FUNCTIONS, metrics_of
from boxgrasp.study.plots import category_shares, forest, score_functions
from boxgrasp.study.report import Cell, Picture, Row, Section, Table
from boxgrasp.study.sections.baselines import (
    BASELINES,
    WAYS,
    baseline_rows,
    unobstructed_baselines,
)
from boxgrasp.study.study import Study

GROUPS = ("known", "novel", "total")
# Table 4-1: average score by version and group.
TABLE_4_1 = {
    "single-spiral": (0.60, 0.50, 0.55),
    "cascade-spiral": (0.64, 0.48, 0.56),
    "single-grid": (0.78, 0.84, 0.81),
    "cascade-grid": (0.84, 0.84, 0.84),
}
RIGHT_BAR = ("four versions", "on the right the labels of the training set")
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
    table_4_1, by_clearance = (_score_rows(evaluation, way) for way in WAYS)
    return Section(
        key=f"results-{size}",
        title=f"Four versions, {size} scenarios",
        place="section 4-2; figures 4-3 and 4-4, table 4-1",
        words=(
            f"{size} test scenarios, {size // 8} for each of the eight targets, the SVM's first "
            "choice, target points and aligned box given. The thesis had 120 of its own.",
            "A face wider than the opening is no grasp (5-2-1): such a pick is red and scores 0. "
            "Beside it every score by clearance alone, as 3-4 words it. A random candidate is the "
            "average over all 15, so that nothing is drawn; the most common class is the "
            f"operator's in training ({_named(evaluation)}).",
        ),
        rows=(
            *table_4_1,
            *by_clearance,
            *_unobstructed_rows(evaluation),
            *_order_rows(evaluation),
            *_agreement_rows(study, evaluation),
            *_exact_rows(evaluation),
        ),
        pictures=_pictures(study, evaluation, table_4_1),
    )


def _named(evaluation: Evaluation) -> str:
    face, line = divmod(evaluation.commonest or 0, LINES)
    return f"{FACES[face]}, line {line + 1}"


def _score_rows(evaluation: Evaluation, way: str) -> list[Row]:
    rows = [
        Row(
            f"{way}, {version}, {group}",
            theirs,
            mean(getattr(evaluation.metrics(version), WAYS[way])[group_of(evaluation, group)]),
        )
        for version in VERSIONS
        for group, theirs in zip(GROUPS, TABLE_4_1[version], strict=True)
    ]
    for group in GROUPS:
        which = group_of(evaluation, group)
        rows += baseline_rows(evaluation, way, which, f", {group}")
    return rows


def _unobstructed_rows(evaluation: Evaluation) -> list[Row]:
    rows = []
    for version in VERSIONS:
        metrics = evaluation.metrics(version)
        bar = "more than 0.90" if version == "cascade-grid" else None
        for words, clear in (
            (f"unobstructed, {version}", metrics.unobstructed),
            (f"unobstructed by clearance alone, {version}", metrics.distant),
        ):
            rows.append(Row(words, bar, share(int(clear.sum()), len(clear))))
    return rows + unobstructed_baselines(evaluation)


def _order_rows(evaluation: Evaluation) -> list[Row]:
    return [
        Row(f"{way}, {a} less {b}", round(TABLE_4_1[a][2] - TABLE_4_1[b][2], 2), gap)
        for way in WAYS
        for a, b, gap in orders(evaluation, way)
    ]


def _agreement_rows(study: Study, evaluation: Evaluation) -> list[Row]:
    own = evaluation.picks("operator")
    names = (*VERSIONS, "commonest")
    picks = [(BASELINES.get(name, name), evaluation.picks(name)) for name in names]
    second = study.again[: len(own)]
    picks.append((f"operator, asked again of {len(second)} scenes", second))
    rows = [
        Row(
            f"same candidate as the operator, {words}",
            None,
            share(int((found == own[: len(found)]).sum()), len(found)),
        )
        for words, found in picks
    ]
    chance = round(1 / (len(FACES) * LINES), 3)
    return [*rows, Row("same candidate as the operator, random candidate", None, chance)]


def _exact_rows(evaluation: Evaluation) -> list[Row]:
    return [
        Row(
            f"score by exact surfaces, {version}",
            None,
            mean(evaluation.metrics(version).exact_score),
        )
        for version in VERSIONS
    ]


def _pictures(study: Study, evaluation: Evaluation, table_4_1: list[Row]) -> tuple[Picture, ...]:
    size = evaluation.rows.count
    categories = (
        Picture(
            f"figure-{number}-{group}-{size}{'-any-width' if any_width else ''}",
            f"Categories by version, {group} objects (figure {number}"
            f"{', by clearance alone' if any_width else ''}); {RIGHT_BAR[group == 'total']}.",
            svg=_categories(study, evaluation, group, any_width=any_width),
            alt=f"Shares of red, yellow and green picks, {group} objects",
        )
        for number, group in (("4-3", "total"), ("4-4a", "known"), ("4-4b", "novel"))
        for any_width in (False, True)
    )
    scores = Picture(
        f"table-4-1-{size}",
        "Average scores, the thesis's as a mark, ours with its 95 % interval.",
        svg=forest(table_4_1),
        alt="Scores of four versions beside the thesis's",
    )
    return (*categories, scores)


def orders(evaluation: Evaluation, way: str = "score") -> list[tuple[str, str, Estimate]]:
    """The order of table 4-1 as paired differences of scores.

    Args:
        evaluation: of a set.
        way: one of `WAYS`.

    Returns:
        Two versions, and the score of the first less that of the second.
    """
    pairs = (
        ("single-grid", "single-spiral"),
        ("cascade-grid", "cascade-spiral"),
        ("cascade-spiral", "single-spiral"),
        ("cascade-grid", "single-grid"),
    )
    scores = {v: getattr(evaluation.metrics(v), WAYS[way]) for v in VERSIONS}
    return [(a, b, difference(scores[a], scores[b])) for a, b in pairs]


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


def _categories(
    study: Study, evaluation: Evaluation, group: str, *, any_width: bool = False
) -> str:
    """Of all groups beside the training set, as figure 4-3 has it; else beside the operator."""
    which = group_of(evaluation, group)
    names = [*VERSIONS]
    counts = [evaluation.category_counts(n, which, any_width=any_width) for n in names]
    if group == "total":
        names.append("training set")
        taught = study.evaluation("labels")
        counts.append(taught.category_counts("operator", any_width=any_width))
    return category_shares(names, counts)


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
    (same, exchanged, table), (alone, _, other) = (
        _compared(study.evaluation("tested"), way) for way in WAYS
    )
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
            Row(
                "the same by clearance alone",
                "all",
                f"{alone} of {len(SCORE_FUNCTIONS)}",
            ),
        ),
        tables=(table, other),
        pictures=(
            Picture(
                "figure-3-14",
                "The score by clearance (figure 3-14), and the other shapes.",
                svg=score_functions(),
                alt="Curves of scores over clearance",
            ),
        ),
    )


def _compared(evaluation: Evaluation, way: str) -> tuple[int, list[str], Table]:
    """How many scores keep the first one's order, which versions change places, and the table."""
    lines: list[tuple[Cell, ...]] = []
    found: list[list[str]] = []
    for function in SCORE_FUNCTIONS:
        scores = {
            v: getattr(
                metrics_of(evaluation.rows, "given", evaluation.picks(v), function), WAYS[way]
            )
            for v in VERSIONS
        }
        order = sorted(VERSIONS, key=lambda v: -float(np.nanmean(scores[v])))
        found.append(order)
        lines.append((function.name, *map(mean, scores.values()), " > ".join(order)))
    first = found[0]
    exchanged = {
        f"{a} and {b}"
        for order in found
        for a, b in combinations(VERSIONS, 2)
        if order.index(a) > order.index(b) and first.index(a) < first.index(b)
    }
    table = Table(f"Average {way} by shape", ("shape", *VERSIONS, "order"), tuple(lines))
    return sum(order == first for order in found), sorted(exchanged), table
