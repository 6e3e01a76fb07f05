"""Why decisions go wrong or change, on scenes: figures 5-1, 5-2, 5-4, 5-5, 5-7 and 5-8."""

from __future__ import annotations

import numpy as np

from boxgrasp.arrays import Array
from boxgrasp.grasps.candidates import LINES, TOP_PARALLEL
from boxgrasp.grasps.gripper import Gripper
from boxgrasp.ranking.sampling import RESOLUTION_M
from boxgrasp.study.evaluation import Evaluation
from boxgrasp.study.plots.scenes import Heading, Panel
from boxgrasp.study.report import Picture, Section
from boxgrasp.study.sections.alike import alike_picture
from boxgrasp.study.sections.chapter5 import hidden_by_cells, usual_faces
from boxgrasp.study.sections.drawn import Found, drawn, hand_corners, pick_panel, section_of
from boxgrasp.study.seen import counted, pick_words, see_row
from boxgrasp.study.study import Study

SINGLE, CASCADE = "single-grid", "cascade-grid"
SPIRALS = ("single-spiral", "cascade-spiral")
_WIDE = (("a", "cereal_y"), ("b", "cereal_z"))  # figure 5-2's two boxes
_TALL_M = 0.20  # the crisps tube has 23 cm, the cereal boxes 19
_MOST_DECISIONS = 3


def discussion_section(study: Study) -> Section:
    """Section 5-2's explanations, each on a scene of the study.

    Args:
        study: whose scenes they are.

    Returns:
        The section.
    """
    pictures: list[Picture | str] = [
        alike_picture(),
        *(_too_wide(study, part, target) for part, target in _WIDE),
        _varying(study),
        _steady(study),
        _bias(study),
        _hidden(study),
    ]
    return section_of(
        Section(
            key="figures-discussion",
            title="The discussion on scenes of the study",
            place="section 5-2; figures 5-1, 5-2, 5-4, 5-5, 5-7, 5-8",
            words=(
                "Scenes that show what the thesis says, where there are any. That one was found "
                "says that it happens, its count how often.",
            ),
        ),
        pictures,
    )


def _too_wide(study: Study, part: str, target: str) -> Picture | str:
    """Figure 5-2: a spiral's top-parallel pick on a face that is too wide."""
    evaluation = study.evaluation("tested")
    own = evaluation.rows["target"] == target
    # A box of a target that is partly hidden may be narrower than the target.
    wide = evaluation.rows["given_dimensions_m"][:, 1] > Gripper().max_opening_m
    met = {v: own & wide & (_face(evaluation, v) == TOP_PARALLEL) for v in SPIRALS}
    either = met[SPIRALS[0]] | met[SPIRALS[1]]
    found = Found(
        "5-2",
        f"test scenes of {target} have a top-parallel pick of a spiral version though the box is "
        "wider there than the opening; the first",
        np.flatnonzero(either),
        int(own.sum()),
    )

    def draw(rows: Array) -> list[Panel]:
        row = int(rows[0])
        version = next(v for v in SPIRALS if met[v][row])
        pick = int(evaluation.picks(version)[row])
        seen = see_row(study, "tested", row)
        return [pick_panel(evaluation, row, pick, seen, f"{version}: ")]

    name = target.replace("_", " ")
    return drawn(found, f"A top-parallel grasp on a face too wide, {name}", draw, part)


def _varying(study: Study) -> Picture | str:
    """Figure 5-4: a decision that changes with the noise."""
    evaluation, runs = study.evaluation("real"), study.scale.runs
    picks = evaluation.picks(CASCADE).reshape(-1, runs)
    decisions = np.array([len(np.unique(own)) for own in picks])
    order = np.argsort(-decisions, kind="stable")
    found = Found(
        "5-4",
        f"scenes of the stand-in for the real world have more than one decision of {CASCADE} in "
        f"{runs} runs; the first of those with the most",
        order[decisions[order] > 1],
        len(picks),
    )

    def draw(scenes: Array) -> list[Panel]:
        scene = int(scenes[0])
        panels = []
        for pick, count in counted(picks[scene].tolist())[:_MOST_DECISIONS]:
            row = scene * runs + int(np.argmax(picks[scene] == pick))
            seen = see_row(study, "real", row)
            panels.append(pick_panel(evaluation, row, pick, seen, f"{count} of {runs}: "))
        return panels

    return drawn(
        found, "A scene whose decision changes with the noise, in the first run of each", draw
    )


