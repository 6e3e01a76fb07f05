"""What the picture says in words."""

from __future__ import annotations

from boxgrasp.draw.palette import WORD
from boxgrasp.geometry.hand_distance import CAP_M
from boxgrasp.grasps.candidates import FACES
from boxgrasp.grasps.gripper import Gripper
from boxgrasp.grasps.scoring import category
from boxgrasp.result import OptionReport, Selection


def centimeters(value_m: float) -> str:
    """`4.2 cm`, or `50 cm or more` at the cap."""
    return f"{100 * CAP_M:.0f} cm or more" if value_m >= CAP_M else f"{100 * value_m:.1f} cm"


def face_name(face: int) -> str:
    """The name of a face's number."""
    return FACES[face - 1] if 1 <= face <= len(FACES) else f"face {face}"


def style_of(option: OptionReport) -> str:
    """`kept`; `wide` where the target's width does not fit or is unknown; else `dropped`."""
    if option.rejected is None:
        return "kept"
    return "dropped" if option.fits else "wide"


def headline_of(selection: Selection) -> tuple[str, str]:
    """The status in capitals and one sentence."""
    if selection.status == "grasp" and selection.label is not None:
        option = selection.option(selection.label)
        free = f"{centimeters(option.seen_m)} free ({WORD[category(option.seen_m)]})"
        return "GRASP", f"{face_name(option.face)} face, line {option.line}: {free}"
    return "ASK A PERSON", selection.reason or "no option passes the check"


def facts_of(selection: Selection, gripper: Gripper) -> list[tuple[str, str]]:
    """(name, value) rows for the text block."""
    rows: list[tuple[str, str]] = []
    if selection.status == "grasp" and selection.label is not None:
        rows += _grasp(selection, selection.option(selection.label), gripper)
    elif selection.best_rejected is not None:
        rows += _rejected(selection, selection.option(selection.best_rejected), gripper)
    best = selection.best_rejected
    if selection.blocking and (
        best is None or selection.option(best).rejected != selection.blocking
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
    rows.append(("Chooser", selection.chooser))
    rows += [("Warning", warning) for warning in selection.warnings]
    return rows


def _grasp(selection: Selection, option: OptionReport, gripper: Gripper) -> list[tuple[str, str]]:
    rows = [("Grasp", f"option {option.label}: {face_name(option.face)} face, line {option.line}")]
    rows += _numbers(option, gripper)
    if selection.position_m is not None:
        x, y, z = selection.position_m
        rows.append(("Gripper at", f"x {x:.3f}, y {y:.3f}, z {z:.3f} m"))
    return rows


def _rejected(
    selection: Selection, option: OptionReport, gripper: Gripper
) -> list[tuple[str, str]]:
    name = f"option {option.label}: {face_name(option.face)} face, line {option.line}"
    rows = [("Best try", name)]
    if option.rejected:
        rows.append(("Rejected", option.rejected))
    return rows + _numbers(option, gripper)


def _numbers(option: OptionReport, gripper: Gripper) -> list[tuple[str, str]]:
    opens = f"{100 * gripper.opening_m:.1f} cm"
    return [
        ("Clearance", f"{centimeters(option.seen_m)} to seen obstacles"),
        ("", f"{centimeters(option.unseen_m)} to unseen space"),
        ("", f"{centimeters(option.approach_m)} on the way in"),
        ("", f"{centimeters(option.support_m)} over the support"),
        ("Width", f"{100 * option.width_m:.1f} cm between the fingers, which open {opens}"),
    ]
