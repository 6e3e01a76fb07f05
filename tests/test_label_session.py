"""One operator at the page, without a browser: what is late, lost or tried again."""

from __future__ import annotations

import signal
import uuid
from collections.abc import Iterator
from datetime import timedelta
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest

pytest.importorskip("viser", reason="extra label")
pytest.importorskip("fastapi", reason="extra label")

import httpx
from test_label_kills import captures

from boxgrasp.config import Config
from boxgrasp.errors import BoxgraspError, StoreError
from boxgrasp.execution import Store
from boxgrasp.labeling.captures import CaptureStore
from boxgrasp.labeling.record import Record
from boxgrasp.labeling.server.desk import Desk, DeskRules, now
from boxgrasp.labeling.server.run import Listening, serve
from boxgrasp.labeling.server.security import Access
from boxgrasp.labeling.server.select_api import Selections
from boxgrasp.labeling.server.session import Said, Session, StaleError
from boxgrasp.labeling.server.sessions import Sessions, UnknownSessionError
from boxgrasp.labeling.sources import source_at
from boxgrasp.labeling.words import Ask, TurnRules, Verdict


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Desk]:
    store = CaptureStore(Store(tmp_path / "kept"))
    source = source_at(str(captures(tmp_path / "captures", 5)), store)
    with Record.open(str(tmp_path / "labels.sqlite")) as record:
        record.add_scenes(source.name, source.scenes())
        found = Desk(record, source.name, store, Config(), DeskRules())
        yield found
        found.close()


@pytest.fixture
def ada(desk: Desk) -> Iterator[Session]:
    session = Session(desk, "Ada")
    yield session
    session.close()


def said(session: Session, label: int | None = 5, **other: Any) -> Said:
    shown = session.state()["shown"]
    verdict: Verdict = "none" if label is None else "candidate"
    told = {"label_id": shown["label_id"], "scene_key": shown["scene_key"], "verdict": verdict}
    return Said(**{**told, "label": label, **other})


def standing(desk: Desk) -> list[tuple[str, int | None]]:
    return [(row.scene_key, row.label) for row in desk.record.standing()]


def test_a_label_said_twice_is_kept_once(desk: Desk, ada: Session) -> None:
    first = said(ada)
    ada.save(first)
    here = ada.state()["shown"]["scene_key"]
    ada.save(first)  # its answer was lost on the way
    assert ada.state()["shown"]["scene_key"] == here
    assert standing(desk) == [(first.scene_key, 5)]
    with pytest.raises(StaleError):
        ada.save(Said(str(uuid.uuid4()), first.scene_key, "none"))


def failing(*_: Any) -> None:
    raise StoreError("the disk is full; valid: free space")


def test_a_label_is_kept_once_where_what_follows_fails(desk: Desk, ada: Session) -> None:
    first = said(ada)
    with patch.object(ada, "_taken_turn", failing):
        ada.save(first)
        state = ada.state()
        assert "Saved" in state["notice"] and "the disk is full" in state["notice"]
        assert state["shown"]["standing"]["label"] == 5
        ada.save(first)  # its answer was lost on the way
        ada.save(said(ada))
        assert ada.state()["shown"]["scene_key"] == first.scene_key
    ada.save(said(ada))
    assert ada.state()["notice"] == "" and ada.state()["shown"]["scene_key"] != first.scene_key
    assert standing(desk) == [(first.scene_key, 5)]
    assert len(desk.record.history(first.scene_key)) == 1
    ada.undo()
    assert standing(desk) == [] and ada.state()["shown"]["scene_key"] == first.scene_key


def test_another_answer_where_what_follows_failed_is_a_correction(desk: Desk, ada: Session) -> None:
    first = said(ada)
    with patch.object(ada, "_taken_turn", failing):
        ada.save(first)
    ada.save(said(ada, 8))
    assert standing(desk) == [(first.scene_key, 8)]
    assert [row.label for row in desk.record.history(first.scene_key)] == [5, 8]
    assert ada.state()["shown"]["scene_key"] != first.scene_key


def test_a_look_ahead_that_failed_is_asked_anew(desk: Desk, ada: Session) -> None:
    ahead = ada._ahead
    assert ahead is not None and ahead.result() is not None
    with patch.object(desk, "next_turn", failing):
        ada._ahead = ada._pool.submit(ada._look_ahead, set())
        assert isinstance(ada._ahead.exception(), StoreError)
        ada.keep()
    first = said(ada)
    ada.save(first)
    assert ada.state()["notice"] == "" and ada.state()["shown"]["scene_key"] != first.scene_key


def test_a_choice_of_the_scene_before_means_nothing(ada: Session) -> None:
    late = ada.state()["serial"]
    ada.save(said(ada))
    ada.choose_in(late, 5, 13)
    assert ada.choice() | {"serial": 0} == {"serial": 0, "face": None, "label": None, "pixel": None}
    ada.choose_in(ada.state()["serial"], 5, 13)
    assert (ada.choice()["face"], ada.choice()["label"]) == (5, 13)
    ada.choose(9, 99)  # neither is there
    assert (ada.choice()["face"], ada.choice()["label"]) == (None, None)


