"""Pictures: exact geometry, marks that stay apart for the color-blind, text that fits, errors."""

from __future__ import annotations

import dataclasses
import itertools
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import item, laid, seen
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from boxgrasp import Capture, GraspSelector, Target, load_capture
from boxgrasp.draw import draw_objects, draw_selection
from boxgrasp.draw.backdrops import base_cloud, camera_panel, fitted_intrinsics
from boxgrasp.draw.canvas import Canvas, clip_to, dashes, fit, hull, text_size, wrap
from boxgrasp.draw.evidence import evidence_of, nearest_obstacle
from boxgrasp.draw.palette import BLOCKED, CATEGORY, GRIPPER, OBSTACLE, SHAPE, WHITE
from boxgrasp.draw.shapes import EDGES, contact_line, corners, face_point, fingers
from boxgrasp.draw.views import camera_view, oblique_frame, plan_view
from boxgrasp.draw.words import facts_of, headline_of
from boxgrasp.errors import BoxgraspError
from boxgrasp.geometry.box import Box
from boxgrasp.geometry.transforms import invert, make_transform, rotation_z, transform
from boxgrasp.grasps.candidates import candidates_of
from boxgrasp.grasps.gripper import Gripper
from boxgrasp.perception.numbering import SceneObject
from boxgrasp.result import BoxReport, Candidate, Selection

TABLE_M = 0.80


@cache
def captured() -> Capture:
    return seen(
        laid(item("mug", 0.85, 0.0), item("beans_can", 0.85, 0.14), item("beans_can", 0.95, -0.2))
    )


@cache
def made(lines: int = 3) -> Selection:
    """An answer by hand round the mug's place: numbers are plain, so a test can know them."""
    box = Box(make_transform(rotation_z(0.2), (0.85, 0.0, TABLE_M + 0.05)), np.full(3, 0.09))
    gripper = Gripper()
    candidates = candidates_of(box, gripper, lines)
    reports = tuple(
        Candidate(
            label=k + 1,
            face=int(candidates.face[k]),
            line=int(candidates.line[k]),
            T_base_gripper=candidates.T_base_gripper[k],
            width_m=float(candidates.width_m[k]),
            visible_clearance_m=(0.01, 0.04, 0.08)[k % 3],
            unseen_distance_m=0.5,
            plane_clearance_m=0.03,
            approach_clearance_m=0.05,
            fits=True,
            rejected="obstacle 1.0 cm, needs 2.3 cm" if k % 3 == 0 else None,
            preference=k + 1,
        )
        for k in range(len(candidates.label))
    )
    chosen = reports[1]
    T_pre = chosen.T_base_gripper.copy()
    T_pre[:3, 3] -= 0.15 * T_pre[:3, 0]
    return Selection(
        status="grasp",
        reason="first by preference that passes",
        frame="given",
        T_base_camera=captured().T_base_camera,
        ranker="clearance",
        face=chosen.face,
        line=chosen.line,
        label=chosen.label,
        T_base_gripper=chosen.T_base_gripper,
        T_base_tcp=chosen.T_base_gripper,
        T_base_pregrasp=T_pre,
        position_m=chosen.T_base_gripper[:3, 3],
        quaternion_xyzw=np.array((0.0, 0.0, 0.0, 1.0)),
        opening_m=0.12,
        clearance_m=chosen.visible_clearance_m,
        box=BoxReport(box.T_base_box, box.dimensions_m),
        best_rejected=1,
        blocking=None,
        candidates=reports,
        warnings=(),
        config_hash="0" * 16,
        timings_ms={"total": 1.0},
        version="0",
    )