def _steady(study: Study) -> Picture | str:
    """Figure 5-5: tall targets, one decision."""
    evaluation, runs = study.evaluation("real"), study.scale.runs
    picks = evaluation.picks(CASCADE).reshape(-1, runs)
    tall = evaluation.rows["true_dimensions_m"][::runs, 2] >= _TALL_M
    steady = (picks == picks[:, :1]).all(axis=1)
    clear = evaluation.metrics(CASCADE).unobstructed.reshape(-1, runs).all(axis=1)
    met = np.flatnonzero(tall & steady & clear)
    # The thesis shows lines off the center, on two faces: those first, and of different decisions.
    central = picks[met, 0] % LINES == (LINES - 1) // 2
    met = met[np.argsort(central, kind="stable")]
    _, first = np.unique(picks[met, 0], return_index=True)
    met = np.concatenate((met[np.sort(first)], np.delete(met, first)))
    found = Found(
        "5-5",
        f"scenes with a target of {100 * _TALL_M:.0f} cm or more have one and the same feasible "
        f"decision of {CASCADE} in all {runs} runs; the first two of different decisions, lines "
        "off the center before others",
        met,
        int(tall.sum()),
    )

    def draw(scenes: Array) -> list[Panel]:
        return [
            pick_panel(
                evaluation,
                scene * runs,
                int(picks[scene, 0]),
                see_row(study, "real", scene * runs),
                f"{runs} of {runs}: ",
            )
            for scene in scenes[:2].tolist()
        ]

    return drawn(found, "Tall targets, whose decision does not change with the noise", draw)


def _bias(study: Study) -> Picture | str:
    """Figure 5-7: the single grid is right, the cascade falls back on the commonest face."""
    evaluation = study.evaluation("tested")
    usual = usual_faces(study, evaluation.rows)
    face = {version: _face(evaluation, version) - 1 for version in (SINGLE, CASCADE)}
    safe = evaluation.metrics(SINGLE).score == 1
    worse = evaluation.metrics(CASCADE).score < 1
    met = evaluation.known & safe & worse & (face[CASCADE] == usual) & (face[SINGLE] != usual)
    found = Found(
        "5-7",
        f"test scenes of known targets have a safe pick of {SINGLE}, and a worse one of {CASCADE} "
        "on the face that training has most often for the target; the first",
        np.flatnonzero(met),
        int(evaluation.known.sum()),
    )
    return drawn(
        found,
        "Bias: the scene, its 7 cm map, and what single and cascade grid take",
        lambda rows: _scene_and_picks(study, int(rows[0])),
    )


def _hidden(study: Study) -> Picture | str:
    """Figure 5-8: coarse cells hide the grasp that the operator takes."""
    evaluation = study.evaluation("tested")
    own = evaluation.picks("operator")
    met = evaluation.metrics("operator").unobstructed
    for version in (SINGLE, CASCADE):
        met = met & (evaluation.picks(version) // LINES != own // LINES)
    rows = evaluation.rows
    kept = [k for k in np.flatnonzero(met).tolist() if hidden_by_cells(rows, k)[own[k]]]
    hidden = np.array(kept, np.int64)
    aside = own[hidden] // LINES + 1 != TOP_PARALLEL
    found = Found(
        "5-8",
        "test scenes have a feasible pick of the operator whose hand meets an occupied 7 cm cell "
        "that the target does not fill, and both grid versions take another face; the first, "
        "top-parallel picks before others as the thesis's is one",
        hidden[np.argsort(aside, kind="stable")],
        rows.count,
    )

    def draw(found_rows: Array) -> list[Panel]:
        row = int(found_rows[0])
        seen = see_row(study, "tested", row)
        candidate = seen.candidates()[int(own[row])]
        words = f"Cells of 7 cm meet the hand at\n{pick_words(int(own[row]))}"
        over = Panel(seen, Heading(words), [hand_corners(candidate)])
        return [
            pick_panel(evaluation, row, int(own[row]), seen, "operator: "),
            over.cells(seen.local_map(RESOLUTION_M["grid"]), 170).hand(candidate, blocked=True),
            *(
                pick_panel(evaluation, row, int(evaluation.picks(v)[row]), seen, f"{v}: ")
                for v in (SINGLE, CASCADE)
            ),
        ]

    return drawn(found, "Coarse cells hide the grasp that the operator takes", draw)


def _scene_and_picks(study: Study, row: int) -> list[Panel]:
    evaluation = study.evaluation("tested")
    seen = see_row(study, "tested", row)
    picks = [int(evaluation.picks(version)[row]) for version in (SINGLE, CASCADE)]
    hands = [hand_corners(seen.candidates()[pick]) for pick in picks]
    over = Panel(seen, Heading("Occupied cells of 7 cm"), hands)
    return [
        Panel(seen, Heading("The scene"), hands).box(),
        over.cells(seen.local_map(RESOLUTION_M["grid"])),
        pick_panel(evaluation, row, picks[0], seen, f"{SINGLE}: "),
        pick_panel(evaluation, row, picks[1], seen, f"{CASCADE}: "),
    ]


def _face(evaluation: Evaluation, version: str) -> Array:
    """(N,) the picked face, 1 to 5."""
    return np.asarray(evaluation.picks(version) // LINES + 1)
