"""Where the thesis can be read in two ways: dimensions as features (3-3-2)."""

from __future__ import annotations

from boxgrasp.study.curves import Kind, fit
from boxgrasp.study.evaluation import Evaluation, ModelSet
from boxgrasp.study.intervals import Estimate, mean, share
from boxgrasp.study.report import Row, Section
from boxgrasp.study.study import Study
from boxgrasp.teaching.sets import Rows
from boxgrasp.teaching.train import SAMPLINGS, SVMS, Part

KINDS: tuple[Kind, ...] = ("single", "cascade")


def readings_section(study: Study) -> Section:
    """The four versions with dimensions over each box's own longest edge."""
    evaluation, labels = study.evaluation("tested"), study.rows("labels")
    rows = []
    for sampling in SAMPLINGS:
        for kind in KINDS:
            version = f"{kind}-{sampling}"
            other = fit(labels, kind, sampling, held(study, sampling), own_edge=True)
            ours = mean(evaluation.metrics(version).score)
            score, agree = judged(evaluation.rows, other)
            rows += [
                Row(f"score, {version}, the set's longest edge", None, ours),
                Row(f"score, {version}, each box's own", None, score),
                Row(f"same candidate as the operator, {version}, each box's own", None, agree),
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
    """C and gamma of the trained SVMs of a sampling, by part."""
    own = [svm for svm in SVMS if svm.sampling == sampling]
    records = {svm.part: study.trained[svm.name]["record"] for svm in own}
    return {part: (record["C"], record["gamma"]) for part, record in records.items()}


def judged(rows: Rows, model_set: ModelSet) -> tuple[Estimate, Estimate]:
    """Score and agreement with the operator of a model_set's bare picks."""
    evaluation = Evaluation(rows, {"own": model_set})
    same = evaluation.picks("own") == rows["label"] - 1
    return mean(evaluation.metrics("own").score), share(int(same.sum()), len(same))
