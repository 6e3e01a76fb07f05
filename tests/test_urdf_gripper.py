"""A hand from a URDF: exact on boxes, the same from meshes, one line for what is wrong."""

from __future__ import annotations

import logging
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("yourdfpy")
trimesh = pytest.importorskip("trimesh")

from boxgrasp.cli import main  # noqa: E402
from boxgrasp.config import load_gripper  # noqa: E402
from boxgrasp.errors import GripperError, MissingExtraError  # noqa: E402
from boxgrasp.grasps.gripper import Gripper, HandBox  # noqa: E402
from boxgrasp.io import urdf  # noqa: E402
from boxgrasp.io.hand_boxes import SLICE_M, fit_boxes, slice_extents  # noqa: E402
from boxgrasp.io.urdf_gripper import gripper_from_urdf  # noqa: E402

PALM_SIZE = (0.04, 0.12, 0.08)  # along the palm's x, y, z; z is the approach
FINGER_SIZE = (0.02, 0.01, 0.06)


def box(size: tuple[float, ...], xyz: tuple[float, ...] = (0, 0, 0)) -> str:
    words = " ".join(map(str, size))
    return shape(f'<box size="{words}"/>', xyz)


def shape(geometry: str, xyz: tuple[float, ...] = (0, 0, 0), tag: str = "collision") -> str:
    at = " ".join(map(str, xyz))
    return f'<{tag}><origin xyz="{at}"/><geometry>{geometry}</geometry></{tag}>'


def link(name: str, inside: str = "") -> str:
    return f'<link name="{name}">{inside}</link>'


def joint(kind: str, parent: str, child: str, axis: str = "0 1 0", **more: str) -> str:
    """A joint; `xyz`, `rpy`, `limit` as 'lower upper', `mimic` as 'joint multiplier'."""
    limit = mimic = ""
    if "limit" in more:
        lower, upper = more["limit"].split()
        limit = f'<limit lower="{lower}" upper="{upper}" effort="1" velocity="1"/>'
    if "mimic" in more:
        name, multiplier = more["mimic"].split()
        mimic = f'<mimic joint="{name}" multiplier="{multiplier}" offset="0"/>'
    origin = f'<origin xyz="{more.get("xyz", "0 0 0")}" rpy="{more.get("rpy", "0 0 0")}"/>'
    return (
        f'<joint name="{child}_joint" type="{kind}">{origin}<parent link="{parent}"/>'
        f'<child link="{child}"/><axis xyz="{axis}"/>{limit}{mimic}</joint>'
    )


PARTS: Mapping[str, str] = {
    "flange": link("flange"),
    "palm": link("palm", box(PALM_SIZE, (0, 0, 0.04))),
    "left": link("left", box(FINGER_SIZE, (0, 0.005, 0.03))),
    "right": link("right", box(FINGER_SIZE, (0, -0.005, 0.03))),
    "flange_joint": joint("fixed", "flange", "palm", xyz="0 0 0.01", rpy="0 0 -0.7853981633974483"),
    "left_joint": joint("prismatic", "palm", "left", xyz="0 0 0.08", limit="0 0.04"),
    "right_joint": joint(
        "prismatic", "palm", "right", "0 -1 0", xyz="0 0 0.08", mimic="left_joint 1", limit="0 0.04"
    ),
}


def write(folder: Path, name: str = "hand.urdf", **changes: str) -> Path:
    """A hand of two sliding fingers, some of its parts changed."""
    path = folder / name
    text = "\n".join({**PARTS, **changes}.values())
    path.write_text(f'<?xml version="1.0"?>\n<robot name="two">\n{text}\n</robot>\n', "utf-8")
    return path


def read(path: Path, **more: Any) -> Gripper:
    return gripper_from_urdf(path, "palm", ("left", "right"), **more)


def assert_box(
    box: HandBox, x: tuple[float, ...], y: tuple[float, ...], z: tuple[float, ...]
) -> None:
    assert box.x_m == pytest.approx(x) and box.y_m == pytest.approx(y)
    assert box.z_m == pytest.approx(z)


