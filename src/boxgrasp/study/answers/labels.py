"""Sections 4-1 and 5-1: what the operator chose; a stand-in, set to match what the text keeps."""

from __future__ import annotations

import numpy as np

from boxgrasp.arrays import Array, Bools
from boxgrasp.grasps.candidates import FACES, FRONT, LINES, TOP_PARALLEL
from boxgrasp.grasps.scoring import RED_BELOW_M
from boxgrasp.study.answers.figures import CENTRAL, Answer, Answers, Figures, green, share_of
from boxgrasp.study.intervals import less, mean

_SET = "The stand-in was set to match this; agreement is no finding."


def _face(figures: Figures) -> Array:
    """(N,) 1 to 5."""
    return np.asarray((figures.labels.rows["label"] - 1) // LINES + 1)


def _obstructed(figures: Figures) -> Bools:
    """(N, 5) whether the middle line of each face is nearer than 2 cm to the visible cloud."""
    clearance_m = figures.labels.rows["given_thesis_clearance_m"]
    found: Bools = clearance_m[:, CENTRAL::LINES] < RED_BELOW_M
    return found


def _full_range(figures: Figures) -> Bools:
    """(N,) whether every face of the target goes between the fingers."""
    return np.asarray(figures.labels.rows["given_true_fits"].all(axis=1))


def _score(figures: Figures) -> Answer:
    return Answer(mean(figures.labels.metrics("operator").score), _SET)


def _unequal(figures: Figures) -> Answer:
    counts = np.bincount(figures.labels.rows["label"], minlength=16)[1:]
    common = int(counts.argmax())
    return Answer(
        share_of(figures.labels.rows["label"] == common + 1),
        f"the commonest of 15 classes, {FACES[common // LINES]}, line {common % LINES + 1}; "
        f"{int((counts == 0).sum())} classes are never taken",
    )


def _front(figures: Figures) -> Answer:
    preferred = np.isin(_face(figures), (FRONT, TOP_PARALLEL))
    return Answer(
        share_of(preferred, _full_range(figures)),
        f"labels on these two of five faces, targets of which every face fits. {_SET}",
    )


def _avoids(figures: Figures) -> Answer:
    blocked = _obstructed(figures)[:, [FRONT - 1, TOP_PARALLEL - 1]].all(axis=1)
    clear = figures.labels.metrics("operator").unobstructed
    return Answer(
        share_of(clear, blocked & _full_range(figures)),
        "unobstructed labels where the middle lines of front and top-parallel are obstructed",
    )


def _line_2(figures: Figures) -> Answer:
    return Answer(share_of((figures.labels.rows["label"] - 1) % LINES == CENTRAL), _SET)


def _off_line(figures: Figures) -> Answer:
    off = (figures.labels.rows["label"] - 1) % LINES != CENTRAL
    blocked = _obstructed(figures)[np.arange(len(off)), _face(figures) - 1]
    with_, without = share_of(off, blocked), share_of(off, ~blocked)
    return Answer(
        less(with_, without),
        "lines 1 and 3 where the middle line of the chosen face is obstructed, less where it is "
        "free",
    )


def _cereal(figures: Figures) -> Answer:
    faces = _face(figures)[figures.labels.rows["target"] == "cereal_y"]
    counts = np.bincount(faces, minlength=6)[1:]
    return Answer(
        FACES[int(counts.argmax())], f"{counts.max()} of {counts.sum()} labels of it. {_SET}"
    )


ANSWERS: Answers = {
    "label-score": _score,
    "label-sides": lambda f: Answer(share_of(_face(f) < TOP_PARALLEL), _SET),
    "label-tops": lambda f: Answer(share_of(_face(f) >= TOP_PARALLEL), _SET),
    "label-unequal": _unequal,
    "label-front": _front,
    "label-avoids": _avoids,
    "label-line-2": _line_2,
    "label-off-line": _off_line,
    "label-not-safe": lambda f: Answer(share_of(~green(f.labels, "operator"))),
    "label-cereal": _cereal,
}
