"""Pictures: exact geometry, marks that stay apart for the color-blind, text that fits, errors."""

from __future__ import annotations

import dataclasses
import itertools
import sys
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
from boxgrasp.draw import draw_objects, draw_selection, selection_png
from boxgrasp.draw.backdrops import camera_panel, fitted_intrinsics
from boxgrasp.draw.canvas import Canvas, Look, Stroke
from boxgrasp.draw.cards import legend_card
from boxgrasp.draw.clouds import base_cloud
from boxgrasp.draw.evidence import draw_marks, marks_of
from boxgrasp.draw.marks import draw_candidates, draw_hand
from boxgrasp.draw.palette import BLOCKED, CATEGORY, GRIPPER, HELD, OBSTACLE, SHAPE, WHITE
from boxgrasp.draw.planar import clip_to, dashes, hull
from boxgrasp.draw.shapes import EDGES, Hand, contact_line, corners, face_point, fingers
from boxgrasp.draw.text import Lettering, fit, text_size, wrap
from boxgrasp.draw.views import Extent, camera_view, oblique_frame, plan_view
from boxgrasp.draw.words import facts_of, headline_of, look_of
from boxgrasp.errors import BoxgraspError, CodedWarning
from boxgrasp.geometry import hand_distance
from boxgrasp.geometry.box import Box
from boxgrasp.geometry.transforms import invert, make_transform, rotation_z, transform
from boxgrasp.grasps.candidates import candidates_of
from boxgrasp.grasps.checks import Check, CheckContext, CheckResult, Witness
from boxgrasp.grasps.checks.check import measured
from boxgrasp.grasps.gripper import Gripper
from boxgrasp.io.images import write_object_image
from boxgrasp.perception import support_plane
from boxgrasp.perception.numbering import SceneObject
from boxgrasp.perception.scene import Scene
from boxgrasp.result import Candidate, CheckValue, Grasp, Refusal, Selection, TargetBox
from boxgrasp.selector import default_checks

TABLE_M = 0.80


@cache
def captured() -> Capture:
    return seen(
        laid(item("mug", 0.85, 0.0), item("beans_can", 0.85, 0.14), item("beans_can", 0.95, -0.2))
    )


def in_m(value: float, limit: float, **changes: Any) -> CheckValue:
    """A distance that must be the limit or more."""
    return dataclasses.replace(CheckValue(value, limit, "m", value >= limit, None, None), **changes)


PASSED = CheckValue(1.0, 1.0, None, True, None, None)
FAILED = CheckValue(0.0, 1.0, None, False, None, None)
CLEAR = in_m(0.04, 0.023)
AT = (0.85, 0.12, TABLE_M + 0.08)


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
            rank=k + 1,
            T_base_gripper=candidates.T_base_gripper[k],
            width_m=float(candidates.width_m[k]),
            checks={
                "visible_clearance": in_m((0.01, 0.04, 0.08)[k % 3], 0.023),
                "unseen_distance": in_m(0.5, 0.0),
                "approach_clearance": in_m(0.05, 0.005),
                "plane_clearance": in_m(0.03, 0.003),
                "width": CheckValue(0.09, 0.117, "m", True, None, None),
                "width_known": PASSED,
                "allowed_faces": PASSED,
            },
        )
        for k in range(len(candidates.label))
    )
    return Selection(
        grasp=grasp_of(reports[1]),
        refusal=None,
        candidates=reports,
        box=TargetBox(box.T_base_box, box.dimensions_m, box.dimensions_m, box.dimensions_m),
        gripper=gripper,
        ranker="clearance",
        frame="given",
        T_base_camera=captured().T_base_camera,
        warnings=(),
        config_hash="0" * 16,
        timings_ms={"total": 1.0},
        version="0",
    )