def asking(best: int = 1, **changes: Any) -> Selection:
    """The same as a question, the best candidate changed as a test needs it."""
    candidates = list(made().candidates)
    candidates[best - 1] = dataclasses.replace(candidates[best - 1], **changes)
    nothing = dict.fromkeys(
        ("face", "line", "label", "T_base_gripper", "T_base_tcp", "T_base_pregrasp")
        + ("position_m", "quaternion_xyzw", "opening_m", "clearance_m")
    )
    reason = candidates[best - 1].rejected
    return dataclasses.replace(
        made(),
        status="ask",
        reason=f"no candidate passes; the nearest to it, {best}: {reason}",
        blocking=reason,
        best_rejected=best,
        candidates=tuple(candidates),
        **nothing,
    )


@cache
def pictured(kind: str) -> Image.Image:
    """The two pictures that most tests look at."""
    return draw_selection(captured(), made() if kind == "grasp" else asking())


def pixels(image: Image.Image) -> np.ndarray:
    return np.asarray(image).astype(np.int64)


def count_of(image: Image.Image, color: tuple[int, int, int], within: int = 12) -> int:
    return int((np.abs(pixels(image) - color).max(axis=2) <= within).sum())


# Geometry


@given(
    left=st.floats(-100, 400),
    upper=st.floats(-100, 400),
    step=st.floats(0.2, 2.0),
    yaw=st.floats(-3, 3),
)
@settings(max_examples=60, deadline=None)
def test_corners_in_the_image_match_exact_projection(
    left: float, upper: float, step: float, yaw: float
) -> None:
    K = np.array([[525.0, 0, 319.5], [0, 520.0, 239.5], [0, 0, 1]])
    T = captured().T_base_camera
    assert T is not None
    places = corners(make_transform(rotation_z(yaw), (0.85, 0.02, 0.85)), np.array((0.1, 0.2, 0.3)))
    found, depth = camera_view(T, K, (left, upper, step), (900, 700)).project(places)
    for place, xy, z in zip(places, found, depth, strict=True):
        u, v, w = K @ (np.linalg.inv(T) @ np.append(place, 1.0))[:3]
        # In image pixels: panel pixel x covers step image pixels from the left edge on.
        back = (xy + 0.5) * step + (left, upper) - 0.5
        np.testing.assert_allclose(back, (u / w, v / w), atol=1e-6)
        assert z == pytest.approx(w)


def test_the_cut_out_image_lies_under_its_own_projection() -> None:
    """A bright pixel of the image must be found where its own point is projected."""
    depth = np.ones((480, 640), np.float32)
    rgb = np.zeros((480, 640, 3), np.uint8)
    rgb[300:303, 400:403] = 255
    K = np.array([[525.0, 0, 319.5], [0, 525.0, 239.5], [0, 0, 1]])
    T = make_transform(np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]]), (0, 0, 1.0))
    capture = Capture(depth, K, T, rgb)
    point = transform(T, np.array([[(401 - 319.5) / 525, (301 - 239.5) / 525, 1.0]]))
    focus = point + np.array([[0.0, -0.1, -0.1], [0.0, 0.1, 0.1]])
    view, image, _ = camera_panel(capture, base_cloud(capture, T), T, focus, (908, 681), 0.0)
    rows, columns = np.nonzero(pixels(image)[:, :, 1] > 150)
    at = view.point(point[0])
    assert at is not None
    assert (columns.mean(), rows.mean()) == pytest.approx(at, abs=0.3)


@pytest.mark.parametrize(
    ("kind", "right", "up"), [("above", (0, -1, 0), (1, 0, 0)), ("side", (1, 0, 0), (0, 0, 1))]
)
def test_plans_have_their_axes_and_scale(kind: str, right: Any, up: Any) -> None:
    focus = np.array([(0.5, -0.2, 0.0), (0.9, 0.3, 0.4)])
    view = plan_view(kind, focus, (600, 500), 0.3)
    at = np.array((0.7, 0.1, 0.2))
    xy, _ = view.project(np.array([at, at + 0.1 * np.array(right), at + 0.1 * np.array(up)]))
    np.testing.assert_allclose(xy[1] - xy[0], (0.1 * view.fx, 0), atol=1e-9)
    np.testing.assert_allclose(xy[2] - xy[0], (0, -0.1 * view.fx), atol=1e-9)
    inside, _ = view.project(focus)
    assert ((inside >= 0) & (inside <= (600, 500))).all()


