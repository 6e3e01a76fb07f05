"""What goes wrong round the labeling page costs one clear line or notice, and no label."""

from __future__ import annotations

import io
import json
import socket
import sqlite3
from collections.abc import Iterator
from contextlib import closing, redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

import httpx
import pytest
from label_browser import Labeling, Server, chromium
from test_label_kills import captures
from test_label_record import small_disk

from boxgrasp.cli import main
from boxgrasp.labeling.record import Record

TOKEN = "a-token-of-this-very-test"


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium(drawing=False) as found:
        yield found


@pytest.fixture(autouse=True)
def own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What a command writes where it is started lies in a folder of the test."""
    monkeypatch.chdir(tmp_path)


def refused(*words: str) -> str:
    """What a command that cannot start says: one line, and exit status 2."""
    err = io.StringIO()
    with redirect_stderr(err), redirect_stdout(io.StringIO()):
        status = main(["label", *words, "--no-browser"])
    lines = [line for line in err.getvalue().splitlines() if line.startswith("boxgrasp: ")]
    assert status == 2, err.getvalue()
    assert len(lines) == 1 and "Traceback" not in err.getvalue(), err.getvalue()
    assert "valid:" in lines[0]
    return lines[0]


def test_a_source_that_is_none(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "set").mkdir()
    (tmp_path / "set" / "set.json").write_text("{")
    database = str(tmp_path / "labels.sqlite")
    assert "nothing to label" in refused(str(tmp_path / "empty"), "--database", database)
    assert "set.json is damaged" in refused(str(tmp_path / "set"), "--database", database)
    assert "no such file" in refused(str(tmp_path / "nowhere"), "--database", database)


def test_a_database_that_is_none(tmp_path: Path) -> None:
    source = str(captures(tmp_path / "captures", 1))
    text = tmp_path / "text.sqlite"
    text.write_text("no database " * 1000)
    assert "text.sqlite" in refused(source, "--database", str(text))
    newer = tmp_path / "newer.sqlite"
    Record.open(str(newer)).close()
    with closing(sqlite3.connect(newer)) as connection:
        connection.execute("UPDATE boxgrasp_labels_version SET version_num = '9999'")
        connection.commit()
    assert "9999" in refused(source, "--database", str(newer))
    unreachable = "postgresql+pg8000://me:secret@127.0.0.1:1/labels"
    assert "secret" not in refused(source, "--database", unreachable)


def test_a_port_in_use(tmp_path: Path) -> None:
    source = str(captures(tmp_path / "captures", 1))
    with closing(socket.create_server(("127.0.0.1", 0))) as taken:
        port = str(taken.getsockname()[1])
        words = (source, "--database", str(tmp_path / "labels.sqlite"), "--port", port)
        assert port in refused(*words)
    with Server(source, "--database", str(tmp_path / "stopped.sqlite")) as server:
        assert server.stop() == 0
        assert "every label that was saved is in the record" in "".join(server.lines)
    for words in (("--host", "no such host"), ("--again-share", "2"), ("--port", "70000")):
        assert words[0].strip("-") in refused(
            source, "--database", str(tmp_path / "refused.sqlite"), *words
        )


def test_a_full_disk_and_a_lost_browser(browser: Any, tmp_path: Path) -> None:
    source = captures(tmp_path / "captures", 4)
    with small_disk(tmp_path / "small", 900) as disk:
        database = disk / "labels.sqlite"
        words = (str(source), "--database", str(database), "--captures", str(tmp_path / "kept"))
        with Server(*words, "--again-share", "0") as server:
            ada = Labeling(browser, server.url, "Ada")
            first = ada.save("2", "2")
            here = ada.scene_key
            filler = disk / "filler"
            with pytest.raises(OSError), filler.open("wb", buffering=0) as file:
                while True:
                    file.write(b"0" * 512)
            ada.press("3", "1", "Enter")
            ada.page.wait_for_selector("#notice:not([hidden])")
            assert "Not saved" in ada.page.inner_text("#notice")
            assert "disk" in ada.page.inner_text("#notice")
            assert ada.scene_key == here
            filler.unlink()
            # The choice still stands: one more key saves it.
            before = ada.serial
            ada.press("Enter")
            ada.shown(before)
            # A browser that is gone leaves nothing behind; another one goes on where it was.
            here = ada.scene_key
            ada.close()
            again = Labeling(browser, server.url, "Ada")
            assert again.scene_key == here
            again.close()
        with Record.open(str(database)) as record:
            kept = {row.scene_key: row.label for row in record.standing()}
        assert kept.pop(first) == 5 and list(kept.values()) == [7]


def test_a_wrong_token(browser: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = captures(tmp_path / "captures", 1)
    monkeypatch.setenv("BOXGRASP_TOKEN", TOKEN)
    with Server(str(source), "--database", str(tmp_path / "labels.sqlite")) as server:
        for path in ("", "api/start", "openapi.json", "page/page.js", "view/x/"):
            for headers in ({}, {"Authorization": "Bearer wrong"}):
                answer = httpx.get(server.url + path, headers=headers)
                assert answer.status_code == 401 and "token" in answer.json()["error"]
        large = httpx.post(
            f"{server.url}select",
            headers={
                "Authorization": f"Bearer {TOKEN}",
                "Content-Type": "application/octet-stream",
            },
            content=b"0" * ((64 << 20) + 1),
            timeout=60,
        )
        assert large.status_code == 413 and "valid: at most" in large.json()["error"]
        context = browser.new_context()
        page = context.new_page()
        page.goto(f"{server.url}?token={TOKEN}")
        assert TOKEN not in page.url
        page.fill("#name", "Ada")
        page.keyboard.press("Enter")
        page.wait_for_selector("body[data-serial]")
        assert json.loads(page.evaluate("JSON.stringify(state.shown !== null)"))
        context.close()
        assert TOKEN not in "".join(server.lines)
