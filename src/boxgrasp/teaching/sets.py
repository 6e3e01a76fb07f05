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
from typing import Any, Protocol

import numpy as np

from boxgrasp.arrays import Array
from boxgrasp.errors import ConfigError, MissingExtraError
from boxgrasp.execution import Store, Workers, finish
from boxgrasp.forks import cached_property
from boxgrasp.io.npz import save_npz
from boxgrasp.ranking.model_set import SAMPLINGS
from boxgrasp.simulate.objects import load_objects
from boxgrasp.strict import build, plain
from boxgrasp.teaching.rows import (
    CHECK_FLAGS,
    CHECK_VALUES,
    TRUTHS,
    Row,
    RowConfig,
    row_of,
    scenario_of_row,
)
from boxgrasp.teaching.samples import sample_points
from boxgrasp.version import __version__

PART_ROWS = 40
MOST_ROWS = 100_000 * PART_ROWS  # of a set: its parts' names have five digits


class RowShape(Protocol):
    """What the columns of rows depend on; a `RowConfig` tells it."""

    @property
    def lines(self) -> int:
        """l, lines a face."""

    @property
    def target_sources(self) -> tuple[str, ...]:
        """Where the target's points come from, `given`, `found` or both."""


@dataclass(frozen=True)
class SetConfig:
    """What a set is made of.

    Attributes:
        rows: how its rows are made.
        count: how many.
        version: of the package that makes them.
        objects_sha256: of the object set as it is read now, so that a set is never made of two.

    Raises:
        ConfigError: no rows, or more than a set can have.
    """

    rows: RowConfig
    count: int
    version: str = __version__
    objects_sha256: str = ""

    def __post_init__(self) -> None:
        if not self.objects_sha256:
            said = repr(dict(load_objects(self.rows.recipe.objects))).encode()
            object.__setattr__(self, "objects_sha256", hashlib.sha256(said).hexdigest())
        if not 1 <= self.count <= MOST_ROWS:
            raise ConfigError(f"count is {self.count}; valid: 1 to {MOST_ROWS}")


@dataclass(frozen=True, eq=False)
class Rows(Mapping[str, Array]):
    """Rows of a set, column by column; what has no answer is NaN, False, 0 or an empty text.

    Attributes:
        columns: (N, ...) arrays by name.
    """

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
        """Some of the rows.

        Args:
            which: (N,) bool, or indices.

        Returns:
            Those.
        """
        return Rows({name: column[which] for name, column in self.columns.items()})

    @cached_property
    def answered(self) -> Rows:
        """Those whose target's points gave an answer: without one nothing can be labeled."""
        return self.take(self["given_error"] == "")


def make_set(
    store: Store,
    prefix: str,
    config: SetConfig,
    workers: Workers,
    title: str,
    *,
    may_grow: bool = True,
) -> None:
    """Write what the set still lacks; finished parts are not made again.

    A set that is there with fewer rows grows, to the very bytes of one made at once.

    Args:
        store: where to.
        prefix: of the names there.
        config: what the set is made of.
        workers: who makes it.
        title: what progress is shown under; nothing is shown where it is empty.
        may_grow: whether a set that is there with fewer rows is made larger.

    Raises:
        ConfigError: the place holds a set that was made otherwise, or a larger one.
        SceneError: a scenario that cannot be drawn.
        StoreError: the place cannot be read or written.
        WorkError: workers were lost.
        MissingExtraError: pyarrow is not installed.
    """
    tasks = {
        f"{prefix}part-{first // PART_ROWS:05d}.parquet": (
            config.rows, range(first, min(first + PART_ROWS, config.count)),
        )
        for first in range(0, config.count, PART_ROWS)
    }  # fmt: skip
    if may_grow:
        _renew_last_part(store, prefix, config, tasks, workers)
    claim(store, prefix, "set.json", config, "a set", grows="count" if may_grow else "")
    finish(store, tasks, part, workers, title)