def grasp_of(chosen: Candidate, approach_m: float = 0.15) -> Grasp:
    T_pre = chosen.T_base_gripper.copy()
    T_pre[:3, 3] -= approach_m * T_pre[:3, 0]
    return Grasp(
        label=chosen.label,
        face=chosen.face,
        line=chosen.line,
        T_base_gripper=chosen.T_base_gripper,
        T_base_tcp=chosen.T_base_gripper,
        T_base_pregrasp=T_pre,
        position_m=chosen.T_base_gripper[:3, 3],
        quaternion_xyzw=np.array((0.0, 0.0, 0.0, 1.0)),
        opening_m=0.12,
        width_m=chosen.width_m,
        clearance_m=chosen.checks["visible_clearance"].value,
        clearance_at_least_m=None,
        probability_clear=None,
        confidence=None,
        T_base_flange=None,
    )


def with_checks(selection: Selection, label: int, **checks: CheckValue) -> Selection:
    """The same answer, some checks of one candidate changed or added."""
    candidates = list(selection.candidates)
    own = candidates[label - 1]
    candidates[label - 1] = dataclasses.replace(own, checks={**own.checks, **checks})
    return dataclasses.replace(selection, candidates=tuple(candidates))


def asking(best: int = 1, **checks: CheckValue) -> Selection:
    """The same as a question, the nearest candidate's checks changed as a test needs it."""
    changed = with_checks(made(), best, **checks)
    nearest = changed.candidate(best)
    reasons = "; ".join(item.sentence for item in nearest.rejections)
    refusal = Refusal(
        code="no_candidate_passes",
        message=f"no candidate passes; the nearest to it, {nearest.name}: {reasons}",
        nearest_label=best,
        violations=nearest.rejections,
    )
    return dataclasses.replace(changed, grasp=None, refusal=refusal)


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
    found, depth = camera_view(T, K, Extent(left, upper, step)).project(places)
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
    panel = camera_panel(capture, base_cloud(capture, T), focus, (908, 681), 0.0)
    rows, columns = np.nonzero(pixels(panel.image)[:, :, 1] > 150)
    at = panel.view.point(point[0])
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
    view = camera_view(np.eye(4), K, Extent(0, 0, 1.0))
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
        local = transform(invert(box.T_base_box), contact_line(candidate, box))
        assert np.abs(local).max() == pytest.approx(0.045)
        assert np.linalg.norm(local[1] - local[0]) == pytest.approx(candidate.width_m)
        way = candidate.T_base_gripper[:3, 3] - face_point(candidate, box)
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
    for other in (*CATEGORY.values(), GRIPPER, BLOCKED, OBSTACLE, WHITE):
        assert np.linalg.norm(as_seen(other, eye) - as_seen(HELD, eye)) > 20


def test_the_check_on_colors_can_fail() -> None:
    pure = (220, 40, 40), (110, 140, 20)
    assert np.linalg.norm(as_seen(pure[0], "normal") - as_seen(pure[1], "normal")) > 60
    assert np.linalg.norm(as_seen(pure[0], "protanopia") - as_seen(pure[1], "protanopia")) < 40


def test_categories_have_a_shape_each() -> None:
    assert set(SHAPE) == set(CATEGORY) and len(set(SHAPE.values())) == 3


def test_marks_differ_without_any_color() -> None:
    gray = []
    for shape in ("circle", "triangle", "square", "diamond"):
        for style in ("kept", "dropped", "wide"):
            canvas = Canvas(Image.new("RGB", (40, 40), WHITE))
            canvas.mark((20, 20), Look(shape, (128, 128, 128), style), 9)
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
    lettering = Lettering(16, (0, 0, 0), halo=WHITE)
    canvas.text((x, y), "M" * length, lettering)
    canvas.text_beside((x, y), "W" * length, lettering, must=True)
    for left, upper, right, lower in canvas.taken:
        assert left >= 0 and upper >= 0 and right <= 300 and lower <= 120
    ink = np.nonzero(pixels(canvas.finish()).min(axis=2) < 128)
    assert len(ink[0]) and ink[1].min() >= 2 and ink[1].max() <= 297


