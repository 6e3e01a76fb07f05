"""The record of labels: nothing lost, nothing doubled, nobody in another's way."""

from __future__ import annotations

import os
import random
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

sa = pytest.importorskip("sqlalchemy", reason="the record needs the extra `label`")
pytest.importorskip("alembic", reason="the record needs the extra `label`")

from alembic.autogenerate import compare_metadata  # noqa: E402
from alembic.runtime.migration import MigrationContext  # noqa: E402
from label_records import SOURCE, after, captured, label, new_id, scene  # noqa: E402
from postgres_server import PostgresServer, running_postgres  # noqa: E402

from boxgrasp.errors import BoxgraspError, ConfigError, LabelError, StoreError  # noqa: E402
from boxgrasp.labeling.record import Record, connection, turns  # noqa: E402
from boxgrasp.labeling.record.agreement import cohens_kappa  # noqa: E402
from boxgrasp.labeling.record.tables import METADATA, draw_of  # noqa: E402
from boxgrasp.labeling.words import Ask, OperatorLabel, Turn, TurnRules  # noqa: E402

WORKER = [sys.executable, str(Path(__file__).with_name("label_records.py"))]
ONCE = TurnRules()


@pytest.fixture(scope="module")
def server() -> Iterator[PostgresServer]:
    with running_postgres() as running:
        yield running


