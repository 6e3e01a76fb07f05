"""The hands that ship against the makers' models, measured by tools/measure_hands.py."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from boxgrasp.cli import main
from boxgrasp.config import gripper_names, load_gripper
from boxgrasp.draw import draw_gripper
from boxgrasp.draw.hands import gripper_facts
from boxgrasp.grasps.gripper import Gripper, HandBox

Floats = NDArray[np.float64]
FOLDER = Path(__file__).parent
MEASURED: dict[str, Any] = json.loads((FOLDER / "hand_measurements.json").read_text("utf-8"))
BAR_MM = 2.0
# What the makers say: mm between the fingers, and where the hand's x = 0 lies before the flange.
OPENING_MM = {
    "robotiq-2f-85": 85.0,
    "robotiq-2f-140": 140.0,
    "franka-hand": 80.0,  # 2 x 40, panda_finger_joint1
    "wsg-50": 104.0,  # 110 between the jaws, 3 on each WSG-FMF finger
    "pal-gripper": 90.0,  # 2 x 45, gripper_left_finger_joint
    "stretch-gripper": 90.0,  # open_aperture_m
    "xarm-gripper": 84.0,  # set_gripper_g2_position; the fingers of the model leave 89
}
# The arms that swing the fingers: mm along y and x at full opening, and by how many rad they turn.
ARMS = {
    "robotiq-2f-85": (37.6, 43.0, 0.8),
    "robotiq-2f-140": (64.66, 76.28, 0.7),
    "xarm-gripper": (35.465, 42.039, 0.85),
}
AHEAD_MM = {"franka-hand": -26.0, "stretch-gripper": 21.0}
HANDS = sorted(MEASURED)


def boxes_mm(boxes: tuple[HandBox, ...]) -> Floats:
    """(B, 3, 2) ends along x, y, z."""
    return 1000 * np.array([(box.x_m, box.y_m, box.z_m) for box in boxes])


def slices_mm(name: str, side: str) -> Floats:
    """(S, 6) of all parts on a side."""
    parts = [part for part in MEASURED[name]["parts"] if part["side"] == side]
    return np.array([row for part in parts for row in part["slices_mm"]])


def farthest_out(rows: Floats, boxes: Floats) -> float:
    """How far any place of the slices lies outside of all boxes, mm: 5 x 5 x 5 places of each."""
    steps = np.linspace(0.0, 1.0, 5)
    grid = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
    ends = rows.reshape(-1, 3, 2)
    points = (ends[:, None, :, 0] + grid * np.ptp(ends, axis=2)[:, None]).reshape(-1, 3)
    over = np.maximum(
        boxes[None, :, :, 0] - points[:, None], points[:, None] - boxes[None, :, :, 1]
    )
    return float(np.linalg.norm(np.maximum(over, 0.0), axis=2).min(axis=1).max())


def loosest(rows: Floats, boxes: Floats) -> float:
    """How far the outermost face of any box lies from the slices that it holds, mm."""
    ends = rows.reshape(-1, 3, 2)
    gaps = []
    for box in boxes:
        meets = ((ends[:, :, 1] > box[:, 0] + 0.1) & (ends[:, :, 0] < box[:, 1] - 0.1)).all(axis=1)
        held = ends[meets]
        gaps += [np.abs(held[:, axis, k] - box[axis, k]).min() for axis in range(3) for k in (0, 1)]
    return float(max(gaps))


def test_all_that_were_measured_ship_and_the_thesis() -> None:
    assert set(gripper_names()) == {*MEASURED, "thesis"}
    assert gripper_names()[0] == "thesis"


def test_the_thesis_hand_is_the_default() -> None:
    assert load_gripper("thesis") == Gripper()


@pytest.mark.parametrize("name", HANDS)
def test_boxes_hold_the_maker_s_model(name: str) -> None:
    hand = load_gripper(name)
    boxes = boxes_mm((*hand.palm, *hand.finger))
    assert farthest_out(slices_mm(name, "palm"), boxes) <= BAR_MM
    assert farthest_out(slices_mm(name, "finger"), boxes) <= BAR_MM


@pytest.mark.parametrize("name", HANDS)
def test_every_face_of_a_box_is_a_face_of_the_model(name: str) -> None:
    hand = load_gripper(name)
    moved = slices_mm(name, "finger")
    mirrored = moved[:, (0, 1, 3, 2, 4, 5)] * (1, 1, -1, -1, 1, 1)
    rows = np.concatenate((slices_mm(name, "palm"), moved, mirrored))
    assert loosest(rows, boxes_mm((*hand.palm, *hand.finger))) <= BAR_MM


@pytest.mark.parametrize("name", HANDS)
def test_sizes_and_opening_are_the_model_s(name: str) -> None:
    hand = load_gripper(name)
    palm, moved = slices_mm(name, "palm"), slices_mm(name, "finger")
    tip = moved[:, 1].max()
    assert 1000 * hand.length_m == pytest.approx(tip, abs=BAR_MM)
    width = 2 * max(-palm[:, 2].min(), palm[:, 3].max(), moved[:, 3].max())
    assert 1000 * hand.width_m == pytest.approx(width, abs=BAR_MM)
    both = np.concatenate((palm, moved))
    thickness = 2 * max(-both[:, 4].min(), both[:, 5].max())
    assert 1000 * hand.thickness_m == pytest.approx(thickness, abs=BAR_MM)
    assert 1000 * hand.max_opening_m == OPENING_MM[name]
    pads = moved[moved[:, 1] > tip - 2 * 1000 * hand.insertion_depth_m]  # half of one is inserted
    gap = 2 * pads[:, 2].min()
    assert gap >= OPENING_MM[name] - 0.5
    if name != "xarm-gripper":
        assert gap == pytest.approx(OPENING_MM[name], abs=BAR_MM)


@pytest.mark.parametrize("name", HANDS)
def test_closing_fingertips_go_as_far_as_their_arms_turn(name: str) -> None:
    said = 1000 * load_gripper(name).closing_advance_m
    if name in ARMS:
        y, x, turn = ARMS[name]
        angles = np.arctan2(x, y) + np.linspace(0.0, turn, 100)
        assert said == pytest.approx(np.hypot(x, y) * np.sin(angles).max() - x, abs=1.0)
    else:
        assert said == (3.0 if name == "stretch-gripper" else 0.0)


@pytest.mark.parametrize("name", HANDS)
def test_flange_lies_where_the_maker_has_it(name: str) -> None:
    hand = load_gripper(name)
    assert hand.flange_pose is not None
    T = hand.flange_pose
    out = np.array((1.0, 0.0, 0.0)) if name == "pal-gripper" else np.array((0.0, 0.0, 1.0))
    assert np.allclose(T[:3, 0], out), "the approach leaves the flange"
    back = T[:3, 3] - hand.length_m / 2 * T[:3, 0]
    assert np.allclose(1000 * back, AHEAD_MM.get(name, 0.0) * out, atol=0.1)
    opening = {
        "franka-hand": (np.sqrt(0.5), np.sqrt(0.5), 0.0),  # y of panda_hand, turned by -45 degrees
        "pal-gripper": (0.0, 0.0, -1.0),
        "stretch-gripper": (-1.0, 0.0, 0.0),
        "xarm-gripper": (0.0, 1.0, 0.0),
    }.get(name, (1.0, 0.0, 0.0))
    assert np.allclose(T[:3, 1], opening)


def test_franka_s_tool_point_is_the_maker_s() -> None:
    hand = load_gripper("franka-hand")
    assert hand.flange_pose is not None
    T_flange_tcp = hand.flange_pose @ hand.tcp_pose
    assert np.allclose(T_flange_tcp[:3, 3], (0.0, 0.0, 0.1034), atol=1e-4)


@pytest.mark.parametrize("name", HANDS)
def test_boxes_are_hardly_larger_than_the_parts_outlines(name: str) -> None:
    """At most 1.75 times the convex outlines of the parts; open linkages cost most."""
    parts = MEASURED[name]["parts"]
    outlines = sum(part["hull_cm3"] * (1 if part["side"] == "palm" else 2) for part in parts)
    assert union_cm3(load_gripper(name)) <= 1.75 * outlines


def union_cm3(hand: Gripper) -> float:
    """What a hand's boxes hold together, counted in cells of 2 mm."""
    size = 0.002
    axes = [np.arange(-half + size / 2, half, size) for half in hand.half_m]
    held = np.zeros([len(axis) for axis in axes], bool)
    for low, high in hand.boxes_m:
        within = [(axis > low[k]) & (axis < high[k]) for k, axis in enumerate(axes)]
        held |= within[0][:, None, None] & within[1][None, :, None] & within[2][None, None, :]
    return float(held.sum()) * size**3 * 1e6