def test_texts_keep_off_each_other() -> None:
    canvas = Canvas(Image.new("RGB", (400, 300), WHITE))
    said = [canvas.text_beside((200, 150), f"number {k}", Lettering(14)) for k in range(30)]
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
    canvas.line((10, 20), (40, 20), Stroke((255, 0, 0), 1.0))
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
    moved = dataclasses.replace(selection, grasp=grasp_of(selection.candidate(12)))
    both = (pictured("grasp"), draw_selection(captured(), moved))
    a, b = (pixels(image.crop((14, 84, 922, 765))) for image in both)
    blue = [np.abs(image - GRIPPER).max(axis=2) < 12 for image in (a, b)]
    assert (blue[0] & ~blue[1]).sum() > 500 and (blue[1] & ~blue[0]).sum() > 500


@pytest.mark.parametrize("width_m", [0.17, 0.30])
def test_a_hand_is_drawn_in_its_own_size(width_m: float) -> None:
    gripper = Gripper(width_m=width_m, length_m=0.25)
    view = plan_view("above", np.array([(0.4, -0.4, 0.0), (1.2, 0.4, 1.0)]), (600, 600), 0.3)
    canvas = Canvas(Image.new("RGB", (600, 600), WHITE))
    T = make_transform(np.eye(3), (0.8, 0.0, 0.9))
    draw_hand(canvas, view, Hand(gripper, T), (0, 0, 255), dashed=False)
    blue = pixels(canvas.finish())[:, :, 0] < 128
    _, columns = np.nonzero(blue)
    assert np.ptp(columns) == pytest.approx(width_m * view.fx, abs=4)
    middle = blue[:, 285:315].any(axis=1)  # the arrow ends behind the hand
    assert np.nonzero(middle)[0].min() == pytest.approx(view.cy - 0.925 * view.fx, abs=4)


def test_pictures_draw_the_hand_that_the_selection_carries() -> None:
    wide = Gripper(width_m=0.30, max_opening_m=0.20)
    other = dataclasses.replace(made(), gripper=wide)
    drawn = draw_selection(captured(), other)
    assert drawn.tobytes() != pictured("grasp").tobytes()
    assert ("Width", "9.0 cm, and the fingers open 20.0 cm") in facts_of(other)


def test_the_way_in_is_as_long_as_the_answer_says() -> None:
    selection = made()
    short = dataclasses.replace(selection, grasp=grasp_of(selection.candidate(2), 0.08))
    for answer, length_m in ((selection, 0.15), (short, 0.08)):
        grasp = answer.grasp
        assert grasp is not None
        hand = Hand(answer.gripper, grasp.T_base_gripper, grasp.T_base_pregrasp)
        assert hand.approach_m == pytest.approx(length_m)
    assert legend_card(selection, 652).tobytes() != legend_card(short, 652).tobytes()
    side = (936, 738, 1588, 1218)
    both = (pictured("grasp"), draw_selection(captured(), short))
    assert pixels(both[0].crop(side)).tobytes() != pixels(both[1].crop(side)).tobytes()


def test_categories_and_rejections_change_marks() -> None:
    safe = made()
    for label in range(1, 16):
        safe = with_checks(safe, label, visible_clearance=in_m(0.2, 0.023))
    all_safe = draw_selection(captured(), safe)
    mixed = pictured("grasp")
    assert count_of(all_safe, CATEGORY["green"]) > count_of(mixed, CATEGORY["green"]) > 500
    assert count_of(all_safe, CATEGORY["red"]) < count_of(mixed, CATEGORY["red"])


def test_a_look_follows_the_checks() -> None:
    plain = made().candidate(3)
    assert look_of(plain) == Look("circle", CATEGORY["green"], "kept")
    assert look_of(made().candidate(1)) == Look("square", CATEGORY["red"], "dropped")
    for name in ("width", "width_known"):
        told = dataclasses.replace(plain, checks={**plain.checks, name: FAILED})
        assert look_of(told) == Look("circle", CATEGORY["green"], "wide")
    told = dataclasses.replace(plain, checks={**plain.checks, "my_check": FAILED})
    assert look_of(told) == Look("circle", CATEGORY["green"], "dropped")
    bare = dataclasses.replace(plain, checks={"my_check": PASSED})
    assert look_of(bare).shape == "diamond" and look_of(bare).style == "kept"


PANEL = (14, 84, 922, 765)
BARE = {"visible_clearance": CLEAR, "allowed_faces": FAILED}


@cache
def unmarked() -> Image.Image:
    return draw_selection(captured(), asking(**BARE)).crop(PANEL)


