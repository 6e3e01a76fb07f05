"""What a scene, a label or an ask must be before it is kept."""

from __future__ import annotations

import json
import math
import re
import uuid
from collections.abc import Mapping
from datetime import datetime
from typing import Any, get_args

from boxgrasp.errors import LabelError, shown
from boxgrasp.labeling.record.tables import KEY_LENGTH, label_row, scene_row
from boxgrasp.labeling.words import ORIGINS, VERDICTS, Ask, LabelScene, OperatorLabel, SceneKind

FACES = 5  # of candidates; the request for help is a verdict of its own
MOST_LINES = 99
LONGEST_NOTE = 10_000  # characters; a page of text is 3,000
LONGEST = 100_000  # characters of any text; a cell of CSV has 131,072 at most
LONGEST_NAME = 200  # characters of an operator's or an asker's name
_KEY = re.compile(rf"[A-Za-z0-9._-]{{1,{KEY_LENGTH}}}")
_KINDS = get_args(SceneKind)
_BOX_KINDS = ("aligned", "yaw")


def check_scene(scene: LabelScene) -> None:
    """Refuse a scene that is none.

    Args:
        scene: as given.

    Raises:
        LabelError: says what is wrong with it.
    """
    if not _KEY.fullmatch(scene.key):
        valid = f"1 to {KEY_LENGTH} letters, digits, `-`, `_` and `.`"
        raise LabelError(f"the scene's key is {shown(scene.key)}; valid: {valid}")
    name = f"scene {scene.key}:"
    _one_of(scene.kind, _KINDS, f"{name} kind")
    _one_of(scene.box_kind, _BOX_KINDS, f"{name} box_kind")
    _whole(scene.lines, 1, MOST_LINES, f"{name} lines")
    if (scene.kind == "capture") != (scene.capture_sha256 is not None):
        raise LabelError(
            f"{name} a {scene.kind} has capture_sha256 {shown(scene.capture_sha256)}; valid: that "
            "of a capture, None of a scenario"
        )
    if scene.number is not None:
        _whole(scene.number, 0, 2**63 - 1, f"{name} number")
    _storable(scene_row(scene), name)


def check_label(label: OperatorLabel) -> None:
    """Refuse a label that is none.

    Args:
        label: as given.

    Raises:
        LabelError: says what is wrong with it.
    """
    check_id(label.id)
    name = f"label {label.id}:"
    _named(label.operator, f"{name} operator")
    _one_of(label.verdict, VERDICTS, f"{name} verdict")
    _one_of(label.origin, ORIGINS, f"{name} origin")
    _one_of(label.box_kind, _BOX_KINDS, f"{name} box_kind")
    _whole(label.lines, 1, MOST_LINES, f"{name} lines")
    last = FACES * label.lines
    if label.verdict == "candidate":
        _whole(label.label, 1, last, f"{name} label")
    elif label.label is not None:
        raise LabelError(f"{name} `{label.verdict}` has a candidate; valid: none")
    if label.proposed is not None:
        _whole(label.proposed, 1, last, f"{name} proposed")
    if label.verdict == "withdrawn" and label.supersedes is None:
        raise LabelError(f"{name} withdraws nothing; valid: the id of a label in supersedes")
    if label.supersedes is not None:
        check_id(label.supersedes)
    _moment(label.labeled_at, f"{name} labeled_at")
    if len(label.note) > LONGEST_NOTE:
        raise LabelError(
            f"{name} its note has {len(label.note)} characters; valid: {LONGEST_NOTE} at most"
        )
    _check_pose(label, name)
    _storable(label_row(label), name)


def check_ask(ask: Ask) -> None:
    """Refuse an ask that is none.

    Args:
        ask: as given.

    Raises:
        LabelError: says what is wrong with it.
    """
    check_id(ask.id)
    name = f"ask {ask.id}:"
    _named(ask.asker, f"{name} asker")
    _moment(ask.asked_at, f"{name} asked_at")
    _moment(ask.expires_at, f"{name} expires_at")
    _storable({"asker": ask.asker, "selection": ask.selection}, name)


def check_id(value: str) -> None:
    """Refuse what is no UUID.

    Args:
        value: as given.

    Raises:
        LabelError: it is none.
    """
    try:
        if str(uuid.UUID(value)) == value:
            return
    except (ValueError, AttributeError, TypeError):
        pass
    valid = "a UUID, 0d9f8e3c-12ab-4cde-8f01-23456789abcd"
    raise LabelError(f"the id is {shown(value)}; valid: {valid}")


def _check_pose(label: OperatorLabel, name: str) -> None:
    pose = label.T_base_gripper
    if pose is not None and (len(pose) != 4 or any(len(line) != 4 for line in pose)):
        raise LabelError(f"{name} T_base_gripper is not 4 x 4; valid: four rows of four numbers")
    for field in ("seconds", "pose_distance_m", "pose_angle_rad"):
        value = getattr(label, field)
        if value is not None and not (math.isfinite(value) and value >= 0):
            raise LabelError(f"{name} {field} is {value}; valid: 0 or more, finite")
    if label.pixel is not None and len(label.pixel) != 2:
        raise LabelError(f"{name} pixel has {len(label.pixel)} numbers; valid: u and v")


def _named(value: Any, name: str) -> None:
    if not isinstance(value, str) or not 1 <= len(value.strip()) <= len(value) <= LONGEST_NAME:
        raise LabelError(f"{name} is {shown(value)}; valid: 1 to {LONGEST_NAME} characters")


def _one_of(value: Any, valid: tuple[str, ...], name: str) -> None:
    if value not in valid:
        raise LabelError(f"{name} is {shown(value)}; valid: {', '.join(valid)}")


def _whole(value: Any, low: int, high: int, name: str) -> None:
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise LabelError(f"{name} is {shown(value)}; valid: {low} to {high}")


def _moment(value: Any, name: str) -> None:
    if not isinstance(value, datetime) or value.tzinfo is None:
        raise LabelError(f"{name} is {shown(value)}; valid: a time with its zone")


def _storable(row: Mapping[str, Any], name: str) -> None:
    """Refuse what not every database keeps as it is: NUL, half characters, NaN."""
    for column, value in row.items():
        texts = [value] if isinstance(value, str) else []
        if isinstance(value, Mapping | list | tuple):
            try:
                texts = [json.dumps(value, allow_nan=False, ensure_ascii=False)]
            except (TypeError, ValueError) as error:
                raise LabelError(
                    f"{name} {column} is not plain: {error}; valid: values as JSON has"
                ) from None
        for text in texts:
            if len(text) > LONGEST:
                raise LabelError(
                    f"{name} {column} has {len(text)} characters; valid: {LONGEST} at most"
                )
            if "\0" in text or "\\u0000" in text:
                raise LabelError(f"{name} {column} holds a NUL; valid: text without")
            try:
                text.encode()
            except UnicodeEncodeError:
                raise LabelError(f"{name} {column} holds half a character; valid: text") from None
