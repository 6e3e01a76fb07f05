"""Labels as Parquet and CSV: exact both ways, taken in once, safe in a spreadsheet."""

from __future__ import annotations

import csv
import io
import json
import re
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("sqlalchemy", reason="the record needs the extra `label`")
pytest.importorskip("alembic", reason="the record needs the extra `label`")
pa = pytest.importorskip("pyarrow", reason="the record needs the extra `label`")

import pyarrow.parquet as pq  # noqa: E402
from label_records import SOURCE, after, captured, label, new_id, scene  # noqa: E402

from boxgrasp.cli import main  # noqa: E402
from boxgrasp.errors import BoxgraspError, ConfigError, LabelError, StoreError  # noqa: E402
from boxgrasp.labeling.record import Record, exchange  # noqa: E402
from boxgrasp.labeling.record.exchange import (  # noqa: E402
    COLUMNS,
    export_labels,
    import_labels,
)
from boxgrasp.labeling.record.labels import KeptLabel  # noqa: E402

SUFFIXES = ("parquet", "csv")


@pytest.fixture(scope="module")
def empty(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("empty") / "labels.db"
    Record.open(str(path)).close()
    return path


@contextmanager
def opened(empty: Path) -> Iterator[Record]:
    """A new record; its file is copied, which is quicker than making the tables."""
    with tempfile.TemporaryDirectory() as folder:
        shutil.copy(empty, f"{folder}/labels.db")
        with Record.open(f"{folder}/labels.db") as record:
            yield record


def fill(record: Record) -> None:
    """Corrections, an undo, two operators, two sources, both kinds of scenes."""
    record.add_scenes(SOURCE, [scene(0), captured(1), scene(2)])
    record.add_scenes("other", [captured(1, name="elsewhere.npz")])
    first = record.save(label(scene(0).key))
    better = record.save(label(scene(0).key, at=1, label=7, supersedes=first.id))
    record.withdraw(better.id, "ann", new_id(), after(2))
    record.save(label("capture-1", "=cmd|' /C calc'!A0", 3, note="-1", pixel=(4, 5)))
    pose = ((1.0, 0.0, 0.0, 1 / 3),) * 3 + ((0.0, 0.0, 0.0, 1.0),)
    record.save(
        label("capture-1", "Zoë", 4, verdict="none", label=None, seconds=None, T_base_gripper=pose)
    )
    record.save(label(scene(2).key, "bob", 5, overridden=({"check": "width", "value": 0.1},)))


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_file_carries_all_into_another_database_once(
    empty: Path, tmp_path: Path, suffix: str
) -> None:
    path = str(tmp_path / f"labels.{suffix}")
    with opened(empty) as record, opened(empty) as other:
        fill(record)
        assert export_labels(record, path) == 6
        assert import_labels(record, path) == (0, 6)
        assert import_labels(other, path) == (6, 0)
        assert import_labels(other, path) == (0, 6)
        assert other.kept() == record.kept()
        assert other.standing() == record.standing() and len(other.standing()) == 3
        assert [item.name for item in other.scenes("other")] == ["elsewhere.npz"]
        assert [item.name for item in other.scenes(SOURCE)] == ["0", "table 1.npz", "2"]
        again = str(tmp_path / f"again.{suffix}")
        export_labels(other, again)
        assert Path(again).read_bytes() == Path(path).read_bytes()


TEXT = st.text(
    st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=12
) | st.sampled_from(
    ["=1+1", "'=1", "''+", "'", "'a", "+", "-2", "@x", "\t=", "\r\n", "＝1", '"', ","]
)
NUMBER = st.floats(0, 1e300) | st.sampled_from([0.1 + 0.2, 5e-324, 1e22])
PLAIN = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**53), 2**53) | NUMBER | TEXT,
    lambda inner: st.lists(inner, max_size=2) | st.dictionaries(TEXT, inner, max_size=2),
    max_leaves=4,
)


@st.composite
def kept_labels(draw: st.DrawFn) -> KeptLabel:
    made = label(
        "capture-1",
        draw(TEXT.filter(lambda text: text.strip())),
        id=str(draw(st.uuids())),
        labeled_at=draw(st.datetimes(timezones=st.timezones())).astimezone(after(0).tzinfo)
        if draw(st.booleans())
        else after(draw(st.integers(0, 10**6)) / 1e6),
        seconds=draw(st.none() | NUMBER),
        gripper=draw(st.dictionaries(TEXT, PLAIN, max_size=3)),
        version=draw(TEXT),
        model=draw(TEXT),
        proposed=draw(st.none() | st.integers(1, 15)),
        note=draw(TEXT),
        pixel=draw(st.none() | st.tuples(st.integers(0, 9999), st.integers(0, 9999))),
        pose_distance_m=draw(st.none() | NUMBER),
    )
    named = captured(1, name=draw(TEXT), target=draw(st.none() | st.dictionaries(TEXT, PLAIN)))
    return KeptLabel(made, named, draw(st.dictionaries(TEXT, TEXT, max_size=2)))