@pytest.mark.parametrize(
    "checks",
    [
        {"width": CheckValue(0.14, 0.117, "m", False, None, None)},
        {"width_known": FAILED},
        {"plane_clearance": in_m(-0.012, 0.003, nearest_point_m=(0.85, 0.0, TABLE_M - 0.012))},
        {"visible_clearance": in_m(0.01, 0.023, object=2, nearest_point_m=AT)},
        {"approach_clearance": in_m(0.0, 0.005, object=2, nearest_point_m=AT)},
        {"unseen_distance": in_m(0.0, 0.01, nearest_point_m=AT)},
        {"unseen_fraction": CheckValue(0.6, 0.25, "fraction", False, None, None)},
        {"a_users_own": in_m(0.01, 0.05, nearest_point_m=AT)},
        {"a_users_question": FAILED},
        {
            "visible_clearance": in_m(0.01, 0.023, object=2, nearest_point_m=AT),
            "approach_clearance": in_m(0.0, 0.005, object=2, nearest_point_m=AT),
            "width_known": FAILED,
        },
    ],
    ids=lambda checks: "+".join(checks),
)
def test_every_rejection_is_marked_in_the_picture(checks: dict[str, CheckValue]) -> None:
    answer = asking(**{"visible_clearance": CLEAR, **checks})
    rejections = answer.candidate(1).rejections
    marks = marks_of(answer)
    assert {item.check for item in rejections} == set(checks)
    assert [mark.words for mark in marks] == [item.sentence for item in rejections]
    for mark, rejection in zip(marks, rejections, strict=True):
        if rejection.nearest_point_m is None:
            assert mark.point_m is None
        else:
            np.testing.assert_array_equal(mark.point_m, rejection.nearest_point_m)
        assert (mark.across_m is not None) == (rejection.check in ("width", "width_known"))
        assert mark.is_obstacle == (rejection.object is not None)
    marked = draw_selection(captured(), answer).crop(PANEL)
    assert (pixels(marked) != pixels(unmarked())).any(axis=2).sum() > 150
    if any(mark.point_m is not None or mark.across_m is not None for mark in marks):
        assert count_of(marked, OBSTACLE) > count_of(unmarked(), OBSTACLE) + 30


def test_what_has_no_place_is_told_in_words_alone() -> None:
    (mark,) = marks_of(asking(**BARE))
    assert mark.words == "allowed faces: no"
    assert mark.point_m is None and mark.across_m is None


def test_a_grasp_marks_the_visible_obstacle_that_its_check_names() -> None:
    assert marks_of(made()) == ()  # no nearest point: nothing within reach
    for number, words in ((2, "object 2 at 4.0 cm"), (0, "obstacle at 4.0 cm")):
        said = in_m(0.04, 0.023, object=number, nearest_point_m=AT)
        (mark,) = marks_of(with_checks(made(), 2, visible_clearance=said))
        assert mark.words == words
        np.testing.assert_array_equal(mark.point_m, AT)


def test_an_unchecked_grasp_shows_why_it_would_be_rejected() -> None:
    unchecked = with_checks(made(), 2, width_known=FAILED)
    assert [mark.words for mark in marks_of(unchecked)] == ["width known: no"]
    assert ("Rejected", "width known: no") in facts_of(unchecked)


def test_lines_to_obstacles_are_as_long_as_the_checks_say() -> None:
    """The place on the hand is found by drawing alone, yet agrees with what was measured."""
    answer = GraspSelector().select(captured(), Target(pixel=captured().target_pixel))
    counted = 0
    for candidate in answer.candidates:
        hand = Hand(answer.gripper, candidate.T_base_gripper)
        for name, on_the_way in (("visible_clearance", False), ("approach_clearance", True)):
            said = candidate.checks[name]
            if said.nearest_point_m is None:
                continue
            point = np.array(said.nearest_point_m)
            gap = np.linalg.norm(hand.nearest(point, on_the_way=on_the_way) - point)
            assert gap == pytest.approx(said.value, abs=1e-6)
            counted += 1
    assert counted == 30