@pytest.fixture(params=["sqlite", "postgresql"])
def url(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """Of a database that is not there yet, or empty."""
    if request.param == "sqlite":
        return str(tmp_path / "labels.db")
    started: PostgresServer = request.getfixturevalue("server")
    return started.emptied_database()


@pytest.fixture
def record(url: str) -> Iterator[Record]:
    with Record.open(url) as opened:
        yield opened


@pytest.fixture
def kept(tmp_path: Path) -> Iterator[Record]:
    """On SQLite, where both databases take the same way."""
    with Record.open(str(tmp_path / "kept.db")) as opened:
        yield opened


def one_line(error: pytest.ExceptionInfo[BoxgraspError]) -> str:
    text = str(error.value)
    assert "\n" not in text and "; valid: " in text, text
    return text


def turn_of(record: Record, operator: str, at: float = 0.0, **asked: Any) -> Turn | None:
    rules = asked.pop("rules", ONCE)
    return record.next_turn(SOURCE, operator, rules, after(at), **asked)


def key_of(record: Record, operator: str, at: float = 0.0, **asked: Any) -> str | None:
    turn = turn_of(record, operator, at, **asked)
    return None if turn is None else turn.scene.key


# The schema.


def test_the_migrations_make_the_tables(record: Record) -> None:
    with record._database.reads() as opened:
        options = {"version_table": connection._VERSION_TABLE, "compare_type": True}
        context = MigrationContext.configure(opened, opts=options)
        assert compare_metadata(context, METADATA) == []


def test_sqlite_is_set_to_lose_nothing(kept: Record) -> None:
    found = {}
    with kept._database.reads() as opened:
        for name in ("journal_mode", "synchronous", "foreign_keys"):
            found[name] = opened.exec_driver_sql(f"PRAGMA {name}").scalar_one()
    assert found == {"journal_mode": "wal", "synchronous": 2, "foreign_keys": 1}


def test_several_open_a_new_database_at_once(url: str) -> None:
    code = "import sys; from boxgrasp.labeling.record import Record; print('ready', flush=True); "
    code += "sys.stdin.readline(); Record.open(sys.argv[1])"
    started = [
        subprocess.Popen(
            [sys.executable, "-c", code, url],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )
        for _ in range(2)
    ]  # fmt: skip
    assert [said_by(process) for process in started] == ["ready"] * 2
    for process in started:
        go(process, 1)
    for process in started:
        assert process.communicate()[1] == ""
        assert process.returncode == 0


def test_a_new_database_that_another_one_makes_is_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """SQLite waits for a writer, but not when it is to begin a write-ahead log."""
    path = str(tmp_path / "labels.db")
    holder = sqlite3.connect(path, isolation_level=None, check_same_thread=False)
    holder.execute("BEGIN IMMEDIATE")
    with monkeypatch.context() as changed:
        changed.setattr(connection, "BUSY_S", 0.05)
        with pytest.raises(StoreError, match="locked; valid:"):
            Record.open(path)
    release = threading.Timer(0.2, holder.execute, ["ROLLBACK"])
    release.start()
    Record.open(path).close()
    release.join()
    holder.close()


def test_threads_open_a_new_database_at_once(url: str) -> None:
    with ThreadPoolExecutor(4) as pool:
        for opened in pool.map(Record.open, [url] * 4):
            assert opened.scenes() == []
            opened.close()


def test_a_newer_schema_is_refused_with_both_revisions(url: str) -> None:
    with Record.open(url) as opened, opened._database.writes() as writer:
        writer.execute(sa.text("UPDATE boxgrasp_labels_version SET version_num = '0999'"))
    with pytest.raises(StoreError) as error:
        Record.open(url)
    assert "its schema is 0999, which a newer boxgrasp made; valid: 0001" in one_line(error)


def test_a_database_of_something_else_is_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "places.db"
    with sqlite3.connect(path) as other:
        other.execute("CREATE TABLE places (id INTEGER)")
    before = path.read_bytes()
    with pytest.raises(StoreError, match="holds places and no labels"):
        Record.open(str(path))
    with sqlite3.connect(path) as other:
        assert [name for (name,) in other.execute("SELECT name FROM sqlite_master")] == ["places"]
    assert before[100:] == path.read_bytes()[100:]


def test_files_that_are_no_database_are_refused(tmp_path: Path) -> None:
    (tmp_path / "text.db").write_text("no database at all, but long enough to be looked at" * 40)
    with Record.open(str(tmp_path / "torn.db")):
        pass
    whole = (tmp_path / "torn.db").read_bytes()
    (tmp_path / "torn.db").write_bytes(whole[:3000] + b"\x99" * 6000)
    for name, said in {
        "text.db": "not a database",
        "torn.db": "malformed",
        "": "is a folder",
        "nowhere/labels.db": "is no folder",
    }.items():
        with pytest.raises(StoreError) as error:
            Record.open(str(tmp_path / name))
        assert said in one_line(error)


def test_a_mistyped_path_makes_no_database_for_who_only_reads(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="no such file"):
        Record.open(str(tmp_path / "labls.db"), create=False)
    assert not (tmp_path / "labls.db").exists()


@pytest.mark.skipif(os.name == "nt" or os.geteuid() == 0, reason="root may read every file")
def test_a_file_without_permission_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "labels.db"
    Record.open(str(path)).close()
    path.chmod(0)
    with pytest.raises(StoreError, match="unable to open"):
        Record.open(str(path))


@pytest.mark.parametrize(
    ("url", "said"),
    [
        ("", "no database given"),
        ("mysql://root:secret@host/labels", "no databases of 'mysql' are known"),
        ("sqlite://", "names no file"),
        ("sqlite:///x.db?mode=secret", "has options after `?`"),
        ("postgresql://ann:secret@host:port/labels", "cannot be read"),
        ("postgresql://ann@host/labels?password=secret", "has options after `?`"),
    ],
)
def test_urls_that_are_none_are_refused(url: str, said: str) -> None:
    with pytest.raises(ConfigError) as error:
        Record.open(url)
    assert said in one_line(error) and "secret" not in str(error.value)


def test_a_server_that_does_not_answer_is_told_without_the_password() -> None:
    with pytest.raises(StoreError) as error:
        Record.open("postgresql://ann:s3cr3t@127.0.0.1:9/labels")
    assert one_line(error).startswith("postgresql+pg8000://ann:***@127.0.0.1:9/labels: ")
    assert "s3cr3t" not in str(error.value)


def test_a_password_is_taken_from_the_environment(
    server: PostgresServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    url = server.locked_database("s3cr3t")
    monkeypatch.setenv("PGPASSWORD", "wr0ng")
    with pytest.raises(StoreError, match="password authentication failed") as error:
        Record.open(url)
    assert "wr0ng" not in one_line(error)
    monkeypatch.setenv("PGPASSWORD", "s3cr3t")
    with Record.open(url) as record:
        assert "s3cr3t" not in record.name


def test_a_database_that_is_not_there_is_told(server: PostgresServer) -> None:
    url = server.new_database()
    with pytest.raises(StoreError, match='database "labels1nowhere" does not exist'):
        Record.open(url.rsplit("/", 1)[0] + "/labels1nowhere")


def test_a_locked_database_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connection, "BUSY_S", 0.05)
    path = tmp_path / "labels.db"
    with Record.open(str(path)) as record:
        record.add_scenes(SOURCE, [scene(0)])
        holder = sqlite3.connect(path, isolation_level=None)
        holder.execute("BEGIN IMMEDIATE")
        with pytest.raises(StoreError, match=r"locked; valid: .* no other program"):
            record.save(label(scene(0).key))
        holder.execute("ROLLBACK")
        record.save(label(scene(0).key))
        holder.close()


@contextmanager
def small_disk(folder: Path, kilobytes: int) -> Iterator[Path]:
    folder.mkdir()
    words = ["mount", "-t", "tmpfs", "-o", f"size={kilobytes}k", "tmpfs", str(folder)]
    if not sys.platform.startswith("linux") or subprocess.run(words).returncode:
        pytest.skip("no small disk can be mounted here (root on Linux can)")
    try:
        yield folder
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)


