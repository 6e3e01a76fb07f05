"""Scenario sets on disk: Parquet parts, a row a scenario, and what they were made with.

A set is a folder or any fsspec URL: `set.json` and `part-00000.parquet` onwards. Its captures are
cast again from the seed, or kept as `capture-000000.npz`.
"""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from boxgrasp.arrays import Array
from boxgrasp.errors import ConfigError, MissingExtraError
from boxgrasp.execution import Store, Workers, finish
from boxgrasp.io.npz import KEYS
from boxgrasp.simulate.objects import load_objects
from boxgrasp.strict import build, plain
from boxgrasp.teaching.rows import (
    NUMBERS,
    SAMPLINGS,
    TRUTHS,
    Row,
    RowConfig,
    row_of,
    sample_points,
    scenario_of_row,
)
from boxgrasp.version import __version__

PART_ROWS = 40
FLAGS = ("fits", "known")


@dataclass(frozen=True)
class SetConfig:
    """A set's rows, how many there are, and the version that made them.

    objects_sha256: of the object set as it is read now, so that a set is never made of two.

    Raises:
        ConfigError: no rows.
    """

    rows: RowConfig
    count: int
    version: str = __version__
    objects_sha256: str = ""

    def __post_init__(self) -> None:
        if not self.objects_sha256:
            said = repr(dict(load_objects(self.rows.recipe.objects))).encode()
            object.__setattr__(self, "objects_sha256", hashlib.sha256(said).hexdigest())
        if self.count < 1:
            raise ConfigError(f"count is {self.count}; valid: 1 or more")


@dataclass(frozen=True, eq=False)
class Rows(Mapping[str, Array]):
    """Columns by name, (N, ...) arrays; what a target_source could not tell is NaN, False or 0."""

    columns: Mapping[str, Array]

    def __getitem__(self, name: str) -> Array:
        return self.columns[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.columns)

    def __len__(self) -> int:
        return len(self.columns)

    @cached_property
    def count(self) -> int:
        """How many rows."""
        return len(self.columns["number"])

    def take(self, which: Array) -> Rows:
        """The rows of a mask or of indices."""
        return Rows({name: column[which] for name, column in self.columns.items()})


def make_set(store: Store, prefix: str, config: SetConfig, workers: Workers, label: str) -> None:
    """Write what the set still lacks; finished parts are not made again.

    Raises:
        ConfigError: the place holds a set that was made otherwise.
    """
    claim(store, prefix, "set.json", config, "a set")
    tasks = {
        f"{prefix}part-{first // PART_ROWS:05d}.parquet": (
            config.rows, range(first, min(first + PART_ROWS, config.count)),
        )
        for first in range(0, config.count, PART_ROWS)
    }  # fmt: skip
    finish(store, tasks, part, workers, label)


def keep_captures(
    store: Store, prefix: str, config: SetConfig, workers: Workers, label: str
) -> None:
    """Write every row's capture that is not there yet, as `capture-000000.npz`."""
    tasks = {f"{prefix}capture-{k:06d}.npz": (config.rows, k) for k in range(config.count)}
    finish(store, tasks, capture_bytes, workers, label)