def _renew_last_part(
    store: Store,
    prefix: str,
    config: SetConfig,
    tasks: Mapping[str, tuple[RowConfig, Sequence[int]]],
    workers: Workers,
) -> None:
    """Make the last part anew that is there with another number of rows than it shall have.

    It is done before set.json tells the new count, so that a kill in between leaves a set that is
    seen to be unfinished.

    Raises:
        ConfigError: as `make_set`.
    """
    if not store.exists(f"{prefix}set.json"):
        return
    there = claimed(store, prefix, "set.json", config, "a set", grows="count")["count"]
    name = f"{prefix}part-{(there - 1) // PART_ROWS:05d}.parquet"
    if (there == config.count and there % PART_ROWS == 0) or not store.exists(name):
        return
    _, numbers = tasks[name]
    if from_parquet(store.read(name)).count != len(numbers):
        for _, made in workers.run(part, [tasks[name]]):
            store.write(name, made)


def keep_captures(
    store: Store, prefix: str, config: SetConfig, workers: Workers, title: str
) -> None:
    """Write every row's capture that is not there yet, as `capture-000000.npz`.

    Args:
        store: as `make_set`.
        prefix: as `make_set`.
        config: as `make_set`.
        workers: as `make_set`.
        title: as `make_set`.

    Raises:
        StoreError: the place cannot be read or written.
        WorkError: workers were lost.
    """
    tasks = {f"{prefix}capture-{k:06d}.npz": (config.rows, k) for k in range(config.count)}
    finish(store, tasks, capture_bytes, workers, title)