def test_a_full_disk_is_told_and_loses_nothing(tmp_path: Path) -> None:
    with small_disk(tmp_path / "small", 1024) as folder:
        kept = []
        with Record.open(str(folder / "labels.db")) as record:
            record.add_scenes(SOURCE, [scene(0)])
            with pytest.raises(StoreError) as error:
                for k in range(1000):
                    kept.append(record.save(label(scene(0).key, at=k, note="n" * 9000)).id)
            assert "disk is full; valid: free space" in one_line(error)
            assert len(kept) > 5
        with Record.open(str(folder / "labels.db")) as record:
            assert [item.id for item in record.standing()] == kept


# Scenes.


def test_scenes_come_back_as_given_in_their_order(record: Record) -> None:
    first = [captured(2), scene(5), scene(1), captured(1, target={"mask": True})]
    record.add_scenes(SOURCE, first)
    record.add_scenes(SOURCE, first)
    assert record.scenes(SOURCE) == first
    record.add_scenes(SOURCE, [scene(0), scene(5), scene(9)])
    assert record.scenes(SOURCE) == [*first, scene(0), scene(9)]
    assert record.scene("capture-2") == captured(2)
    assert {item.key for item in record.scenes()} == {item.key for item in record.scenes(SOURCE)}


def test_sources_share_a_scene_under_names_of_their_own(record: Record) -> None:
    record.add_scenes("here", [captured(1, name="a.npz")])
    record.add_scenes("there", [captured(1, name="b/c.npz")])
    record.save(label("capture-1"))
    assert [item.name for item in record.scenes("there")] == ["b/c.npz"]
    assert len(record.standing("here")) == len(record.standing("there")) == 1
    assert record.standing("nowhere") == []


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"key": "a/b"}, "key is 'a/b'"),
        ({"key": "k" * 121}, "valid: 1 to 120 letters"),
        ({"kind": "photo"}, "kind is 'photo'; valid: capture, scenario"),
        ({"lines": 0}, "lines is 0"),
        ({"capture_sha256": None}, "capture_sha256 None"),
        ({"target": {"pixel": [float("nan")]}}, "target is not plain"),
        ({"name": "a\0b"}, "name holds a NUL"),
        ({"name": "\ud800"}, "name holds half a character"),
    ],
)
def test_what_is_no_scene_is_refused(kept: Record, changes: dict[str, Any], said: str) -> None:
    with pytest.raises(LabelError) as error:
        kept.add_scenes(SOURCE, [captured(1, **changes)])
    assert said in one_line(error) and kept.scenes() == []


def test_another_scene_of_a_known_key_is_refused(record: Record) -> None:
    record.add_scenes(SOURCE, [captured(1)])
    for source in (SOURCE, "other"):
        with pytest.raises(LabelError, match="known with another target"):
            record.add_scenes(source, [captured(1, target={"pixel": [0, 0]})])
    with pytest.raises(LabelError, match="no scene nothing is known"):
        record.scene("nothing")


# Labels.


def full_label() -> OperatorLabel:
    pose = (
        (1.0, 0.0, 0.0, 0.1),
        (0.0, 1.0, 0.0, 1 / 3),
        (0.0, 0.0, 1.0, 1e-17),
        (0.0,) * 3 + (1.0,),
    )
    return label(
        "capture-1",
        operator="Zoë <b>",
        seconds=0.1 + 0.2,
        model="cascade-grid 3",
        proposed=15,
        overridden=({"check": "width", "value": 0.11, "limit": 0.1, "unit": "m"},),
        note="=1+1\r\n'quoted' \"and\" 🤖, \\ {}",
        pixel=(12, 40),
        origin="pose",
        T_base_gripper=pose,
        pose_distance_m=0.012345678901234567,
        pose_angle_rad=0.5,
    )


def test_a_label_comes_back_as_it_was(record: Record) -> None:
    record.add_scenes(SOURCE, [captured(1)])
    given = full_label()
    assert record.save(given) == given
    assert record.standing() == [given] == record.history("capture-1")
    assert isinstance(record.standing()[0].T_base_gripper, tuple)


def test_a_second_try_of_a_save_keeps_the_first(record: Record) -> None:
    record.add_scenes(SOURCE, [scene(0)])
    first = record.save(label(scene(0).key))
    again = replace(first, labeled_at=after(9), seconds=11.0, version="0.2.0")
    assert record.save(again) == first
    assert record.standing() == [first]
    for changes in ({"label": 5}, {"operator": "bob"}, {"note": "x"}):
        with pytest.raises(LabelError) as error:
            record.save(replace(first, **changes))
        assert "kept already and says something else" in one_line(error)
    assert record.standing() == [first]


def test_one_label_saved_by_many_at_once_is_kept_once(record: Record) -> None:
    record.add_scenes(SOURCE, [scene(0)])
    given = label(scene(0).key)
    with ThreadPoolExecutor(8) as pool:
        assert set(item.id for item in pool.map(record.save, [given] * 16)) == {given.id}
    assert record.standing() == [given]


