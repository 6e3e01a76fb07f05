"""Appendix A on the first test scenes: floor, table, the target's cluster."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from boxgrasp.arrays import Array
from boxgrasp.errors import BoxgraspError
from boxgrasp.selector import GraspSelector
from boxgrasp.simulate.scenario import Scenario
from boxgrasp.study.answers.figures import Answer, Answers, Figures, share_of
from boxgrasp.study.answers.samplings import TABLE_M
from boxgrasp.study.intervals import mean
from boxgrasp.teaching.rows import scenario_of_row

_SCENES = 24
_FLOOR = 0  # its number among the objects
_NEAR_M, _FAR_M = 0.4, 1.6
_OFF_M, _OVERLAP = 0.01, 0.75


def _scenarios(figures: Figures) -> list[Scenario]:
    config, count = figures.study.sets()["tested"].rows, figures.tested.rows.count
    return [scenario_of_row(config, k) for k in range(min(_SCENES, count))]


def _floor(figures: Figures) -> Answer:
    left = []
    for scenario in _scenarios(figures):
        capture, ids = scenario.capture("none")
        points, pixels = capture.valid_points()
        floor = np.linalg.norm(points[ids.ravel()[pixels] == _FLOOR], axis=1)
        if len(floor):
            left.append(float(((floor >= _NEAR_M) & (floor <= _FAR_M)).mean()))
    return Answer(mean(left), "of the floor's points those that the pass-through filter leaves")


@lru_cache(maxsize=1)  # two results are read from it
def _judged(figures: Figures) -> Array:
    """(N, 2) of each scene as `_segmented`."""
    selector = GraspSelector({"scene": {"segmentation": "euclidean"}})
    return np.array([_segmented(selector, scenario) for scenario in _scenarios(figures)])


def _segmented(selector: GraspSelector, scenario: Scenario) -> tuple[float, float]:
    """How far the table's plane is off, m, and the overlap F of the target's cluster."""
    capture, ids = scenario.capture("none")
    try:
        scene = selector.scene(capture)
    except BoxgraspError:
        return np.inf, 0.0
    image, target = scene.object_image(), ids == scenario.scene.target_id
    numbers = np.bincount(image[target])
    numbers[:1] = 0
    found: Array = image == numbers.argmax() if numbers.any() else np.zeros_like(target)
    both = float((found & target).sum())
    return abs(float(scene.T_base_table[2, 3]) - TABLE_M), 2 * both / (found.sum() + target.sum())


def _table(figures: Figures) -> Answer:
    return Answer(
        share_of(_judged(figures)[:, 0] <= _OFF_M),
        "planes within 1 cm of the table's top, first test scenes",
    )


def _cluster(figures: Figures) -> Answer:
    return Answer(
        share_of(_judged(figures)[:, 1] >= _OVERLAP),
        "targets whose cluster overlaps their true points by F 0.75 or more, first test scenes. "
        "The package's plane and its `euclidean` clusters at 1.5 cm; the appendix's own order of "
        "steps is a section of its own.",
    )


ANSWERS: Answers = {
    "appendix-floor": _floor,
    "appendix-table": _table,
    "appendix-cluster": _cluster,
}
