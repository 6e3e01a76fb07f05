"""A robot that is stuck asks an operator: over HTTP, through the record, and back."""

from __future__ import annotations

import dataclasses
import json
import socket
import threading
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import drawn, halved, seen

from boxgrasp import Capture, GraspSelector, Selection, Target
from boxgrasp.cli import main
from boxgrasp.errors import BoxgraspError, ConfigError, StoreError
from boxgrasp.io.npz import save_npz
from boxgrasp.labeling import client
from boxgrasp.labeling.client import Assistance, Stuck, ask_person
from boxgrasp.result import JSON_SCHEMA_PATH

pytest.importorskip("fastapi", reason="needs boxgrasp[label]")
pytest.importorskip("sqlalchemy", reason="needs boxgrasp[label]")
import httpx
import jsonschema
import uvicorn
from fastapi import FastAPI

from boxgrasp.execution import Store
from boxgrasp.labeling.captures import CaptureStore
from boxgrasp.labeling.record import Record
from boxgrasp.labeling.server.asks_api import AskLimits, Asks, asks_router
from boxgrasp.labeling.server.openapi import publish_schemas
from boxgrasp.labeling.server.security import QUIET, Access, Guard, UploadLimits
from boxgrasp.labeling.server.select_api import Selections, select_router
from boxgrasp.labeling.sources import load_scene
from boxgrasp.labeling.words import Ask, OperatorLabel
from boxgrasp.strict import plain

SEEN = halved(seen(drawn(7), 7))
FACES = {"candidates": {"faces": ["left"]}}  # none of which passes in this view
SELECTOR = GraspSelector(FACES)
STUCK = SELECTOR.select(SEEN)
PREGRASP_M = SELECTOR.config.checks.pregrasp_distance_m
TOKEN = "secret-0123456789abcdef"


@dataclasses.dataclass
class Server:
    place: Path
    port: int
    record: Record

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}"


@contextmanager
def served(
    place: Path, port: int = 0, token: str | None = None, config: Any = None
) -> Iterator[Server]:
    held = socket.socket()
    held.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    held.bind(("127.0.0.1", port))
    record = Record.open(str(place / "labels.db"))
    selections = Selections(config, UploadLimits(body_bytes=8 << 20))
    app = FastAPI(docs_url=None, redoc_url=None)
    app.include_router(select_router(selections))
    limits = AskLimits(open_asks=3, look_s=0.02)
    app.include_router(asks_router(Asks(selections, record, CaptureStore(Store(place)), limits)))
    publish_schemas(app)
    guard = Guard(app, Access("127.0.0.1", token, True), selections.limits)
    server = uvicorn.Server(uvicorn.Config(guard, timeout_graceful_shutdown=1, **QUIET))
    thread = threading.Thread(target=server.run, kwargs={"sockets": [held]})
    thread.start()
    try:
        while not server.started:
            time.sleep(0.01)
        yield Server(place, int(held.getsockname()[1]), record)
    finally:
        server.should_exit = True
        thread.join(10)
        held.close()
        selections.close()
        record.close()
    assert not thread.is_alive()


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    with served(tmp_path_factory.mktemp("server")) as found:
        yield found


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    path = tmp_path / "table.npz"
    save_npz(SEEN, path)
    return path


def now() -> datetime:
    return datetime.now(timezone.utc)


def said(ask: Ask, **words: Any) -> OperatorLabel:
    given: dict[str, Any] = {"verdict": "candidate", "label": None, "origin": "ask"} | words
    return OperatorLabel(
        id=str(uuid.uuid4()),
        scene_key=ask.scene_key,
        operator="Ada",
        labeled_at=now(),
        seconds=1.0,
        gripper=plain(SELECTOR.config.gripper),
        box_kind="yaw",
        lines=3,
        version="0",
        **given,
    )