def test_the_nearest_place_of_a_hand_is_the_nearest_of_all() -> None:
    rng = np.random.default_rng(3)
    hand = Hand(Gripper(), made().candidate(12).T_base_gripper)
    inside = rng.uniform(-1, 1, (20_000, 3)) * hand.gripper.half_m
    places = transform(hand.T_base_gripper, inside)
    for point in rng.uniform((0.5, -0.4, 0.75), (1.2, 0.4, 1.3), (50, 3)):
        found = hand.nearest(point)
        best = np.linalg.norm(places - point, axis=1).min()
        assert np.linalg.norm(found - point) <= best + 1e-12
        local = transform(invert(hand.T_base_gripper), found[None])[0]
        assert (np.abs(local) <= hand.gripper.half_m + 1e-9).all()
    center = hand.T_base_gripper[:3, 3]
    np.testing.assert_allclose(hand.nearest(center), center, atol=1e-12)


class KeepOut(Check):
    """A user's own check: nothing passes, because of one place."""

    name = "keep_out"

    def __init__(self, point: tuple[float, float, float]) -> None:
        self.point = point

    def evaluate(self, context: CheckContext) -> CheckResult:
        count = len(context.candidates.label)
        witness = Witness(np.full(count, -1), np.tile(self.point, (count, 1)))
        return CheckResult.at_least(np.full(count, 0.01), 0.05, witness)


@pytest.mark.parametrize("point", [(0.80, 0.10, 1.05), (0.90, -0.12, 1.00)])
def test_a_users_check_is_drawn_at_its_nearest_point(point: tuple[float, float, float]) -> None:
    selector = GraspSelector(checks=[*default_checks(), KeepOut(point)])
    answer = selector.select(captured(), Target(pixel=captured().target_pixel))
    assert answer.grasp is None
    marks = [mark for mark in marks_of(answer) if mark.words == "keep out: 1.0 cm, needs 5.0 cm"]
    assert len(marks) == 1
    np.testing.assert_array_equal(marks[0].point_m, point)
    for kind in ("above", "side"):
        view = plan_view(kind, np.array([point, answer.box.T_base_box[:3, 3]]), (600, 600), 0.6)
        canvas = Canvas(Image.new("RGB", (600, 600), WHITE))
        lone = dataclasses.replace(marks[0], words="", on_hand_m=marks[0].point_m)
        draw_marks(canvas, view, answer, [lone])
        ring = np.abs(pixels(canvas.finish()) - OBSTACLE).max(axis=2) < 12
        rows, columns = np.nonzero(ring)
        assert (columns.mean(), rows.mean()) == pytest.approx(view.point(np.array(point)), abs=1)
        assert np.ptp(rows) == pytest.approx(24, abs=4)
    picture = draw_selection(captured(), answer)
    without = GraspSelector(checks=[*default_checks(), Elsewhere(point)])
    plain = draw_selection(
        captured(), without.select(captured(), Target(pixel=captured().target_pixel))
    )
    for panel in (PANEL, (936, 84, 1588, 724), (936, 738, 1588, 1218)):
        assert count_of(picture.crop(panel), OBSTACLE) > count_of(plain.crop(panel), OBSTACLE) + 40


class Elsewhere(KeepOut):
    """The same check without a place."""

    def evaluate(self, context: CheckContext) -> CheckResult:
        return CheckResult.at_least(np.full(len(context.candidates.label), 0.01), 0.05)


SIDES = {"camera": PANEL, "above": (936, 84, 1588, 724), "side": (936, 738, 1588, 1218)}
HOLDS = CheckValue(9e-4, 1.4e-4, "m2", True, None, None)


@cache
def selected() -> Selection:
    return GraspSelector().select(captured(), Target(pixel=captured().target_pixel))


@pytest.mark.parametrize("kind", SIDES)
def test_what_is_held_is_shown_in_every_panel(kind: str) -> None:
    """And only where the check was made: without it the same pictures have none of its color."""
    answer = selected()
    assert answer.shown is not None
    unmade = {k: v for k, v in answer.shown.checks.items() if k != "holds"}
    bare = dataclasses.replace(answer.shown, checks=unmade)
    rows = tuple(bare if c is answer.shown else c for c in answer.candidates)
    for other in (answer, dataclasses.replace(answer, candidates=rows)):
        count = count_of(draw_selection(captured(), other).crop(SIDES[kind]), HELD)
        assert count > 150 if other is answer else count == 0


