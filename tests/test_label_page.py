"""The labeling page in a real Chromium, by mouse and by keyboard, over a killed server."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from label_browser import Labeling, Server, answers, chromium

from boxgrasp.labeling.record import Record

SIMULATED = ("simulated_1.npz", "simulated_2.npz", "simulated_3.npz")
REAL = ("6dofgn_cheezit", "uois_00")
# Screenshots to be looked at, in a folder that the environment names.
_SHOTS = os.environ.get("BOXGRASP_SHOTS")
SHOTS = None if _SHOTS is None else Path(_SHOTS)


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Drawing by software takes both cores: only who clicks in the cloud, or looks, has it."""
    with chromium(drawing=SHOTS is not None) as found:
        yield found


@pytest.fixture
def source(captures_dir: Path, tmp_path: Path) -> Path:
    """Three simulated scenes and the things of two real captures."""
    folder = tmp_path / "captures"
    folder.mkdir()
    for name in SIMULATED:
        shutil.copy(captures_dir / name, folder)
    for name in REAL:
        shutil.copytree(captures_dir / name, folder / name)
    return folder


@pytest.mark.slow
def test_session(browser: Any, source: Path, tmp_path: Path) -> None:
    database = tmp_path / "labels.sqlite"
    said: dict[str, tuple[str, int | None]] = {}
    with Server(str(source), "--database", str(database), "--again-share", "0") as server:
        ada = Labeling(browser, server.url, "Ada")
        ada.shot(SHOTS, "first")
        # By keyboard: front, line 2; then none.
        said[ada.save("2", "2")] = ("candidate", 5)
        said[ada.save("0")] = ("none", None)
        # By mouse, on the page's buttons.
        key, before = ada.scene_key, ada.serial
        ada.page.click("#face-4")
        ada.page.click("#line-3")
        ada.page.fill("#note", "<b>tall</b> & round")
        ada.shot(SHOTS, "chosen")
        ada.page.click("#save")
        ada.shown(before)
        said[key] = ("candidate", 12)
        # A label taken back, and given anew; it is the same scene.
        undone = ada.save("1", "1")
        before = ada.serial
        ada.page.click("#undo")
        ada.shown(before)
        assert ada.scene_key == undone
        said[ada.save("3", "3")] = ("candidate", 9)
        # Back through two, and the earlier one is corrected.
        for _ in range(2):
            before = ada.serial
            ada.press("b")
            ada.shown(before)
        assert ada.scene_key == key
        assert ada.page.input_value("#note") == "<b>tall</b> & round"
        ada.shot(SHOTS, "corrected")
        waiting = ada.save("5", "1")
        assert waiting == key
        said[key] = ("candidate", 13)
        # The page loaded again shows the same scene.
        here = ada.scene_key
        ada.page.reload()
        ada.page.wait_for_selector("body[data-serial]")
        assert ada.scene_key == here
        # The server is killed while the page stands; the label waits in the page.
        server.kill()
        ada.press("2", "1", "Enter")
        ada.page.wait_for_selector("#lost:not([hidden])")
        ada.shot(SHOTS, "lost")
        server.start()
        ada.page.wait_for_function("key => state.shown.scene_key !== key", arg=here)
        ada.page.wait_for_selector("#lost", state="hidden")
        said[here] = ("candidate", 4)
        # The box is wrong, and the right thing is shown in the image.
        wrong, before = ada.scene_key, ada.serial
        ada.press("w")
        box = ada.page.locator("#image").bounding_box()
        ada.page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
        ada.page.wait_for_selector("#spot:not([hidden])")
        ada.shot(SHOTS, "wrong")
        ada.press("Enter")
        ada.shown(before)
        said[wrong] = ("box_wrong", None)
        _label_the_rest(ada, said)
        _learn(ada)
        assert ada.faults == [] or SHOTS is None
        ada.close()
    with Record.open(str(database)) as record:
        assert answers(record.standing()) == {key: [what] for key, what in said.items()}
        pixel = next(row.pixel for row in record.standing() if row.verdict == "box_wrong")
        assert pixel is not None
        notes = [row.note for row in record.history(key)]
        assert "<b>tall</b> & round" in notes