@contextmanager
def operator(record: Record, answer: Callable[[Ask], OperatorLabel]) -> Iterator[list[Ask]]:
    """Somebody at the page, who answers the first question that comes."""
    asks: list[Ask] = []

    def work() -> None:
        end = time.monotonic() + 10
        while time.monotonic() < end:
            if found := record.open_asks(now()):
                asks.append(found[0])
                record.save(answer(found[0]))
                return
            time.sleep(0.01)

    thread = threading.Thread(target=work)
    thread.start()
    yield asks
    thread.join(15)


def asked(url: str, seconds: float = 20.0, own: Selection = STUCK, **more: Any) -> Selection:
    assistance = Assistance(url, seconds, "arm 3", more.pop("token", ""))
    capture, target = more.pop("capture", SEEN), more.pop("target", None)
    return ask_person(Stuck(capture, target, own, PREGRASP_M), assistance)


def codes(selection: Selection) -> list[str]:
    jsonschema.validate(selection.to_dict(), json.loads(JSON_SCHEMA_PATH.read_text()))
    return [warning.code for warning in selection.warnings]


# What becomes of an answer, without any server.


@pytest.mark.parametrize("hand", ["thesis", "robotiq-2f-85", "franka-hand"])
def test_a_taken_candidate_has_the_poses_that_the_robot_would_have_given(hand: str) -> None:
    selector = GraspSelector({"gripper": hand, "checks": {"pregrasp_distance_m": 0.07}})
    own = selector.select(SEEN)
    assert own.grasp is not None
    taken = own.asking("ranker_asks", "asked").taken(own.grasp.label, 0.07).grasp
    assert taken is not None and taken.confidence is None
    for name in ("T_base_gripper", "T_base_tcp", "T_base_pregrasp", "quaternion_xyzw"):
        np.testing.assert_array_equal(getattr(taken, name), getattr(own.grasp, name))
    flange = own.grasp.T_base_flange
    assert (taken.T_base_flange is None) == (flange is None)
    assert (taken.opening_m, taken.clearance_m) == (own.grasp.opening_m, own.grasp.clearance_m)


def test_every_check_that_a_person_overrides_is_named() -> None:
    failing = next(item for item in STUCK.candidates if len(item.rejections) > 1)
    taken = STUCK.taken(failing.label, PREGRASP_M)
    assert (taken.status, taken.ranker) == ("grasp", "person") and taken.refusal is None
    (warning,) = (item for item in taken.warnings if item.code == "person_overrode_checks")
    for name, value in failing.checks.items():
        assert (name in warning.message) == (not value.passed)
    assert Selection.from_json(taken.to_json()).to_dict() == taken.to_dict()
    clear = GraspSelector().select(SEEN)
    assert clear.grasp is not None
    assert codes(clear.taken(clear.grasp.label, PREGRASP_M)) == codes(clear)
    with pytest.raises(BoxgraspError, match="no candidate 99"):
        STUCK.taken(99, PREGRASP_M)


# Through the server.


def test_a_person_takes_a_candidate(server: Server) -> None:
    with operator(server.record, lambda ask: said(ask, label=5)) as asks:
        answer = asked(server.url)
    assert (answer.status, answer.ranker) == ("grasp", "person")
    assert answer.grasp is not None and answer.grasp.label == 5
    assert answer.grasp.confidence is None and "person_overrode_checks" in codes(answer)
    assert answer.candidate(5).checks == STUCK.candidate(5).checks
    (ask,) = asks
    assert ask.asker == "arm 3" and Selection.from_json(ask.selection).candidates
    # What the operator was shown is what the robot saw.
    scene = load_scene(server.record.scene(ask.scene_key), CaptureStore(Store(server.place)))
    again = SELECTOR.select(scene.capture, scene.target)
    np.testing.assert_array_equal(again.box.T_base_box, STUCK.box.T_base_box)