def test_of_corrections_at_once_one_is_kept(record: Record) -> None:
    record.add_scenes(SOURCE, [scene(0)])
    first = record.save(label(scene(0).key))

    def correct(k: int) -> bool:
        try:
            record.save(label(scene(0).key, at=1 + k, label=1 + k, supersedes=first.id))
        except LabelError as error:
            assert "superseded already" in str(error)
            return False
        return True

    with ThreadPoolExecutor(8) as pool:
        assert sum(pool.map(correct, range(8))) == 1
    assert len(record.standing()) == 1 and len(record.history(scene(0).key)) == 2


def test_a_correction_supersedes_and_an_undo_withdraws(record: Record) -> None:
    record.add_scenes(SOURCE, [scene(0), scene(1)])
    first = record.save(label(scene(0).key))
    better = record.save(label(scene(0).key, at=1, label=6, supersedes=first.id))
    assert record.standing() == [better]
    gone = record.withdraw(better.id, "ann", new_id(), after(2))
    assert (gone.verdict, gone.label, gone.supersedes) == ("withdrawn", None, better.id)
    assert record.withdraw(better.id, "ann", gone.id, after(3)) == gone
    assert record.standing() == [] and record.history(scene(0).key) == [first, better, gone]
    anew = record.save(label(scene(0).key, at=4, supersedes=gone.id))
    assert record.standing() == [anew]


def test_corrections_that_cannot_be_are_refused(record: Record) -> None:
    record.add_scenes(SOURCE, [scene(0), scene(1)])
    first = record.save(label(scene(0).key))
    for wrong, said in (
        (label(scene(0).key, supersedes=new_id()), "valid: one that was saved"),
        (label(scene(1).key, supersedes=first.id), "same operator and scene"),
        (label(scene(0).key, "bob", supersedes=first.id), "same operator and scene"),
        (label("elsewhere"), "no scene elsewhere is known"),
    ):
        with pytest.raises(LabelError) as error:
            record.save(wrong)
        assert said in one_line(error)
    with pytest.raises(LabelError, match="of bob is known"):
        record.withdraw(first.id, "bob", new_id(), after(1))
    assert record.standing() == [first] == record.history(scene(0).key)


@pytest.mark.parametrize("words", ["UPDATE labels SET label = 1", "DELETE FROM labels"])
def test_the_database_itself_keeps_every_label(record: Record, words: str) -> None:
    record.add_scenes(SOURCE, [scene(0)])
    first = record.save(label(scene(0).key))
    with pytest.raises((StoreError, sa.exc.IntegrityError), match="only ever added"):
        with record._database.writes() as writer:
            writer.execute(sa.text(words))
    assert record.standing() == [first]


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"id": "1"}, "the id is '1'; valid: a UUID"),
        ({"operator": " "}, "operator is ' '"),
        ({"operator": "o" * 201}, "valid: 1 to 200 characters"),
        ({"verdict": "maybe"}, "valid: candidate, none, box_wrong, withdrawn"),
        ({"verdict": "none"}, "`none` has a candidate"),
        ({"label": None}, "label is None; valid: 1 to 15"),
        ({"label": 16}, "label is 16; valid: 1 to 15"),
        ({"label": 0}, "label is 0; valid: 1 to 15"),
        ({"label": True}, "label is True"),
        ({"proposed": -1}, "proposed is -1"),
        ({"verdict": "withdrawn", "label": None}, "withdraws nothing"),
        ({"labeled_at": after(0).replace(tzinfo=None)}, "valid: a time with its zone"),
        ({"seconds": float("inf")}, "seconds is inf"),
        ({"pose_distance_m": -0.1}, "pose_distance_m is -0.1"),
        ({"note": "n" * 10_001}, "valid: 10000 at most"),
        ({"note": "a\0"}, "note holds a NUL"),
        ({"gripper": {"a": object()}}, "gripper is not plain"),
        ({"T_base_gripper": ((1.0,),)}, "is not 4 x 4"),
        ({"pixel": (1, 2, 3)}, "pixel has 3 numbers"),
        ({"origin": "dream"}, "valid: page, assist, ask, pose, import"),
    ],
)
def test_what_is_no_label_is_refused(kept: Record, changes: dict[str, Any], said: str) -> None:
    kept.add_scenes(SOURCE, [scene(0)])
    with pytest.raises(LabelError) as error:
        kept.save(label(scene(0).key, **changes))
    assert said in one_line(error) and kept.standing() == []


# Turns.


def test_two_operators_never_get_the_same_scene(record: Record) -> None:
    record.add_scenes(SOURCE, [scene(k) for k in range(3)])
    assert [key_of(record, who) for who in ("ann", "bob", "cem")] == [
        scene(k).key for k in range(3)
    ]
    assert key_of(record, "dan") is None
    assert [key_of(record, who, 5.0) for who in ("bob", "ann")] == [scene(1).key, scene(0).key]


