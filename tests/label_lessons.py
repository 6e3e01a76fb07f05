"""Labeled scenes for tests: a small set, a database, and labels as operators give them."""

from __future__ import annotations

import uuid
from collections.abc import Callable, Iterable
from datetime import datetime, timedelta, timezone
from functools import partial
from pathlib import Path
from typing import Any

from boxgrasp.execution import Store
from boxgrasp.grasps.gripper import Gripper
from boxgrasp.labeling.captures import CaptureStore
from boxgrasp.labeling.record import Record
from boxgrasp.labeling.words import LabelScene, OperatorLabel
from boxgrasp.strict import plain

START = datetime(2026, 1, 1, tzinfo=timezone.utc)


def said(
    scene: LabelScene, label: int | None, operator: str = "anna", after_s: int = 0, **other: Any
) -> OperatorLabel:
    """A label of a scene; None is `none`."""
    told: dict[str, Any] = {
        "id": str(uuid.uuid4()),
        "scene_key": scene.key,
        "operator": operator,
        "verdict": "none" if label is None else "candidate",
        "label": label,
        "labeled_at": START + timedelta(seconds=after_s),
        "seconds": 1.0,
        "gripper": plain(Gripper()),
        "box_kind": scene.box_kind,
        "lines": scene.lines,
        "version": "test",
    }
    return OperatorLabel(**{**told, **other})


def database(folder: Path, scenes: Iterable[LabelScene], labels: Iterable[OperatorLabel]) -> Path:
    """A database with scenes and labels."""
    path = folder / "labels.db"
    with Record.open(str(path)) as record:
        record.add_scenes("test", list(scenes))
        for label in labels:
            record.save(label)
    return path


def opener(path: Path) -> Callable[[], Record]:
    """What opens a database, here or in another process."""
    return partial(Record.open, str(path), False)


def captures_in(folder: Path) -> CaptureStore:
    return CaptureStore(Store(folder))
