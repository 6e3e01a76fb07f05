"""The tables of the record, and its rows as what the rest of the package knows.

`migrations/` makes them; a test holds these to what the migrations make. Rows of `labels` are only
ever added: the database itself refuses to change or delete one.
"""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Sequence
from datetime import datetime, timezone
from typing import Any

from sqlalchemy import (
    JSON,
    BigInteger,
    Boolean,
    CheckConstraint,
    Column,
    Connection,
    DateTime,
    Dialect,
    Double,
    ForeignKey,
    Index,
    Integer,
    MetaData,
    RowMapping,
    String,
    Table,
    Text,
    TypeDecorator,
    literal,
    text,
)
from sqlalchemy.dialects import postgresql, sqlite

from boxgrasp.labeling.words import Ask, LabelScene, OperatorLabel

KEY_LENGTH, ID_LENGTH = 120, 36
BATCH = 500  # rows a statement
Row = dict[str, Any]


class UtcTime(TypeDecorator[datetime]):
    """A moment; SQLite keeps no time zone, so every moment is kept in UTC."""

    impl = DateTime(timezone=True)
    cache_ok = True

    def process_bind_param(self, value: datetime | None, dialect: Dialect) -> datetime | None:
        """The moment as the database keeps it."""
        if value is None:
            return None
        moment = value.astimezone(timezone.utc)
        return moment.replace(tzinfo=None) if dialect.name == "sqlite" else moment

    def process_result_value(self, value: datetime | None, dialect: Dialect) -> datetime | None:
        """The moment with its time zone."""
        if value is None:
            return None
        return (value if value.tzinfo else value.replace(tzinfo=timezone.utc)).astimezone(
            timezone.utc
        )


_JSON = JSON(none_as_null=True)
METADATA = MetaData()

SCENES = Table(
    "scenes",
    METADATA,
    Column("key", String(KEY_LENGTH), primary_key=True),
    Column("kind", String(16), nullable=False),
    Column("name", Text, nullable=False),
    Column("box_kind", String(16), nullable=False),
    Column("lines", Integer, nullable=False),
    Column("capture_sha256", String(64)),
    Column("target", _JSON),
    Column("row_config", _JSON),
    Column("number", BigInteger),
    # In [0, 1), of the key alone: below a share, the scene is one of that share.
    Column("second_draw", Double, nullable=False),
    Column("again_draw", Double, nullable=False),
    Index("scenes_drawn_for_second", "second_draw"),
    Index("scenes_drawn_for_again", "again_draw"),
)

# In which order a source has its scenes, and what it calls them.
SOURCES = Table(
    "source_scenes",
    METADATA,
    Column("source", Text, primary_key=True),
    Column("scene_key", ForeignKey("scenes.key"), primary_key=True),
    Column("position", BigInteger, nullable=False),
    Column("name", Text, nullable=False),
    Index("source_scenes_in_order", "source", "position", "scene_key"),
)

LABELS = Table(
    "labels",
    METADATA,
    Column("id", String(ID_LENGTH), primary_key=True),
    Column("scene_key", ForeignKey("scenes.key"), nullable=False),
    Column("operator", Text, nullable=False),
    Column("verdict", String(16), nullable=False),
    Column("label", Integer),
    Column("labeled_at", UtcTime, nullable=False),
    Column("seconds", Double),
    Column("gripper", _JSON, nullable=False),
    Column("box_kind", String(16), nullable=False),
    Column("lines", Integer, nullable=False),
    Column("version", Text, nullable=False),
    Column("model", Text, nullable=False),
    Column("proposed", Integer),
    Column("overridden", _JSON, nullable=False),
    Column("note", Text, nullable=False),
    Column("pixel", _JSON),
    Column("origin", String(16), nullable=False),
    Column("pose", _JSON),
    Column("pose_distance_m", Double),
    Column("pose_angle_rad", Double),
    Column("supersedes", ForeignKey("labels.id"), unique=True),
    CheckConstraint(
        "(verdict = 'candidate') = (label IS NOT NULL)", name="labels_candidate_has_label"
    ),
    CheckConstraint(
        "verdict <> 'withdrawn' OR supersedes IS NOT NULL", name="labels_withdrawn_supersedes"
    ),
    Index("labels_of_scene", "scene_key", "operator"),
    Index("labels_of_operator", "operator", "labeled_at"),
)

# Who has which scene before them; a scene is with one operator at most.
LEASES = Table(
    "leases",
    METADATA,
    Column("scene_key", ForeignKey("scenes.key"), primary_key=True),
    Column("operator", Text, nullable=False),
    Column("given_at", UtcTime, nullable=False),
    Column("expires_at", UtcTime, nullable=False),
    Column("lease_s", Double, nullable=False),
    Index("leases_of_operator", "operator"),
)

