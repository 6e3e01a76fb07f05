"""The method on scenes of the study: figures 2-1 to 2-5, 2-15, 3-6, 3-11 and 3-13."""

from __future__ import annotations

import json
from itertools import permutations

import numpy as np

from boxgrasp.arrays import Array, Bools, Floats
from boxgrasp.geometry.transforms import transform
from boxgrasp.grasps.candidates import FACES, FRONT, LINES, TOP_PARALLEL
from boxgrasp.grasps.scoring import GREEN_FROM_M, RED_BELOW_M
from boxgrasp.mapping.local_map import OCCUPIED
from boxgrasp.ranking.sampling import RESOLUTION_M, sampling
from boxgrasp.study.evaluation import Evaluation
from boxgrasp.study.plots.scenes import Heading, Panel, stacked
from boxgrasp.study.report import Picture, Section
from boxgrasp.study.sections.drawn import Found, drawn, hand_corners, pick_panel, section_of
from boxgrasp.study.seen import Seen, pick_words, see_row
from boxgrasp.study.study import Study
from boxgrasp.teaching.samples import states_at
from boxgrasp.teaching.sets import Rows

VERSION = "cascade-grid"
_LEAST_OBSTACLES = 3


def method_section(study: Study) -> Section:
    """The method, step by step on one scene, and examples of what it learns and is measured by.

    Args:
        study: whose scenes they are.

    Returns:
        The section.
    """
    evaluation = study.evaluation("tested")
    return section_of(
        Section(
            key="figures-method",
            title="The method on scenes of the study",
            place="chapters 2 and 3; figures 2-1 to 2-5, 2-15, 3-6, 3-11, 3-13",
            words=(
                "Every picture of a scene in this report is found, not posed: each says by which "
                "rule, how many scenes meet it, and takes the first of them. Scenes are cast "
                "again with the depth and the numbers of their row.",
            ),
        ),
        (
            *_stages(study, evaluation),
            drawn(
                _labeled(study.rows("labels")),
                "Two training scenes as the operator saw them, the target in its box",
                lambda rows: [_labeled_panel(study, int(row)) for row in rows[:2]],
            ),
            drawn(
                _of_each_category(evaluation),
                "One scene, a safe, a feasible and an unfeasible candidate: the hand's box, and "
                "d to the nearest visible obstacle",
                lambda rows: _category_panels(study, evaluation, int(rows[0])),
            ),
        ),
    )


def lamps_and_obstacles(rows: Rows) -> tuple[Bools, Array]:
    """What stands round the targets.

    Args:
        rows: of a set.

    Returns:
        (N,) bool, whether something floats over the table, and (N,) how many obstacles there are.
    """
    placed = [json.loads(str(scene))["obstacles"] for scene in rows["scene"]]
    floats = [any(item["z"] > 0 for item in items) for items in placed]
    return np.array(floats, bool), np.array([len(items) for items in placed])


# ---- chapter 2, and figure 3-6


