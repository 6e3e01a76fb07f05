"""What the operator chose: figures 4-1 and 4-2, section 5-1."""

from __future__ import annotations

import numpy as np

from boxgrasp.grasps.candidates import FACES, FRONT, TOP_PARALLEL, TOP_PERPENDICULAR
from boxgrasp.grasps.gripper import Gripper
from boxgrasp.study.intervals import mean, share
from boxgrasp.study.plots import category_shares, label_distribution
from boxgrasp.study.report import Picture, Row, Section, Table
from boxgrasp.study.study import Study


def labels_section(study: Study) -> Section:
    """The training set's labels by category, face and line, beside what the text keeps of them."""
    evaluation = study.evaluation("labels")
    rows, found = evaluation.rows, evaluation.metrics("operator")
    label = rows["label"]
    face, line = (label - 1) // 3 + 1, (label - 1) % 3 + 1
    counts = evaluation.categories("operator")
    upright = rows["target"] == "cereal_y"
    on_box = np.bincount(face[upright], minlength=6)[1:]
    by_face = np.bincount(face, minlength=6)[1:]
    by_line = np.bincount(line, minlength=4)[1:]
    across = np.where(np.isin(face, (FRONT, TOP_PARALLEL)), 1, 0)
    width = rows["given_dimensions_m"][np.arange(rows.count), across]
    labels = np.bincount(label, minlength=16)[1:].reshape(5, 3)
    return Section(
        key="labels",
        title="What the operator chose",
        place="sections 3-3-1, 4-1, 5-1; figures 4-1 and 4-2",
        words=(
            "The operator is a stand-in, a rule with habits and not a person. Its few numbers "
            "were set so that its choices match what the thesis's text keeps of these figures, "
            "so that agreement here is no finding.",
        ),
        rows=(
            Row("average score of the labels", 0.93, mean(found.score)),
            Row("side faces chosen", 408, int(by_face[:3].sum())),
            Row("top faces chosen", 392, int(by_face[3:].sum())),
            Row("line 2 chosen", "by far the commonest", share(int(by_line[1]), len(label))),
            Row(
                "commonest face on the cereal box along y",
                FACES[TOP_PERPENDICULAR - 1],
                FACES[int(np.argmax(on_box))],
            ),
            Row(
                "faces wider than the opening chosen",
                0,
                int((width > Gripper().max_opening_m).sum()),
            ),
        ),
        tables=(
            Table(
                "Labels by face and line",
                ("face", "line 1", "line 2", "line 3", "all"),
                tuple(
                    (name, *map(int, labels[k]), int(by_face[k])) for k, name in enumerate(FACES)
                ),
            ),
        ),
        pictures=(
            Picture(
                "figure-4-1",
                "Labels by category (figure 4-1); clearance to the visible cloud.",
                svg=category_shares(("labels",), (counts,)),
                alt="Shares of red, yellow and green labels",
            ),
            Picture(
                "figure-4-2",
                "Labels by face and line (figure 4-2).",
                svg=label_distribution(labels),
                alt="Bars of the number of labels on each face and line",
            ),
        ),
    )