def assert_two(hand: Gripper) -> None:
    """The sizes of PARTS."""
    (palm,), (finger,) = hand.palm, hand.finger
    assert_box(palm, (0, 0.08), (-0.06, 0.06), (-0.02, 0.02))
    assert_box(finger, (0.08, 0.14), (0.04, 0.05), (-0.01, 0.01))
    assert hand.max_opening_m == pytest.approx(0.08)
    assert (hand.length_m, hand.width_m) == pytest.approx((0.14, 0.12))
    assert hand.thickness_m == pytest.approx(0.04) and hand.closing_advance_m == 0.0


# What is exact.


def test_sliding_boxes_are_exact(tmp_path: Path) -> None:
    hand = read(write(tmp_path))
    assert_two(hand)
    assert hand.name == "two" and hand.insertion_depth_m == pytest.approx(0.02)
    wanted = [[0, 0, -1, 0], [0, 1, 0, 0], [1, 0, 0, 0.07], [0, 0, 0, 1]]
    assert np.allclose(hand.flange_pose, wanted), "the palm's own frame"


def test_flange_is_a_link_fixed_to_the_palm(tmp_path: Path) -> None:
    hand = read(write(tmp_path), flange="flange")
    half = np.sqrt(0.5)
    wanted = [[0, half, -half, 0], [0, half, half, 0], [1, 0, 0, 0.08], [0, 0, 0, 1]]
    assert np.allclose(hand.flange_pose, wanted)


def test_insertion_may_be_told(tmp_path: Path) -> None:
    assert read(write(tmp_path), insertion_depth_m=0.012).insertion_depth_m == 0.012


def test_fingers_may_be_named_in_any_order(tmp_path: Path) -> None:
    hand = gripper_from_urdf(write(tmp_path), "palm", ("right", "left"))
    assert_two(hand)
    assert hand.flange_pose is not None
    assert np.allclose(hand.flange_pose[:3, 1], (0, -1, 0)), "y points to the first finger"


def test_two_joints_that_follow_none_open_both(tmp_path: Path) -> None:
    alone = joint("prismatic", "palm", "right", "0 1 0", xyz="0 0 0.08", limit="-0.04 0")
    assert_two(read(write(tmp_path, right_joint=alone)))


def test_what_reaches_behind_the_palm_s_origin_is_in_the_hand(tmp_path: Path) -> None:
    hand = read(write(tmp_path, palm=link("palm", box(PALM_SIZE, (0, 0, 0.03)))))
    assert_box(hand.palm[0], (0, 0.08), (-0.06, 0.06), (-0.02, 0.02))
    assert_box(hand.finger[0], (0.09, 0.15), (0.04, 0.05), (-0.01, 0.01))
    assert hand.flange_pose is not None
    assert hand.flange_pose[2, 3] == pytest.approx(0.065)


def test_swinging_fingers_stand_at_the_open_end(tmp_path: Path) -> None:
    """Bars of 10 cm that turn outward by 0.2 rad; their cups hold the tips' rear 2 cm apart."""
    turn = {
        f"{side}_joint": joint(
            "revolute", "palm", side, "1 0 0", xyz=f"0 {at} 0.08", limit="-0.2 0.2", **follow
        )
        for side, at, follow in (
            ("left", 0.01, {}),
            ("right", -0.01, {"mimic": "left_joint -1"}),
        )
    }
    bars = {
        "left": link("left", box((0.02, 0.01, 0.1), (0, 0.005, 0.05))),
        "right": link("right", box((0.02, 0.01, 0.1), (0, -0.005, 0.05))),
    }
    hand = read(write(tmp_path, **turn, **bars))
    length, c, s = 0.1, np.cos(0.2), np.sin(0.2)
    assert hand.length_m == pytest.approx(0.08 + length * c + 0.01 * s, abs=1e-4) or (
        hand.length_m == pytest.approx(0.08 + length * c, abs=1e-4)
    )
    # The inner face is free from 2 cm before the tips on, to a slice.
    free = 2 * (0.01 + (length - 0.02 / c) * s)
    assert hand.max_opening_m == pytest.approx(free, abs=2 * SLICE_M * s + 2e-3)
    assert len(hand.palm) > 1, "the rest of the bars counts to the palm"
    # They meet 0.1 rad inward, where an outer corner of a bar is foremost.
    foremost = length * np.cos(0.1) + 0.01 * np.sin(0.1)
    assert hand.closing_advance_m == pytest.approx(foremost - length * c, abs=3e-4)
    assert all(box.y_m[0] >= hand.max_opening_m / 2 - 1e-4 for box in hand.finger)


