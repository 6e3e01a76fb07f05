"""Every result of the thesis beside what came out here, each with its verdict."""

from __future__ import annotations

from boxgrasp.study.answers import ANSWERS, Answer, Figures
from boxgrasp.study.catalogue import Result, catalogue
from boxgrasp.study.intervals import Estimate
from boxgrasp.study.report import Claim
from boxgrasp.study.study import Study
from boxgrasp.study.verdicts import judge

NONE = "This study has no such scenes."


def claims(study: Study) -> tuple[Claim, ...]:
    """The whole catalogue, judged.

    Args:
        study: what it is held against.

    Returns:
        A claim a result, in the thesis's order.

    Raises:
        StoreError: the study's place cannot be read or written.
    """
    figures = Figures(study)
    return tuple(_claim(result, figures) for result in catalogue())


def _claim(result: Result, figures: Figures) -> Claim:
    if result.said.kind == "open":
        answer = Answer(None, result.why_open)
    else:
        answer = ANSWERS[result.key](figures)
    verdict, reason = judge(result.said, answer.ours), answer.reason
    if verdict == "cannot be judged here" and isinstance(answer.ours, Estimate):
        reason = " ".join(part for part in (NONE, reason) if part)
    return Claim(
        key=result.key,
        text=result.says,
        place=result.place,
        kind=result.said.kind,
        theirs=str(result.said),
        ours=answer.ours,
        verdict=verdict,
        reason=reason,
    )
