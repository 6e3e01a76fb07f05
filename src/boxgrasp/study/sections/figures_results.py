"""Decisions of single and cascade grid where a line off the center is needed: figures 4-5, 4-7."""

from __future__ import annotations

import numpy as np

from boxgrasp.arrays import Bools
from boxgrasp.grasps.candidates import LINES
from boxgrasp.study.evaluation import Evaluation
from boxgrasp.study.plots.scenes import Panel
from boxgrasp.study.report import Section
from boxgrasp.study.sections.drawn import Found, drawn, pick_panel, section_of
from boxgrasp.study.seen import see_row
from boxgrasp.study.study import Study

SINGLE, CASCADE = "single-grid", "cascade-grid"
_PARTS = ("a", "b")


def decisions_section(study: Study) -> Section:
    """What single and cascade grid do in scenes that need a line off the center.

    Args:
        study: whose scenes they are.

    Returns:
        The section.
    """
    need, ad_hoc = _off_center(study), _ad_hoc(study)
    pictures = [
        drawn(
            need,
            "A scene that needs a line off the center, as the cascade and the single grid decide",
            lambda rows: _both(study, "need", int(rows[0])),
        )
    ]
    for k, part in enumerate(_PARTS[: max(1, len(ad_hoc.rows))]):
        pictures.append(
            drawn(
                ad_hoc,
                "An ad hoc scene of the stand-in for the real world, as both decide",
                lambda rows, k=k: _both(study, "ad-hoc", int(rows[k])),  # type: ignore[misc]
                part if len(ad_hoc.rows) > 1 else "",
            )
        )
    return section_of(
        Section(
            key="figures-results",
            title="Decisions where a line off the center is needed",
            place="sections 4-2 and 4-3; figures 4-5 and 4-7",
            words=(
                "The figures show scenes in which the cascade does better, as the thesis's do; "
                "how often it does and does not is in the tables of those sections.",
            ),
        ),
        pictures,
    )


def _off_center(study: Study) -> Found:
    evaluation = study.evaluation("need")
    single, cascade = evaluation.picks(SINGLE), evaluation.picks(CASCADE)
    met = _better(evaluation) & (single // LINES == cascade // LINES)
    rule = (
        f"scenes with the need have the same face from both, and a feasible and higher scored "
        f"line from {CASCADE}; the first"
    )
    return Found("4-5", rule, np.flatnonzero(met), len(met))


def _ad_hoc(study: Study) -> Found:
    evaluation = study.evaluation("ad-hoc")
    first = evaluation.rows["run"] == 0
    met = _better(evaluation) & first
    rule = f"ad hoc scenes, seen for the first time, are feasible and score higher with {CASCADE}"
    return Found(
        "4-7", f"{rule}; of these at most two, the first", np.flatnonzero(met), int(first.sum())
    )


def _better(evaluation: Evaluation) -> Bools:
    """(N,) where the cascade's pick is feasible and has the higher score."""
    cascade = evaluation.metrics(CASCADE)
    return np.asarray(cascade.unobstructed & (cascade.score > evaluation.metrics(SINGLE).score))


def _both(study: Study, name: str, row: int) -> list[Panel]:
    evaluation = study.evaluation(name)
    seen = see_row(study, name, row)
    return [
        pick_panel(evaluation, row, int(evaluation.picks(version)[row]), seen, f"{version}: ")
        for version in (CASCADE, SINGLE)
    ]