def test_meshes_give_the_same_as_boxes(tmp_path: Path) -> None:
    (tmp_path / "my_hand" / "meshes").mkdir(parents=True)
    (tmp_path / "my_hand" / "urdf").mkdir()
    for name, size, middle in (
        ("palm", PALM_SIZE, (0, 0, 0.04)),
        ("left", FINGER_SIZE, (0, 0.005, 0.03)),
        ("right", FINGER_SIZE, (0, -0.005, 0.03)),
    ):
        mesh = trimesh.creation.box(1000 * np.array(size))
        mesh.apply_translation(1000 * np.array(middle))
        mesh.export(tmp_path / "my_hand" / "meshes" / f"{name}.stl")
    mesh = '<mesh filename="{}meshes/{}.stl" scale="0.001 0.001 0.001"/>'
    for start in ("package://my_hand/", "../"):
        links = {
            name: link(name, shape(mesh.format(start, name))) for name in ("palm", "left", "right")
        }
        assert_two(read(write(tmp_path / "my_hand" / "urdf", **links)))


def test_mesh_in_an_installed_package_is_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = tmp_path / "ws" / "share" / "my_hand" / "meshes"
    place.mkdir(parents=True)
    (place / "palm.stl").write_bytes(b"")
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{tmp_path}/none:{tmp_path}/ws")
    found = urdf.find_mesh("package://my_hand/meshes/palm.stl", tmp_path / "a.urdf", "palm")
    assert found == place / "palm.stl"


def test_round_palm_has_its_cylinder_s_size(tmp_path: Path) -> None:
    round_palm = link("palm", shape('<cylinder radius="0.05" length="0.08"/>', (0, 0, 0.04)))
    hand = read(write(tmp_path, palm=round_palm))
    assert_box(hand.palm[0], (0, 0.08), (-0.05, 0.05), (-0.05, 0.05))


