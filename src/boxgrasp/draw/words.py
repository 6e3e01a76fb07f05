"""What the picture says in words."""

from __future__ import annotations

from boxgrasp.draw.palette import WORD
from boxgrasp.geometry.hand_distance import CAP_M
from boxgrasp.grasps.candidates import FACES
from boxgrasp.grasps.gripper import Gripper
from boxgrasp.grasps.scoring import category
from boxgrasp.result import Candidate, Selection


def centimeters(value_m: float) -> str:
    """`4.2 cm`, or `50 cm or more` at the cap."""
    return f"{100 * CAP_M:.0f} cm or more" if value_m >= CAP_M else f"{100 * value_m:.1f} cm"


def face_name(face: int) -> str:
    """The name of a face's number."""
    return FACES[face - 1] if 1 <= face <= len(FACES) else f"face {face}"


def style_of(candidate: Candidate) -> str:
    """`kept`; `wide` where the target's width does not fit or is unknown; else `dropped`."""
    if candidate.rejected is None:
        return "kept"
    return "dropped" if candidate.fits else "wide"


def headline_of(selection: Selection) -> tuple[str, str]:
    """The status in capitals and one sentence."""
    if selection.status == "grasp" and selection.label is not None:
        candidate = selection.candidate(selection.label)
        free = f"{centimeters(candidate.visible_clearance_m)} free ({WORD[category(candidate.visible_clearance_m)]})"
        return "GRASP", f"{face_name(candidate.face)} face, line {candidate.line}: {free}"
    return "ASK A PERSON", selection.reason or "no candidate passes the check"


def facts_of(selection: Selection, gripper: Gripper) -> list[tuple[str, str]]:
    """(name, value) rows for the text block."""
    rows: list[tuple[str, str]] = []
    if selection.status == "grasp" and selection.label is not None:
        rows += _grasp(selection, selection.candidate(selection.label), gripper)
    elif selection.best_rejected is not None:
        rows += _rejected(selection, selection.candidate(selection.best_rejected), gripper)
    best = selection.best_rejected
    if selection.blocking and (
        best is None or selection.candidate(best).rejected != selection.blocking
    ):
        rows.append(("In the way", selection.blocking))
    if selection.reason and selection.status == "grasp":
        rows.append(("Reason", selection.reason))
    sides = " x ".join(f"{100 * value:.1f}" for value in selection.box.dimensions_m)
    rows.append(("Target", f"{sides} cm (x, y, z of its box)"))
    given = (
        "robot base, as given"
        if selection.frame == "given"
        else "support plane (no transform given)"
    )
    rows.append(("Frame", given))
    rows.append(("Ranker", selection.ranker))
    rows += [("Warning", warning) for warning in selection.warnings]
    return rows


def _grasp(selection: Selection, candidate: Candidate, gripper: Gripper) -> list[tuple[str, str]]:
    rows = [
        (
            "Grasp",
            f"candidate {candidate.label}: {face_name(candidate.face)} face, line {candidate.line}",
        )
    ]
    rows += _numbers(candidate, gripper)
    if selection.position_m is not None:
        x, y, z = selection.position_m
        rows.append(("Gripper at", f"x {x:.3f}, y {y:.3f}, z {z:.3f} m"))
    return rows


def _rejected(
    selection: Selection, candidate: Candidate, gripper: Gripper
) -> list[tuple[str, str]]:
    name = f"candidate {candidate.label}: {face_name(candidate.face)} face, line {candidate.line}"
    rows = [("Best try", name)]
    if candidate.rejected:
        rows.append(("Rejected", candidate.rejected))
    return rows + _numbers(candidate, gripper)


def _numbers(candidate: Candidate, gripper: Gripper) -> list[tuple[str, str]]:
    opens = f"{100 * gripper.max_opening_m:.1f} cm"
    return [
        ("Clearance", f"{centimeters(candidate.visible_clearance_m)} to seen obstacles"),
        ("", f"{centimeters(candidate.unseen_distance_m)} to unseen space"),
        ("", f"{centimeters(candidate.approach_clearance_m)} on the way in"),
        ("", f"{centimeters(candidate.plane_clearance_m)} over the support"),
        ("Width", f"{100 * candidate.width_m:.1f} cm between the fingers, which open {opens}"),
    ]
