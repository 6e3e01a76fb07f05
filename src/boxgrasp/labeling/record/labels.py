"""Rows of labels: how one is added, and which of them stand."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from typing import Any

import sqlalchemy as sa

from boxgrasp.errors import LabelError
from boxgrasp.labeling.record.tables import (
    BATCH,
    LABELS,
    LEASES,
    SCENES,
    SOURCES,
    insert_all,
    label_of,
    label_row,
)
from boxgrasp.labeling.record.turns import stands
from boxgrasp.labeling.words import LabelScene, OperatorLabel, Progress
from boxgrasp.strict import plain

RECENT = 20  # labels that a rate is of
PAUSE_S = 600.0  # a longer gap between two labels is a pause, which no rate counts
# What the server notes when a save reaches it: another time at the second try of the same.
_NOTED = ("labeled_at", "seconds", "version")


@dataclass(frozen=True)
class KeptLabel:
    """A label with its scene, as it is carried from one record into another.

    Attributes:
        label: any row, superseded and withdrawn ones too.
        scene: that it is of.
        sources: what each source that has the scene calls it, by the source's name.
    """

    label: OperatorLabel
    scene: LabelScene
    sources: Mapping[str, str]


def label_with(connection: sa.Connection, label_id: str) -> OperatorLabel | None:
    """A label by its id.

    Args:
        connection: to the database.
        label_id: of the label.

    Returns:
        The label, if there is one.
    """
    row = connection.execute(sa.select(LABELS).where(LABELS.c.id == label_id)).mappings().first()
    return None if row is None else label_of(row)


def add(connection: sa.Connection, label: OperatorLabel) -> OperatorLabel:
    """Add a label, and let others have its scene; one that is there already stays as it is.

    Args:
        connection: of a transaction that writes.
        label: a checked one.

    Returns:
        What is kept under its id.

    Raises:
        LabelError: it contradicts what is there.
        IntegrityError: it does, by what another writer did at the same moment.
    """
    kept = label_with(connection, label.id)
    if kept is not None:
        if said(kept) != said(label):
            raise LabelError(
                f"label {label.id} is kept already and says something else; valid: an id of its own"
            )
        return kept
    if connection.scalar(sa.select(SCENES.c.key).where(SCENES.c.key == label.scene_key)) is None:
        raise LabelError(f"no scene {label.scene_key} is known; valid: one that was added")
    if label.supersedes is not None:
        check_superseded(connection, label)
    connection.execute(sa.insert(LABELS).values(label_row(label)))
    mine = sa.and_(LEASES.c.scene_key == label.scene_key, LEASES.c.operator == label.operator)
    connection.execute(sa.delete(LEASES).where(mine))
    return label


def check_superseded(connection: sa.Connection, label: OperatorLabel) -> None:
    """Refuse a correction of what cannot be corrected.

    Args:
        connection: to the database.
        label: that supersedes another one.

    Raises:
        LabelError: there is none, it is of another scene or operator, or superseded already.
    """
    old = label_with(connection, str(label.supersedes))
    if old is None:
        raise LabelError(f"no label {label.supersedes} is known; valid: one that was saved")
    if (old.scene_key, old.operator) != (label.scene_key, label.operator):
        raise LabelError(
            f"label {old.id} is {old.operator}'s, of scene {old.scene_key}; valid: a label of the "
            "same operator and scene"
        )
    later = connection.scalar(sa.select(LABELS.c.id).where(LABELS.c.supersedes == old.id))
    if later is not None:
        raise superseded(old.id)


def superseded(label_id: str) -> LabelError:
    """The refusal of a second correction.

    Args:
        label_id: of the label that was corrected.

    Returns:
        The error.
    """
    return LabelError(f"label {label_id} is superseded already; valid: the newest of its scene")


def said(label: OperatorLabel) -> dict[str, Any]:
    """What a label says, without what its server notes when it arrives.

    Args:
        label: the label.

    Returns:
        Plain values by name.
    """
    return {name: value for name, value in content(label).items() if name not in _NOTED}


def content(label: OperatorLabel) -> dict[str, Any]:
    """All of a label as values that can be compared.

    Args:
        label: the label.

    Returns:
        Plain values by name.
    """
    fields: dict[str, Any] = plain(replace(label))
    return {
        name: json.loads(json.dumps(value)) if isinstance(value, dict | list) else value
        for name, value in fields.items()
    }


def take_in(connection: sa.Connection, found: Sequence[OperatorLabel]) -> int:
    """Add many labels, what is superseded before what supersedes it.

    Args:
        connection: of a transaction that writes.
        found: checked ones, in any order; their scenes are there.

    Returns:
        How many were new.

    Raises:
        LabelError: one contradicts what is there, or another one.
        IntegrityError: one does, by what another writer did at the same moment.
    """
    wanted: dict[str, OperatorLabel] = {}
    for label in sorted(found, key=lambda item: item.labeled_at):
        if content(wanted.setdefault(label.id, label)) != content(label):
            raise LabelError(f"label {label.id} is there twice and differs; valid: one id a label")
    known = _known(connection, list(wanted))
    for label_id, kept in known.items():
        if content(kept) != content(wanted[label_id]):
            raise LabelError(f"label {label_id} is kept already and differs; valid: one id a label")
    waiting = [label for label_id, label in wanted.items() if label_id not in known]
    added = len(waiting)
    while waiting:
        names = {label.id for label in waiting}
        ready = [label for label in waiting if label.supersedes not in names]
        if not ready:
            raise LabelError(f"label {waiting[0].id} supersedes itself; valid: an earlier label")
        _insert_all(connection, ready)
        ids = {label.id for label in ready}
        waiting = [label for label in waiting if label.id not in ids]
    return added


def _insert_all(connection: sa.Connection, ready: Sequence[OperatorLabel]) -> None:
    """Add labels of which none supersedes another one."""
    corrected: set[str] = set()
    for label in ready:
        if label.supersedes is not None:
            check_superseded(connection, label)
            if label.supersedes in corrected:
                raise superseded(label.supersedes)
            corrected.add(label.supersedes)
    insert_all(connection, LABELS, [label_row(label) for label in ready])


def _known(connection: sa.Connection, ids: Sequence[str]) -> dict[str, OperatorLabel]:
    found: dict[str, OperatorLabel] = {}
    for k in range(0, len(ids), BATCH):
        query = sa.select(LABELS).where(LABELS.c.id.in_(ids[k : k + BATCH]))
        rows = connection.execute(query).mappings()
        found |= {row["id"]: label_of(row) for row in rows}
    return found


def withdrawal(old: OperatorLabel, new_id: str, now: datetime) -> OperatorLabel:
    """The row that takes a label back.

    Args:
        old: the label.
        new_id: of the row.
        now: when.

    Returns:
        A label that says `withdrawn`.
    """
    return replace(
        old,
        id=new_id,
        verdict="withdrawn",
        label=None,
        labeled_at=now,
        seconds=None,
        overridden=(),
        note="",
        pixel=None,
        T_base_gripper=None,
        pose_distance_m=None,
        pose_angle_rad=None,
        supersedes=old.id,
    )


def standing(
    connection: sa.Connection,
    source: str | None = None,
    operator: str | None = None,
    scene_key: str | None = None,
) -> list[OperatorLabel]:
    """Labels that are neither superseded nor withdrawn.

    Args:
        connection: to the database.
        source: only of its scenes.
        operator: only these.
        scene_key: only of this scene.

    Returns:
        The oldest first.
    """
    query = sa.select(LABELS).where(stands())
    if source is not None:
        query = query.where(LABELS.c.scene_key.in_(_keys_of(source)))
    if operator is not None:
        query = query.where(LABELS.c.operator == operator)
    if scene_key is not None:
        query = query.where(LABELS.c.scene_key == scene_key)
    return _ordered(connection, query)


def history(connection: sa.Connection, scene_key: str | None = None) -> list[OperatorLabel]:
    """Every row, superseded and withdrawn ones too.

    Args:
        connection: to the database.
        scene_key: only of this scene.

    Returns:
        The oldest first.
    """
    query = sa.select(LABELS)
    if scene_key is not None:
        query = query.where(LABELS.c.scene_key == scene_key)
    return _ordered(connection, query)


def progress(connection: sa.Connection, source: str, operator: str, now: datetime) -> Progress:
    """How far one operator, and all of them, are.

    Args:
        connection: to the database.
        source: whose scenes.
        operator: whose labels.
        now: up to when.

    Returns:
        Counts, and the rate of the operator's last labels.
    """
    scenes = _count(connection, _keys_of(source))
    labeled = sa.select(LABELS.c.scene_key).where(
        stands(), LABELS.c.scene_key.in_(_keys_of(source))
    )
    done = _count(connection, labeled.distinct())
    mine = _count(connection, labeled.where(LABELS.c.operator == operator))
    # Nobody sat before an imported label or a pose at that moment.
    times = connection.scalars(
        sa.select(LABELS.c.labeled_at)
        .where(stands(), LABELS.c.operator == operator, LABELS.c.labeled_at <= now)
        .where(LABELS.c.origin.not_in(("import", "pose")))
        .order_by(LABELS.c.labeled_at.desc())
        .limit(RECENT)
    )
    rate = _rate_per_hour(list(times))
    left = scenes - done
    return Progress(
        scenes=scenes,
        done=done,
        mine=mine,
        rate_per_hour=rate,
        seconds_left=None if rate is None else 3600.0 * left / rate,
    )


def _rate_per_hour(times: Sequence[datetime]) -> float | None:
    """Of labels, the newest first; pauses do not count."""
    gaps = [(b - a).total_seconds() for b, a in zip(times, times[1:], strict=False)]
    gaps = [gap for gap in gaps if gap <= PAUSE_S]
    return 3600.0 * len(gaps) / sum(gaps) if sum(gaps) > 0.0 else None


def _keys_of(source: str) -> sa.Select[Any]:
    return sa.select(SOURCES.c.scene_key).where(SOURCES.c.source == source)


def _count(connection: sa.Connection, query: sa.Select[Any]) -> int:
    return connection.execute(sa.select(sa.func.count()).select_from(query.subquery())).scalar_one()


def _ordered(connection: sa.Connection, query: sa.Select[Any]) -> list[OperatorLabel]:
    ordered = query.order_by(LABELS.c.labeled_at, LABELS.c.id)
    return [label_of(row) for row in connection.execute(ordered).mappings()]
