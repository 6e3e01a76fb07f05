"""Two operators label at once while the server is killed: nothing is lost, nothing is doubled."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from label_browser import Labeling, Server, answers, chromium, chromium_path
from postgres_server import running_postgres

from boxgrasp import Capture
from boxgrasp.io.npz import save_npz
from boxgrasp.labeling.record import Record

OPERATORS = ("Ada", "Bo")
# How many scenes, and how often the server is killed meanwhile: here, and of the slow run.
SMALL = (12, 1)
LARGE = (1000, 20)


def cast(number: int) -> Capture:
    """A small view of a block on a table, another one for each number."""
    v, u = np.mgrid[:120, :160]
    rays = np.stack(((u - 80) / 130, (v - 60) / 130, np.ones(u.shape)), axis=-1)
    down = np.array([0.0, 0.6, 0.8])
    block = (np.abs(u - 70 - number % 20) < 12) & (np.abs(v - 60) < 12)
    depth = (0.7 - np.where(block, 0.08 + 0.00004 * number, 0.0)) / (rays @ down)
    intrinsics = np.array([[130.0, 0, 80], [0, 130, 60], [0, 0, 1]])
    return Capture(depth, intrinsics, target_pixel=(70 + number % 20, 60))


def captures(folder: Path, count: int) -> Path:
    folder.mkdir()
    for number in range(count):
        save_npz(cast(number), folder / f"{number:04d}.npz")
    return folder


@dataclass
class Operator:
    """Labels by keys until nothing is left, and notes what the page said was saved."""

    name: str
    url: str
    saved: dict[str, tuple[str, int | None]] = field(default_factory=dict)
    fault: BaseException | None = None

    def label(self) -> None:
        try:
            with chromium(drawing=False) as browser:
                page = Labeling(browser, self.url, self.name)
                page.page.set_default_timeout(120_000)
                rng = np.random.default_rng(len(self.name))
                while page.state["shown"] is not None:
                    face, line = (int(k) for k in rng.integers(1, (6, 4)))
                    none = rng.random() < 0.1
                    key = page.save(*(("0",) if none else (str(face), str(line))))
                    self.saved[key] = ("none", None) if none else ("candidate", 3 * face - 3 + line)
        except BaseException as error:
            self.fault = error


@pytest.fixture(params=["sqlite", "postgresql"])
def database(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[str]:
    with ExitStack() as stack:
        if request.param == "sqlite":
            yield str(tmp_path / "labels.sqlite")
        else:
            yield stack.enter_context(running_postgres()).new_database()


LONG = pytest.mark.skipif(
    not os.environ.get("BOXGRASP_LONG"), reason="four minutes a database: set BOXGRASP_LONG=1"
)


@pytest.mark.slow
@pytest.mark.parametrize("size", [SMALL, pytest.param(LARGE, marks=LONG)], ids=["small", "large"])
def test_killed_server(database: str, size: tuple[int, int], tmp_path: Path) -> None:
    chromium_path()
    count, kills = size
    source = captures(tmp_path / "captures", count)
    rng = np.random.default_rng(count)
    words = (str(source), "--database", database, "--captures", str(tmp_path / "kept"))
    with Server(*words, "--again-share", "0") as server:
        operators = [Operator(name, server.url) for name in OPERATORS]
        threads = [threading.Thread(target=item.label) for item in operators]
        for thread in threads:
            thread.start()
        # The moments are random among the labels, wherever the server is in one.
        for wanted in np.sort(rng.integers(1, count - 4, kills)).tolist():
            while sum(len(item.saved) for item in operators) < wanted and _anybody(threads):
                time.sleep(0.01)
            time.sleep(rng.uniform(0, 0.3))
            server.kill()
            server.start()
        for thread in threads:
            thread.join()
    for operator in operators:
        if operator.fault is not None:
            raise operator.fault
    with Record.open(database) as record:
        kept = {name: answers(record.standing(operator=name)) for name in OPERATORS}
        scenes = {scene.key for scene in record.scenes()}
        rows = sum(len(record.history(key)) for key in scenes)
    # Every label that the page called saved is there as it was given, and no scene has two.
    for item in operators:
        given = {key: [what] for key, what in item.saved.items()}
        other = [
            (key, kept[item.name].get(key), given.get(key))
            for key in kept[item.name].keys() | given.keys()
            if kept[item.name].get(key) != given.get(key)
        ]
        assert other == []
    assert rows == count == len(scenes)
    assert all(item.saved for item in operators)
    assert not operators[0].saved.keys() & operators[1].saved.keys()


def _anybody(threads: list[threading.Thread]) -> bool:
    return any(thread.is_alive() for thread in threads)
