"""The cloud on the labeling page, drawn by a real Chromium: a click on a line chooses it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from label_browser import Labeling, Server, chromium

from boxgrasp.draw.shapes import contact_line
from boxgrasp.execution import Store
from boxgrasp.labeling.captures import CaptureStore
from boxgrasp.labeling.record import Record
from boxgrasp.labeling.server.prepared import prepare
from boxgrasp.labeling.server.view import opening_rad
from boxgrasp.labeling.sources import load_scene
from boxgrasp.labeling.words import LabelScene
from boxgrasp.selector import GraspSelector


def test_a_click_on_a_line_chooses_it(captures_dir: Path, tmp_path: Path) -> None:
    database = tmp_path / "labels.sqlite"
    words = (
        str(captures_dir / "simulated_1.npz"),
        "--database",
        str(database),
        "--again-share",
        "0",
    )
    with Server(*words) as server, chromium() as browser:
        ada = Labeling(browser, server.url, "Ada")
        with Record.open(str(database)) as record:
            scene = record.scene(ada.scene_key)
        clicked = _click_line(ada, scene, tmp_path / "labels-captures")
        assert ada.page.evaluate("mine.label") == clicked
        ada.save()
        assert ada.faults == []
        ada.close()
    with Record.open(str(database)) as record:
        assert [row.label for row in record.standing()] == [clicked]


def _click_line(ada: Labeling, scene: LabelScene, captures: Path) -> int:
    """Clicks in the cloud on the middle of a line that faces the camera; the line's label."""
    loaded = load_scene(scene, CaptureStore(Store(captures)))
    selector = GraspSelector()
    prepared = prepare(scene, loaded.capture, loaded.target, selector)
    box = prepared.selection.box
    camera = prepared.camera_position_m
    facing = max(
        prepared.selection.candidates[:9],  # of the sides; those on top cross one another
        key=lambda item: -item.T_base_gripper[:3, 0] @ (camera - box.T_base_box[:3, 3]),
    )
    middle = contact_line(facing, box).mean(axis=0)
    forward = box.T_base_box[:3, 3] - camera
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    x, y, z = (float(axis @ (middle - camera)) for axis in (right, down, forward))
    place = ada.page.locator("#view").bounding_box()
    focal_px = place["height"] / 2 / np.tan(opening_rad(prepared) / 2)
    ada.page.wait_for_timeout(3000)  # until a software renderer has drawn the cloud
    ada.page.mouse.click(
        place["x"] + place["width"] / 2 + focal_px * x / z,
        place["y"] + place["height"] / 2 + focal_px * y / z,
    )
    ada.page.wait_for_function("() => mine.label !== null")
    return int(facing.label)