def test_nearer_points_hide_farther_ones_in_every_view() -> None:
    T = captured().T_base_camera
    assert T is not None
    above = plan_view("above", np.zeros((1, 3)), (9, 9), 0.3)
    side = plan_view("side", np.zeros((1, 3)), (9, 9), 0.3)
    assert above.project(np.array([(0, 0, 1.0), (0, 0, 0.0)]))[1].argmin() == 0
    assert side.project(np.array([(0, 1.0, 0), (0, -1.0, 0)]))[1].argmin() == 1
    oblique = oblique_frame(np.zeros(3))
    assert np.allclose(oblique[:3, :3] @ oblique[:3, :3].T, np.eye(3))
    eye = invert(oblique)[:3, 3]
    assert eye[0] < 0 and eye[1] < 0 and eye[2] > 0  # from the robot's side, right, above


def test_lines_behind_the_camera_are_cut_or_left_out() -> None:
    K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    view = camera_view(np.eye(4), K, (0, 0, 1.0), (640, 480))
    assert view.segment(np.array((0, 0, -1.0)), np.array((0, 0, -2.0))) is None
    assert view.point(np.array((0, 0, -1.0))) is None
    ends = view.segment(np.array((0.1, 0, -1.0)), np.array((0.1, 0, 1.0)))
    assert ends is not None and np.isfinite(ends).all()
    assert ends[1] == pytest.approx((369.5 + 0.5, 240.0))
    assert ends[0][0] > 1000  # the cut end, far out to the right


def test_the_fingers_stand_at_the_opening_and_end_with_the_gripper() -> None:
    gripper = Gripper()
    left, right = fingers(np.eye(4), gripper)
    assert left[:, 1].min() == pytest.approx(0.06) and left[:, 1].max() == pytest.approx(0.085)
    assert right[:, 1].max() == pytest.approx(-0.06)
    assert left[:, 0].max() == pytest.approx(gripper.length_m / 2)


def test_every_line_lies_on_its_face_for_any_gripper() -> None:
    selection = made()
    box = selection.box
    for candidate in selection.candidates:
        local = transform(invert(box.T_base_box), contact_line(option, box))
        assert np.abs(local).max() == pytest.approx(0.045)
        assert np.linalg.norm(local[1] - local[0]) == pytest.approx(candidate.width_m)
        way = option.T_base_gripper[:3, 3] - face_point(option, box)
        np.testing.assert_allclose(way, -0.10 * candidate.T_base_gripper[:3, 0], atol=1e-9)


def test_edges_join_corners_that_differ_in_one_axis() -> None:
    places = corners(np.eye(4), np.array((1.0, 2.0, 3.0)))
    assert len(set(EDGES)) == 12
    for a, b in EDGES:
        assert (places[a] != places[b]).sum() == 1


def test_an_organized_cloud_tells_its_own_intrinsics() -> None:
    capture = captured()
    assert capture.intrinsics is not None and capture.depth is not None
    height, width = capture.depth.shape
    points, index = capture.valid_points()
    cloud = np.full((height * width, 3), np.nan, np.float32)
    cloud[index] = points
    organized = Capture.from_cloud(cloud.reshape(height, width, 3))
    found = fitted_intrinsics(organized)
    assert found is not None
    np.testing.assert_allclose(found, capture.intrinsics, atol=0.05)
    shuffled = np.random.default_rng(0).permutation(cloud).reshape(height, width, 3)
    assert fitted_intrinsics(Capture.from_cloud(shuffled)) is None


# Colors