@settings(max_examples=100, deadline=None)
@given(kept=kept_labels())
def test_any_row_is_read_as_it_was_written(kept: KeptLabel) -> None:
    row = exchange._row(kept)
    for data, rows in (
        (exchange._csv_bytes([row]), exchange._csv_rows),
        (exchange._parquet_bytes([row]), exchange._parquet_rows),
    ):
        (read,) = rows(data, "file")
        found = exchange._kept(read, "row")
        assert found == kept and repr(found) == repr(replace(kept))
    lines = list(csv.reader(io.StringIO(exchange._csv_bytes([row]).decode(), newline="")))
    assert [len(line) for line in lines] == [len(COLUMNS)] * 2
    assert not [cell for cell in lines[1] if re.match(r"[=+\-@\t\r\n＝＋－＠]", cell)]


@settings(max_examples=12, deadline=None)
@given(kept=kept_labels(), suffix=st.sampled_from(SUFFIXES))
def test_any_label_comes_back_exactly(empty: Path, kept: KeptLabel, suffix: str) -> None:
    with opened(empty) as record, opened(empty) as other:
        path = str(Path(record.name).with_name(f"labels.{suffix}"))
        record.take_in([kept])
        assert record.kept() == [kept]
        export_labels(record, path)
        assert import_labels(other, path) == (1, 0)
        assert repr(other.kept()) == repr(record.kept())


def test_columns_are_of_types_that_other_programs_read(empty: Path, tmp_path: Path) -> None:
    path = str(tmp_path / "labels.parquet")
    with opened(empty) as record:
        fill(record)
        export_labels(record, path)
        kept = record.kept()
    table = pq.read_table(path)
    assert table["labeled_at"].to_pylist() == [item.label.labeled_at for item in kept]
    assert table["label"].type == pa.int64() and table["seconds"].type == pa.float64()
    assert json.loads(table["gripper"][0].as_py()) == kept[0].label.gripper


# What is refused.


def broken(change: Callable[[dict[str, Any]], object]) -> Callable[[Path], None]:
    """Change the second row of a CSV."""

    def rewrite(path: Path) -> None:
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        change(rows[1])
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, list(rows[0]))
            writer.writeheader()
            writer.writerows(rows)

    return rewrite


def edited(old: str, new: str) -> Callable[[Path], None]:
    return lambda path: (
        path.write_text(path.read_text("utf-8").replace(old, new, 1), "utf-8") and None
    )


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda path: path.write_bytes(b""), "is empty"),
        (lambda path: path.write_bytes(b"\xff\xfe\x00"), "is no UTF-8 text"),
        (lambda path: path.write_bytes(path.read_bytes()[:-30]), "unexpected end of data"),
        (lambda path: path.write_bytes(path.read_bytes().rpartition(b',"{')[0]), "row 6: "),
        (edited('"note",', '"remark",'), "lacks column 'note'"),
        (edited('"note",', '"note","note",'), "has twice column 'note'"),
        (edited('"note",', '"note","more",'), "has an unknown column 'more'"),
        (broken(lambda row: row.update(label="five")), "row 2: label is 'five'; valid: a whole"),
        (broken(lambda row: row.update(label="99")), "label is 99; valid: 1 to 15"),
        (broken(lambda row: row.update(seconds="nan")), "seconds is 'nan'; valid: a finite"),
        (broken(lambda row: row.update(labeled_at="monday")), "labeled_at is 'monday'"),
        (broken(lambda row: row.update(labeled_at="2026-03-01T08:00:00")), "time with its zone"),
        (broken(lambda row: row.update(lines="")), "lines is empty"),
        (broken(lambda row: row.update(gripper="{")), "gripper is no JSON"),
        (broken(lambda row: row.update(gripper="[" * 90_000)), "gripper is no JSON"),
        (broken(lambda row: row.update(pixel="3")), "row 2: "),
        (broken(lambda row: row.update(sources="[]")), "sources is no object"),
        (broken(lambda row: row.update(id="x")), "row 2: the id is 'x'"),
        (broken(lambda row: row.update(scene_kind="x")), "row 2: scene scene-0000: kind is 'x'"),
        (broken(lambda row: row.update(supersedes=new_id())), "valid: one that was saved"),
        (broken(lambda row: row.update(supersedes=row["id"])), "supersedes itself"),
        (broken(lambda row: row.update(operator="cem")), "same operator and scene"),
    ],
)
def test_a_bad_csv_is_refused_whole(
    empty: Path, tmp_path: Path, spoil: Callable[[Path], None], said: str
) -> None:
    path = tmp_path / "labels.csv"
    with opened(empty) as record, opened(empty) as other:
        fill(record)
        export_labels(record, str(path))
        spoil(path)
        with pytest.raises(LabelError) as error:
            import_labels(other, str(path))
        text = str(error.value)
        assert said in text and text.startswith(str(path)) and "\n" not in text, text
        assert other.kept() == [] and other.scenes() == []