@pytest.mark.parametrize("name", ["thesis", *HANDS])
def test_every_number_has_a_source(name: str) -> None:
    text = (FOLDER.parent / f"src/boxgrasp/grasps/hands/{name}.yaml").read_text("utf-8")
    lines = text.splitlines()
    for k, line in enumerate(lines):
        key = line.split(":")[0]
        if key in ("max_opening_m", "insertion_depth_m", "palm", "finger", "T_flange_gripper"):
            assert lines[k - 1].startswith("# "), line


def test_a_hand_that_is_wrong_is_found() -> None:
    """The measures can fail: a finger 3 mm short, and one 3 mm too wide."""
    hand = load_gripper("wsg-50")
    rows, boxes = slices_mm("wsg-50", "finger"), boxes_mm((*hand.palm, *hand.finger))
    boxes[-1, 0, 1] -= 3.0
    assert farthest_out(rows, boxes) > BAR_MM
    boxes[-1, 0, 1] += 3.0
    boxes[-1, 1, 1] += 3.0
    assert loosest(rows, boxes[-1:]) > BAR_MM


# The command.


def test_list_has_all(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["gripper", "list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == ["hand", *gripper_names()]


def test_show_prints_what_load_reads(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    picture, file = tmp_path / "hand.png", tmp_path / "own.yaml"
    words = ["gripper", "show", "robotiq-2f-85", "--picture", str(picture), "--output", str(file)]
    assert main(words) == 0
    assert capsys.readouterr().out == f"{file}\n"
    assert load_gripper(file) == load_gripper("robotiq-2f-85")
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert main(["gripper", "show", str(file)]) == 0
    assert "robosuite 1.5.2" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("gripper", "required: list|show|from-urdf"),
        ("gripper draw", "invalid choice: 'draw'"),
        ("gripper show", "gripper show needs HAND"),
        ("gripper show nohand", "unknown gripper: nohand; valid: thesis, franka-hand"),
        ("gripper show nohand.yaml", "nohand.yaml: No such file"),
        ("gripper show thesis --palm a", "--palm does not go with gripper show"),
        ("gripper list thesis", "thesis does not go with gripper list"),
        ("gripper list --visual", "--visual does not go with gripper list"),
        ("gripper from-urdf a.urdf", "gripper from-urdf needs --palm, --fingers"),
        ("gripper from-urdf a.urdf --palm p --fingers a", "--fingers is 'a'; valid: two links"),
        ("gripper show thesis --picture a.txt", "suffix '.txt'; valid: .png"),
        ("gripper show thesis --output /nowhere/a.yaml", "/nowhere/a.yaml cannot be written"),
    ],
)
def test_mistakes_are_one_line(line: str, said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(line.split()) == 2
    text = capsys.readouterr().err
    assert said in text and text.startswith("boxgrasp: ") and text.count("\n") == 1


@pytest.mark.parametrize("name", ["thesis", "stretch-gripper"])
def test_pictures_have_all_boxes(name: str) -> None:
    hand = load_gripper(name)
    image = draw_gripper(hand)
    assert image.size[0] == 1600 and image.size[1] > 700
    facts = dict(gripper_facts(hand))
    assert facts["Opens"].startswith(f"{100 * hand.max_opening_m:.1f} cm")
    assert (facts["Flange"] == "not known") == (name == "thesis")