def test_corrections_and_undoing_them_leave_every_row(desk: Desk, ada: Session) -> None:
    first = said(ada)
    ada.save(first)
    waiting = ada.state()["shown"]["scene_key"]
    ada.back(-1)
    assert ada.state()["shown"]["standing"]["label"] == 5
    ada.save(said(ada, 8))
    assert ada.state()["shown"]["scene_key"] == waiting
    assert standing(desk) == [(first.scene_key, 8)]
    ada.undo()  # of the correction: what it corrected stands again
    assert standing(desk) == [(first.scene_key, 5)]
    rows = desk.record.history(first.scene_key)
    assert [row.label for row in rows] == [5, 8, 5]
    assert rows[1].supersedes == rows[0].id and rows[2].supersedes == rows[1].id
    assert ada.state()["shown"]["standing"]["label"] == 5
    ada.save(said(ada, 5))  # the same again is no correction
    assert desk.record.history(first.scene_key) == rows
    assert ada.state()["shown"]["scene_key"] == waiting


def test_two_operators_never_have_one_scene(desk: Desk) -> None:
    sessions = Sessions(desk)
    ada, bo = sessions.of("Ada"), sessions.of("  Bo ")
    assert sessions.of("Bo") is bo and sessions.get(bo.id) is bo
    seen = {name: [] for name in ("Ada", "Bo")}
    while any(item.state()["shown"] for item in (ada, bo)):
        for item in (ada, bo):
            if item.state()["shown"]:
                seen[item.operator].append(item.state()["shown"]["scene_key"])
                item.save(said(item))
    assert not {*seen["Ada"]} & {*seen["Bo"]}
    assert len(seen["Ada"]) + len(seen["Bo"]) == 5 == len(standing(desk))
    sessions.close()
    with pytest.raises(UnknownSessionError):
        sessions.get(bo.id)
    for name in ("", " ", "a" * 61, "a\nb\x00"):
        with pytest.raises(BoxgraspError, match="valid: 1 to 60"):
            sessions.of(name)


def test_the_next_scene_that_others_took_meanwhile_is_not_shown(desk: Desk, ada: Session) -> None:
    ahead = ada._ahead
    assert ahead is not None
    turn = ahead.result()
    assert turn is not None
    later = now() + timedelta(seconds=2 * TurnRules().lease_s)
    assert desk.record.hold(turn.scene.key, "Bo", TurnRules(), later)
    ada.save(said(ada))
    assert ada.state()["shown"]["scene_key"] != turn.scene.key


def test_what_is_skipped_comes_again_when_it_is_asked_for(ada: Session) -> None:
    keys = []
    while ada.state()["shown"]:
        keys.append(ada.state()["shown"]["scene_key"])
        ada.skip()
    assert len({*keys}) == 5 and ada.state()["skipped"] == 5
    ada.return_to_skipped()
    assert ada.state()["shown"]["scene_key"] == keys[0] and ada.state()["skipped"] == 0


def test_a_question_comes_to_who_has_nothing_to_do(desk: Desk, ada: Session) -> None:
    while ada.state()["shown"]:
        ada.save(said(ada, None))
    asked = desk.scenes[2].key
    ask = Ask(str(uuid.uuid4()), asked, now(), now() + timedelta(seconds=60), "robot", "{}")
    desk.record.add_ask(ask)
    assert ada.waiting_asks() == 1
    assert ada.state()["shown"]["ask"]["asker"] == "robot"
    ada.save(said(ada, 11))
    answer = desk.record.answer_of(ask.id)
    assert answer is not None and (answer.label, answer.origin) == (11, "ask")
    assert ada.state()["shown"] is None and ada.waiting_asks() == 0


def test_jumping_gives_back_what_it_leaves(desk: Desk, ada: Session) -> None:
    first = ada.state()["shown"]["scene_key"]
    for number in (4, 5):
        ada.jump(number)
        assert ada.state()["shown"]["number"] == number
    assert desk.record.hold(desk.scenes[3].key, "Bo", TurnRules(), now())
    assert not desk.record.hold(desk.scenes[4].key, "Bo", TurnRules(), now())
    with pytest.raises(BoxgraspError, match="another operator"):
        ada.jump(4)
    with pytest.raises(BoxgraspError, match="valid: 1 to 5"):
        ada.jump(6)
    ada.save(said(ada))
    assert ada.state()["shown"]["scene_key"] == first


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_server_stopped_as_soon_as_its_address_is_told_ends_well(
    desk: Desk, number: signal.Signals
) -> None:
    def stop(url: str) -> None:
        told.append(url)
        signal.raise_signal(number)

    told: list[str] = []
    listening = Listening(Access("127.0.0.1", None, True), 0, open_browser=False)
    serve(desk, Selections(), listening, stop)
    assert len(told) == 1
    with pytest.raises(httpx.ConnectError):
        httpx.get(told[0])
