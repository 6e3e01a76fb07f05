"""The eight SVMs: figure 3-12 and table B-1."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from boxgrasp.grasps.candidates import LINES, TOP_PARALLEL
from boxgrasp.ranking.model_set import SVMS, Svm
from boxgrasp.study.evaluation import Evaluation
from boxgrasp.study.intervals import Estimate, share
from boxgrasp.study.metrics import ASK
from boxgrasp.study.plots import heat_map
from boxgrasp.study.report import Cell, Picture, Row, Section, Table
from boxgrasp.study.study import Study
from boxgrasp.teaching.search import AS_GOOD

# C, gamma, support vectors and training examples of appendix B-1, by the figure's numbers.
B1 = {
    1: (3.3636, 0.1387, 796, 800),
    2: (1.3195, 0.0035, 793, 800),
    3: (10.1967, 0.0490, 720, 800),
    4: (1.2311, 0.0427, 725, 800),
    5: (1.7411, 0.2871, 232, 408),
    6: (174.8532, 0.0229, 151, 408),
    7: (50.2134, 0.0156, 229, 392),
    8: (3.6050, 0.0490, 266, 392),
}
COLUMNS = (
    "SVM", "features x classes seen", "C (thesis)", "C", "gamma (thesis)", "gamma",
    "vectors (thesis)", "vectors", "examples (thesis)", "examples",
    "accuracy", "most common class", "balanced accuracy", "accuracy, one against the rest",
    "most common answer in the test scenes",
)  # fmt: skip
Kept = Mapping[str, Any]


def training_section(study: Study) -> Section:
    """Parameters, support vectors and accuracies, theirs and ours, and the heat maps.

    Args:
        study: whose SVMs they are.

    Returns:
        The section.
    """
    kept = {svm: study.trained[svm.name] for svm in SVMS}
    accuracies = [item["record"]["accuracy"] for item in kept.values()]
    others = [item["one_vs_rest"] for item in kept.values()]
    return Section(
        key="training",
        title="The eight SVMs",
        place="sections 2-3, 3-3-2, 4-1; figure 3-12, table B-1",
        words=(
            "RBF kernels, 5-fold stratified cross-validation, a coarse grid over C and gamma, then "
            "a finer one round its best region. Of the pairs within half a point of the best "
            "accuracy the one with the best balanced accuracy (the mean over the classes of the "
            "share that is found again) is taken, then the larger gamma. The thesis took a larger "
            "gamma among accurate pairs, to counter the bias of unequal classes (4-1); where "
            "nearly all labels are of one class that picks an SVM that says it always. A pair "
            "that answers every example alike is never taken. The thesis gives no accuracies.",
            _plateaus(kept),
            "The thesis's text describes one class against the rest, but LIBSVM, which it used, "
            "trains one against one. These models are one against one; the other is measured at "
            f"the same parameters: {np.mean(others):.3f} against {np.mean(accuracies):.3f} on "
            "average over the eight.",
        ),
        rows=tuple(_row(svm, item) for svm, item in kept.items()),
        tables=(
            Table(
                "Table B-1, theirs and ours",
                COLUMNS,
                tuple(
                    (*_line(svm, item), commonest_answer(study.evaluation("tested"), svm))
                    for svm, item in kept.items()
                ),
            ),
        ),
        pictures=tuple(_picture(svm, item) for svm, item in kept.items()),
    )


def _plateaus(kept: Mapping[Svm, Kept]) -> str:
    """The SVMs that know hardly more than the most common class, named."""
    flat = [
        svm.name
        for svm, item in kept.items()
        if item["record"]["accuracy"] <= item["search"]["commonest"] + AS_GOOD
    ]
    if not flat:
        return "Every SVM is more accurate than its most common class."
    return (
        "No more accurate than saying the most common class always, by half a point: "
        f"{', '.join(flat)}."
    )


def _row(svm: Svm, kept: Kept) -> Row:
    _, _, vectors, count = B1[svm.number]
    record = kept["record"]
    return Row(
        f"{svm.name}: share of examples that are support vectors",
        round(vectors / count, 3),
        round(record["support_vectors"] / record["training_examples"], 3),
    )


def _line(svm: Svm, kept: Kept) -> tuple[Cell, ...]:
    C, gamma, vectors, count = B1[svm.number]
    record, search = kept["record"], kept["search"]
    return (
        f"{svm.number}. {svm.name}",
        f"{len(record['features'])} x {len(record['classes'])}",
        C, round(record["C"], 4), gamma, round(record["gamma"], 4),
        vectors, record["support_vectors"], count, record["training_examples"],
        round(record["accuracy"], 3), round(search["commonest"], 3), round(search["balanced"], 3),
        round(kept["one_vs_rest"], 3),
    )  # fmt: skip


def commonest_answer(evaluation: Evaluation, svm: Svm) -> Estimate:
    """How often an SVM says what it says most often: 1 would be a constant.

    Args:
        evaluation: of a set.
        svm: which one; of a cascade's second half the scenes whose face is its.

    Returns:
        The share.
    """
    picks = evaluation.picks(svm.version)
    picks = picks[picks != ASK]
    face, line = np.divmod(picks, LINES)
    if svm.part == "side":
        said = line[face < TOP_PARALLEL - 1]
    elif svm.part == "top":
        said = line[face >= TOP_PARALLEL - 1]
    else:
        said = face if svm.part == "face" else picks
    return share(int(np.bincount(said).max(initial=0)), len(said))


def _picture(svm: Svm, kept: Kept) -> Picture:
    return Picture(
        f"figure-3-12-{svm.name}",
        f"Accuracy over C and gamma, {svm.name} (figure 3-12 shows single-grid).",
        svg=heat_map(kept["search"], svm.name),
        alt=f"Heat map of accuracies of {svm.name}",
    )