def test_looks_are_taken_where_nothing_collides_and_it_is_said(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    size = " ".join(map(str, FINGER_SIZE))
    seen = link("left", shape(f'<box size="{size}"/>', (0, 0.005, 0.03), "visual"))
    with caplog.at_level(logging.WARNING, "boxgrasp"):
        assert_two(read(write(tmp_path, left=seen)))
    assert [record.message.split(": ")[1] for record in caplog.records] == [
        "left collides with nothing; its looks are taken"
    ]


def test_looks_are_taken_where_asked(tmp_path: Path) -> None:
    size = " ".join(map(str, PALM_SIZE))
    looks = shape(f'<box size="{size}"/>', (0, 0, 0.04), "visual")
    both = {"palm": link("palm", box((0.1, 0.1, 0.1)) + looks)}
    for name, side in (("left", 0.005), ("right", -0.005)):
        words = " ".join(map(str, FINGER_SIZE))
        both[name] = link(name, shape(f'<box size="{words}"/>', (0, side, 0.03), "visual"))
    assert_two(read(write(tmp_path, **both), visual=True))


def test_prefixes_that_nobody_declares_are_read_over(tmp_path: Path) -> None:
    assert_two(read(write(tmp_path, more="<drake:member link='left'/>")))


# What is refused.


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"left": "", "left_joint": ""}, "no link 'left'; valid: flange, palm, right"),
        ({"left_joint": joint("fixed", "palm", "left")}, "finger 'left' does not move against"),
        (
            {
                "right_joint": joint("fixed", "left", "right", xyz="0 -0.08 0"),
            },
            "'left' and 'right' move as one; valid: two fingers",
        ),
        (
            {"left_joint": joint("prismatic", "palm", "left", limit="0 0")},
            "joints left_joint have no range",
        ),
        (
            {"left_joint": joint("continuous", "palm", "left", "1 0 0")},
            "joint 'left_joint' of the fingers has no limits",
        ),
        (
            {"right_joint": joint("prismatic", "palm", "right", "0 -1 0", xyz="0 0 0.09",
                                  mimic="left_joint 1", limit="0 0.04")},
            "differ by 10.0 mm in how they stand or move; valid: alike to 2 mm",
        ),
        (
            {"right_joint": joint("prismatic", "palm", "right", "0 -1 0", xyz="0 0 0.08",
                                  mimic="left_joint 0.5", limit="0 0.04")},
            "in how they stand or move",
        ),
        (
            {"right": link("right", box((0.02, 0.02, 0.06), (0, -0.01, 0.03)))},
            "reach 10.0 mm differently; valid: alike to 2 mm",
        ),
        (
            {"left_joint": joint("prismatic", "palm", "left", "1 0 0", xyz="0 0 0.08",
                                 limit="0 0.04"),
             "right_joint": joint("prismatic", "palm", "right", "1 0 0", xyz="0 0 0.08",
                                  mimic="left_joint 1", limit="0 0.04")},
            "left and right do not move apart",
        ),
        ({"left": link("left"), "right": link("right")}, "finger 'left' has no geometry"),
        (
            {"left": link("left", shape('<mesh filename="package://a/left.stl"/>'))},
            "mesh 'package://a/left.stl' of 'left' is not there; valid: beside the URDF",
        ),
        (
            {"left": link("left", shape('<mesh filename="left.blend"/>'))},
            "mesh 'left.blend' of 'left'; valid: .stl, .obj",
        ),
        ({"left": link("left", shape('<mesh filename="hand.stl"/>'))}, "mesh of 'left'"),
        ({"more": "<xacro:macro name='a'/>"}, "is xacro; valid: a URDF, as the command xacro"),
        ({"more": "<link name='open'>"}, "no sound XML (mismatched tag"),
        ({"more": joint("fixed", "palm", "left")}, "two joints move 'left'; valid: a tree"),
        (
            {"more": joint("fixed", "palm", "thumb")},
            "joint 'thumb_joint' holds 'thumb', which is no link",
        ),
        ({"left": link("left", shape('<box size="0.1 0.1"/>'))}, "geometry of 'left': Extents"),
        ({"left": link("left", box((0.1, 0.1, np.nan)))}, "geometry of 'left' is not finite"),
        ({"left": link("left", shape(""))}, "IndexError in reading it"),
        ({"left_joint": joint("prismatic", "palm", "left", "0 0 0")}, "axis of left_joint is [0.0"),
        ({"flange_joint": joint("fixed", "flange", "palm", xyz="0 0 inf")}, "origin of palm_joint"),
        ({"left_joint": PARTS["left_joint"].replace("0.04", "wide")}, "could not convert string"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_one_line(tmp_path: Path, changes: dict[str, str], said: str) -> None:
    (tmp_path / "hand.stl").write_bytes(b"solid nothing\nendsolid\n")
    with pytest.raises(GripperError) as error:
        read(write(tmp_path, **changes))
    assert said in str(error.value) and "\n" not in str(error.value)
    assert str(tmp_path) in str(error.value)


WORDS = st.sampled_from(
    [
        "",
        "0",
        "-1",
        "nan",
        "1e999",
        "abc",
        "palm",
        "left",
        "fixed",
        "revolute",
        "planar",
        "0 0",
        "<",
    ]
)


@settings(deadline=None, max_examples=40)
@given(changes=st.lists(st.tuples(st.integers(0, 10**6), WORDS), min_size=1, max_size=3))
def test_any_change_of_a_urdf_gives_a_hand_or_a_line(
    changes: list[tuple[int, str]], tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = write(tmp_path_factory.mktemp("changed"))
    text = path.read_text("utf-8")
    for place, word in changes:
        values = list(re.finditer(r'"[^"]*"', text))
        match = values[place % len(values)]
        text = f'{text[: match.start()]}"{word}"{text[match.end() :]}'
    path.write_text(text, "utf-8")
    try:
        assert isinstance(read(path), Gripper)
    except GripperError as error:
        assert "\n" not in str(error) and str(path.parent) in str(error)


def test_flange_that_moves_is_refused(tmp_path: Path) -> None:
    with pytest.raises(GripperError, match="'left' is not fixed to 'palm'"):
        read(write(tmp_path), flange="left")


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"", "no element found"),
        (b"\x00\xff", "no sound XML"),
        (b"<sdf/>", "root element is 'sdf'; valid: 'robot'"),
        (b"<robot name='a'/>", "no link 'palm'; valid: "),
    ],
)
def test_bytes_that_are_no_urdf(tmp_path: Path, data: bytes, said: str) -> None:
    path = tmp_path / "hand.urdf"
    path.write_bytes(data)
    with pytest.raises(GripperError) as error:
        read(path)
    assert said in str(error.value) and "\n" not in str(error.value)
    with pytest.raises(GripperError, match="No such file"):
        read(tmp_path / "gone.urdf")