_DEFICIENT = {
    "normal": np.eye(3),
    # Machado, Oliveira and Fernandes (2009), severity 1, linear RGB.
    "protanopia": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216],
         [-0.003882, -0.048116, 1.051998]]
    ),
    "deuteranopia": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413],
         [-0.011820, 0.042940, 0.968881]]
    ),
    "tritanopia": np.array(
        [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602],
         [0.004733, 0.691367, 0.303900]]
    ),
}  # fmt: skip


def lab(linear: np.ndarray) -> np.ndarray:
    to_xyz = np.array(
        [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
    )
    f = np.cbrt(np.clip(to_xyz @ linear / (0.9505, 1.0, 1.089), 1e-6, None))
    return np.array((116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])))


def as_seen(color: tuple[int, int, int], eye: str) -> np.ndarray:
    share = np.array(color) / 255
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    return lab(np.clip(_DEFICIENT[eye] @ linear, 0, 1))


@pytest.mark.parametrize("eye", ["normal", "protanopia", "deuteranopia"])
def test_categories_stay_apart_for_the_color_blind(eye: str) -> None:
    for a, b in itertools.combinations(CATEGORY.values(), 2):
        assert np.linalg.norm(as_seen(a, eye) - as_seen(b, eye)) > 25
    for hand in CATEGORY.values():
        assert np.linalg.norm(as_seen(hand, eye) - as_seen(GRIPPER, eye)) > 25


def test_the_check_on_colors_can_fail() -> None:
    pure = (220, 40, 40), (110, 140, 20)
    assert np.linalg.norm(as_seen(pure[0], "normal") - as_seen(pure[1], "normal")) > 60
    assert np.linalg.norm(as_seen(pure[0], "protanopia") - as_seen(pure[1], "protanopia")) < 40


def test_categories_have_a_shape_each() -> None:
    assert set(SHAPE) == set(CATEGORY) and len(set(SHAPE.values())) == 3


def test_marks_differ_without_any_color() -> None:
    gray = []
    for shape in ("circle", "triangle", "square"):
        for style in ("kept", "dropped", "wide"):
            canvas = Canvas(Image.new("RGB", (40, 40), WHITE))
            canvas.mark((20, 20), shape, (128, 128, 128), 9, style)
            gray.append(pixels(canvas.finish()))
    for a, b in itertools.combinations(gray, 2):
        assert (np.abs(a - b).max(axis=2) > 60).sum() > 15


# Drawing and text


@given(st.text(st.characters(codec="ascii"), max_size=300), st.integers(30, 400))
@settings(max_examples=60, deadline=None)
def test_wrapped_text_fits_and_says_all(text: str, width: int) -> None:
    lines = wrap(text, 16, width)
    assert all(text_size(line, 16)[0] <= width for line in lines)
    assert "".join(lines).replace(" ", "") == "".join(text.split())
    assert len(wrap(text, 16, width, 2)) <= 2
    assert all(text_size(line, 16)[0] <= width for line in wrap(text, 16, width, 2))
    assert text_size(fit(text, 16, width), 16)[0] <= width


@given(st.floats(-500, 500), st.floats(-500, 500), st.integers(1, 60))
@settings(max_examples=40, deadline=None)
def test_text_never_leaves_its_panel(x: float, y: float, length: int) -> None:
    canvas = Canvas(Image.new("RGB", (300, 120), WHITE))
    canvas.text((x, y), "M" * length, 16, (0, 0, 0), halo=WHITE)
    canvas.label((x, y), "W" * length, 16, (0, 0, 0), halo=WHITE, must=True)
    for left, upper, right, lower in canvas.taken:
        assert left >= 0 and upper >= 0 and right <= 300 and lower <= 120
    ink = np.nonzero(pixels(canvas.finish()).min(axis=2) < 128)
    assert len(ink[0]) and ink[1].min() >= 2 and ink[1].max() <= 297


