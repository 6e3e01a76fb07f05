"""What came out here for each result of the thesis, by the results' keys in `thesis.yaml`."""

from __future__ import annotations

from boxgrasp.study.answers import (
    discussion,
    labels,
    need,
    real,
    samplings,
    segmentation,
    versions,
)
from boxgrasp.study.answers.figures import Answer, Figures

__all__ = ["ANSWERS", "Answer", "Figures"]

ANSWERS = {
    **samplings.ANSWERS,
    **labels.ANSWERS,
    **versions.ANSWERS,
    **need.ANSWERS,
    **real.ANSWERS,
    **discussion.ANSWERS,
    **segmentation.ANSWERS,
}
