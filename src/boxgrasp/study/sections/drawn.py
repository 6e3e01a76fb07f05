"""What every drawn scene has in common: by which rule it was found, and a pick as a panel."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from boxgrasp.arrays import Array, Floats
from boxgrasp.draw.shapes import corners
from boxgrasp.grasps.gripper import Gripper
from boxgrasp.grasps.scoring import GREEN_FROM_M, RED_BELOW_M
from boxgrasp.result import Candidate
from boxgrasp.study.evaluation import Evaluation
from boxgrasp.study.metrics import largest_visible_m
from boxgrasp.study.plots.scenes import Heading, Panel, stacked
from boxgrasp.study.report import Picture, Section
from boxgrasp.study.seen import Seen, pick_words


@dataclass(frozen=True, eq=False)
class Found:
    """The scenes that meet a figure's rule.

    Attributes:
        figure: its number.
        rule: what they do, after `12 of 40`: `test scenes have a lamp`.
        rows: their indices, the ones to draw first.
        of: how many were looked at.
    """

    figure: str
    rule: str
    rows: Array
    of: int

    @property
    def said(self) -> str:
        """The rule with its count."""
        return f"{len(self.rows):,} of {self.of:,} {self.rule}"


def drawn(
    found: Found, words: str, draw: Callable[[Array], Sequence[Panel]], part: str = ""
) -> Picture | str:
    """A figure's picture, or a sentence where no scene is as it should be.

    Args:
        found: the scenes.
        words: what the picture shows.
        draw: draws the first ones.
        part: of the figure, after its number in the picture's name.

    Returns:
        The picture, or why there is none.
    """
    if not len(found.rows):
        return f"Figure {found.figure}{part} is not drawn: {found.said}."
    return Picture(
        f"figure-{found.figure}{part}",
        f"{words} (figure {found.figure}). {found.said}; drawn by that rule, not by look.",
        png=stacked(draw(found.rows)),
        alt=words,
    )


def section_of(section: Section, pictures: Sequence[Picture | str]) -> Section:
    """A section with its pictures, and sentences for those that are not drawn.

    Args:
        section: without pictures.
        pictures: of `drawn`.

    Returns:
        The whole section.
    """
    missing = [item for item in pictures if isinstance(item, str)]
    return Section(
        key=section.key,
        title=section.title,
        place=section.place,
        words=(*section.words, *missing),
        pictures=tuple(item for item in pictures if isinstance(item, Picture)),
    )


def hand_corners(candidate: Candidate) -> Floats:
    """What a panel must show of the hand.

    Args:
        candidate: where it is.

    Returns:
        (8, 3) base frame, m.
    """
    return corners(candidate.T_base_gripper, 2 * Gripper().half_m)


def pick_panel(
    evaluation: Evaluation, row: int, pick: int, seen: Seen, words: str, kind: str = "camera"
) -> Panel:
    """A decision in its scene: box, line, hand and d, or the width that does not fit.

    Args:
        evaluation: of the set.
        row: whose scene it is.
        pick: index of the candidate.
        seen: the scene.
        words: before the candidate's name and d.
        kind: of the view.

    Returns:
        The panel.
    """
    candidate = seen.candidates()[pick]
    distance_m = evaluation.rows["given_thesis_clearance_m"][row, pick]
    fits = bool(evaluation.rows["given_true_fits"][row, pick])
    tail = f"d = {100 * distance_m:.1f} cm" if fits else "wider than the opening"
    kind_of = category_of(evaluation, row, pick)
    heading = Heading(f"{words}{pick_words(pick)}\n{kind_of}, {tail}", kind_of)
    _, point = seen.nearest_obstacle(candidate)
    focus = [hand_corners(candidate), *([point[None]] if fits and point is not None else [])]
    panel = Panel(seen, heading, focus, kind)
    panel.box().lines((), candidate).hand(candidate, blocked=not fits)
    return panel.gap(candidate) if fits else panel.width(candidate)


def category_of(evaluation: Evaluation, row: int, pick: int) -> str:
    """A candidate's category (3-4), red where it is too wide.

    Args:
        evaluation: of the set.
        row: whose scene it is.
        pick: index of the candidate.

    Returns:
        `green`, `yellow` or `red`.
    """
    rows = evaluation.rows
    distance_m = rows["given_thesis_clearance_m"][row, pick]
    if distance_m < RED_BELOW_M or not rows["given_true_fits"][row, pick]:
        return "red"
    largest_m = largest_visible_m(rows.take(np.array([row])), "given")[0]
    return "green" if distance_m >= min(GREEN_FROM_M, float(largest_m)) else "yellow"
