"""Labels with their scenes as one table, a Parquet or a CSV file: written, read, and taken in.

A row is a label, superseded and withdrawn ones too. In CSV a cell of text that a spreadsheet would
take for a formula gets a `'` in front, and so does one that begins with such a `'`; reading takes
it away again.
"""

from __future__ import annotations

import csv
import io
import json
import math
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from typing import Any, Literal, NoReturn

import pyarrow as pa
import pyarrow.parquet as pq

from boxgrasp.errors import BoxgraspError, ConfigError, LabelError
from boxgrasp.execution import Store
from boxgrasp.labeling.record.checks import check_label, check_scene
from boxgrasp.labeling.record.database import Record
from boxgrasp.labeling.record.labels import KeptLabel
from boxgrasp.labeling.record.tables import LABEL_FIELDS, SCENE_FIELDS, label_from_plain
from boxgrasp.labeling.words import LabelScene
from boxgrasp.strict import plain

VALID = "FILE.parquet or FILE.csv"
Kind = Literal["text", "whole", "number", "moment", "json"]
_FORMULA = "=+-@\t\r\n\uff1d\uff0b\uff0d\uff20"  # the last four are the wide ones of CJK fonts
_TYPES = {
    "text": pa.string(),
    "whole": pa.int64(),
    "number": pa.float64(),
    "moment": pa.timestamp("us", tz="UTC"),
    "json": pa.string(),
}


@dataclass(frozen=True)
class Column:
    """A column of the table.

    Attributes:
        name: of the label's field, or of the scene's with `scene_` before it.
        kind: what its cells are; `json` is text.
        optional: whether a cell may be empty.
    """

    name: str
    kind: Kind
    optional: bool = False


_KINDS: dict[str, tuple[Kind, bool]] = {
    "label": ("whole", True),
    "labeled_at": ("moment", False),
    "seconds": ("number", True),
    "gripper": ("json", False),
    "lines": ("whole", False),
    "proposed": ("whole", True),
    "overridden": ("json", False),
    "pixel": ("json", True),
    "T_base_gripper": ("json", True),
    "pose_distance_m": ("number", True),
    "pose_angle_rad": ("number", True),
    "supersedes": ("text", True),
    "capture_sha256": ("text", True),
    "target": ("json", True),
    "row_config": ("json", True),
    "number": ("whole", True),
}
_SCENE_COLUMNS = {name: f"scene_{name}" for name in SCENE_FIELDS}  # key is the label's scene_key
COLUMNS = (
    *(Column(name, *_KINDS.get(name, ("text", False))) for name in LABEL_FIELDS),
    *(
        Column(column, *_KINDS.get(name, ("text", False)))
        for name, column in _SCENE_COLUMNS.items()
        if column not in LABEL_FIELDS
    ),
    Column("sources", "json"),  # what each source calls the scene
)


def export_labels(record: Record, path: str) -> int:
    """Write every row of a record.

    Args:
        record: of labels.
        path: FILE.parquet or FILE.csv, or an fsspec URL of one; it is written wholly or not at all.

    Returns:
        How many rows.

    Raises:
        ConfigError: another kind of file.
        StoreError: it cannot be written, or the record not read.
    """
    store, name, suffix = _place(path)
    rows = [_row(kept) for kept in record.kept()]
    store.write(name, _csv_bytes(rows) if suffix == ".csv" else _parquet_bytes(rows))
    return len(rows)


def import_labels(record: Record, path: str) -> tuple[int, int]:
    """Take in the rows of a file; all of them or, where one is refused, none.

    Args:
        record: of labels.
        path: of what `export_labels` wrote.

    Returns:
        How many rows were new, and how many were there already.

    Raises:
        ConfigError: another kind of file.
        StoreError: it cannot be read, or the record not written.
        LabelError: it is no table of labels, or contradicts the record.
    """
    store, name, suffix = _place(path)
    data = store.read(name)
    place = f"{store}/{name}" if "://" in path else path
    rows = list(_csv_rows(data, place) if suffix == ".csv" else _parquet_rows(data, place))
    kept = [_kept(row, f"{place}, row {number}") for number, row in enumerate(rows, start=1)]
    try:
        added = record.take_in(kept)
    except LabelError as error:
        raise LabelError(f"{place}: {error}") from None
    return added, len(kept) - added