def test_labels_keep_off_each_other() -> None:
    canvas = Canvas(Image.new("RGB", (400, 300), WHITE))
    said = [canvas.label((200, 150), f"label {k}", 14, (0, 0, 0)) for k in range(30)]
    assert 3 <= sum(said) < 30
    for a, b in itertools.combinations(canvas.taken, 2):
        assert a[0] >= b[2] - 4 or b[0] >= a[2] - 4 or a[1] >= b[3] - 3 or b[1] >= a[3] - 3


def test_segments_are_clipped_and_dashed() -> None:
    assert clip_to((-10, 5), (20, 5), (0, 0, 10, 10)) == ((0, 5), (10, 5))
    assert clip_to((-10, 15), (20, 15), (0, 0, 10, 10)) is None
    assert clip_to((20, 0), (20, 9), (0, 0, 10, 10)) is None
    assert clip_to((1, 2), (3, 4), (0, 0, 10, 10)) == ((1, 2), (3, 4))
    pieces = list(dashes((0, 0), (10, 0), (2, 3)))
    assert pieces == [((0, 0), (2, 0)), ((5, 0), (7, 0))]
    assert list(dashes((0, 0), (10, 0), None)) == [((0, 0), (10, 0))]
    square = [(0, 0), (4, 0), (4, 4), (0, 4)]
    assert sorted(hull([*square, (2, 2), (1, 3)])) == sorted(square)


def test_the_canvas_draws_lines_where_told() -> None:
    canvas = Canvas(Image.new("RGB", (50, 50), WHITE))
    canvas.line((10, 20), (40, 20), (255, 0, 0), 1.0)
    image = pixels(canvas.finish())
    rows, columns = np.nonzero(image[:, :, 1] < 140)
    assert set(rows) <= {19, 20, 21} and columns.min() in (9, 10) and columns.max() in (40, 41)


# Pictures


def test_a_grasp_shows_the_gripper_and_an_ask_what_is_in_the_way() -> None:
    grasp, ask = pictured("grasp"), pictured("ask")
    assert grasp.width == ask.width == 1600
    assert count_of(grasp, GRIPPER) > 3000 > 300 > count_of(ask, GRIPPER)
    assert count_of(ask, BLOCKED) > 2 * count_of(grasp, BLOCKED)


def test_the_chosen_gripper_is_drawn_where_it_will_be() -> None:
    """Another line on the same face moves blue in the picture, and only where a hand is."""
    selection = made()
    other = selection.candidate(12)
    moved = dataclasses.replace(
        selection, label=12, face=4, line=3, T_base_gripper=other.T_base_gripper
    )
    both = (pictured("grasp"), draw_selection(captured(), moved))
    a, b = (pixels(image.crop((14, 84, 922, 765))) for image in both)
    blue = [np.abs(image - GRIPPER).max(axis=2) < 12 for image in (a, b)]
    assert (blue[0] & ~blue[1]).sum() > 500 and (blue[1] & ~blue[0]).sum() > 500


def test_categories_and_rejections_change_marks() -> None:
    selection = made()
    safe = tuple(
        dataclasses.replace(option, visible_clearance_m=0.2, rejected=None)
        for option in selection.options
    )
    all_safe = draw_selection(captured(), dataclasses.replace(selection, candidates=safe))
    mixed = pictured("grasp")
    assert count_of(all_safe, CATEGORY["green"]) > count_of(mixed, CATEGORY["green"]) > 500
    assert count_of(all_safe, CATEGORY["red"]) < count_of(mixed, CATEGORY["red"])


@cache
def unmarked() -> Image.Image:
    return draw_selection(captured(), asking(rejected="face not allowed"))