def test_a_hand_that_holds_nothing_shows_nothing_held() -> None:
    """The legend says so; the same hand at the target says how much."""
    far = make_transform(np.eye(3), (0.3, 0.0, 0.3)) @ made().candidate(2).T_base_gripper
    for T, holds in (
        (far, dataclasses.replace(HOLDS, value=0.0, passed=False)),
        (made().candidate(2).T_base_gripper, HOLDS),
    ):
        answer = with_checks(made(), 2, holds=holds)
        rows = list(answer.candidates)
        rows[1] = dataclasses.replace(rows[1], T_base_gripper=T)
        moved = dataclasses.replace(answer, candidates=tuple(rows), grasp=grasp_of(rows[1]))
        picture = draw_selection(captured(), moved)
        counts = [count_of(picture.crop(place), HELD) for place in SIDES.values()]
        assert max(counts) == 0 if T is far else min(counts) > 50
        assert count_of(legend_card(moved, 652), HELD) > 100
    assert count_of(legend_card(made(), 652), HELD) == 0


def test_the_legend_says_how_much_is_held() -> None:
    less = dataclasses.replace(HOLDS, value=2.3e-4)
    cards = [legend_card(with_checks(made(), 2, holds=said), 652) for said in (HOLDS, less)]
    assert cards[0].size == cards[1].size and cards[0].tobytes() != cards[1].tobytes()


def test_marks_keep_off_what_is_held() -> None:
    """A patch is put where the shown candidate's mark would be: it moves, and is drawn."""
    selection, size = made(), (600, 600)
    view = plan_view("above", corners(selection.box.T_base_box, np.full(3, 0.3)), size, 0.3)
    own = face_point(selection.candidate(2), selection.box)
    patch = own + np.random.default_rng(0).uniform(-0.01, 0.01, (500, 3))
    xy, _ = view.project(patch)
    marked = []
    for held in (patch[:0], patch):
        canvas = Canvas(Image.new("RGB", size, WHITE))
        draw_candidates(canvas, view, selection, held.astype(np.float32), "above")
        marked.append((pixels(canvas.finish()) != 255).any(axis=2))
    inside = np.zeros(size, bool)
    inside[np.rint(xy[:, 1]).astype(int), np.rint(xy[:, 0]).astype(int)] = True
    before, after = ((mark & inside).sum() for mark in marked)
    assert before > 50 and after < 0.3 * before
    assert marked[1].sum() > 0.9 * marked[0].sum()


def test_pictures_measure_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    capture = captured()
    free = Capture(capture.depth, capture.intrinsics, None, capture.rgb)
    selector = GraspSelector()
    target = Target(pixel=capture.target_pixel)
    answers = [(view, selector.select(view, target)) for view in (capture, free)]
    scenes = [(view, selector.scene(view)) for view in (capture, free)]

    def refuse(*_: Any, **__: Any) -> None:
        raise AssertionError("measured again")

    measuring = {
        hand_distance: ("to_points", "to_columns", "to_cells", "to_plane", "uprights"),
        support_plane: ("find_support_plane",),
    }
    names = [name for module in measuring for name in measuring[module]]
    for module, own in measuring.items():
        for name in own:
            monkeypatch.setattr(module, name, refuse)
    for name, module in list(sys.modules.items()):
        if name.startswith("boxgrasp.draw"):
            assert not {*names, "find_scene"} & set(vars(module))
    for view, answer in answers:
        assert draw_selection(view, answer).width == 1600
    for view, scene in scenes:
        assert draw_objects(view, scene).width == 1600


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
    objects = draw_objects(capture, scene_with(some_objects(), capture.T_base_camera))
    assert objects.width == 1600 and count_of(objects, GRIPPER) > 600