ASKS = Table(
    "asks",
    METADATA,
    Column("id", String(ID_LENGTH), primary_key=True),
    Column("scene_key", ForeignKey("scenes.key"), nullable=False),
    Column("asked_at", UtcTime, nullable=False),
    Column("expires_at", UtcTime, nullable=False),
    Column("asker", Text, nullable=False),
    Column("selection", Text, nullable=False),
    Column("withdrawn", Boolean(create_constraint=False), nullable=False),
    Index("asks_of_scene", "scene_key"),
)

# Columns that are called otherwise than the field: a database folds capitals of names.
_COLUMN_OF = {"T_base_gripper": "pose"}
SCENE_FIELDS = tuple(item.name for item in dataclasses.fields(LabelScene))
LABEL_FIELDS = tuple(item.name for item in dataclasses.fields(OperatorLabel))
ASK_FIELDS = tuple(item.name for item in dataclasses.fields(Ask))


def draw_of(key: str, purpose: str) -> float:
    """A number that a scene always draws, whoever asks.

    Args:
        key: of the scene.
        purpose: what is drawn for.

    Returns:
        In [0, 1), even over keys.
    """
    digest = hashlib.sha256(f"{purpose}:{key}".encode()).digest()
    return int.from_bytes(digest[:6], "big") / 2**48


def insert_all(
    connection: Connection, table: Table, rows: Sequence[Row], skip_known: bool = False
) -> None:
    """Add many rows.

    Args:
        connection: of a transaction that writes.
        table: that they are of.
        rows: values by column, all of the same columns.
        skip_known: whether rows that are there already are left out, else refused.

    Raises:
        IntegrityError: a row contradicts what is there.
    """
    on_sqlite = connection.dialect.name == "sqlite"
    for k in range(0, len(rows), BATCH):
        some = list(rows[k : k + BATCH])
        if on_sqlite:
            plain = sqlite.insert(table)
            connection.execute(plain.on_conflict_do_nothing() if skip_known else plain, some)
            continue
        insert = postgresql.insert(table)
        # With an answer, SQLAlchemy sends many rows at once; without, pg8000 one by one.
        answered = (insert.on_conflict_do_nothing() if skip_known else insert).returning(literal(1))
        connection.execute(answered, some).all()
    if not on_sqlite and len(rows) >= BATCH:
        # Else PostgreSQL plans for an empty table until it looks by itself, in a minute or so.
        connection.execute(text(f"ANALYZE {table.name}"))


def scene_row(scene: LabelScene) -> Row:
    """A scene as a row.

    Args:
        scene: the scene.

    Returns:
        Values by column of `scenes`.
    """
    row = {name: getattr(scene, name) for name in SCENE_FIELDS}
    draws = {f"{name}_draw": draw_of(scene.key, name) for name in ("second", "again")}
    return {**row, **draws}


def scene_of(row: RowMapping) -> LabelScene:
    """A row of `scenes` as a scene.

    Args:
        row: of the database.

    Returns:
        The scene.
    """
    return LabelScene(**{name: row[name] for name in SCENE_FIELDS})


def label_row(label: OperatorLabel) -> Row:
    """A label as a row.

    Args:
        label: the label.

    Returns:
        Values by column of `labels`.
    """
    return {_COLUMN_OF.get(name, name): getattr(label, name) for name in LABEL_FIELDS}


def label_of(row: RowMapping) -> OperatorLabel:
    """A row of `labels` as a label.

    Args:
        row: of the database.

    Returns:
        The label.
    """
    fields = {name: row[_COLUMN_OF.get(name, name)] for name in LABEL_FIELDS}
    return label_from_plain(fields)


def label_from_plain(fields: Row) -> OperatorLabel:
    """A label of values as JSON has them.

    Args:
        fields: by name.

    Returns:
        The label, its lists as tuples.
    """
    pixel, pose = fields["pixel"], fields["T_base_gripper"]
    fields = {**fields, "overridden": tuple(fields["overridden"])}
    fields["pixel"] = None if pixel is None else tuple(pixel)
    fields["T_base_gripper"] = None if pose is None else tuple(tuple(line) for line in pose)
    return OperatorLabel(**fields)


def ask_of(row: RowMapping) -> Ask:
    """A row of `asks` as an ask.

    Args:
        row: of the database.

    Returns:
        The ask.
    """
    return Ask(**{name: row[name] for name in ASK_FIELDS})