@pytest.mark.parametrize(
    ("rejected", "changes"),
    [
        ("target 14.0 cm wide, opening 12.0 cm less 0.3 cm", {"fits": False, "width_m": 0.14}),
        ("width unknown", {"fits": False}),
        ("support plane -1.2 cm", {"plane_clearance_m": -0.012}),
        ("object 2 1.0 cm, needs 2.3 cm", {}),
        ("approach: object 2 0.0 cm", {"approach_clearance_m": 0.0}),
        ("unseen space 0.0 cm, needs 1.0 cm", {"unseen_distance_m": 0.0}),
        ("object 2 1.0 cm, needs 2.3 cm; approach: object 2 0.0 cm; width unknown", {}),
    ],
)
def test_every_reason_is_marked_in_the_picture(rejected: str, changes: dict[str, Any]) -> None:
    plain = asking(rejected="face not allowed")
    bare = unmarked()
    answer = dataclasses.replace(
        asking(rejected=rejected, **changes), reason=plain.reason, blocking=plain.blocking
    )
    best = answer.candidate(1)
    cloud = base_cloud(captured(), answer.T_base_camera)
    marks = evidence_of(cloud.points, answer, best, Gripper(), TABLE_M)
    assert [mark.word for mark in marks] == rejected.split("; ")
    assert evidence_of(cloud.points, plain, plain.candidate(1), Gripper(), TABLE_M) == []
    area = (14, 84, 922, 765)
    marked, bare = draw_selection(captured(), answer).crop(area), bare.crop(area)
    assert (pixels(marked) != pixels(bare)).any(axis=2).sum() > 150
    if "object" in rejected or "cm wide" in rejected:
        assert count_of(marked, OBSTACLE) > count_of(bare, OBSTACLE) + 30


def test_the_nearest_obstacle_is_the_nearest_point_that_is_neither_target_nor_table() -> None:
    selection = made()
    candidate = selection.candidate(12)
    rng = np.random.default_rng(3)
    points = rng.uniform((0.5, -0.4, 0.75), (1.2, 0.4, 1.1), (4000, 3)).astype(np.float32)
    found = nearest_obstacle(points, selection.box, candidate, Gripper(), TABLE_M, 0.0)
    assert found is not None
    half = Gripper().half_m
    best = np.inf
    for point in points.astype(np.float64):
        local = transform(invert(selection.box.T_base_box), point[None])[0]
        if point[2] <= TABLE_M + 0.012 or (np.abs(local) <= 0.055).all():
            continue
        at = transform(invert(candidate.T_base_gripper), point[None])[0]
        best = min(best, float(np.linalg.norm(np.maximum(np.abs(at) - half, 0))))
    assert found.distance_m == pytest.approx(best, abs=1e-5)
    gap = np.linalg.norm(found.point - found.on_hand)
    assert gap == pytest.approx(best, abs=1e-5)
    none = nearest_obstacle(points[:0], selection.box, candidate, Gripper(), TABLE_M, 0.0)
    assert none is None


VARIANTS = (
    "depth with color",
    "depth",
    "organized",
    "organized, colored",
    "optical cloud",
    "colored cloud",
    "base cloud",
    "base cloud, camera known",
    "robot masked",
)


@cache
def variants() -> dict[str, Capture]:
    capture = captured()
    assert capture.depth is not None and capture.rgb is not None
    T = capture.T_base_camera
    assert T is not None
    points, index = capture.valid_points()
    colors = capture.rgb.reshape(-1, 3)[index]
    organized = np.full((*capture.depth.shape, 3), np.nan, np.float32)
    organized.reshape(-1, 3)[index] = points
    base = transform(T, points)
    return {
        "depth with color": capture,
        "depth": Capture(capture.depth, capture.intrinsics, T),
        "organized": Capture.from_cloud(organized, T_base_camera=T),
        "organized, colored": Capture.from_cloud(organized, colors=capture.rgb, T_base_camera=T),
        "optical cloud": Capture.from_cloud(points, T_base_camera=T),
        "colored cloud": Capture.from_cloud(points, colors=colors, T_base_camera=T),
        "base cloud": Capture.from_cloud(base, cloud_frame="base"),
        "base cloud, camera known": Capture.from_cloud(base, cloud_frame="base", T_base_camera=T),
        "robot masked": Capture.from_cloud(
            points, colors=colors, T_base_camera=T, robot_mask=points[:, 0] > 0.3
        ),
    }