def test_a_view_seen_by_the_camera_agrees_for_image_and_cloud() -> None:
    """The painted cloud and the image both have the target in their midst."""
    for name in ("depth", "optical cloud", "organized"):
        capture = variants()[name]
        cloud = base_cloud(capture, capture.T_base_camera)
        focus = corners(made().box.T_base_box, np.full(3, 0.3))
        panel = camera_panel(capture, cloud, focus, (908, 681), TABLE_M)
        at = panel.view.point(made().box.T_base_box[:3, 3])
        assert at is not None
        assert 200 < at[0] < 708 and 150 < at[1] < 531
        assert ("Points" in panel.caption) == (name == "optical cloud")


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
    warnings = tuple(CodedWarning(f"w{k}", f"warning {k}: " + "many words " * 30) for k in range(6))
    long = dataclasses.replace(made(), warnings=warnings)
    short, tall = pictured("grasp"), draw_selection(captured(), long)
    assert tall.width == short.width and tall.height > short.height
    for message in ("x" * 500, "a sentence " * 60):
        refusal = dataclasses.replace(asking().refusal, message=message)  # type: ignore[type-var]
        endless = draw_selection(captured(), dataclasses.replace(asking(), refusal=refusal))
        assert endless.width == 1600 and endless.height > short.height
    many = {f"a_check_of_my_own_{k}": FAILED for k in range(30)}
    assert draw_selection(captured(), asking(**many)).width == 1600


def test_an_answer_that_shows_no_candidate_is_drawn() -> None:
    bare = dataclasses.replace(asking(), refusal=None)
    assert bare.shown is None and draw_selection(captured(), bare).width == 1600


def test_words_say_the_answers_data() -> None:
    grasp, ask = made(), asking()
    assert headline_of(grasp) == ("GRASP", grasp.headline())
    assert headline_of(ask) == ("ASK A PERSON", ask.headline())
    rows = facts_of(grasp)
    assert ("Grasp", "candidate 2, left line 2") in rows
    first = "left line 2 (2), left line 3 (3), front line 2 (5) and 7 more"
    assert ("Passing", f"10 of 15 candidates, best first: {first}") in rows
    assert ("Rejected", "visible clearance: 1.0 cm, needs 2.3 cm") in facts_of(ask)
    assert ("Nearest", "candidate 1, left line 1") in facts_of(ask)
    warned = CodedWarning("target_cut", "the border cuts the target")
    assert ("Warning", warned.message) in facts_of(dataclasses.replace(grasp, warnings=(warned,)))
    assert measured(0.5, "m") == "at least 50 cm" and measured(0.04, "m") == "4.0 cm"


@pytest.mark.parametrize("name", ["visible_clearance", "plane_clearance", "a_users_own"])
def test_the_shown_candidates_checks_are_listed_with_their_values(name: str) -> None:
    below = (14, 779, 922, 1500)
    answers = [with_checks(made(), 2, **{name: in_m(value, 0.02)}) for value in (0.0311, 0.0422)]
    a, b = (draw_selection(captured(), answer).crop(below) for answer in answers)
    assert a.size == b.size and (pixels(a) != pixels(b)).any(axis=2).sum() > 20


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


@cache
def found_scene() -> Scene:
    return GraspSelector().scene(captured())


def scene_with(objects: tuple[SceneObject, ...], T_base_camera: np.ndarray | None) -> Scene:
    return dataclasses.replace(found_scene(), objects=objects, T_base_camera=T_base_camera)


def seen_objects(count: int) -> Scene:
    return scene_with(some_objects()[:count], captured().T_base_camera)


def test_every_object_gets_its_number_even_where_they_meet() -> None:
    panel = (14, 84, 1074, 879)
    none, one, four = (
        count_of(draw_objects(captured(), seen_objects(count)).crop(panel), GRIPPER)
        for count in (0, 1, 4)
    )
    assert none == 0 and four > 3.5 * one > 1000


def test_objects_are_numbered_without_a_transform() -> None:
    capture = captured()
    free = Capture(capture.depth, capture.intrinsics, None, capture.rgb)
    scene = GraspSelector().scene(free)
    image = draw_objects(free, scene)
    assert count_of(image.crop((14, 84, 1074, 879)), GRIPPER) > 300 * len(scene.objects)


