"""Where the thesis can be read in two ways: dimensions as features (3-3-2)."""

from __future__ import annotations

from boxgrasp.ranking.model_set import SAMPLINGS, SVMS, ModelSet, Part
from boxgrasp.study.curves import Kind, Variant, fit
from boxgrasp.study.evaluation import Evaluation
from boxgrasp.study.intervals import Estimate, mean, share
from boxgrasp.study.report import Row, Section
from boxgrasp.study.study import Study
from boxgrasp.teaching.sets import Rows

KINDS: tuple[Kind, ...] = ("single", "cascade")


def readings_section(study: Study) -> Section:
    """The four versions with dimensions over each box's own longest edge.

    Args:
        study: whose labels and test scenarios they are.

    Returns:
        The section.
    """
    evaluation, labels = study.evaluation("tested"), study.rows("labels")
    rows = []
    for sampling in SAMPLINGS:
        for kind in KINDS:
            variant = Variant(kind, sampling, own_edge=True)
            other = fit(labels.answered, variant, held(study, sampling))
            usual = evaluation.metrics(variant.version)
            own = Evaluation(evaluation.rows, {"own": other}).metrics("own")
            score, agree = judged(evaluation.rows, other)
            same = f"same candidate as the operator, {variant.version}, each box's own"
            rows += [
                Row(f"score, {variant.version}, the set's longest edge", None, mean(usual.score)),
                Row(f"score, {variant.version}, each box's own", None, score),
                *(
                    Row(f"score by clearance alone, {variant.version}, {words}", None, mean(scores))
                    for words, scores in (
                        ("the set's longest edge", usual.clearance_score),
                        ("each box's own", own.clearance_score),
                    )
                ),
                Row(same, None, agree),
            ]
    return Section(
        key="readings",
        title="Dimensions as features, read in two ways",
        place="section 3-3-2",
        words=(
            "`Normalized with respect to the maximal AABB edge` can mean the longest edge of the "
            "training set, which all else in this report uses, or each box's own, which loses its "
            "scale. C and gamma are held.",
        ),
        rows=tuple(rows),
    )


def held(study: Study, sampling: str) -> dict[Part, tuple[float, float]]:
    """C and gamma of the trained SVMs of a sampling.

    Args:
        study: whose they are.
        sampling: `spiral` or `grid`.

    Returns:
        C and gamma by part.
    """
    own = [svm for svm in SVMS if svm.sampling == sampling]
    records = {svm.part: study.trained[svm.name]["record"] for svm in own}
    return {part: (record["C"], record["gamma"]) for part, record in records.items()}


def judged(rows: Rows, model_set: ModelSet) -> tuple[Estimate, Estimate]:
    """What a model set's bare picks come to.

    Args:
        rows: of a set.
        model_set: any.

    Returns:
        Score, and agreement with the operator.
    """
    evaluation = Evaluation(rows, {"own": model_set})
    same = evaluation.picks("own") == rows["label"] - 1
    return mean(evaluation.metrics("own").score), share(int(same.sum()), len(same))
