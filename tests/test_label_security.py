from __future__ import annotations

import asyncio
import logging
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from boxgrasp.errors import ConfigError

pytest.importorskip("fastapi", reason="needs boxgrasp[label]")
import httpx
import uvicorn
from fastapi import Body, FastAPI, WebSocket
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Origin

from boxgrasp.labeling.server.security import (
    COOKIE,
    QUIET,
    Access,
    Guard,
    UploadLimits,
    access_of,
)

TOKEN = "secret-0123456789abcdef"
OPEN = Access("127.0.0.1", None, is_loopback=True)
FLEET = Access("0.0.0.0", TOKEN, is_loopback=False)
LIMITS = UploadLimits(body_bytes=100_000)


def guarded(access: Access) -> Guard:
    app = FastAPI(docs_url=None, redoc_url=None)

    @app.get("/")
    @app.get("/view/1/")
    def page() -> str:
        return "page"

    @app.post("/echo")
    def echo(found: Any = Body()) -> Any:  # noqa: B008 - how FastAPI is told
        return found

    @app.websocket("/view/1/")
    async def view(connection: WebSocket) -> None:
        await connection.accept()
        await connection.send_text("hello")
        await connection.close()

    return Guard(app, access, LIMITS)


def asked(access: Access, path: str = "/", method: str = "GET", **more: Any) -> httpx.Response:
    base = more.pop("base", "http://localhost:8000")

    async def ask() -> httpx.Response:
        transport = httpx.ASGITransport(guarded(access))
        async with httpx.AsyncClient(transport=transport, base_url=base) as client:
            return await client.request(method, path, **more)

    return asyncio.run(ask())


@contextmanager
def served(access: Access) -> Iterator[int]:
    with socket.socket() as held:
        held.bind(("127.0.0.1", 0))
        port = int(held.getsockname()[1])
        server = uvicorn.Server(uvicorn.Config(guarded(access), **QUIET))
        thread = threading.Thread(target=server.run, kwargs={"sockets": [held]})
        thread.start()
        try:
            while not server.started:
                time.sleep(0.01)
            yield port
        finally:
            server.should_exit = True
            thread.join(10)
    assert not thread.is_alive()


@pytest.mark.parametrize("host", ["localhost", "127.0.0.1:8080", "[::1]:8080", "LOCALHOST:1"])
def test_this_machines_names_are_let_in(host: str) -> None:
    assert asked(OPEN, headers={"host": host}).status_code == 200


@pytest.mark.parametrize(
    "host",
    ["evil.example:8000", "localhost.evil.example", "", "localhost:x", "127.0.0.1@evil", "::1"],
)
def test_a_name_that_was_pointed_at_this_machine_is_refused(host: str) -> None:
    response = asked(OPEN, headers={"host": host})
    assert response.status_code == 421
    assert "valid: localhost, 127.0.0.1 or [::1]" in response.json()["error"]


@pytest.mark.parametrize(
    "origin,status",
    [
        (None, 200),
        ("http://localhost:8000", 200),
        ("https://localhost:8000", 200),
        ("http://localhost:3000", 403),
        ("http://127.0.0.1:8000", 403),
        ("http://evil.example", 403),
        ("null", 403),
        ("ftp://localhost:8000", 403),
        ("http://localhost:99999", 403),
        ("", 403),
    ],
)
def test_what_changes_something_comes_from_our_own_page_or_a_program(
    origin: str | None, status: int
) -> None:
    headers = {} if origin is None else {"origin": origin}
    assert asked(OPEN, "/echo", "POST", json=1, headers=headers).status_code == status


def test_an_origin_without_a_port_is_that_of_its_scheme() -> None:
    headers = {"origin": "http://localhost:80", "host": "localhost"}
    assert asked(OPEN, "/echo", "POST", json=1, headers=headers).status_code == 200


def test_every_path_asks_for_the_token() -> None:
    for path, method in (
        ("/", "GET"),
        ("/echo", "POST"),
        ("/nowhere", "GET"),
        ("/openapi.json", "GET"),
    ):
        response = asked(FLEET, path, method)
        assert response.status_code == 401
        assert response.headers["www-authenticate"] == "Bearer"
        assert "token is missing or wrong" in response.json()["error"]
    bearer = {"authorization": f"Bearer {TOKEN}"}
    assert asked(FLEET, headers=bearer).status_code == 200
    assert asked(FLEET, "/echo", "POST", json=3, headers=bearer).json() == 3
    assert asked(FLEET, "/echo", "POST", json=3, params={"token": TOKEN}).status_code == 401