def _place(path: str) -> tuple[Store, str, str]:
    suffix = os.path.splitext(path)[1].lower()
    if suffix not in (".parquet", ".csv"):
        raise ConfigError(f"labels are exchanged as {path!r}; valid: {VALID}")
    if "://" in path:
        folder, _, name = path.rpartition("/")
        return Store(folder), name, suffix
    folder, name = os.path.split(path)
    return Store(folder or "."), name, suffix


# A row and what it holds.


def _row(kept: KeptLabel) -> dict[str, Any]:
    row: dict[str, Any] = plain(kept.label)
    scene = plain(kept.scene)
    row |= {column: scene[name] for name, column in _SCENE_COLUMNS.items()}
    row["sources"] = dict(kept.sources)
    for column in COLUMNS:
        if column.kind == "json" and row[column.name] is not None:
            row[column.name] = json.dumps(row[column.name], ensure_ascii=False, allow_nan=False)
    return {column.name: row[column.name] for column in COLUMNS}


def _kept(row: dict[str, Any], place: str) -> KeptLabel:
    """A label with its scene from the values of a row.

    Raises:
        LabelError: says in which row what is wrong.
    """
    for column in COLUMNS:
        row[column.name] = _value(row[column.name], column, place)
    try:
        label = label_from_plain({name: row[name] for name in LABEL_FIELDS})
        scene = LabelScene(**{name: row[column] for name, column in _SCENE_COLUMNS.items()})
        check_scene(scene)
        check_label(label)
        sources = row["sources"]
        if not isinstance(sources, dict) or not all(isinstance(x, str) for x in sources.values()):
            raise LabelError("sources is no object of names; valid: what an export has")
    except BoxgraspError as error:
        raise LabelError(f"{place}: {error}") from None
    except (TypeError, ValueError, AttributeError) as error:
        raise LabelError(f"{place}: {error}; valid: a row of an export") from None
    return KeptLabel(label, scene, sources)


def _value(value: Any, column: Column, place: str) -> Any:
    if value is None:
        if column.optional:
            return None
        raise LabelError(f"{place}: {column.name} is empty; valid: {_SAID[column.kind]}")
    if column.kind == "moment":
        return value.astimezone(timezone.utc)
    if column.kind != "json":
        return value
    try:
        return json.loads(value, parse_constant=_no_constant)
    except (ValueError, RecursionError):
        raise LabelError(f"{place}: {column.name} is no JSON; valid: {_SAID['json']}") from None


def _no_constant(name: str) -> NoReturn:
    raise ValueError(name)


_SAID = {
    "text": "text",
    "whole": "a whole number",
    "number": "a finite number",
    "moment": "a time with its zone, 2026-03-01T08:00:00+00:00",
    "json": "JSON",
}


# Parquet.


def _schema() -> pa.Schema:
    return pa.schema(
        [pa.field(column.name, _TYPES[column.kind], column.optional) for column in COLUMNS]
    )


def _parquet_bytes(rows: Sequence[dict[str, Any]]) -> bytes:
    written = io.BytesIO()
    pq.write_table(pa.Table.from_pylist(list(rows), schema=_schema()), written)
    return written.getvalue()