def _label_the_rest(ada: Labeling, said: dict[str, tuple[str, int | None]]) -> None:
    for k in range(20):
        if ada.state["shown"] is None:
            break
        said[ada.save("4", "2") if k % 2 else ada.save("0")] = (
            ("candidate", 11) if k % 2 else ("none", None)
        )
    assert "Everything is labeled" in ada.page.inner_text("#empty")


def _learn(ada: Labeling) -> None:
    """Learns from the labels, sees the curve, and lets the new models propose, and the old ones."""
    ada.press("l")
    ada.page.click("#learn-now")
    ada.page.wait_for_selector("#learn-box[data-state=done]", timeout=300_000)
    ada.shot(SHOTS, "learned")
    assert ada.page.locator("#curve polyline").count() == 4
    assert "agrees with you" in ada.page.inner_text("#learn-table")
    models = ada.page.locator("#models input")
    assert models.count() == 2
    usable = not models.nth(1).is_disabled()
    if usable:
        models.nth(1).check()
        ada.page.wait_for_function("() => state.model.endsWith(' 1')", polling=50)
    models.nth(0).check()
    ada.page.wait_for_function("() => !/ [0-9]/.test(state.model)", polling=50)


@pytest.mark.slow
def test_the_robot_asks(browser: Any, source: Path, tmp_path: Path) -> None:
    """A robot that finds nothing asks on the page, and takes what the person chooses."""
    database = tmp_path / "labels.sqlite"
    config = tmp_path / "careful.yaml"
    config.write_text("checks: {visible_clearance_m: 0.45}\n")
    common = ("--config", str(config))
    words = (str(source / REAL[1]), "--database", str(database), "--again-share", "0", *common)
    with Server(*words, command="assist") as server:
        bo = Labeling(browser, server.url, "Bo")
        assert "The robot asks" in bo.page.inner_text("#proposal")  # nothing passes such checks
        asked = [sys.executable, "-m", "boxgrasp", "select", str(source / SIMULATED[0]), *common]
        robot = subprocess.Popen(
            [*asked, "--json", "--assist", server.url.rstrip("/"), "--assist-seconds", "60"],
            stdout=subprocess.PIPE,
        )
        bo.page.wait_for_selector("#asks:not([hidden])", timeout=60_000)
        aside, before = bo.scene_key, bo.serial
        for key in ("a", "s", "a"):  # shown, put off, and shown again
            bo.press(key)
            before = bo.shown(before)
        assert bo.scene_key != aside
        bo.press("4", "2")
        bo.page.wait_for_selector("#failed:not([hidden])")
        overridden = bo.page.inner_text("#failed")
        bo.shot(SHOTS, "asked")
        before = bo.serial
        bo.press("Enter")
        bo.shown(before)
        assert bo.scene_key == aside  # the scene that waited
        answer = json.loads(robot.communicate(timeout=60)[0])
        bo.close()
    assert (answer["status"], answer["ranker"]) == ("grasp", "person")
    assert answer["grasp"]["label"] == 11
    failed = [c for c in answer["candidates"][10]["checks"].items() if not c[1]["passed"]]
    assert failed and "visible clearance" in overridden
    with Record.open(str(database)) as record:
        (label,) = record.standing()
    assert (label.origin, label.label, label.operator) == ("ask", 11, "Bo")
    assert {item["check"] for item in label.overridden} == {name for name, _ in failed}


def test_assist(browser: Any, source: Path, tmp_path: Path) -> None:
    """The robot proposes; the operator confirms, and takes another one."""
    database = tmp_path / "labels.sqlite"
    words = (str(source / REAL[0]), "--database", str(database), "--again-share", "0")
    with Server(*words, command="assist") as server:
        bo = Labeling(browser, server.url, "Bo")
        proposed = bo.state["shown"]["proposal"]["label"]
        assert proposed == bo.page.evaluate("mine.label")
        assert "The robot proposes" in bo.page.inner_text("#proposal")
        bo.shot(SHOTS, "proposed")
        bo.save()
        bo.close()
    with Record.open(str(database)) as record:
        (label,) = record.standing()
    assert (label.origin, label.label, label.proposed) == ("assist", proposed, proposed)
    assert label.overridden == ()
