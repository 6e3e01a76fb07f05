"""Sections 4-2, 4-3 and 5-2-2: scenes that need a line off the center."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from boxgrasp.arrays import Bools, Floats
from boxgrasp.grasps.candidates import LINES
from boxgrasp.study.answers.figures import (
    Answer,
    Answers,
    Figures,
    more_often,
    off_center,
    share_of,
)
from boxgrasp.study.intervals import Estimate, difference, less, mean
from boxgrasp.study.sections.need import CASCADE, SINGLE, only_faces
from boxgrasp.study.sections.real import changed_scenes
from boxgrasp.study.sections.results import group_of


def _rate(group: str) -> Callable[[Figures], Answer]:
    def answer(figures: Figures) -> Answer:
        needed, _, _ = only_faces(figures.tested.rows)
        return Answer(share_of(needed, group_of(figures.tested, group)))

    return answer


def _bigger(figures: Figures) -> Answer:
    known, novel = (_rate(group)(figures).ours for group in ("known", "novel"))
    assert isinstance(known, Estimate) and isinstance(novel, Estimate)
    return Answer(less(known, novel), "how often the need occurs, known less novel targets")


def _score(version: str, group: str) -> Callable[[Figures], Answer]:
    def answer(figures: Figures) -> Answer:
        return Answer(mean(figures.need.metrics(version).score[group_of(figures.need, group)]))

    return answer


def _gap(figures: Figures, a: str, b: str) -> Answer:
    first, second = (figures.need.metrics(version).score for version in (a, b))
    return Answer(difference(first, second))


def _never_red(figures: Figures) -> Answer:
    metrics = figures.need.metrics(CASCADE)
    return Answer(share_of(~metrics.unobstructed), "red picks of cascade grid")


def _on_face(figures: Figures, version: str) -> Bools:
    _, face, _ = only_faces(figures.need.rows)
    found: Bools = figures.need.picks(version) // LINES == face
    return found


def _single_face(figures: Figures) -> Answer:
    ours = share_of(_on_face(figures, SINGLE))
    cascade = share_of(_on_face(figures, CASCADE))
    value = 0.0 if cascade.value is None else cascade.value
    return Answer(ours, f"picks on the one face that has feasible candidates; cascade {value:.3f}")


def _single_line(figures: Figures) -> Answer:
    off = off_center(figures.need, SINGLE)
    return Answer(
        share_of(off, _on_face(figures, SINGLE)),
        "of the picks on that face those on line 1 or 3, where the best one always is",
    )


def _cascade_line(figures: Figures) -> Answer:
    flags = (off_center(figures.need, version) for version in (CASCADE, SINGLE))
    return Answer(more_often(*flags), "picks on line 1 or 3, cascade less single grid")


def _varies_line(figures: Figures) -> Answer:
    flags = (off_center(figures.tested, version) for version in (CASCADE, SINGLE))
    return Answer(more_often(*flags), "picks on line 1 or 3, cascade less single grid")


def _spiral_none(figures: Figures) -> Answer:
    gap, _ = _gap(figures, "cascade-spiral", "single-spiral")
    means = (
        np.nanmean(figures.need.metrics(f"{kind}-spiral").score) for kind in ("single", "cascade")
    )
    return Answer(gap, "scores there, single and cascade spiral: {:.3f}, {:.3f}".format(*means))


def _ad_hoc(figures: Figures, version: str) -> Floats:
    return figures.by_scene(figures.study.evaluation("ad-hoc").metrics(version).score)


def _pooled(figures: Figures, version: str) -> Floats:
    return np.concatenate((figures.need.metrics(version).score, _ad_hoc(figures, version)))


def _steady(figures: Figures) -> Answer:
    runs, evaluation = figures.study.scale.runs, figures.study.evaluation("ad-hoc")
    changing = np.zeros(evaluation.rows.count // runs, dtype=bool)
    changing[changed_scenes(evaluation, runs)] = True
    return Answer(share_of(changing), "each decision from one frame alone; the thesis's map ran on")


ANSWERS: Answers = {
    "need-rate": _rate("total"),
    "need-rate-known": _rate("known"),
    "need-rate-novel": _rate("novel"),
    "need-bigger": _bigger,
    **{f"need-single-{group}": _score(SINGLE, group) for group in ("known", "novel", "total")},
    **{f"need-cascade-{group}": _score(CASCADE, group) for group in ("known", "novel", "total")},
    "need-cascade-safer": lambda f: _gap(f, CASCADE, SINGLE),
    "need-never-red": _never_red,
    "need-single-face": _single_face,
    "need-single-line": _single_line,
    "need-cascade-line": _cascade_line,
    "cascade-varies-line": _varies_line,
    "need-spiral-none": _spiral_none,
    "need-spiral-lines": lambda f: Answer(
        share_of(off_center(f.need, "cascade-spiral")), "picks of cascade spiral on line 1 or 3"
    ),
    "ad-hoc-single": lambda f: Answer(mean(_ad_hoc(f, SINGLE))),
    "ad-hoc-cascade": lambda f: Answer(mean(_ad_hoc(f, CASCADE))),
    "ad-hoc-safer": lambda f: Answer(difference(_ad_hoc(f, CASCADE), _ad_hoc(f, SINGLE))),
    "ad-hoc-steady": _steady,
    "pooled-single": lambda f: Answer(mean(_pooled(f, SINGLE))),
    "pooled-cascade": lambda f: Answer(mean(_pooled(f, CASCADE))),
    "pooled-safer": lambda f: Answer(difference(_pooled(f, CASCADE), _pooled(f, SINGLE))),
}