def test_a_bad_parquet_is_refused(empty: Path, tmp_path: Path) -> None:
    path = tmp_path / "labels.parquet"
    with opened(empty) as record, opened(empty) as other:
        fill(record)
        export_labels(record, str(path))
        whole, table = path.read_bytes(), pq.read_table(path)
        path.write_bytes(whole[:-40])
        with pytest.raises(LabelError, match="is no Parquet file"):
            import_labels(other, str(path))
        pq.write_table(table.drop_columns(["note"]), path)
        with pytest.raises(LabelError, match="lacks column 'note'"):
            import_labels(other, str(path))
        index = table.column_names.index("label")
        pq.write_table(table.set_column(index, "label", pa.array(["a"] * 6)), path)
        with pytest.raises(LabelError, match="label is of string; valid: a whole number"):
            import_labels(other, str(path))
        assert other.kept() == []


def test_places_that_are_none_are_refused(empty: Path, tmp_path: Path) -> None:
    with opened(empty) as record:
        for call in (export_labels, import_labels):
            with pytest.raises(ConfigError, match=r"valid: FILE.parquet or FILE.csv"):
                call(record, str(tmp_path / "labels.xlsx"))
        with pytest.raises(StoreError, match="No such file"):
            import_labels(record, str(tmp_path / "nowhere.csv"))
        (tmp_path / "file").touch()
        with pytest.raises(StoreError):
            export_labels(record, str(tmp_path / "file" / "labels.csv"))


def test_labels_that_contradict_are_refused(empty: Path, tmp_path: Path) -> None:
    """The same id with another answer; another correction of the same label."""
    with opened(empty) as record:
        record.add_scenes(SOURCE, [scene(0)])
        first = record.save(label(scene(0).key))
        record.save(label(scene(0).key, at=1, supersedes=first.id))
        other = label(scene(0).key, at=2, label=5, supersedes=first.id)
        for wrong, said in (
            ([replace(first, seconds=9.0)], "kept already and differs"),
            ([other], "superseded already"),
            ([label(scene(0).key), replace(other, supersedes=other.id)], "supersedes itself"),
        ):
            before = record.kept()
            with pytest.raises(LabelError, match=said):
                record.take_in([KeptLabel(item, scene(0), {}) for item in wrong])
            assert record.kept() == before
        with pytest.raises(LabelError, match="known with another number"):
            changed = replace(scene(0), number=9)
            record.take_in([KeptLabel(label(scene(0).key), changed, {})])


# The command.


def test_the_command_counts_and_carries(
    empty: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with opened(empty) as record:
        fill(record)
        words = ["labels", record.name]
        path, other = str(tmp_path / "labels.csv"), str(tmp_path / "other.db")
        assert main([*words, "--export", path]) == 0
        said = capsys.readouterr().out
        assert f"{path}: 6 rows\n3 labels of 2 scenes\n" in said
        assert re.search(r"^Zoë +1 +0 +1 +0$", said, re.M)
        assert re.search(r"^=cmd.* Zoë +1 +0.0% +0.000$", said, re.M)
        for new, known in ((6, 0), (0, 6)):
            assert main(["labels", other, "--import", path, "--json"]) == 0
            told = json.loads(capsys.readouterr().out)
            assert (told["imported"], told["known"], told["labels"]) == (new, known, 3)
        assert told["operators"][1] == {
            "operator": "Zoë", "labels": 1, "candidate": 0, "none": 1, "box_wrong": 0,
        }  # fmt: skip
        assert [item["scenes"] for item in told["agreements"]] == [1]


def test_a_name_moves_no_terminal(empty: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with opened(empty) as record:
        record.add_scenes(SOURCE, [scene(0)])
        record.save(label(scene(0).key, "ann\x1b[2J"))
        assert main(["labels", record.name]) == 0
        assert "ann?[2J" in capsys.readouterr().out


@pytest.mark.parametrize("name", ["gone.db", "empty.db", "text.db", ""])
def test_the_command_refuses_in_one_line_and_makes_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    (tmp_path / "empty.db").touch()
    (tmp_path / "text.db").write_text("text " * 999)
    assert main(["labels", str(tmp_path / name)]) == 2
    said = capsys.readouterr().err
    assert said.startswith("boxgrasp: ") and said.count("\n") == 1 and "; valid: " in said
    assert (tmp_path / "empty.db").stat().st_size == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["empty.db", "text.db"]


def test_errors_of_the_record_are_the_package_s() -> None:
    assert issubclass(LabelError, BoxgraspError)