def test_without_the_reader_it_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "yourdfpy", None)
    with pytest.raises(MissingExtraError, match=r"needs yourdfpy; install boxgrasp\[urdf\]"):
        read(write(tmp_path))


def test_command_writes_what_select_takes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, picture = tmp_path / "two.yaml", tmp_path / "two.png"
    words = ["gripper", "from-urdf", str(write(tmp_path)), "--palm", "palm"]
    words += ["--fingers", "left,right", "--flange", "flange"]
    assert main([*words, "--output", str(out), "--picture", str(picture)]) == 0
    assert capsys.readouterr().out == f"{out}\n"
    assert load_gripper(out) == read(tmp_path / "hand.urdf", flange="flange")
    assert picture.exists()
    assert main(words) == 0
    assert capsys.readouterr().out == out.read_text("utf-8")


# Boxes from any surface.


@st.composite
def surfaces(draw: st.DrawFn) -> Any:
    """(N, 3, 3) of a few turned boxes."""
    pieces = []
    for _ in range(draw(st.integers(1, 3))):
        numbers = [draw(st.floats(-1.0, 1.0)) for _ in range(6)]
        size = [draw(st.floats(0.004, 0.08)) for _ in range(3)]
        mesh = trimesh.creation.box(size)
        mesh.apply_transform(trimesh.transformations.euler_matrix(*numbers[:3]))
        mesh.apply_translation(0.05 * np.array(numbers[3:]))
        pieces.append(np.array(mesh.triangles))
    return np.concatenate(pieces)


@settings(deadline=None, max_examples=40)
@given(surface=surfaces(), most=st.integers(1, 5))
def test_boxes_hold_the_surface(surface: Any, most: int) -> None:
    boxes = fit_boxes(slice_extents(surface), most)
    assert 1 <= len(boxes) <= most
    ends = np.array([(box.x_m, box.y_m, box.z_m) for box in boxes])
    mix = np.random.default_rng(0).dirichlet(np.ones(3), 50)
    points = np.einsum("kc,ncd->nkd", mix, surface).reshape(-1, 3)
    points = np.concatenate((points, surface.reshape(-1, 3)))[:, None]
    inside = ((points >= ends[..., 0] - 2e-5) & (points <= ends[..., 1] + 2e-5)).all(axis=2)
    assert inside.any(axis=1).all()


@settings(deadline=None, max_examples=25)
@given(surface=surfaces())
def test_slices_are_those_of_another_library(surface: Any) -> None:
    mesh = trimesh.Trimesh(surface.reshape(-1, 3), np.arange(surface.shape[0] * 3).reshape(-1, 3))
    for row in slice_extents(surface):
        near = SLICE_M * np.round((row[0] + row[1]) / 2 / SLICE_M - 0.5)
        held = surface.reshape(-1, 3)
        held = [held[(held[:, 0] >= near) & (held[:, 0] <= near + SLICE_M)]]
        for x in (near, near + SLICE_M):
            lines = trimesh.intersections.mesh_plane(mesh, (1, 0, 0), (x, 0, 0))
            held.append(np.reshape(lines, (-1, 3)))
        points = np.concatenate(held)
        ends = np.stack((points.min(axis=0), points.max(axis=0)), axis=1).reshape(-1)
        assert np.allclose(ends, row, atol=1e-6)


def test_more_boxes_fit_closer() -> None:
    ramp = np.array([[0, 0, 0], [0.1, 0.1, 0], [0.1, 0.1, 0.01]], float)[None]
    volumes = []
    for most in (1, 2, 4, 8):
        boxes = fit_boxes(slice_extents(ramp), most)
        sizes = [np.ptp([b.x_m, b.y_m, b.z_m], axis=1) for b in boxes]
        volumes.append(sum(float(np.prod(size)) for size in sizes))
    assert volumes == sorted(volumes, reverse=True) and volumes[0] > 2 * volumes[3]
    assert fit_boxes(np.zeros((0, 6))) == ()
