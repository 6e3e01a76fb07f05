"""What the picture says in words, from the answer's data."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from boxgrasp.draw.canvas import Look
from boxgrasp.draw.palette import CATEGORY, FAINT, SHAPE
from boxgrasp.grasps.checks.check import spelled
from boxgrasp.grasps.checks.visible_clearance import VisibleClearance
from boxgrasp.grasps.checks.width import Width
from boxgrasp.grasps.checks.width_known import WidthKnown
from boxgrasp.grasps.scoring import category
from boxgrasp.result import Candidate, CheckValue, Selection

_NAMED: Final = 3  # passing candidates; the others stand in the table
UNMEASURED: Final = Look("diamond", FAINT)


def visible_clearance(candidate: Candidate) -> CheckValue | None:
    """What the check of the visible clearance says of a candidate.

    Args:
        candidate: any.

    Returns:
        Its value, None where that check was not made.
    """
    return candidate.checks.get(VisibleClearance.name)


def look_of(candidate: Candidate) -> Look:
    """A candidate's marker.

    Args:
        candidate: any.

    Returns:
        Shape and color by its visible clearance, a gray diamond where nobody measured it; style
        `kept` where it passed, `wide` where the width does not fit or is unknown, else `dropped`.
    """
    style = "kept"
    if not candidate.passed:
        said = (candidate.checks.get(name) for name in (Width.name, WidthKnown.name))
        style = "wide" if any(s is not None and not s.passed for s in said) else "dropped"
    near = visible_clearance(candidate)
    if near is None:
        return replace(UNMEASURED, style=style)
    kind = category(near.value)
    return Look(SHAPE[kind], CATEGORY[kind], style)


def headline_of(selection: Selection) -> tuple[str, str]:
    """The status in capitals, and one sentence.

    Args:
        selection: the answer.

    Returns:
        `GRASP` or `ASK A PERSON`, and the selection's headline.
    """
    return "ASK A PERSON" if selection.grasp is None else "GRASP", selection.headline()


def facts_of(selection: Selection) -> list[tuple[str, str]]:
    """What is said of an answer beside its checks.

    Args:
        selection: the answer.

    Returns:
        Name and value of each row.
    """
    rows: list[tuple[str, str]] = []
    shown, grasp = selection.shown, selection.grasp
    if shown is not None:
        said = f"candidate {shown.label}, {shown.name}"
        asked = "Best" if shown.passed else "Nearest"
        rows.append((asked if grasp is None else "Grasp", said))
        rows += [("Rejected", item.sentence) for item in shown.rejections]
        opening = spelled(selection.gripper.fingers_open_m, "m")
        width = spelled(shown.width_m, "m")
        rows.append(("Width", f"{width}, and the fingers open {opening}"))
    if grasp is not None:
        x, y, z = grasp.position_m
        rows.append(("Gripper at", f"x {x:.3f}, y {y:.3f}, z {z:.3f} m"))
    rows.append(("Passing", _passing(selection)))
    sides = " x ".join(f"{100 * value:.1f}" for value in selection.box.dimensions_m)
    rows.append(("Target", f"{sides} cm (x, y, z of its box)"))
    given = selection.frame == "given"
    rows.append(("Frame", "robot base, as given" if given else "support plane, as none is given"))
    rows.append(("Ranker", selection.ranker))
    return rows + [("Warning", warning.message) for warning in selection.warnings]


def _passing(selection: Selection) -> str:
    passing = selection.passing
    counts = f"{len(passing)} of {len(selection.candidates)} candidates"
    names = [f"{candidate.name} ({candidate.label})" for candidate in passing[:_NAMED]]
    more = f" and {len(passing) - _NAMED} more" if len(passing) > _NAMED else ""
    return f"{counts}, best first: {', '.join(names)}{more}" if names else counts