def _stages(study: Study, evaluation: Evaluation) -> list[Picture | str]:
    """Chapter 2 and figure 3-6 on one scene."""
    lamp, count = lamps_and_obstacles(evaluation.rows)
    pick = evaluation.picks(VERSION)
    faces = np.isin(pick // LINES + 1, (FRONT, TOP_PARALLEL))
    met = lamp & (count >= _LEAST_OBSTACLES) & faces & (evaluation.metrics(VERSION).score == 1)
    found = Found(
        "2-1",
        f"test scenes have a lamp, {_LEAST_OBSTACLES} or more obstacles, and a safe pick of "
        f"{VERSION} on the front or top-parallel face; the first of them",
        np.flatnonzero(met),
        len(met),
    )
    if not len(found.rows):
        return [f"Figures 2-1 to 2-5, 2-15 and 3-6 are not drawn: {found.said}."]
    row = int(found.rows[0])
    seen = see_row(study, "tested", row)
    steps = {
        "2-1": ("The method in four steps", _overview(evaluation, row, seen)),
        "2-2": ("The box with both top grasps", _top_grasps(seen)),
        "2-3": ("The box with 3 and with 5 lines a face", _lined(seen)),
        "2-4": ("The half sphere of 30 cm round the target", [_half_sphere(seen)]),
        "2-5": ("Its 2,256 samples at 3 cm", [_sampled(seen, "dense", 2.6)]),
        "2-15": ("The pose of the chosen face and line", _pose(evaluation, row, seen)),
        "3-6": ("The scene, and its 7 cm map over it", _mapped(seen)),
    }
    pictures = [
        Picture(
            f"figure-{number}{'-scene' if number == '2-5' else ''}",
            f"{words} (figure {number}). {found.said if number == '2-1' else 'As figure 2-1'}.",
            png=stacked(panels),
            alt=words,
        )
        for number, (words, panels) in steps.items()
    ]
    return list(pictures)


def _overview(evaluation: Evaluation, row: int, seen: Seen) -> list[Panel]:
    pick = int(evaluation.picks(VERSION)[row])
    candidates = seen.candidates()
    chosen = f"3. Of 15 candidates the SVMs take\n{pick_words(pick)}"
    return [
        Panel(seen, Heading("1. A box round the target"), [_sphere(seen)]).box(),
        _sampled(seen, "grid", 5.0, "2. Samples: occupied red, free white, unseen gray"),
        Panel(seen, Heading(chosen)).box().lines(candidates, candidates[pick]),
        pick_panel(evaluation, row, pick, seen, "4. The pose: "),
    ]


def _top_grasps(seen: Seen) -> list[Panel]:
    panels = []
    for face in (TOP_PARALLEL, TOP_PARALLEL + 1):
        candidate = seen.candidates()[(face - 1) * LINES + LINES // 2]
        heading = Heading(f"{FACES[face - 1]}: {100 * candidate.width_m:.1f} cm between fingers")
        panel = Panel(seen, heading, [hand_corners(candidate)])
        panels.append(panel.box().lines((), candidate).hand(candidate))
    return panels


def _lined(seen: Seen) -> list[Panel]:
    return [
        Panel(seen, Heading(f"l = {lines}: {5 * lines} candidates"), height_px=330)
        .box()
        .lines(seen.candidates(lines))
        for lines in (3, 5)
    ]


def _half_sphere(seen: Seen) -> Panel:
    heading = Heading("Centered 5 cm over the middle of the box's base")
    return Panel(seen, heading, [_sphere(seen)]).box().half_sphere()


def _sampled(seen: Seen, name: str, radius_px: float, words: str = "") -> Panel:
    points = sampling(name)
    states = states_at(seen.local_map(RESOLUTION_M[name]), points)
    heading = Heading(words or "Occupied red, free white, unseen gray")
    return Panel(seen, heading, [_sphere(seen)]).half_sphere().samples(points, states, radius_px)


def _pose(evaluation: Evaluation, row: int, seen: Seen) -> list[Panel]:
    pick = int(evaluation.picks(VERSION)[row])
    return [
        pick_panel(evaluation, row, pick, seen, "", kind) for kind in ("camera", "side", "above")
    ]


def _mapped(seen: Seen) -> list[Panel]:
    size_m = RESOLUTION_M["grid"]
    local_map = seen.local_map(size_m)
    cells = local_map.cells(OCCUPIED) + (0.0, 0.0, size_m / 2)
    focus = [_sphere(seen), np.asarray(transform(local_map.T_base_map, cells))]
    over = Panel(seen, Heading("Occupied cells of 7 cm, paler with height"), focus)
    return [Panel(seen, Heading("The scene"), focus), over.cells(local_map)]


def _sphere(seen: Seen) -> Floats:
    return np.asarray(transform(seen.box.T_base_map(), sampling("grid")))


# ---- figure 3-11


def _labeled(rows: Rows) -> Found:
    """Training scenes with a lamp, of each target the first one before the second."""
    lamp, count = lamps_and_obstacles(rows)
    met = np.flatnonzero(lamp & (count >= _LEAST_OBSTACLES))
    _, first = np.unique(rows["target"][met], return_index=True)
    order = np.concatenate((met[np.sort(first)], np.delete(met, first)))
    rule = (
        f"training scenes have a lamp and {_LEAST_OBSTACLES} or more obstacles; the first two of "
        "different targets"
    )
    return Found("3-11", rule, order, rows.count)


def _labeled_panel(study: Study, row: int) -> Panel:
    rows = study.rows("labels")
    seen = see_row(study, "labels", row)
    name = str(rows["target"][row]).replace("_", " ")
    heading = Heading(f"{name}; the operator took {pick_words(int(rows['label'][row]) - 1)}")
    return Panel(seen, heading, [_sphere(seen)]).box()


# ---- figure 3-13


def _categories(rows: Rows) -> tuple[Bools, Bools, Bools]:
    """(N, 5 l) which candidates are safe, feasible and too near; the first two fit."""
    distance_m, fits = rows["given_thesis_clearance_m"], rows["given_true_fits"]
    red = distance_m < RED_BELOW_M
    green = distance_m >= GREEN_FROM_M
    kinds = (green, ~red & ~green, red)
    green, yellow, red = (np.asarray(kind & fits) for kind in kinds)
    return green, yellow, red


def _of_each_category(evaluation: Evaluation) -> Found:
    rows = evaluation.rows
    green, yellow, red = (
        np.any(kind.reshape(rows.count, len(FACES), -1), axis=2).T for kind in _categories(rows)
    )
    met = np.zeros(rows.count, bool)
    for a, b, c in permutations(range(len(FACES)), 3):
        met |= green[a] & yellow[b] & red[c]
    rule = "test scenes have candidates that fit of all three categories on three faces; the first"
    return Found("3-13", rule, np.flatnonzero(met), rows.count)


def three_categories(evaluation: Evaluation, row: int) -> tuple[int, int, int]:
    """A safe, a feasible and an unfeasible candidate that fit, on three faces.

    Args:
        evaluation: of a set.
        row: that has such ones.

    Returns:
        Their indices; of each face's the nearest to the middle line.
    """
    kinds = [
        kind.reshape(len(FACES), -1) for kind in (k[row] for k in _categories(evaluation.rows))
    ]
    lines = kinds[0].shape[1]
    away = np.abs(np.arange(lines) - (lines - 1) / 2)
    order = next(
        order
        for order in permutations(range(len(FACES)), 3)
        if all(kinds[k][face].any() for k, face in enumerate(order))
    )
    picks = [
        face * lines + int(np.where(kinds[k][face], away, np.inf).argmin())
        for k, face in enumerate(order)
    ]
    return picks[0], picks[1], picks[2]


def _category_panels(study: Study, evaluation: Evaluation, row: int) -> list[Panel]:
    seen = see_row(study, "tested", row)
    return [
        pick_panel(evaluation, row, pick, seen, "") for pick in three_categories(evaluation, row)
    ]
