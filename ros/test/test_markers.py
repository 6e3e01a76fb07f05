"""Markers show the answer's own geometry, and nothing that RViz refuses."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from answers import HEADER, answer, answer_to, cast, checked_fields, matrix, real_answer, sent, xyz
from boxgrasp_ros.markers import NAMESPACES, failed_markers, marker_array
from boxgrasp_ros.seen import surfaces, target_number, things
from marker_picture import picture
from visualization_msgs.msg import Marker

from boxgrasp.draw.palette import BLOCKED, CATEGORY, FAINT, GRIPPER, RGB, WHITE
from boxgrasp.geometry.transforms import invert, transform
from boxgrasp.ranking.sampling import grid, spiral
from boxgrasp.result import Candidate, Selection

KINDS = ("grasp", "ask")
LISTS = (Marker.LINE_LIST, Marker.LINE_STRIP, Marker.POINTS, Marker.SPHERE_LIST,
         Marker.TRIANGLE_LIST)  # fmt: skip
# Which of scale's x, y, z RViz reads, where it does not read all: the others stay 0.
USED = {Marker.LINE_LIST: "x", Marker.LINE_STRIP: "x", Marker.POINTS: "xy",
        Marker.TEXT_VIEW_FACING: "z"}  # fmt: skip


def shown(kind: str) -> dict[tuple[str, int], Any]:
    return keyed(marker_array(*answer(kind), HEADER))


def keyed(array: Any) -> dict[tuple[str, int], Any]:
    return {(marker.ns, marker.id): marker for marker in array.markers[1:]}


def places(marker: Any) -> np.ndarray:
    return np.array([xyz(point) for point in marker.points])


def is_colored(color: Any, expected: RGB) -> bool:
    return np.allclose((color.r, color.g, color.b), np.array(expected) / 255, atol=1e-3)


def check_for_rviz(array: Any) -> None:
    """What RViz refuses or warns of."""
    array = sent(array)
    first, *others = array.markers
    assert first.action == Marker.DELETEALL
    keys = [(marker.ns, marker.id) for marker in others]
    assert len(set(keys)) == len(keys)
    for marker in others:
        where = f"{marker.ns} {marker.id}"
        assert marker.action == Marker.ADD and marker.ns and marker.header == HEADER, where
        matrix(marker.pose)
        scale, points = xyz(marker.scale), places(marker).reshape(-1, 3)
        numbers = [*scale, *points.ravel(), *xyz(marker.pose.position)]
        assert np.isfinite(numbers).all(), where
        used = USED.get(marker.type, "xyz")
        assert all((value > 0) == (axis in used) for axis, value in zip("xyz", scale, strict=True))
        color = marker.color
        assert 0 < color.a <= 1 and min(color.r, color.g, color.b) >= 0, where
        assert max(color.r, color.g, color.b) <= 1, where
        assert (len(points) > 0) == (marker.type in (*LISTS, Marker.ARROW)), where
        assert len(marker.colors) in (0, len(points)), where
        assert bool(marker.text) == (marker.type == Marker.TEXT_VIEW_FACING), where
        if marker.type == Marker.LINE_LIST:
            assert len(points) % 2 == 0, where
        if marker.type == Marker.TRIANGLE_LIST:
            assert len(points) % 3 == 0, where
        if marker.type == Marker.ARROW:
            assert len(points) == 2 and np.linalg.norm(points[1] - points[0]) > 0.01, where


@pytest.mark.parametrize("kind", KINDS)
def test_rviz_takes_every_marker(kind: str) -> None:
    with checked_fields():
        array = marker_array(*answer(kind), HEADER)
    check_for_rviz(array)
    namespaces = {marker.ns for marker in array.markers[1:]}
    assert namespaces == set(NAMESPACES)
    assert len(array.markers) == len(marker_array(*answer(kind), HEADER).markers)


@pytest.mark.parametrize("sentence", ["", "no view arrived on depth in 2.0 s; " * 5])
def test_a_failure_clears_all_and_says_why(sentence: str) -> None:
    array = failed_markers(HEADER, sentence)
    check_for_rviz(array)
    (text,) = array.markers[1:]
    assert text.text.replace("\n", " ") == (sentence.strip() or "no answer")
    assert (text.ns, text.id) == ("headline", 0)  # so that it replaces an answer's


def test_what_stands_for_the_same_has_the_same_id() -> None:
    grasp, ask = shown("grasp"), shown("ask")
    both = grasp.keys() & ask.keys()
    assert len(both) > 30
    for key in both:
        assert grasp[key].type == ask[key].type, key


@pytest.mark.parametrize("kind", KINDS)
def test_the_target_box_is_the_answers(kind: str) -> None:
    selection, found = answer(kind)[1], shown(kind)
    cube = found["target_box", 0]
    np.testing.assert_allclose(matrix(cube.pose), selection.box.T_base_box, atol=1e-12)
    np.testing.assert_array_equal(xyz(cube.scale), selection.box.dimensions_m)
    edges = transform(invert(selection.box.T_base_box), places(found["target_box", 1]))
    np.testing.assert_allclose(np.abs(edges), np.tile(selection.box.dimensions_m / 2, (24, 1)))
    assert ("target_box", 2) not in found
    along = np.abs(edges[1::2] - edges[::2]) > 1e-9
    np.testing.assert_array_equal(along.sum(axis=0), (4, 4, 4))


def test_edges_of_which_a_bound_was_seen_are_dashed() -> None:
    analysis, selection = answer("grasp")
    most = np.array([np.inf, selection.box.dimensions_m[1], selection.box.dimensions_m[2]])
    box = dataclasses.replace(selection.box, dimensions_at_most_m=most)
    array = marker_array(analysis, dataclasses.replace(selection, box=box), HEADER)
    check_for_rviz(array)
    found = keyed(array)
    T = invert(box.T_base_box)
    solid = transform(T, places(found["target_box", 1])).reshape(-1, 2, 3)
    dashes = transform(T, places(found["target_box", 2])).reshape(-1, 2, 3)
    assert len(solid) == 8 and np.allclose(solid[:, 0, 0], solid[:, 1, 0])
    np.testing.assert_allclose(dashes[:, 0, 1:], dashes[:, 1, 1:])  # along x, on the edges
    half = box.dimensions_m / 2
    np.testing.assert_allclose(np.abs(dashes[..., 1:]), np.tile(half[1:], (len(dashes), 2, 1)))
    assert np.abs(dashes[..., 0]).max() <= half[0] + 1e-9
    drawn = np.abs(dashes[:, 1, 0] - dashes[:, 0, 0]).sum() / (4 * box.dimensions_m[0])
    assert 0.4 < drawn < 0.75
    width = [found["target_box", number].scale.x for number in (1, 2)]
    assert width[1] < width[0]
    assert ">=" in found["headline", 0].text


@pytest.mark.parametrize("kind", KINDS)
def test_the_table_lies_on_the_plane_under_all_that_stands_on_it(kind: str) -> None:
    analysis, found = answer(kind)[0], shown(kind)
    rim = places(found["table", 1])
    np.testing.assert_array_equal(rim[0], rim[-1])
    assert np.abs(analysis.scene.plane.heights(rim)).max() < 1e-6
    assert np.abs(rim[:, 2] - 0.80).max() < 0.004
    middle = rim[:-1].mean(axis=0)[:2]
    for place in [*(item.center_m for item in analysis.scene.objects), (*middle, 0.0)]:
        for a, b in zip(rim[:-1, :2], rim[1:, :2], strict=True):
            turn = np.linalg.det((b - a, np.asarray(place)[:2] - a))
            assert turn > 0  # counter-clockwise from above
    # The triangles are the outline's area.
    x, y = rim[:-1, :2].T
    area = 0.5 * abs(x @ np.roll(y, -1) - y @ np.roll(x, -1))
    triangles = places(found["table", 0]).reshape(-1, 3, 3)
    sides = triangles[:, 1:, :2] - triangles[:, :1, :2]
    assert 0.5 * np.abs(np.linalg.det(sides)).sum() == pytest.approx(area, rel=1e-6)
    assert 0.1 < area < 2.0


@pytest.mark.parametrize("kind", KINDS)
def test_objects_are_shown_by_their_points_and_numbers(kind: str) -> None:
    analysis, found = answer(kind)[0], shown(kind)
    target = target_number(analysis)
    for item in analysis.scene.objects:
        keys = [("objects", 2 * item.number), ("objects", 2 * item.number + 1)]
        if item.number == target:
            assert not any(key in found for key in keys)
            continue
        dots, text = (found[key] for key in keys)
        away = np.abs(places(dots) - item.center_m)
        assert (away <= item.size_m / 2 + 1e-6).all()
        assert text.text == str(item.number)
        assert np.all(np.abs(xyz(text.pose.position)[:2] - item.center_m[:2]) < 1e-6)
    numbered = [marker for (name, _), marker in found.items() if name == "objects"]
    assert sum(len(marker.points) for marker in numbered) <= 2000 + len(numbered)


def test_the_target_is_the_object_that_was_meant() -> None:
    for kind in KINDS:
        analysis, selection = answer(kind)
        item = analysis.scene.objects[target_number(analysis) - 1]
        assert np.linalg.norm(item.center_m - selection.box.T_base_box[:3, 3]) < 0.03
        assert {thing.number for thing in things(analysis)} >= (
            {other.number for other in analysis.scene.objects} - {item.number}
        )


def expected_color(candidate: Candidate) -> RGB:
    d = candidate.checks["visible_clearance"].value
    if d < 0.02:
        return CATEGORY["red"]
    if not candidate.passed:
        return FAINT
    return CATEGORY["yellow" if d < 0.06 else "green"]


@pytest.mark.parametrize("kind", KINDS)
def test_each_candidate_points_at_its_line_in_its_color(kind: str) -> None:
    selection, found = answer(kind)[1], shown(kind)
    T_box_base = invert(selection.box.T_base_box)
    half = selection.box.dimensions_m / 2
    others = [item for item in selection.candidates if item is not selection.shown]
    lines, colors = places(found["lines", 0]).reshape(-1, 2, 3), found["lines", 0].colors[::2]
    for candidate, line, color in zip(others, lines, colors, strict=True):
        arrow, label = (found["candidates", 2 * candidate.label + k] for k in (0, 1))
        tail, tip = places(arrow)
        approach, opening = candidate.T_base_gripper[:3, :2].T
        way = (tip - tail) / np.linalg.norm(tip - tail)
        np.testing.assert_allclose(way, approach, atol=1e-9)
        # The tip is on the face, on the candidate's line.
        np.testing.assert_allclose(np.cross(tip - line[0], opening), 0.0, atol=1e-9)
        local = np.abs(transform(T_box_base, np.array([tip, *line])))
        assert (local <= half + 1e-9).all()
        axis = int(np.argmax(np.abs(T_box_base[:3, :3] @ approach)))
        np.testing.assert_allclose(local[:, axis], half[axis])
        length = np.linalg.norm(line[1] - line[0])
        assert length == pytest.approx(candidate.width_m)
        assert label.text == str(candidate.label)
        assert (arrow.scale.x == 0.006) == candidate.passed
        for own in (arrow.color, color):
            assert is_colored(own, expected_color(candidate))
    assert selection.shown is not None
    assert ("candidates", 2 * selection.shown.label) not in found  # the gripper stands there
    assert is_colored(found["lines", 1].color, expected_color(selection.shown))


def test_all_colors_come_up() -> None:
    seen = {expected_color(item) for kind in KINDS for item in answer(kind)[1].candidates}
    assert {CATEGORY["red"], CATEGORY["green"], FAINT} <= seen


def in_hand(selection: Selection, T: np.ndarray, points: np.ndarray) -> np.ndarray:
    return transform(invert(T), points) / selection.gripper.half_m


def test_the_gripper_stands_where_it_closes() -> None:
    selection, found = answer("grasp")[1], shown("grasp")
    grasp, gripper = selection.grasp, selection.gripper
    assert grasp is not None
    box = found["gripper", 0]
    np.testing.assert_allclose(matrix(box.pose), grasp.T_base_gripper, atol=1e-12)
    np.testing.assert_allclose(xyz(box.scale), 2 * gripper.half_m)
    for number, T in ((1, grasp.T_base_gripper), (4, grasp.T_base_pregrasp)):
        edges = in_hand(selection, T, places(found["gripper", number]))
        np.testing.assert_allclose(np.abs(edges), 1.0, atol=1e-9)
        assert len(edges) == 24
    assert found["gripper", 4].color.a < found["gripper", 1].color.a  # the pregrasp is faint
    gaps = []
    for number in (2, 3):
        finger = found["gripper", number]
        local = invert(grasp.T_base_gripper) @ matrix(finger.pose)
        np.testing.assert_allclose(local[:3, :3], np.eye(3), atol=1e-9)
        size, middle = xyz(finger.scale), local[:3, 3]
        assert middle[0] + size[0] / 2 == pytest.approx(gripper.length_m / 2)
        gaps.append(abs(middle[1]) - size[1] / 2)
    np.testing.assert_allclose(gaps, gripper.max_opening_m / 2)
    tail, tip = places(found["gripper", 5])
    np.testing.assert_allclose(
        tip - tail, grasp.T_base_gripper[:3, 3] - grasp.T_base_pregrasp[:3, 3], atol=1e-9
    )
    assert all(is_colored(found["gripper", k].color, GRIPPER) for k in range(6))
    assert found["gripper", 6].text == str(grasp.label)


def test_a_hand_of_several_boxes_is_shown_as_these() -> None:
    capture = cast(("green_cube", 0.85, 0.0, 0.3), ("beans_can", 0.80, 0.22, 0.0))
    analysis, selection = answer_to(capture, hand="robotiq-2f-85")
    grasp, hand = selection.grasp, selection.gripper
    assert grasp is not None and len(hand.boxes_m) > 3
    array = marker_array(analysis, selection, HEADER)
    check_for_rviz(array)
    solids = [m for m in array.markers[1:] if m.ns == "gripper" and m.type == Marker.CUBE]
    assert len(solids) == len(hand.boxes_m)
    for solid, (low, high) in zip(solids, hand.boxes_m, strict=True):
        local = invert(grasp.T_base_gripper) @ matrix(solid.pose)
        np.testing.assert_allclose(local[:3, :3], np.eye(3), atol=1e-9)
        np.testing.assert_allclose(local[:3, 3], (low + high) / 2, atol=1e-9)
        np.testing.assert_allclose(xyz(solid.scale), high - low, atol=1e-9)


def test_an_ask_shows_the_nearest_hand_as_a_warning() -> None:
    selection, found = answer("ask")[1], shown("ask")
    assert selection.shown is not None
    T = selection.shown.T_base_gripper
    np.testing.assert_allclose(matrix(found["gripper", 0].pose), T, atol=1e-12)
    assert ("gripper", 4) not in found  # no pregrasp
    assert is_colored(found["gripper", 0].color, BLOCKED)
    assert found["gripper", 6].text == f"nearest: {selection.shown.label}, rejected"
    assert found["headline", 0].text.startswith("ASK A PERSON\n")
    assert is_colored(found["headline", 0].color, BLOCKED)


@pytest.mark.parametrize("kind", KINDS)
def test_the_clearance_is_drawn_as_long_as_it_is(kind: str) -> None:
    selection, found = answer(kind)[1], shown(kind)
    assert selection.shown is not None
    said = selection.shown.checks["visible_clearance"]
    assert said.nearest_point_m is not None
    np.testing.assert_allclose(places(found["clearance", 0])[0], said.nearest_point_m)
    if ("clearance", 1) in found:
        start, end = places(found["clearance", 1])
        assert np.linalg.norm(end - start) == pytest.approx(said.value, abs=1e-5)
    assert found["clearance", 2].text == f"{100 * said.value:.1f} cm"


@pytest.mark.parametrize(
    ("ranker", "points"), [("clearance", grid()), ("cascade-spiral", spiral())]
)
def test_samples_say_what_the_map_says(ranker: str, points: np.ndarray) -> None:
    capture = cast(("green_cube", 0.85, 0.0, 0.3), ("beans_can", 0.80, 0.22, 0.0))
    analysis, selection = answer_to(capture, ranker=ranker)
    found = keyed(marker_array(analysis, selection, HEADER))
    held = {key[1]: places(marker) for key, marker in found.items() if key[0] == "samples"}
    assert sorted(held) == [0, 1, 2] and sum(map(len, held.values())) == 184
    maps = analysis.context.local_maps
    local_map = maps[0.03]  # both the default and what the spiral reads
    center = selection.box.T_base_box[:3, 3].copy()
    center[2] += 0.05 - selection.box.dimensions_m[2] / 2
    for state, own in held.items():
        local = transform(invert(local_map.T_base_map), own)
        np.testing.assert_array_equal(local_map.values_at(local), state / 2)
        assert np.linalg.norm(own - center, axis=1).max() <= 0.3 + 1e-6
    every = transform(invert(local_map.T_base_map), np.vstack(list(held.values())))
    np.testing.assert_allclose(
        every[np.lexsort(every.round(6).T)], points[np.lexsort(points.round(6).T)], atol=1e-9
    )


@pytest.mark.parametrize("kind", KINDS)
def test_the_headline_is_the_answers_and_over_all_near_it(kind: str) -> None:
    analysis, selection = answer(kind)
    text = shown(kind)["headline", 0]
    flat = text.text.replace("\n", " ")
    assert selection.headline() in flat and max(map(len, text.text.split("\n"))) <= 56
    assert f"target {target_number(analysis)}: " in flat
    near = (
        np.linalg.norm(analysis.scene.points[:, :2] - selection.box.T_base_box[:2, 3], axis=1) < 0.3
    )
    low = text.pose.position.z - text.scale.z * (text.text.count("\n") + 1) / 2
    assert low > analysis.scene.points[near, 2].max()


def test_a_scene_moved_moves_its_markers() -> None:
    """The same things 10 cm farther from the robot, seen by a camera that moved along."""
    arrays = []
    for shift in (0.0, 0.1):
        T = np.eye(4)
        T[0, 3] = shift
        capture = cast(("green_cube", 0.85, 0.0, 0.3), ("beans_can", 0.80, 0.22, 0.0))
        assert capture.T_base_camera is not None
        moved = dataclasses.replace(capture, T_base_camera=T @ capture.T_base_camera)
        arrays.append(keyed(marker_array(*answer_to(moved), HEADER)))
    assert arrays[0].keys() == arrays[1].keys()
    for key in arrays[0]:
        before, after = (array[key] for array in arrays)
        if key[0] in ("target_box", "gripper", "candidates", "lines"):
            way = matrix(after.pose)[:3, 3] - matrix(before.pose)[:3, 3]
            if before.points:
                way = way + places(after) - places(before)
            np.testing.assert_allclose(way, np.broadcast_to((0.1, 0.0, 0.0), way.shape), atol=2e-3)


def test_a_picture_shows_each_stage_in_its_color() -> None:
    array = marker_array(*answer("grasp"), HEADER)
    whole = np.asarray(picture(array), dtype=np.int64)
    for name in NAMESPACES:
        bare = without(array, name)
        assert np.abs(np.asarray(picture(bare), dtype=np.int64) - whole).max() > 40, name


def without(array: Any, left_out: str) -> Any:
    kept = [marker for marker in array.markers if marker.ns != left_out]
    return type(array)(markers=kept)


def test_a_lone_target_has_no_obstacles_to_show() -> None:
    analysis, selection = answer_to(cast(("green_cube", 0.85, 0.0, 0.0)))
    assert things(analysis) == []
    array = marker_array(analysis, selection, HEADER)
    check_for_rviz(array)
    assert {marker.ns for marker in array.markers[1:]} == set(NAMESPACES) - {"objects", "clearance"}


def test_of_a_real_capture_too() -> None:
    analysis, selection = real_answer("uois_00", 7)
    array = marker_array(analysis, selection, HEADER)
    check_for_rviz(array)
    (surface,) = surfaces(analysis)
    span = np.ptp(surface.outline_m, axis=0)
    assert 0.5 < span.min() and span.max() < 2.0
    assert is_colored(keyed(array)["target_box", 0].color, WHITE)
