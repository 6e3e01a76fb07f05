"""A labeling server as a user starts it, and the page in a real Chromium."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome")
# WebGL without a graphics card; and none, where the cloud is not what a test is about.
DRAWING = ("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
NOT_DRAWING = ("--disable-3d-apis", "--disable-gpu")
POLLING_MS = 20  # else it looks once a picture, and a software renderer makes few
PATIENCE_MS = 5_000
SIZE = {"width": 1280, "height": 720}


def chromium_path() -> str:
    found = next((path for path in map(shutil.which, NAMES) if path), None)
    if found is None:
        pytest.skip(f"no browser: none of {', '.join(NAMES)} is installed (apt install chromium)")
    return found


@contextlib.contextmanager
def chromium(*, drawing: bool = True) -> Iterator[Any]:
    """A headless browser, with or without the cloud; skips where there is none."""
    sync_api = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed")
    path = chromium_path()
    with sync_api.sync_playwright() as playwright:
        words = ["--no-sandbox", *(DRAWING if drawing else NOT_DRAWING)]
        browser = playwright.chromium.launch(executable_path=path, args=words)
        yield browser
        browser.close()


class Server:
    """`boxgrasp label` in a process of its own, which may be killed and started again."""

    def __init__(self, *words: str, command: str = "label") -> None:
        self.words = (command, *words)
        self.port = 0
        self.url = ""
        self.lines: list[str] = []
        self._process: subprocess.Popen[str] | None = None

    def __enter__(self) -> Server:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    @property
    def pid(self) -> int:
        assert self._process is not None
        return self._process.pid

    def start(self) -> None:
        words = [*self.words, "--no-browser", "--port", str(self.port)]
        process = subprocess.Popen(
            [sys.executable, "-m", "boxgrasp", *words],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            env={**os.environ, "PYTHONUNBUFFERED": "1"},
        )
        self._process = process
        assert process.stdout is not None
        for line in process.stdout:
            self.lines.append(line)
            told = re.search(r"(http://\S+:(\d+)/\S*)", line)
            if told:
                self.url, self.port = told[1], int(told[2])
                # What follows is read too, or a full pipe would hold the server up.
                self._reader = threading.Thread(target=self.lines.extend, args=(process.stdout,))
                self._reader.start()
                return
        raise AssertionError("".join(self.lines))

    def kill(self) -> None:
        assert self._process is not None
        self._process.kill()
        self._process.wait()

    def stop(self) -> int:
        if self._process is None or self._process.poll() is not None:
            return 0
        self._process.send_signal(signal.SIGINT)
        status = self._process.wait(20)
        self._reader.join()
        return status


class Labeling:
    """One operator's page, driven as a person drives it."""

    def __init__(self, browser: Any, url: str, operator: str) -> None:
        from playwright.sync_api import TimeoutError

        self._timed_out = TimeoutError
        self.context = browser.new_context(viewport=SIZE)
        self.page = self.context.new_page()
        self.faults: list[str] = []
        self.page.on("pageerror", lambda error: self.faults.append(str(error)))
        self.operator = operator
        self.open(url)

    def open(self, url: str) -> None:
        self.page.goto(url)
        self.page.wait_for_selector("#start-box[open]")
        self.page.fill("#name", self.operator)
        self.page.keyboard.press("Enter")
        self.shown()

    def shown(self, after: int | None = None) -> int:
        """Waits until the page shows a scene, or another one than before."""
        before = -1 if after is None else after
        self.page.wait_for_function(
            "before => Number(document.body.dataset.serial ?? -1) > before",
            arg=before,
            polling=POLLING_MS,
        )
        return self.serial

    @property
    def serial(self) -> int:
        return int(self.page.evaluate("document.body.dataset.serial ?? -1"))

    @property
    def state(self) -> dict[str, Any]:
        return dict(self.page.evaluate("state"))

    @property
    def scene_key(self) -> str:
        return str(self.state["shown"]["scene_key"])

    def press(self, *keys: str) -> None:
        for key in keys:
            self.page.keyboard.press(key)

    def save(self, *keys: str) -> str:
        """Chooses by keys, saves, and waits for the next scene; the key of what was labeled.

        Keys that came while the page waited for a lost server are given again, as people do.
        """
        self.settled()
        key, before = self.scene_key, self.serial
        while True:
            self.press(*keys, "Enter")
            with contextlib.suppress(self._timed_out):
                self.page.wait_for_function(
                    "before => document.body.dataset.serial !== String(before)",
                    arg=before,
                    timeout=PATIENCE_MS,
                    polling=POLLING_MS,
                )
            self.settled()
            shown = self.state["shown"]
            if shown is None or shown["scene_key"] != key:
                return key
            before = self.serial  # the same scene still, or by a server that was started again
            self.press("Escape", "Escape")

    def settled(self) -> None:
        """Waits until nothing is under way: no lost server, no label that is not confirmed."""
        self.page.wait_for_function(
            "() => state && !busy && !returning && localStorage.getItem(PENDING) === null",
            polling=POLLING_MS,
            timeout=120_000,
        )

    def shot(self, folder: Path | None, name: str) -> None:
        if folder is not None:
            self.page.wait_for_timeout(1500)  # until a software renderer has drawn the cloud
            self.page.screenshot(path=folder / f"{name}.png")

    def close(self) -> None:
        self.context.close()


def answers(rows: Sequence[Any]) -> dict[str, list[tuple[str, int | None]]]:
    """What stands of each scene: verdict and label."""
    found: dict[str, list[tuple[str, int | None]]] = {}
    for row in rows:
        found.setdefault(row.scene_key, []).append((row.verdict, row.label))
    return found
