"""What a score is worth: a random candidate, the most common class, the operator itself.

Every score stands in two ways: `score`, in which a face wider than the opening is no grasp (5-2-1),
and by clearance alone, the words of 3-4.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from boxgrasp.arrays import Array, Floats
from boxgrasp.study.evaluation import Evaluation
from boxgrasp.study.intervals import mean, share
from boxgrasp.study.plots import category_shares
from boxgrasp.study.report import Row

# By what a row is called, the attribute of `Metrics` and of `Chance`.
WAYS = {"score": "score", "score by clearance alone": "clearance_score"}
BASELINES = {"commonest": "most common class", "operator": "operator"}
Averages = Callable[[Floats], Floats]


def baseline_rows(
    evaluation: Evaluation,
    way: str,
    which: Array | slice = slice(None),
    tail: str = "",
    averaged: Averages = np.asarray,
) -> list[Row]:
    """What a random candidate, the most common class and the operator score.

    Args:
        evaluation: of a set.
        way: one of `WAYS`.
        which: (N,) bool, rows that count.
        tail: of the rows' names.
        averaged: values of rows to values that are independent.

    Returns:
        A row each.
    """
    name = WAYS[way]
    values = {"random candidate": getattr(evaluation.chance, name)}
    values |= {
        words: getattr(evaluation.metrics(ranker), name) for ranker, words in BASELINES.items()
    }
    return [
        Row(f"{way}, {words}{tail}", None, mean(averaged(value[which])))
        for words, value in values.items()
    ]


def categories_both_ways(
    names: Sequence[str], counts_of: Callable[[str, bool], tuple[int, int, int]]
) -> str:
    """Shares of red, yellow and green with faces too wide as red, and by clearance alone.

    Args:
        names: of the columns.
        counts_of: a column's counts, by its name and whether any width counts.

    Returns:
        SVG, twice as many columns.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    columns = (*names, *(f"{name}, by clearance" for name in names))
    counts = tuple(counts_of(name, any_width) for any_width in (False, True) for name in names)
    return category_shares(columns, counts)


def unobstructed_baselines(evaluation: Evaluation) -> list[Row]:
    """The share of unobstructed picks of the same three.

    Args:
        evaluation: of a set.

    Returns:
        A row each.
    """
    chance = mean(evaluation.chance.unobstructed)
    rows = [Row("unobstructed, random candidate", None, chance)]
    for ranker, words in BASELINES.items():
        clear = evaluation.metrics(ranker).unobstructed
        rows.append(Row(f"unobstructed, {words}", None, share(int(clear.sum()), len(clear))))
    return rows