@pytest.mark.parametrize("name", VARIANTS)
def test_every_kind_of_capture_is_drawn(name: str) -> None:
    capture = variants()[name]
    selection = dataclasses.replace(made(), T_base_camera=capture.T_base_camera)
    image = draw_selection(capture, selection)
    panel = image.crop((14, 84, 922, 765))
    assert count_of(panel, GRIPPER) > 500
    assert len(np.unique(pixels(panel).reshape(-1, 3)[::7], axis=0)) > 60  # there is a scene
    objects = draw_objects(capture, some_objects(), T_base_camera=capture.T_base_camera)
    assert objects.width == 1600 and count_of(objects, GRIPPER) > 600


def test_a_view_seen_by_the_camera_agrees_for_image_and_cloud() -> None:
    """The painted cloud and the image both have the target in their midst."""
    for name in ("depth", "optical cloud", "organized"):
        capture = variants()[name]
        cloud = base_cloud(capture, capture.T_base_camera)
        focus = corners(made().box.T_base_box, np.full(3, 0.3))
        view, _, caption = camera_panel(
            capture, cloud, capture.T_base_camera, focus, (908, 681), TABLE_M
        )
        at = view.point(made().box.T_base_box[:3, 3])
        assert at is not None
        assert 200 < at[0] < 708 and 150 < at[1] < 531
        assert ("Points" in caption) == (name == "optical cloud")


def test_support_frame_answers_are_drawn_with_the_answers_own_camera() -> None:
    capture = captured()
    free = Capture(capture.depth, capture.intrinsics, None, capture.rgb)
    answer = GraspSelector().select(free, Target(pixel=capture.target_pixel))
    assert answer.frame == "support"
    image = draw_selection(free, answer)
    color = GRIPPER if answer.status == "grasp" else BLOCKED
    assert count_of(image.crop((14, 84, 922, 765)), color) > 500


@pytest.mark.parametrize("lines", [1, 5, 40])
def test_any_number_of_lines_is_drawn(lines: int) -> None:
    assert count_of(draw_selection(captured(), made(lines)), GRIPPER) > 1000


def test_long_texts_make_the_picture_higher_not_wider() -> None:
    long = dataclasses.replace(
        made(), warnings=tuple(f"warning {k}: " + "many words " * 30 for k in range(6))
    )
    short, tall = pictured("grasp"), draw_selection(captured(), long)
    assert tall.width == short.width and tall.height > short.height
    endless = dataclasses.replace(asking(), reason="x" * 500, blocking="y" * 900)
    assert draw_selection(captured(), endless).width == 1600


def test_an_ask_without_any_candidate_left_is_drawn() -> None:
    bare = dataclasses.replace(asking(), best_rejected=None, candidates=(), blocking=None)
    assert draw_selection(captured(), bare).width == 1600


def test_words_say_the_numbers() -> None:
    rows = facts_of(made(), Gripper())
    text = " ".join(value for _, value in rows)
    assert "4.0 cm to seen obstacles" in text and "50 cm or more to unseen space" in text
    assert "left face, line 2" in headline_of(made())[1]
    assert headline_of(asking())[0] == "ASK A PERSON"
    warned = dataclasses.replace(made(), warnings=("the border cuts the target",))
    assert ("Warning", "the border cuts the target") in facts_of(warned, Gripper())


def some_objects() -> tuple[SceneObject, ...]:
    places = ((0.85, 0.0), (0.85, 0.14), (0.86, 0.14), (0.95, -0.2))
    return tuple(
        SceneObject(
            number=k + 1,
            center_m=np.array((x, y, TABLE_M + 0.05)),
            size_m=np.full(3, 0.08),
            distance_m=0.9,
            points=100,
            pixel=(320, 240),
        )
        for k, (x, y) in enumerate(places)
    )