def capture_bytes(task: tuple[RowConfig, int]) -> bytes:
    """A row's capture; a task of its own.

    Args:
        task: how rows are made, and the row's number.

    Returns:
        A .npz that `load_capture` reads; `object_ids` (H, W) int16 in it is the true object of
        each pixel.
    """
    config, number = task
    scenario, run = scenario_of_row(config, number // config.runs), number % config.runs
    capture, object_ids = scenario.capture(config.recipe.noise, run * config.frames)
    out = io.BytesIO()
    save_npz(capture, out, object_ids=object_ids.astype(np.int16))
    return out.getvalue()


def part(task: tuple[RowConfig, Sequence[int]]) -> bytes:
    """One part of a set; a task of its own.

    Args:
        task: how rows are made, and the rows' numbers.

    Returns:
        Parquet.
    """
    config, numbers = task
    return to_parquet([row_of(config, number) for number in numbers], config)


def read_set(store: Store, prefix: str = "") -> tuple[SetConfig, Rows]:
    """A finished set.

    Args:
        store: where it is.
        prefix: of its names there.

    Returns:
        What it is made of, and its rows.

    Raises:
        ConfigError: there is none, or parts or rows of it are missing.
        StoreError: the place cannot be read.
        MissingExtraError: pyarrow is not installed.
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
            f"{store}/{prefix} holds {rows.count} rows; valid: {config.count} as in its set.json "
            "(run `boxgrasp simulate` again)"
        )
    return config, rows


def joined(parts: Sequence[Rows]) -> Rows:
    """Rows one after the other.

    Args:
        parts: each with the columns of the first.

    Returns:
        All of them.
    """
    return Rows({name: np.concatenate([p[name] for p in parts]) for name in parts[0]})


def to_parquet(rows: Sequence[Row], config: RowShape) -> bytes:
    """Rows as one Parquet file.

    Args:
        rows: values by column; what is not there is null.
        config: how they were made.

    Returns:
        The file, columns and types by `schema`.

    Raises:
        MissingExtraError: pyarrow is not installed.
    """
    pa, pq = _arrow()
    table = pa.table(
        {field.name: _column(pa, field, rows) for field in schema(config)}, schema=schema(config)
    )
    out = io.BytesIO()
    pq.write_table(table, out, compression="zstd")
    return out.getvalue()


def from_parquet(data: bytes) -> Rows:
    """The rows of one Parquet file.

    Args:
        data: the file.

    Returns:
        The rows; null is NaN, False, 0 or an empty text.

    Raises:
        ConfigError: it is none.
        MissingExtraError: pyarrow is not installed.
    """
    pa, pq = _arrow()
    try:
        # Arrow's threads would still hold the bytes when Python ends, and abort it now and then.
        table = pq.ParquetFile(pa.BufferReader(data), pre_buffer=False).read(use_threads=False)
    except (pa.ArrowInvalid, OSError) as error:
        raise ConfigError(f"not a part of a set: {error}") from None
    return Rows({name: _array(pa, table.column(name)) for name in table.column_names})


def schema(config: RowShape) -> Any:
    """The columns of a set's rows.

    Args:
        config: how they are made.

    Returns:
        An Arrow schema.

    Raises:
        MissingExtraError: pyarrow is not installed.
    """
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
    for source in config.target_sources:
        fields += [
            (f"{source}_error", pa.string()),
            (f"{source}_box", pa.list_(pa.float64(), 4)),
            (f"{source}_dimensions_m", pa.list_(pa.float64(), 3)),
            (f"{source}_passes", flags),
            (f"{source}_thesis_clearance_m", meters),
            *((f"{source}_{name}", meters) for name in CHECK_VALUES),
            *((f"{source}_{name}", flags) for name in CHECK_FLAGS),
            *((f"{source}_true_{name}", flags if name == "fits" else meters) for name in TRUTHS),
        ]
        for name in SAMPLINGS:
            whole, portions = sample_points(name)
            fields.append((f"{source}_{name}", pa.list_(pa.uint8(), len(whole))))
            fields.append((f"{source}_{name}_portions", pa.list_(pa.uint8(), len(portions))))
    return pa.schema(fields)


def claim(
    store: Store, prefix: str, name: str, settings: Any, what: str, *, grows: str = ""
) -> None:
    """Keep the settings beside what is made with them, so that nothing is mixed in later.

    Args:
        store: where to.
        prefix: of the names there.
        name: of the settings' file.
        settings: a dataclass, or plain values.
        what: what is made with them, in words.
        grows: name of a setting that may be larger now than it is there.

    Raises:
        ConfigError: the place holds other settings.
        StoreError: the place cannot be read or written.
    """
    mine = json.loads(json.dumps(plain(settings)))
    if store.exists(prefix + name) and mine == claimed(
        store, prefix, name, settings, what, grows=grows
    ):
        return
    store.write(prefix + name, (json.dumps(mine, indent=1, sort_keys=True) + "\n").encode())


def claimed(
    store: Store, prefix: str, name: str, settings: Any, what: str, *, grows: str = ""
) -> dict[str, Any]:
    """The settings that are kept at a place, refused where they are other than these.

    Args:
        store: as `claim`.
        prefix: as `claim`.
        name: as `claim`.
        settings: as `claim`.
        what: as `claim`.
        grows: as `claim`.

    Returns:
        Plain values.

    Raises:
        ConfigError: they are other ones, or damaged.
        StoreError: the place cannot be read.
    """
    mine = json.loads(json.dumps(plain(settings)))
    there = _read_json(store, prefix + name)
    found = there.get(grows)
    can_grow = type(found) is int and found > 0
    others = {**there, grows: mine[grows]} if can_grow else there
    if others != mine:
        raise ConfigError(
            f"{store}/{prefix} holds {what} made otherwise ({_difference(others, mine)}); "
            "valid: another place, or the same settings to go on"
        )
    if can_grow and found > mine[grows]:
        raise ConfigError(
            f"{store}/{prefix} holds {what} of {found}, {mine[grows]} are asked for; valid: "
            f"{found} or more, or another place"
        )
    return there


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
        # A null for each value, since pyarrow before 26 cannot read a null for the whole list.
        empty = [None] * field.type.list_size
        values = [empty if value is None else np.asarray(value).tolist() for value in values]
    return pa.array(values, type=field.type)


def _array(pa: Any, column: Any) -> Array:
    column = column.combine_chunks()
    kind = column.type
    if pa.types.is_fixed_size_list(kind):
        width, nothing = kind.list_size, _nothing(pa, kind.value_type)
        whole = (
            column.fill_null(pa.scalar([nothing] * width, kind)) if column.null_count else column
        )
        flat = whole.flatten()
        return np.asarray(flat.fill_null(nothing) if flat.null_count else flat).reshape(-1, width)
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