def test_a_page_that_is_opened_with_the_token_keeps_it_in_a_cookie() -> None:
    response = asked(FLEET, "/?scene=3&token=" + TOKEN)
    assert response.status_code == 303 and response.headers["location"] == "/?scene=3"
    cookie = response.headers["set-cookie"]
    assert "HttpOnly" in cookie and "SameSite=Strict" in cookie
    cookies = {"cookie": f"{COOKIE}={TOKEN}"}
    assert asked(FLEET, "/?scene=3", headers=cookies).status_code == 200
    # A link with an old token, opened by who has the cookie already, leaves it too.
    again = asked(FLEET, "/?token=old", headers=cookies)
    assert again.status_code == 303 and TOKEN in again.headers["set-cookie"]
    slashes = asked(FLEET, f"http://localhost//evil.example/?token={TOKEN}")
    assert slashes.headers["location"] == "/evil.example/"


def test_a_person_gets_a_page_in_place_of_json() -> None:
    response = asked(FLEET, headers={"accept": "text/html,*/*"})
    assert response.status_code == 401
    assert response.headers["content-type"].startswith("text/html")
    assert "token is missing or wrong" in response.text
    odd = asked(OPEN, headers={"accept": "text/html", "host": "<b>evil</b>"})
    assert "<b>" not in odd.text


@settings(max_examples=60, deadline=None)
@given(st.binary(max_size=60), st.sampled_from(["authorization", "cookie"]))
def test_no_other_bytes_are_the_token(found: bytes, header: str) -> None:
    start = b"Bearer " if header == "authorization" else COOKIE.encode() + b"="
    response = asked(FLEET, headers=[(header.encode(), start + found), (b"host", b"robot")])
    assert response.status_code == 401


def test_another_programs_odd_cookie_hides_nothing() -> None:
    cookies = f'theme={{"dark": true}}; {COOKIE}=old; odd; {COOKIE}={TOKEN}'
    assert asked(FLEET, headers={"cookie": cookies}).status_code == 200


NAMES = ["host", "origin", "cookie", "authorization", "content-length", "accept", "content-type"]


@settings(max_examples=80, deadline=None)
@given(
    st.lists(st.tuples(st.sampled_from(NAMES), st.binary(max_size=40)), max_size=6),
    st.binary(max_size=40),
    st.text(max_size=20),
    st.sampled_from([OPEN, FLEET]),
    st.sampled_from(["GET", "POST", "PUT"]),
)
def test_headers_of_any_bytes_get_an_answer(
    headers: list[tuple[str, bytes]], query: bytes, path: str, access: Access, method: str
) -> None:
    scope = {
        "type": "http",
        "method": method,
        "path": "/" + path,
        "raw_path": b"/",
        "query_string": query,
        "headers": [(name.encode(), value) for name, value in headers],
    }
    sent: list[Any] = []

    async def receive() -> Any:
        return {"type": "http.request", "body": b"", "more_body": False}

    async def send(message: Any) -> None:
        sent.append(message)

    asyncio.run(guarded(access)(scope, receive, send))
    statuses = [item["status"] for item in sent if item["type"] == "http.response.start"]
    assert len(statuses) == 1 and statuses[0] != 500


def test_every_answer_tells_a_browser_what_it_may() -> None:
    for response in (asked(OPEN), asked(FLEET), asked(OPEN, "/nowhere")):
        assert response.headers["x-content-type-options"] == "nosniff"
        assert response.headers["referrer-policy"] == "no-referrer"
        assert response.headers["cache-control"] == "no-store"
        policy = response.headers["content-security-policy"]
        assert "frame-ancestors 'self'" in policy and "unsafe" not in policy
    view = asked(OPEN, "/view/1/").headers["content-security-policy"]
    assert "script-src 'self' 'unsafe-inline'" in view and "frame-ancestors 'self'" in view


def test_an_upload_is_bounded_whether_or_not_it_tells_its_length() -> None:
    valid = "valid: at most 100000 bytes"
    told = asked(OPEN, "/echo", "POST", content=b"1" * 100_001)
    assert told.status_code == 413 and valid in told.json()["error"]

    async def chunks() -> Any:
        for _ in range(30):
            yield b"1" * 10_000

    streamed = asked(OPEN, "/echo", "POST", content=chunks())
    assert streamed.status_code == 413 and valid in streamed.json()["error"]
    lies = asked(OPEN, "/echo", "POST", content=chunks(), headers={"content-length": "5"})
    assert lies.status_code == 413
    fits = asked(OPEN, "/echo", "POST", content=b"1" * 4000)
    assert fits.status_code != 413
    wrong = asked(OPEN, "/echo", "POST", content=b"1", headers={"content-length": "-1"})
    assert wrong.status_code == 400