def test_a_number_lies_on_its_object() -> None:
    """Through the camera that the scene names, not the capture's."""
    capture = captured()
    free = Capture(capture.depth, capture.intrinsics, None, capture.rgb)
    for view in (capture, free):
        scene = GraspSelector().scene(view)
        (first,) = scene.objects[:1]
        image = draw_objects(view, dataclasses.replace(scene, objects=(first,)))
        rows, columns = np.nonzero(
            np.abs(pixels(image.crop((14, 84, 1074, 879))) - GRIPPER).max(axis=2) < 12
        )
        assert scene.T_base_camera is not None and view.intrinsics is not None
        x, y, z = transform(invert(scene.T_base_camera), first.center_m[None])[0]
        u = view.intrinsics[0, 0] * x / z + view.intrinsics[0, 2]
        v = view.intrinsics[1, 1] * y / z + view.intrinsics[1, 2]
        assert columns.mean() == pytest.approx((u + 0.5) * 1060 / 640, abs=3)
        assert rows.mean() == pytest.approx((v + 0.5) * 795 / 480, abs=3)


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


def test_a_notebook_gets_the_same_picture(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    draw_selection(captured(), made(), path)
    assert selection_png(captured(), made()) == path.read_bytes()
    answer = GraspSelector().select(captured(), Target(pixel=captured().target_pixel))
    assert answer._repr_png_() == selection_png(captured(), answer)
    assert Selection.from_json(answer.to_json())._repr_png_() is None


@pytest.mark.parametrize("name", ["a.gif", "a.txt", "a", "missing/a.png", "folder.png"])
def test_a_path_that_cannot_be_written_is_one_line(tmp_path: Path, name: str) -> None:
    (tmp_path / "folder.png").mkdir()
    for draw in (
        lambda path: draw_selection(captured(), made(), path),
        lambda path: draw_objects(captured(), seen_objects(4), path),
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
    draw_objects(capture, seen_objects(4))
    assert selection.to_json() == before and capture.rgb.tobytes() == rgb


def test_real_captures_are_drawn(captures_dir: Path) -> None:
    selector = GraspSelector()
    for name in ("uois_00", "haf_table1/cloud.pcd"):
        frame = "base" if "haf" in name else "optical"
        capture = load_capture(captures_dir / name, cloud_frame=frame)  # type: ignore[arg-type]
        scene = selector.scene(capture)
        answer = selector.select(capture, Target(object=scene.objects[0].number))
        color = GRIPPER if answer.status == "grasp" else BLOCKED
        assert count_of(draw_selection(capture, answer), color) > 1000
        assert count_of(draw_objects(capture, scene), GRIPPER) > 300 * len(scene.objects)


@pytest.mark.parametrize("highest", [0, 7, 255, 256, 65535])
def test_an_object_image_is_read_back_exactly(tmp_path: Path, highest: int) -> None:
    path = tmp_path / "objects.PNG"
    image = np.random.default_rng(0).integers(0, highest + 1, (31, 47)).astype(np.int32)
    image[3, 5] = highest
    write_object_image(path, image)
    with Image.open(path) as read:
        assert read.format == "PNG" and read.size == (47, 31)
        assert (read.mode == "L") == (highest <= 255)
        np.testing.assert_array_equal(np.asarray(read), image)


def test_the_segmentation_of_a_view_is_written_as_it_is(tmp_path: Path) -> None:
    image = GraspSelector().segment(captured())
    write_object_image(tmp_path / "objects.png", image)
    with Image.open(tmp_path / "objects.png") as read:
        np.testing.assert_array_equal(np.asarray(read), image)
    assert image.max() >= 3


@pytest.mark.parametrize(
    ("name", "number"), [("a.jpg", 1), ("a.png", -1), ("a.png", 65536), ("missing/a.png", 1)]
)
def test_an_object_image_that_cannot_be_written_is_one_line(
    tmp_path: Path, name: str, number: int
) -> None:
    with pytest.raises(BoxgraspError) as caught:
        write_object_image(tmp_path / name, np.full((4, 4), number, np.int32))
    assert "\n" not in str(caught.value) and list(tmp_path.iterdir()) == []