def test_the_scene_after_next_is_prepared_with_skip(record: Record) -> None:
    record.add_scenes(SOURCE, [scene(k) for k in range(3)])
    assert key_of(record, "ann") == scene(0).key
    assert key_of(record, "ann", 1, skip=[scene(0).key]) == scene(1).key
    assert key_of(record, "bob", 2) == scene(2).key
    assert key_of(record, "ann", 3) == scene(0).key  # after a reload, what was before her first
    record.save(label(scene(0).key, at=4))
    assert key_of(record, "ann", 5) == scene(1).key
    assert key_of(record, "ann", 6, skip=[scene(1).key]) is None


def test_a_scene_is_free_when_its_time_is_over_or_it_is_released(record: Record) -> None:
    record.add_scenes(SOURCE, [scene(0)])
    rules = TurnRules(lease_s=10.0)
    assert key_of(record, "ann", 0, rules=rules) == scene(0).key
    assert key_of(record, "bob", 9, rules=rules) is None
    assert record.renew(scene(0).key, "ann", after(9))
    assert key_of(record, "bob", 18, rules=rules) is None
    assert key_of(record, "bob", 19, rules=rules) == scene(0).key
    assert not record.renew(scene(0).key, "ann", after(20))
    record.release(scene(0).key, "ann")  # no longer hers
    assert key_of(record, "ann", 20, rules=rules) is None
    record.release(scene(0).key, "bob")
    assert key_of(record, "ann", 20, rules=rules) == scene(0).key
    assert record.renew(scene(0).key, "ann", after(500))  # nobody wanted it meanwhile


def test_an_operator_goes_back_to_a_scene_that_nobody_has(record: Record) -> None:
    record.add_scenes(SOURCE, [scene(0), scene(1)])
    first = record.save(label(scene(0).key))
    assert record.find(first.id) == first and record.find(new_id()) is None
    assert record.hold(scene(0).key, "ann", ONCE, after(1))
    assert not record.hold(scene(0).key, "bob", ONCE, after(2))
    assert key_of(record, "ann", 3) == scene(1).key  # one that she labeled is no turn
    assert record.hold(scene(0).key, "bob", ONCE, after(4))
    assert not record.hold(scene(1).key, "bob", ONCE, after(5))
    with pytest.raises(LabelError, match="no scene nothing"):
        record.hold("nothing", "ann", ONCE, after(6))


def test_a_label_of_one_whose_time_was_over_is_kept(record: Record) -> None:
    record.add_scenes(SOURCE, [scene(0)])
    rules = TurnRules(lease_s=10.0)
    assert key_of(record, "ann", 0, rules=rules) == key_of(record, "bob", 11, rules=rules)
    record.save(label(scene(0).key, "ann", 12))
    record.save(label(scene(0).key, "bob", 13))
    assert [item.operator for item in record.standing()] == ["ann", "bob"]


def test_a_scene_whose_label_was_withdrawn_comes_back(record: Record) -> None:
    record.add_scenes(SOURCE, [scene(0), scene(1)])
    first = record.save(label(scene(0).key))
    assert key_of(record, "ann", 1) == scene(1).key
    record.save(label(scene(1).key, at=2))
    assert key_of(record, "ann", 3) is None
    record.withdraw(first.id, "ann", new_id(), after(4))
    turn = turn_of(record, "bob", 5)
    assert turn == Turn(scene(0))


def test_a_scene_that_somebody_labeled_without_a_turn_is_passed_over(record: Record) -> None:
    record.add_scenes(SOURCE, [scene(0), scene(1)])
    assert key_of(record, "ann") == scene(0).key
    record.save(label(scene(0).key, "bob", 1, origin="pose"))
    assert key_of(record, "ann", 2) == scene(1).key


def run_through(record: Record, operator: str, rules: TurnRules, at: float) -> list[Turn]:
    """All turns of an operator who labels all that comes."""
    found = []
    while turn := turn_of(record, operator, at + 3 * len(found), rules=rules):
        found.append(turn)
        record.save(label(turn.scene.key, operator, at + 3 * len(found)))
    return found


def test_a_share_comes_again_to_its_operator_spaced(kept: Record) -> None:
    scenes = [scene(k) for k in range(60)]
    kept.add_scenes(SOURCE, scenes)
    rules = TurnRules(again_share=0.3)
    given = run_through(kept, "ann", rules, 0.0)
    keys = [turn.scene.key for turn in given]
    twice = {item.key for item in scenes if draw_of(item.key, "again") < 0.3}
    assert 8 <= len(twice) <= 28
    assert Counter(keys) == {item.key: 1 + (item.key in twice) for item in scenes}
    again = [turn.again for turn in given]
    assert again == [keys.index(key) < k for k, key in enumerate(keys)]
    first_half = again[:40]
    assert any(first_half), "some come before the end is reached"
    new = [k for k, old in enumerate(again) if not old]
    for k, key in enumerate(keys):
        if again[k] and k < new[-1]:
            assert k - keys.index(key) > turns.SPACING
            assert not again[k - 1], "every other turn at most"
    assert not any(turn.second for turn in given)


