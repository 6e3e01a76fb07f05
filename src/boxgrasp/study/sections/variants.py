"""The test scenarios cast otherwise: with a sensor's noise, and with empty tables among them."""

from __future__ import annotations

import numpy as np

from boxgrasp.ranking.model_set import VERSIONS
from boxgrasp.study.evaluation import Evaluation
from boxgrasp.study.intervals import difference, mean
from boxgrasp.study.report import Row, Section
from boxgrasp.study.sections.baselines import WAYS, baseline_rows
from boxgrasp.study.study import Study

VARIANTS = {"tested-xtion": "an Xtion's noise", "tested-empty": "0 to 4 obstacles"}


def variants_section(study: Study) -> Section:
    """Scores under an Xtion's noise and where tables may be empty.

    Args:
        study: whose scenarios they are.

    Returns:
        The section.
    """
    tested, noisy = study.evaluation("tested"), study.evaluation("tested-xtion")
    same = tested.take(np.arange(tested.rows.count) < noisy.rows.count)
    return Section(
        key="variants",
        title="Noise, and empty tables",
        place="sections 3-1, 3-3-1",
        words=(
            "The thesis tells of noise for the real camera alone (3-5-2), and its figures fit "
            "tables that are never empty. "
            f"Here the first {noisy.rows.count} test scenarios are cast with an Xtion's noise, and "
            "as many others with 0 to 4 obstacles: where there is none everything scores 1 that "
            "fits. The models are those of all else.",
        ),
        rows=tuple(
            row
            for way in WAYS
            for name, words in VARIANTS.items()
            for row in _rows(study.evaluation(name), way, words)
        )
        + tuple(
            Row(
                f"score, {version}, an Xtion's noise less none, same scenes",
                None,
                difference(noisy.metrics(version).score, same.metrics(version).score),
            )
            for version in VERSIONS
        ),
    )


def _rows(evaluation: Evaluation, way: str, words: str) -> list[Row]:
    scores = {version: getattr(evaluation.metrics(version), WAYS[way]) for version in VERSIONS}
    own = [Row(f"{way}, {who}, {words}", None, mean(score)) for who, score in scores.items()]
    return own + baseline_rows(evaluation, way, tail=f", {words}")