@pytest.mark.parametrize(
    "access,path,length,status",
    [
        (OPEN, "/echo", 190_000, 413),
        (FLEET, "/echo", 90_000, 401),
        (OPEN, "/nowhere", 90_000, 404),
        (OPEN, "/", 90_000, 405),
    ],
)
def test_who_sends_before_it_reads_can_read_why_it_was_refused(
    access: Access, path: str, length: int, status: int
) -> None:
    with served(access) as port:
        with socket.create_connection(("127.0.0.1", port), timeout=10) as connection:
            head = f"POST {path} HTTP/1.1\r\nHost: localhost\r\nContent-Length: {length}\r\n\r\n"
            connection.sendall(head.encode())
            for _ in range(10):
                time.sleep(0.01)  # a server that closed meanwhile breaks the pipe here
                connection.sendall(b"1" * (length // 10))
            assert connection.recv(99).startswith(f"HTTP/1.1 {status} ".encode())


def test_a_websocket_passes_the_same_guard() -> None:
    with served(FLEET) as port:
        place = f"ws://127.0.0.1:{port}/view/1/"
        with connect(place, additional_headers={"Cookie": f"{COOKIE}={TOKEN}"}) as socket_:
            assert socket_.recv() == "hello"
        with pytest.raises(InvalidStatus) as refused:
            connect(place)
        assert refused.value.response.status_code == 403
        with pytest.raises(InvalidStatus):
            connect(f"{place}?token={TOKEN}")
    with served(OPEN) as port:
        with connect(f"ws://127.0.0.1:{port}/view/1/") as socket_:
            assert socket_.recv() == "hello"
        with pytest.raises(InvalidStatus) as refused:
            connect(f"ws://127.0.0.1:{port}/view/1/", origin=Origin("http://evil.example"))
        assert refused.value.response.status_code == 403
        pointed = socket.create_connection(("127.0.0.1", port))
        with pytest.raises(InvalidStatus) as refused:
            connect(f"ws://evil.example:{port}/view/1/", sock=pointed)
        assert refused.value.response.status_code == 403


def test_no_token_stands_in_a_log(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.DEBUG), served(FLEET) as port:
        for name in ("uvicorn", "uvicorn.access", "uvicorn.error"):
            logging.getLogger(name).addHandler(caplog.handler)
        httpx.get(f"http://127.0.0.1:{port}/?token={TOKEN}")
        with pytest.raises(InvalidStatus):
            connect(f"ws://127.0.0.1:{port}/view/1/?token={TOKEN}")
    said = [record for record in caplog.records if record.name.startswith("uvicorn")]
    assert all(TOKEN not in record.getMessage() for record in said)
    assert TOKEN not in repr(FLEET)


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "::1", "[::1]", "127.8.9.1"])
def test_a_loopback_address_needs_no_token(host: str) -> None:
    access = access_of(host)
    assert access.token is None and access.is_loopback
    assert access_of(host, environment={"BOXGRASP_TOKEN": TOKEN}).token == TOKEN


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.1.4", "robot.local", "::ffff:10.0.0.1"])
def test_every_other_address_has_a_token(host: str, tmp_path: Path) -> None:
    made = access_of(host)
    assert made.token is not None and len(made.token) >= 32 and made.is_made
    assert access_of(host).token != made.token
    assert f"?token={made.token}" in made.url(8080)
    assert made.token not in made.url(8080, with_token=False)
    file = tmp_path / "token"
    file.write_text(TOKEN + "\n")
    given_ = access_of(host, str(file), {"BOXGRASP_TOKEN": "another-0123456789"})
    assert given_.token == TOKEN and not given_.is_made


def test_a_faulty_token_or_host_is_refused_without_being_told(tmp_path: Path) -> None:
    for token in ("short", "with blanks 0123456789", "x" * 201, 'quote"0123456789abc'):
        with pytest.raises(ConfigError, match="valid: 16 to 200") as refused:
            access_of("0.0.0.0", None, {"BOXGRASP_TOKEN": token})
        assert token not in str(refused.value)
    with pytest.raises(ConfigError, match="No such file"):
        access_of("0.0.0.0", str(tmp_path / "none"))
    (tmp_path / "bytes").write_bytes(b"\xff\xfe")
    with pytest.raises(ConfigError, match="is no text"):
        access_of("0.0.0.0", str(tmp_path / "bytes"))
    for host in ("", "a b", "http://x/"):
        with pytest.raises(ConfigError, match="valid: an address"):
            access_of(host)


def test_the_address_can_be_opened() -> None:
    assert OPEN.url(8080) == "http://127.0.0.1:8080/"
    assert access_of("::1").url(8080) == "http://[::1]:8080/"
    assert access_of("0.0.0.0").url(1).startswith(f"http://{socket.gethostname()}:1/?token=")