def _parquet_rows(data: bytes, place: str) -> Iterator[dict[str, Any]]:
    try:
        table = pq.read_table(io.BytesIO(data))
    except (pa.ArrowException, OSError, ValueError):
        raise LabelError(f"{place}: is no Parquet file; valid: what an export wrote") from None
    _check_names(table.column_names, place)
    for column in COLUMNS:
        # Nulls are told apart later, with their row.
        try:
            cast = table[column.name].cast(_TYPES[column.kind])
        except (pa.ArrowException, ValueError):
            found = table.schema.field(column.name).type
            raise LabelError(
                f"{place}: {column.name} is of {found}; valid: {_SAID[column.kind]}"
            ) from None
        index = table.column_names.index(column.name)
        table = table.set_column(index, column.name, cast)
    yield from table.select([column.name for column in COLUMNS]).to_pylist()


# CSV.


def _csv_bytes(rows: Sequence[dict[str, Any]]) -> bytes:
    written = io.StringIO(newline="")
    writer = csv.writer(written, quoting=csv.QUOTE_ALL, lineterminator="\n")
    writer.writerow([column.name for column in COLUMNS])
    for row in rows:
        writer.writerow([_cell(row[column.name], column) for column in COLUMNS])
    return written.getvalue().encode()


def _cell(value: Any, column: Column) -> str:
    if value is None:
        return ""
    if isinstance(value, datetime):
        return value.astimezone(timezone.utc).isoformat(timespec="microseconds")
    if column.kind in ("whole", "number"):
        return repr(value)
    risky = value[:1] in _FORMULA if value else False
    return f"'{value}" if risky or _is_escaped(value) else str(value)


def _is_escaped(text: str) -> bool:
    """Whether text begins with as many `'` as there are, and then what a formula begins with."""
    rest = text.lstrip("'")
    return len(rest) < len(text) and rest[:1] != "" and rest[:1] in _FORMULA


def _csv_rows(data: bytes, place: str) -> Iterator[dict[str, Any]]:
    try:
        lines = list(csv.reader(io.StringIO(data.decode("utf-8-sig"), newline=""), strict=True))
    except UnicodeDecodeError:
        raise LabelError(f"{place}: is no UTF-8 text; valid: what an export wrote") from None
    except csv.Error as error:
        raise LabelError(f"{place}: {error}; valid: what an export wrote") from None
    if not lines:
        raise LabelError(f"{place}: is empty; valid: what an export wrote")
    names = lines[0]
    _check_names(names, place)
    for number, line in enumerate(lines[1:], start=1):
        if len(line) != len(names):
            raise LabelError(
                f"{place}, row {number}: has {len(line)} cells; valid: {len(names)}, one a column"
            )
        cells = dict(zip(names, line, strict=True))
        where = f"{place}, row {number}"
        yield {column.name: _uncell(cells[column.name], column, where) for column in COLUMNS}


def _uncell(text: str, column: Column, place: str) -> Any:
    if text == "" and (column.optional or column.kind != "text"):
        return None
    if column.kind in ("text", "json"):
        return text[1:] if _is_escaped(text) else text
    try:
        if column.kind == "whole" and re.fullmatch(r"-?[0-9]{1,19}", text):
            return int(text)
        if column.kind == "number" and math.isfinite(number := float(text)):
            return number
        if column.kind == "moment" and (moment := datetime.fromisoformat(text)).tzinfo:
            return moment
    except ValueError:
        pass
    raise LabelError(f"{place}: {column.name} is {text[:40]!r}; valid: {_SAID[column.kind]}")


def _check_names(names: Sequence[str], place: str) -> None:
    wanted = {column.name for column in COLUMNS}
    twice = [name for name in names if names.count(name) > 1]
    for said, wrong in (
        ("lacks", [column.name for column in COLUMNS if column.name not in names]),
        ("has twice", twice),
        ("has an unknown", [name for name in names if name not in wanted]),
    ):
        if wrong:
            more = f" and {len(wrong) - 1} more" if len(wrong) > 1 else ""
            raise LabelError(
                f"{place}: {said} column {wrong[0][:40]!r}{more}; valid: the {len(COLUMNS)} of an "
                "export"
            )