@pytest.mark.parametrize(
    "words,code,message",
    [
        ({"verdict": "none"}, "person_would_help", "help is needed"),
        ({"verdict": "box_wrong", "pixel": (12, 34)}, "box_wrong", "at pixel 12 34"),
        ({"verdict": "box_wrong"}, "box_wrong", "not the target's"),
    ],
)
def test_a_person_says_why_not(
    server: Server, words: dict[str, Any], code: str, message: str
) -> None:
    with operator(server.record, lambda ask: said(ask, **words)):
        answer = asked(server.url)
    assert answer.status == "ask" and answer.refusal is not None
    assert answer.refusal.code == code and message in answer.refusal.message
    codes(answer)


def test_nobody_answers(server: Server) -> None:
    answer = asked(server.url, seconds=1.0)
    assert answer.refusal == STUCK.refusal
    assert codes(answer) == [*codes(STUCK), "nobody_answered"]
    assert server.record.open_asks(now()) == []


def test_an_answer_at_the_last_moment_counts(
    server: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = client._Question._withdraw

    def late(question: client._Question) -> None:
        (ask,) = server.record.open_asks(now())
        server.record.save(said(ask, label=4))
        before(question)

    monkeypatch.setattr(client._Question, "_withdraw", late)
    answer = asked(server.url, seconds=1.0)
    assert answer.grasp is not None and answer.grasp.label == 4


def test_a_grasp_asks_nobody() -> None:
    own = GraspSelector().select(SEEN)
    assert own.grasp is not None
    assert asked("http://127.0.0.1:1", own=own) is own


@pytest.mark.parametrize("way", ["mask", "object", "box", "point", "pixel"])
def test_every_way_to_point_leads_the_operator_to_the_same_thing(server: Server, way: str) -> None:
    scene = SELECTOR.scene(SEEN)
    one = scene.objects_with_pixels()[-1]
    image = scene.object_image() == one.number
    v, u = np.nonzero(image)
    ways = {
        "mask": Target(mask=image),
        "object": Target(object=one.number),
        "box": Target(box=(u.min(), v.min(), u.max(), v.max())),
        "point": Target(point=tuple(scene.points[scene.object_numbers == one.number][0].tolist())),
        "pixel": Target(pixel=one.pixel),
    }
    own = SELECTOR.select(SEEN, ways[way])
    with operator(server.record, lambda ask: said(ask, verdict="none")) as asks:
        answer = asked(server.url, own=own.asking("ranker_asks", "asked"), target=ways[way])
    assert answer.refusal is not None and answer.refusal.code == "person_would_help", answer
    loaded = load_scene(server.record.scene(asks[0].scene_key), CaptureStore(Store(server.place)))
    shown = SELECTOR.select(loaded.capture, loaded.target)
    np.testing.assert_array_equal(shown.box.T_base_box, own.box.T_base_box)


def test_a_question_outlives_its_server(tmp_path: Path) -> None:
    found: list[Selection] = []
    with served(tmp_path) as first:
        thread = threading.Thread(target=lambda: found.append(asked(first.url)))
        thread.start()
        while not first.record.open_asks(now()):
            time.sleep(0.01)
    assert not found
    with served(tmp_path, first.port) as second:
        (ask,) = second.record.open_asks(now())
        second.record.save(said(ask, label=2))
        thread.join(15)
    assert found and found[0].grasp is not None and found[0].grasp.label == 2


def test_a_server_of_another_hand_is_told_from_the_robots_own(tmp_path: Path) -> None:
    from boxgrasp import load_config

    with served(tmp_path, config=load_config({"gripper": "franka-hand"})) as other:
        answer = asked(other.url)
        assert codes(answer)[-1] == "assist_failed"
        assert "other candidates or another gripper" in answer.warnings[-1].message
        assert other.record.open_asks(now()) == []


def test_a_token_is_asked_for_and_never_told(
    tmp_path: Path, saved: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    with served(tmp_path, token=TOKEN) as guarded:
        refused = asked(guarded.url, token="wrong-0123456789abcdef")
        assert codes(refused)[-1] == "assist_failed"
        assert "token is missing or wrong" in refused.warnings[-1].message
        assert "wrong-01" not in refused.warnings[-1].message
        monkeypatch.setenv(client.TOKEN_VARIABLE, TOKEN)
        words = ["-v", "select", str(saved), "--faces", "left", "--assist", guarded.url, "--json"]
        with operator(guarded.record, lambda ask: said(ask, label=5)):
            assert main(words) == 0
    out, err = capsys.readouterr()
    answer = Selection.from_json(out)
    assert (answer.capture, answer.ranker) == (str(saved), "person")
    assert TOKEN not in out + err


@pytest.mark.parametrize("url", ["http://127.0.0.1:1", "http://no-such-host.invalid:80"])
def test_nobody_there_costs_a_warning_and_no_status(saved: Path, capsys: Any, url: str) -> None:
    assert main(["select", str(saved), "--faces", "left", "--assist", url]) == 0
    out, err = capsys.readouterr()
    assert "ask: no candidate passes" in out
    assert f"warning: {url} cannot be asked" in out and err == ""


def test_too_large_and_a_cloud_are_told(server: Server, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(client, "_packed", lambda *_: (bytes(9 << 20), {}))
    answer = asked(server.url)
    assert "valid: at most 8388608 bytes" in answer.warnings[-1].message
    monkeypatch.undo()
    cloud = Capture.from_cloud(SEEN.valid_points()[0], T_base_camera=SEEN.T_base_camera)
    assert "a cloud is not sent" in asked(server.url, capture=cloud).warnings[-1].message


@pytest.mark.parametrize(
    "url,seconds,message",
    [
        ("robot:8080", 9, "valid: http://HOST:PORT"),
        ("ftp://robot", 9, "valid: http://HOST:PORT"),
        ("http://robot:99999999", 9, "valid: http://HOST:PORT"),
        (f"http://robot/?token={TOKEN}", 9, client.TOKEN_VARIABLE),
        (f"http://me:{TOKEN}@robot", 9, client.TOKEN_VARIABLE),
        ("http://robot", 0, "--assist-seconds is 0; valid: 1 to 3600"),
        ("http://robot", float("nan"), "valid: 1 to 3600"),
    ],
)
def test_a_faulty_address_is_refused_before_anything(
    url: str, seconds: float, message: str
) -> None:
    with pytest.raises(ConfigError, match="valid") as refused:
        Assistance(url, seconds)
    assert message in str(refused.value) and TOKEN not in str(refused.value)


def test_further_scans_are_not_sent(saved: Path, capsys: Any) -> None:
    words = ["select", str(saved), "--assist", "http://127.0.0.1:1", "--scan", str(saved)]
    assert main(words) == 2
    assert "valid: --assist alone" in capsys.readouterr().err


@pytest.mark.parametrize("body", [b"", b"hello", b"[1]", b'{"selection": 3}', b"\xff" * 99])
def test_another_kind_of_server_costs_a_warning(body: bytes) -> None:
    async def app(scope: Any, _receive: Any, send: Any) -> None:
        if scope["type"] == "http":
            await send({"type": "http.response.start", "status": 202, "headers": []})
            await send({"type": "http.response.body", "body": body})

    held = socket.socket()
    held.bind(("127.0.0.1", 0))
    server = uvicorn.Server(uvicorn.Config(app, lifespan="off", **QUIET))
    thread = threading.Thread(target=server.run, kwargs={"sockets": [held]})
    thread.start()
    answer = asked(f"http://127.0.0.1:{held.getsockname()[1]}", seconds=2)
    server.should_exit = True
    thread.join(10)
    held.close()
    assert codes(answer)[-1] == "assist_failed"


# The interface, for programs of other languages.


def post(server: Server, **params: Any) -> httpx.Response:
    import io

    held = io.BytesIO()
    save_npz(SEEN, held)
    kind = {"content-type": "application/octet-stream"}
    return httpx.post(f"{server.url}/ask", content=held.getvalue(), headers=kind, params=params)


def test_asking_twice_asks_once_and_a_question_can_be_taken_back(server: Server) -> None:
    first = post(server, id=str(uuid.UUID(int=7)), seconds=30)
    again = post(server, id=str(uuid.UUID(int=7)), seconds=30)
    assert (first.status_code, again.status_code) == (202, 202)
    assert first.json()["id"] == again.json()["id"] == str(uuid.UUID(int=7))
    assert len(server.record.open_asks(now())) == 1
    other = post(server, id=str(uuid.UUID(int=7)), object=2)
    assert other.status_code == 409 and "another capture" in other.json()["error"]
    place = f"{server.url}/ask/{uuid.UUID(int=7)}"
    waiting = httpx.get(place, params={"wait": 0.1})
    assert waiting.status_code == 202 and 0 < waiting.json()["seconds_left"] <= 30
    assert httpx.delete(place).status_code == 204
    assert server.record.open_asks(now()) == []


def test_the_queue_is_bounded(server: Server) -> None:
    found = [post(server, seconds=5) for _ in range(4)]
    assert [item.status_code for item in found] == [202, 202, 202, 503]
    for item in found[:3]:
        httpx.delete(f"{server.url}/ask/{item.json()['id']}")


@pytest.mark.parametrize(
    "params,status,message",
    [
        ({"seconds": "0"}, 400, "valid: 1 to 3600"),
        ({"seconds": "nan"}, 400, "valid: 1 to 3600"),
        ({"seconds": "soon"}, 400, "valid: 1 to 3600"),
        ({"asker": "x" * 81}, 400, "at most 80 characters"),
        ({"asker": "a\nb"}, 400, "on one line"),
        ({"id": "7"}, 400, "valid: a UUID"),
        ({"object": "77"}, 422, "no object 77"),
        ({"who": "me"}, 400, "unknown name 'who'"),
    ],
)
def test_a_faulty_question_gets_one_line(
    server: Server, params: dict[str, str], status: int, message: str
) -> None:
    response = post(server, **params)
    assert response.status_code == status and message in response.json()["error"]


def test_a_full_disk_gets_one_line(server: Server, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_given: Any) -> str:
        raise StoreError("captures/ab: No space left on device")

    monkeypatch.setattr(CaptureStore, "add", full)
    response = post(server)
    assert response.status_code == 503
    assert response.json() == {"error": "captures/ab: No space left on device"}


def test_a_fault_of_ours_gets_one_line(server: Server, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Selections, "selector", lambda *_: 1 / 0)
    response = post(server)
    assert response.status_code == 500
    assert response.json()["error"].startswith("internal error: ZeroDivisionError")


@pytest.mark.parametrize("wait", ["x", "-1", "nan", "61"])
def test_a_faulty_wait_gets_one_line(server: Server, wait: str) -> None:
    response = httpx.get(f"{server.url}/ask/x", params={"wait": wait})
    assert response.status_code == 400 and "valid: 0 to 60" in response.json()["error"]


def test_an_unknown_question_gets_one_line(server: Server) -> None:
    for method in ("GET", "DELETE"):
        for name in (str(uuid.uuid4()), "x", "%00", "a" * 500):
            response = httpx.request(method, f"{server.url}/ask/{name}")
            assert response.status_code == 404 and "valid: the id" in response.json()["error"]


def test_the_openapi_document_describes_questions(server: Server) -> None:
    paths = httpx.get(f"{server.url}/openapi.json").json()["paths"]
    assert {"post"} == set(paths["/ask"]) and {"get", "delete"} == set(paths["/ask/{ask_id}"])
    names = {item["name"] for item in paths["/ask"]["post"]["parameters"]}
    assert names >= {"seconds", "asker", "id", "pixel"}