def test_a_share_gets_a_second_label_by_one_other(kept: Record) -> None:
    scenes = [scene(k) for k in range(40)]
    kept.add_scenes(SOURCE, scenes)
    rules = TurnRules(second_share=0.4)
    first = run_through(kept, "ann", rules, 0.0)
    assert [turn.scene for turn in first] == scenes and not any(turn.second for turn in first)
    second = run_through(kept, "bob", rules, 500.0)
    wanted = [item.key for item in scenes if draw_of(item.key, "second") < 0.4]
    assert [turn.scene.key for turn in second] == wanted and len(wanted) > 5
    assert all(turn.second and not turn.again for turn in second)
    assert run_through(kept, "cem", rules, 900.0) == []


def test_second_ones_leave_every_other_turn_to_new_scenes(kept: Record) -> None:
    kept.add_scenes(SOURCE, [scene(k) for k in range(20)])
    rules = TurnRules(second_share=1.0)
    for k in range(10):
        kept.save(label(scene(k).key, "ann", k))
    given = run_through(kept, "bob", rules, 100.0)
    assert [turn.second for turn in given] == [True, False] * 10


def test_few_scenes_come_again_at_the_end(kept: Record) -> None:
    kept.add_scenes(SOURCE, [scene(k) for k in range(3)])
    given = run_through(kept, "ann", TurnRules(again_share=1.0), 0.0)
    assert [turn.scene.number for turn in given] == [0, 1, 2, 0, 1, 2]


@settings(max_examples=30, deadline=None)
@given(st.data())
def test_turns_and_labels_follow_the_plain_rules(data: st.DataObject) -> None:
    """Against a model in plain Python: whose scene is whose, what stands, what was said."""
    import tempfile

    with tempfile.TemporaryDirectory() as folder, Record.open(f"{folder}/labels.db") as record:
        record.add_scenes(SOURCE, [scene(k) for k in range(4)])
        rules = TurnRules(lease_s=10.0)
        leases: dict[str, tuple[str, float]] = {}
        rows: list[OperatorLabel] = []
        now = 0.0
        for _ in range(data.draw(st.integers(1, 12))):
            now += data.draw(st.sampled_from([1.0, 4.0, 11.0]))
            who = data.draw(st.sampled_from(["ann", "bob", "cem"]))
            over = {item.supersedes for item in rows}
            standing = [x for x in rows if x.id not in over and x.verdict != "withdrawn"]
            done = {item.scene_key for item in standing}
            mine = [item for item in standing if item.operator == who]
            held = [key for key, (holder, _) in leases.items() if holder == who]
            doing = data.draw(st.sampled_from(["ask", "save", "undo", "correct"]))
            if doing == "ask":
                key = key_of(record, who, now, rules=rules)
                held = [name for name in held if name not in done]
                busy = {k for k, (holder, end) in leases.items() if holder != who and end > now}
                free = [scene(k).key for k in range(4)]
                free = [name for name in free if name not in done and name not in busy]
                assert key == (held[0] if held else free[0] if free else None)
                if key is not None:
                    leases = {name: kept for name, kept in leases.items() if name != key}
                    leases[key] = (who, now + 10.0)
            elif doing == "save" and held:
                rows.append(record.save(label(held[0], who, now)))
                del leases[held[0]]
            elif doing == "undo" and mine:
                rows.append(record.withdraw(mine[-1].id, who, new_id(), after(now)))
            elif doing == "correct" and mine:
                new = label(mine[0].scene_key, who, now, label=2, supersedes=mine[0].id)
                rows.append(record.save(new))
                leases = {k: v for k, v in leases.items() if k != new.scene_key or v[0] != who}
            over = {item.supersedes for item in rows}
            assert record.standing() == [
                x for x in rows if x.id not in over and x.verdict != "withdrawn"
            ]
        assert [x for k in range(4) for x in record.history(scene(k).key)] == sorted(
            rows, key=lambda x: (x.scene_key, x.labeled_at)
        )


# Several processes, and their ends.