def capture_bytes(task: tuple[RowConfig, int]) -> bytes:
    """A row's capture as the .npz that `load_capture` reads; `labels` are the true objects."""
    config, number = task
    scenario, run = scenario_of_row(config, number // config.runs), number % config.runs
    capture, labels = scenario.capture(config.recipe.noise, run * config.frames)
    out = io.BytesIO()
    arrays = {name: getattr(capture, name) for name in KEYS}
    held = {name: np.asarray(value) for name, value in arrays.items() if value is not None}
    np.savez_compressed(out, labels=labels.astype(np.int16), **held)  # type: ignore[arg-type]
    return out.getvalue()


def part(task: tuple[RowConfig, Sequence[int]]) -> bytes:
    """One part of a set as Parquet."""
    config, numbers = task
    return to_parquet([row_of(config, number) for number in numbers], config)


def read_set(store: Store, prefix: str = "") -> tuple[SetConfig, Rows]:
    """A finished set.

    Raises:
        ConfigError: there is none, or parts or rows of it are missing.
    """
    if not store.exists(f"{prefix}set.json"):
        raise ConfigError(f"no set at {store}/{prefix}; valid: what `boxgrasp simulate` wrote")
    made = _read_json(store, f"{prefix}set.json")
    config = build(SetConfig, made, f"{store}/{prefix}set.json", ConfigError)
    parts = -(-config.count // PART_ROWS)
    names = [f"{prefix}part-{k:05d}.parquet" for k in range(parts)]
    missing = [name for name in names if not store.exists(name)]
    if missing:
        raise ConfigError(
            f"set lacks {len(missing)} of {parts} parts; valid: run `boxgrasp simulate` again"
        )
    rows = joined([from_parquet(store.read(name)) for name in names])
    if rows.count != config.count:
        raise ConfigError(
            f"{store}/{prefix} holds {rows.count} rows; valid: {config.count} as in its set.json"
        )
    return config, rows


def joined(parts: Sequence[Rows]) -> Rows:
    """Rows one after the other."""
    return Rows({name: np.concatenate([p[name] for p in parts]) for name in parts[0]})


def to_parquet(rows: Sequence[Row], config: RowConfig) -> bytes:
    """Rows as one Parquet file, columns and types by `schema`."""
    pa, pq = _arrow()
    table = pa.table(
        {field.name: _column(pa, field, rows) for field in schema(config)}, schema=schema(config)
    )
    out = io.BytesIO()
    pq.write_table(table, out, compression="zstd")
    return out.getvalue()


def from_parquet(data: bytes) -> Rows:
    """The rows of one Parquet file.

    Raises:
        ConfigError: it is none.
    """
    pa, pq = _arrow()
    try:
        table = pq.read_table(io.BytesIO(data))
    except (pa.ArrowInvalid, OSError) as error:
        raise ConfigError(f"not a part of a set: {error}") from None
    return Rows({name: _array(pa, table.column(name)) for name in table.column_names})


def schema(config: RowConfig) -> Any:
    """Arrow schema of a set's rows."""
    pa, _ = _arrow()
    candidates = 5 * config.lines
    meters = pa.list_(pa.float64(), candidates)
    flags = pa.list_(pa.bool_(), candidates)
    fields = [
        ("seed", pa.int64()),
        ("number", pa.int64()),
        ("run", pa.int64()),
        ("target", pa.string()),
        ("scene", pa.string()),
        ("feasible", pa.bool_()),
        ("best_m", pa.float64()),
        ("true_box", pa.list_(pa.float64(), 4)),
        ("true_dimensions_m", pa.list_(pa.float64(), 3)),
        *((f"true_{name}", flags if name == "fits" else meters) for name in TRUTHS),
        ("label", pa.int64()),
        ("label_source", pa.string()),
    ]
    for target_source in config.target_sources:
        fields += [
            (f"{target_source}_error", pa.string()),
            (f"{target_source}_box", pa.list_(pa.float64(), 4)),
            (f"{target_source}_dimensions_m", pa.list_(pa.float64(), 3)),
            (f"{target_source}_passes", flags),
            (f"{target_source}_visible_m", meters),
            *((f"{target_source}_{name}", flags if name in FLAGS else meters) for name in NUMBERS),
            *((f"{target_source}_true_{n}", flags if n == "fits" else meters) for n in TRUTHS),
        ]
        for name in SAMPLINGS:
            whole, portions = sample_points(name)
            fields.append((f"{target_source}_{name}", pa.list_(pa.uint8(), len(whole))))
            fields.append((f"{target_source}_{name}_portions", pa.list_(pa.uint8(), len(portions))))
    return pa.schema(fields)


def claim(store: Store, prefix: str, name: str, settings: Any, what: str) -> None:
    """Keep the settings beside what is made with them, so that nothing is mixed in later.

    Raises:
        ConfigError: the place holds other settings.
    """
    mine = json.loads(json.dumps(plain(settings)))
    if store.exists(prefix + name):
        there = _read_json(store, prefix + name)
        if there != mine:
            raise ConfigError(
                f"{store}/{prefix} holds {what} made otherwise ({_difference(there, mine)}); "
                "valid: another place, or the same settings to go on"
            )
        return
    store.write(prefix + name, (json.dumps(mine, indent=1, sort_keys=True) + "\n").encode())


def _read_json(store: Store, name: str) -> dict[str, Any]:
    try:
        found = json.loads(store.read(name))
    except ValueError:  # also bytes that are no text
        found = None
    if not isinstance(found, dict):
        raise ConfigError(f"{store}/{name} is damaged; valid: the file as boxgrasp wrote it")
    return found


def _difference(there: Any, mine: Any, place: str = "") -> str:
    if isinstance(there, dict) and isinstance(mine, dict):
        for key in sorted({*there, *mine}):
            if there.get(key) != mine.get(key):
                return _difference(there.get(key), mine.get(key), f"{place}.{key}".strip("."))
    return f"{place} is {there} there, {mine} now"


def _column(pa: Any, field: Any, rows: Sequence[Row]) -> Any:
    values = [row.get(field.name) for row in rows]
    if pa.types.is_fixed_size_list(field.type):
        values = [None if value is None else np.asarray(value).tolist() for value in values]
    return pa.array(values, type=field.type)


def _array(pa: Any, column: Any) -> Array:
    column = column.combine_chunks()
    kind = column.type
    if pa.types.is_fixed_size_list(kind):
        width = kind.list_size
        empty = pa.scalar([_nothing(pa, kind.value_type)] * width, type=kind)
        flat = column.fill_null(empty) if column.null_count else column
        return np.asarray(flat.flatten()).reshape(-1, width)
    if pa.types.is_string(kind):
        return np.array(["" if v is None else v for v in column.to_pylist()], dtype=np.str_)
    filled = column.fill_null(_nothing(pa, kind)) if column.null_count else column
    return np.asarray(filled)


def _nothing(pa: Any, kind: Any) -> Any:
    if pa.types.is_boolean(kind):
        return False
    return float("nan") if pa.types.is_floating(kind) else 0


def _arrow() -> tuple[Any, Any]:
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError:
        raise MissingExtraError(
            "scenario sets need pyarrow; install with: pip install 'boxgrasp[train]'"
        ) from None
    return pa, pq
