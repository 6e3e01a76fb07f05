"""What the operator chose: figures 4-1 and 4-2, section 5-1."""

from __future__ import annotations

import numpy as np

from boxgrasp.arrays import Array
from boxgrasp.grasps.candidates import FACES, FRONT, LINES, TOP_PARALLEL, TOP_PERPENDICULAR
from boxgrasp.grasps.gripper import Gripper
from boxgrasp.study.evaluation import Evaluation
from boxgrasp.study.intervals import mean, share
from boxgrasp.study.plots import category_shares, label_distribution
from boxgrasp.study.report import Picture, Row, Section, Table
from boxgrasp.study.sections.baselines import WAYS, baseline_rows
from boxgrasp.study.study import Study
from boxgrasp.teaching.sets import Rows


def labels_section(study: Study) -> Section:
    """The training set's labels by category, face and line, beside what the text keeps of them.

    Args:
        study: whose labels they are.

    Returns:
        The section.
    """
    evaluation = study.evaluation("labels")
    counts = _counts(evaluation.rows["label"])
    return Section(
        key="labels",
        title="What the operator chose",
        place="sections 3-3-1, 4-1, 5-1; figures 4-1 and 4-2",
        words=(
            "The operator is a stand-in, a rule with habits and not a person. Its few numbers "
            "were set so that its choices match what the thesis's text keeps of these figures, "
            "so that agreement here is no finding.",
        ),
        rows=_rows(evaluation, counts),
        tables=(
            Table(
                "Labels by face and line",
                ("face", "line 1", "line 2", "line 3", "all"),
                tuple(
                    (name, *line, sum(line))
                    for name, line in zip(FACES, counts.tolist(), strict=True)
                ),
            ),
        ),
        pictures=_pictures(evaluation, counts),
    )


def _counts(label: Array) -> Array:
    """(5, l) how many labels are on each face and line."""
    return np.bincount(label, minlength=5 * LINES + 1)[1:].reshape(5, LINES)


def _rows(evaluation: Evaluation, counts: Array) -> tuple[Row, ...]:
    rows = evaluation.rows
    on_box = _counts(rows["label"][rows["target"] == "cereal_y"]).sum(axis=1)
    by_face = counts.sum(axis=1)
    return (
        Row("average score of the labels", 0.93, mean(evaluation.metrics("operator").score)),
        *(
            row
            for way in WAYS
            for row in baseline_rows(evaluation, way, tail=", the labels' scenes")
        ),
        Row("side faces chosen", 408, int(by_face[:3].sum())),
        Row("top faces chosen", 392, int(by_face[3:].sum())),
        Row("line 2 chosen", "by far the commonest", share(int(counts[:, 1].sum()), rows.count)),
        Row(
            "commonest face on the cereal box along y",
            FACES[TOP_PERPENDICULAR - 1],
            FACES[int(np.argmax(on_box))],
        ),
        Row("faces wider than the opening chosen", 0, _too_wide(rows)),
    )


def _too_wide(rows: Rows) -> int:
    """How many labels are on a face that the fingers do not go round."""
    face = (rows["label"] - 1) // LINES + 1
    across = np.where(np.isin(face, (FRONT, TOP_PARALLEL)), 1, 0)
    width_m = rows["given_dimensions_m"][np.arange(rows.count), across]
    return int((width_m > Gripper().max_opening_m).sum())


def _pictures(evaluation: Evaluation, counts: Array) -> tuple[Picture, Picture]:
    return (
        Picture(
            "figure-4-1",
            "Labels by category (figure 4-1); clearance to the visible cloud.",
            svg=category_shares(("labels",), (evaluation.category_counts("operator"),)),
            alt="Shares of red, yellow and green labels",
        ),
        Picture(
            "figure-4-2",
            "Labels by face and line (figure 4-2).",
            svg=label_distribution(counts),
            alt="Bars of the number of labels on each face and line",
        ),
    )