def started_worker(url: str, operator: str) -> subprocess.Popen[str]:
    worker = subprocess.Popen(
        [*WORKER, url, operator],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert said_by(worker) == "ready"
    return worker


def said_by(worker: subprocess.Popen[str]) -> str:
    assert worker.stdout is not None
    line = worker.stdout.readline().strip()
    assert line, "the worker has ended"
    return line


def go(worker: subprocess.Popen[str], most: int) -> None:
    """It labels until nothing is left; after so many it does nothing more, and stands open."""
    assert worker.stdin is not None
    worker.stdin.write(f"{most}\n")
    worker.stdin.flush()


@pytest.mark.skipif(os.name == "nt", reason="the workers fork")
def test_processes_label_side_by_side(url: str) -> None:
    scenes = [scene(k) for k in range(60)]
    with Record.open(url) as record:
        record.add_scenes(SOURCE, scenes)
        workers = [started_worker(url, name) for name in ("ann", "bob")]
        for worker in workers:
            go(worker, 40)  # so that the slower one has its part, and the faster one rests
        deadline = time.monotonic() + 60
        while len(record.standing()) < len(scenes) and time.monotonic() < deadline:
            time.sleep(0.05)
        for worker in workers:
            os.killpg(worker.pid, signal.SIGKILL)
        heard = [worker.communicate()[0] for worker in workers]
        labels = record.standing()
        assert Counter(item.scene_key for item in labels) == {item.key: 1 for item in scenes}
        counts = Counter(item.operator for item in labels)
        assert min(counts["ann"], counts["bob"]) >= 20, "neither waits for the other"
        kept = {line.split()[1] for text in heard for line in text.splitlines() if "kept" in line}
        assert kept <= {item.id for item in labels} and len(kept) >= len(scenes) - 2


def test_all_who_ask_at_once_get_scenes_of_their_own(record: Record) -> None:
    record.add_scenes(SOURCE, [scene(k) for k in range(10)])
    with ThreadPoolExecutor(8) as pool:
        keys = list(pool.map(lambda k: key_of(record, f"operator {k}"), range(10)))
    assert sorted(filter(None, keys)) == [scene(k).key for k in range(10)]


# In a process of its own: this one may have threads of other tests, which a fork does not take.
FORKED = """
import os, sys
from boxgrasp.labeling.record import Record
from label_records import SOURCE, label, scene

with Record.open(sys.argv[1]) as record:
    record.add_scenes(SOURCE, [scene(0), scene(1)])
    record.save(label(scene(0).key))
    child = os.fork()
    if child == 0:
        record.save(label(scene(1).key, at=1))
        os._exit(len(record.standing()))
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), len(record.standing()))
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork here")
def test_a_forked_child_connects_by_itself(url: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", FORKED, url],
        cwd=Path(__file__).parent,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert (done.stdout, done.stderr) == ("2 2\n", "")


@pytest.mark.skipif(os.name == "nt", reason="SIGKILL")
def test_a_writer_that_is_killed_loses_and_doubles_nothing(url: str) -> None:
    scenes = [scene(k) for k in range(120)]
    moments = random.Random(5)
    with Record.open(url) as record:
        record.add_scenes(SOURCE, scenes)
        worker, kept, kills = started_worker(url, "ann"), [], 0
        go(worker, 20)
        line = ""
        while line != "done":
            line = said_by(worker)
            if line.startswith("kept"):
                kept.append(line.split()[1])
            elif line.startswith("started"):
                child, labeled = int(line.split()[1]), len(kept)
            if kills < 6 and len(kept) >= labeled + 4:
                time.sleep(moments.uniform(0.0, 0.02))  # anywhere between two saves, or in one
                os.kill(child, signal.SIGKILL)
                kills, labeled = kills + 1, len(scenes)
                go(worker, 20 if kills < 6 else len(scenes))
        worker.communicate()
        assert kills == 6
        labels = record.standing()
        assert set(kept) <= {item.id for item in labels}
        assert Counter(item.scene_key for item in labels) == {item.key: 1 for item in scenes}


def test_a_server_that_was_killed_is_reached_again(
    caplog: pytest.LogCaptureFixture,
) -> None:
    # A server of its own: one with many databases takes seconds to come back.
    with running_postgres() as server, Record.open(server.new_database()) as record:
        record.add_scenes(SOURCE, [scene(k) for k in range(2)])
        first = record.save(label(scene(0).key))
        server.stop()
        with pytest.raises(StoreError) as error:
            record.save(label(scene(1).key))
        one_line(error)
        server.start()
        second = record.save(label(scene(1).key, at=1))
        assert record.standing() == [first, second]
        assert caplog.records == []  # the driver's traces would be printed


# How far, and how alike.


def test_progress_counts_and_leaves_pauses_out(record: Record) -> None:
    record.add_scenes(SOURCE, [scene(k) for k in range(10)])
    record.add_scenes("other", [scene(20)])
    assert record.progress(SOURCE, "ann", after(0)).rate_per_hour is None
    for k, at in enumerate((0, 10, 20, 4000, 4010)):
        record.save(label(scene(k).key, "ann", at))
    record.save(label(scene(5).key, "bob", 5))
    record.save(label(scene(20).key, "bob", 6))
    found = record.progress(SOURCE, "ann", after(5000))
    assert (found.scenes, found.done, found.mine) == (10, 6, 5)
    assert found.rate_per_hour == pytest.approx(360.0)
    assert found.seconds_left == pytest.approx(40.0)
    bobs = record.progress(SOURCE, "bob", after(5000))
    assert (bobs.mine, bobs.done) == (1, 6)


def test_agreement_of_two_and_of_one_with_herself(record: Record) -> None:
    record.add_scenes(SOURCE, [scene(k) for k in range(4)])
    for k, (ann, bob) in enumerate([(1, 1), (2, 3), (None, None), (4, None)]):
        for who, said in (("ann", ann), ("bob", bob)):
            verdict = "none" if said is None else "candidate"
            record.save(label(scene(k).key, who, k, verdict=verdict, label=said))
    record.save(label(scene(0).key, "ann", 9, label=1))
    record.save(label(scene(1).key, "ann", 9.5, label=7))
    found = {(item.first, item.second): item for item in record.agreements()}
    assert set(found) == {("ann", "ann"), ("ann", "bob")}
    assert found["ann", "bob"].scenes == 4 and found["ann", "bob"].same == 0.5
    assert found["ann", "bob"].kappa == pytest.approx((8 - 3) / (16 - 3))
    assert found["ann", "ann"].same == 0.5
    assert record.agreements("nowhere") == []


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.sampled_from("abcd"), st.sampled_from("abc")), min_size=1))
def test_kappa_is_that_of_scikit_learn(pairs: list[tuple[str, str]]) -> None:
    metrics = pytest.importorskip("sklearn.metrics")
    ours = cohens_kappa(pairs)
    if ours is None:
        assert {a for a, _ in pairs} == {b for _, b in pairs} == {pairs[0][0]}
        return
    theirs = metrics.cohen_kappa_score([a for a, _ in pairs], [b for _, b in pairs])
    assert ours == pytest.approx(theirs, abs=1e-12)


@pytest.mark.parametrize("suffix", ["parquet", "csv"])
def test_a_file_carries_all_from_one_database_into_another(
    url: str, kept: Record, tmp_path: Path, suffix: str
) -> None:
    exchange = pytest.importorskip("boxgrasp.labeling.record.exchange")
    there, back = tmp_path / f"labels.{suffix}", tmp_path / f"back.{suffix}"
    kept.add_scenes(SOURCE, [captured(1), scene(0)])
    first = kept.save(full_label())
    for at in (1.5, 2.5):
        first = kept.save(replace(first, id=new_id(), labeled_at=after(at), supersedes=first.id))
    exchange.export_labels(kept, str(there))
    with Record.open(url) as other:
        assert exchange.import_labels(other, str(there)) == (3, 0)
        assert exchange.import_labels(other, str(there)) == (0, 3)
        assert other.kept() == kept.kept() and other.standing() == [first]
        exchange.export_labels(other, str(back))
    assert back.read_bytes() == there.read_bytes()


# What robots ask.


def an_ask(**changes: Any) -> Ask:
    fields = {"id": new_id(), "scene_key": scene(0).key, "asked_at": after(10)}
    fields |= {"expires_at": after(70), "asker": "robot 3", "selection": '{"status": "ask"}'}
    return Ask(**(fields | changes))


def test_an_ask_waits_until_it_is_answered(record: Record) -> None:
    record.add_scenes(SOURCE, [scene(0), scene(1)])
    record.save(label(scene(0).key, at=5, origin="ask"))  # before it was asked
    first, second = an_ask(), an_ask(scene_key=scene(1).key, asked_at=after(11))
    for ask in (second, first, first):
        record.add_ask(ask)
    assert record.open_asks(after(12)) == [first, second]
    assert record.open_asks(after(70)) == []
    record.save(label(scene(0).key, at=13))  # of the page, not an answer
    assert record.answer_of(first.id) is None
    answer = record.save(label(scene(0).key, "bob", at=20, origin="ask"))
    assert record.answer_of(first.id) == answer and record.open_asks(after(21)) == [second]
    record.withdraw(answer.id, "bob", new_id(), after(22))
    assert record.answer_of(first.id) is None and len(record.open_asks(after(23))) == 2
    record.withdraw_ask(second.id)
    assert record.open_asks(after(24)) == [first]


def test_asks_that_cannot_be_are_refused(record: Record) -> None:
    record.add_scenes(SOURCE, [scene(0)])
    first = an_ask()
    record.add_ask(first)
    for ask, said in (
        (replace(first, asker="robot 4"), "kept already and differs"),
        (an_ask(scene_key="nothing"), "no scene nothing"),
        (an_ask(asker=""), "asker is ''"),
        (an_ask(id="x"), "the id is 'x'"),
    ):
        with pytest.raises(LabelError, match=said):
            record.add_ask(ask)
    for call in (record.answer_of, record.withdraw_ask):
        asked: Callable[[str], object] = call
        with pytest.raises(LabelError, match="no ask"):
            asked(new_id())
    assert record.open_asks(after(12)) == [first]