def test_every_object_gets_its_number_even_where_they_meet() -> None:
    none = draw_objects(captured(), ())
    four = draw_objects(captured(), some_objects())
    panel = (14, 84, 1074, 879)
    disc = count_of(four.crop(panel), GRIPPER)
    one = count_of(draw_objects(captured(), some_objects()[:1]).crop(panel), GRIPPER)
    assert count_of(none.crop(panel), GRIPPER) == 0
    assert disc > 3.5 * one > 1000


def test_objects_are_numbered_without_a_transform() -> None:
    capture = captured()
    free = Capture(capture.depth, capture.intrinsics, None, capture.rgb)
    found = GraspSelector().objects(free)
    image = draw_objects(free, found)
    assert count_of(image.crop((14, 84, 1074, 879)), GRIPPER) > 300 * len(found)


def test_objects_go_to_their_pixels_where_no_plane_is_found() -> None:
    depth = np.full((240, 320), 0.0, np.float32)
    depth[105, 65] = 1.0
    K = np.array([[300.0, 0, 160], [0, 300, 120], [0, 0, 1]])
    item = dataclasses.replace(some_objects()[0], pixel=(65, 105))
    image = draw_objects(Capture(depth, K), (item,))
    rows, columns = np.nonzero(np.abs(pixels(image)[:, :1074] - GRIPPER).max(axis=2) < 12)
    assert columns.mean() == pytest.approx(14 + 65.5 * 1060 / 320, abs=3)
    assert rows.mean() == pytest.approx(84 + 105.5 * 795 / 240, abs=3)


# Files


@pytest.mark.parametrize("suffix", [".png", ".PNG", ".jpg", ".jpeg", ".webp"])
def test_the_same_answer_gives_the_same_bytes(tmp_path: Path, suffix: str) -> None:
    first, second = tmp_path / f"a{suffix}", tmp_path / f"b{suffix}"
    image = draw_selection(captured(), made(), first)
    draw_selection(captured(), made(), str(second))
    assert first.read_bytes() == second.read_bytes()
    with Image.open(first) as read:
        assert read.size == image.size
        if suffix.lower() == ".png":
            assert read.convert("RGB").tobytes() == image.tobytes()


@pytest.mark.parametrize("name", ["a.gif", "a.txt", "a", "missing/a.png", "folder.png"])
def test_a_path_that_cannot_be_written_is_one_line(tmp_path: Path, name: str) -> None:
    (tmp_path / "folder.png").mkdir()
    for draw in (
        lambda path: draw_selection(captured(), made(), path),
        lambda path: draw_objects(captured(), some_objects(), path),
    ):
        with pytest.raises(BoxgraspError) as caught:
            draw(tmp_path / name)
        assert "\n" not in str(caught.value) and name.split("/")[0] in str(caught.value)
    assert [path.name for path in tmp_path.iterdir()] == ["folder.png"]


def test_drawing_changes_no_argument_and_needs_no_font_file() -> None:
    capture, selection = captured(), made()
    before = selection.to_json()
    assert capture.rgb is not None
    rgb = capture.rgb.tobytes()
    draw_selection(capture, selection)
    draw_objects(capture, some_objects())
    assert selection.to_json() == before and capture.rgb.tobytes() == rgb


def test_real_captures_are_drawn(captures_dir: Path) -> None:
    selector = GraspSelector()
    for name in ("uois_00", "haf_table1/cloud.pcd"):
        frame = "base" if "haf" in name else "optical"
        capture = load_capture(captures_dir / name, cloud_frame=frame)  # type: ignore[arg-type]
        found = selector.objects(capture)
        answer = selector.select(capture, Target(object=found[0].number))
        color = GRIPPER if answer.status == "grasp" else BLOCKED
        assert count_of(draw_selection(capture, answer), color) > 1000
        assert count_of(draw_objects(capture, found), GRIPPER) > 300 * len(found)
