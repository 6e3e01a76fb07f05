"""The four versions on simulated scenes: figures 4-3, 4-4, table 4-1, agreement, scores (3-4)."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from boxgrasp.arrays import Array
from boxgrasp.study.evaluation import VERSIONS, Evaluation
from boxgrasp.study.intervals import Estimate, difference, mean, share
from boxgrasp.study.metrics import SHAPES, metrics_of
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
    """Table 4-1 on the first `count` test scenarios, or on all."""
    evaluation = study.evaluation("tested")
    if count is not None:
        evaluation = evaluation.take(np.arange(evaluation.rows.count) < count)
    size = evaluation.rows.count
    rows = []
    for version in VERSIONS:
        score = evaluation.metrics(version).score
        for group, theirs in zip(GROUPS, TABLE_4_1[version], strict=True):
            which = group_of(evaluation, group)
            rows.append(Row(f"score, {version}, {group}", theirs, mean(score[which])))
    for version in VERSIONS:
        clear = evaluation.metrics(version).unobstructed
        bar = "more than 0.90" if version == "cascade-grid" else None
        rows.append(Row(f"unobstructed, {version}", bar, share(int(clear.sum()), size)))
    rows += [
        Row(f"score, {a} less {b}", round(TABLE_4_1[a][2] - TABLE_4_1[b][2], 2), gap)
        for a, b, gap in orders(evaluation)
    ]
    rows.append(
        Row(
            "score of the operator on the same scenes",
            None,
            mean(evaluation.metrics("operator").score),
        )
    )
    agree = {v: (evaluation.picks(v) == evaluation.picks("operator")) for v in VERSIONS}
    rows += [
        Row(f"same candidate as the operator, {v}", None, share(int(a.sum()), size))
        for v, a in agree.items()
    ]
    rows += [
        Row(f"score by exact surfaces, {v}", None, mean(evaluation.metrics(v).exact_score))
        for v in VERSIONS
    ]
    return Section(
        key=f"results-{size}",
        title=f"Four versions, {size} scenarios",
        place="section 4-2; figures 4-3 and 4-4, table 4-1",
        words=(
            f"{size} test scenarios, {size // 8} for each of the eight targets, the bare SVM's "
            "word, target points and aligned box given. The thesis had 120 of its own.",
        ),
        rows=tuple(rows),
        pictures=(
            *(
                Picture(
                    f"figure-{number}-{group}-{size}",
                    f"Categories by version, {group} objects (figure {number}).",
                    svg=_categories(evaluation, group),
                    alt=f"Shares of red, yellow and green picks, {group} objects",
                )
                for number, group in (("4-3", "total"), ("4-4a", "known"), ("4-4b", "novel"))
            ),
            Picture(
                f"table-4-1-{size}",
                "Average scores, the thesis's as a mark, ours with its 95 % interval.",
                svg=forest(
                    tuple(
                        row
                        for row in rows
                        if row.name.startswith("score, ") and "less" not in row.name
                    )
                ),
                alt="Scores of four versions beside the thesis's",
            ),
        ),
    )


def orders(evaluation: Evaluation) -> list[tuple[str, str, Estimate]]:
    """The order of table 4-1 as paired differences of scores."""
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
    """(N,) bool, the rows of a group of targets."""
    everything = np.ones(evaluation.rows.count, dtype=bool)
    return {"known": evaluation.known, "novel": ~evaluation.known, "total": everything}[group]


def _categories(evaluation: Evaluation, group: str) -> str:
    which = group_of(evaluation, group)
    names = (*VERSIONS, "operator")
    counts = tuple(evaluation.categories(name, which) for name in names)
    return category_shares(names, counts)


def agreement_section(study: Study) -> Section:
    """How often single and cascade decide alike."""
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
    """Other scores: does the order of the versions change?"""
    evaluation = study.evaluation("tested")
    table: list[tuple[Cell, ...]] = []
    same = 0
    first: list[str] = []
    ties = []
    for shape in SHAPES:
        scores = {
            v: metrics_of(evaluation.rows, "given", evaluation.picks(v), shape).score
            for v in VERSIONS
        }
        means = {v: mean(scores[v]) for v in VERSIONS}
        order = sorted(VERSIONS, key=lambda v: -float(scores[v].mean()))
        first = first or order
        same += order == first
        table.append((shape.name, *(means[v] for v in VERSIONS), " > ".join(order)))
        ties += [
            f"{a} and {b}"
            for a, b in combinations(VERSIONS, 2)
            if order.index(a) > order.index(b) and first.index(a) < first.index(b)
        ]
    changed = f"; exchanged: {', '.join(sorted(set(ties)))}" if ties else ""
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
                f"{same} of {len(SHAPES)}{changed}",
            ),
        ),
        tables=(Table("Average score by shape", ("shape", *VERSIONS, "order"), tuple(table)),),
        pictures=(
            Picture(
                "figure-3-14",
                "The score by clearance (figure 3-14), and the other shapes.",
                svg=score_functions(),
                alt="Curves of scores over clearance",
            ),
        ),
    )
