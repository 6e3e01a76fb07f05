"""A robot that is stuck asks: what is kept of its question, and what the answer makes of it."""

from __future__ import annotations

from typing import Any, Final

from boxgrasp.errors import CodedWarning, TargetError
from boxgrasp.labeling.sources import plain_target
from boxgrasp.labeling.words import OperatorLabel
from boxgrasp.perception.target import Target, find_target
from boxgrasp.result import BOX_WRONG, NOBODY_ANSWERED, PERSON_WOULD_HELP, Selection
from boxgrasp.selector import GraspSelector
from boxgrasp.sensing.capture import Capture

ASKS: Final = "asks"  # the source, as the record names them, of scenes that robots asked about


def asked_target(
    capture: Capture, target: Target | None, selector: GraspSelector
) -> dict[str, Any]:
    """The target of a question in plain values, which lead back to the same object.

    Args:
        capture: the view.
        target: what was pointed at; None for the capture's own mask or pixel.
        selector: that found the object.

    Returns:
        As `LabelScene.target`.

    Raises:
        TargetError: nothing that can be kept leads back to it.
        SceneError: no support plane, or nothing on it.
    """
    if target is None and capture.mask is not None:
        return {"mask": True}
    if target is None and capture.target_pixel is not None:
        return {"pixel": list(capture.target_pixel)}
    if target is not None and target.pixel is not None:
        return {"pixel": [int(value) for value in target.pixel]}
    if target is not None and target.point is not None:
        return {"point": [float(value) for value in target.point]}
    scene = selector.scene(capture)
    found = find_target(scene, capture, target)
    number = int(scene.object_numbers[found.target_mask][0])
    image = scene.object_image() if scene.shape is not None else None
    (item,) = (item for item in scene.objects_with_pixels() if item.number == number)
    told = plain_target(scene, capture, item, image)
    if told is None:
        raise TargetError(f"nothing leads back to object {number}; valid: a pixel or a mask of it")
    return told


def answered(own: Selection, label: OperatorLabel, pregrasp_distance_m: float) -> Selection:
    """What the robot does with an operator's answer.

    Args:
        own: the robot's own answer.
        label: the operator's.
        pregrasp_distance_m: of the configuration, m.

    Returns:
        A grasp of ranker `person`; or an `ask` where the person would help, or says that the box
        is wrong.
    """
    if label.verdict == "candidate" and label.label is not None:
        return own.taken(label.label, pregrasp_distance_m)
    if label.verdict == "box_wrong":
        said = "a person says that the box is not the target's"
        if label.pixel is not None:
            said += f"; the target is at pixel {label.pixel[0]} {label.pixel[1]}"
        return own.asking(BOX_WRONG, said)
    return own.asking(PERSON_WOULD_HELP, "a person says that help is needed: no candidate would do")


def unanswered(own: Selection, seconds: float) -> Selection:
    """What the robot is left with when the time ran out.

    Args:
        own: the robot's own answer.
        seconds: how long it waited, s.

    Returns:
        The same, with a warning.
    """
    said = f"nobody answered within {seconds:.0f} s"
    return own.with_warnings(CodedWarning(NOBODY_ANSWERED, said))
