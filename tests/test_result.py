"""The answer's line: its published schema, and that it comes back as it went out."""

from __future__ import annotations

import json
from collections.abc import Iterator
from copy import deepcopy
from dataclasses import fields
from functools import cache
from typing import Any

import numpy as np
import pytest
from helpers import CAMERA, drawn, item, laid, seen
from jsonschema import Draft202012Validator

from boxgrasp import Capture, GraspSelector, Target
from boxgrasp.errors import BoxgraspError
from boxgrasp.result import JSON_SCHEMA_PATH, BoxReport, Candidate, Selection
from boxgrasp.simulate import build_scene, to_capture

SCHEMA = json.loads(JSON_SCHEMA_PATH.read_text("utf-8"))
GRASP_FIELDS = [
    "face",
    "line",
    "label",
    "T_base_gripper",
    "T_base_tcp",
    "T_base_pregrasp",
    "position_m",
    "quaternion_xyzw",
    "opening_m",
    "clearance_m",
]


@cache
def a_grasp() -> Selection:
    answer = GraspSelector().select(seen(laid(item("green_cube", 0.85, 0.0)), 0))
    assert answer.status == "grasp"
    return answer


@cache
def an_ask() -> Selection:
    narrow = GraspSelector({"gripper": {"max_opening_m": 0.05}})
    answer = narrow.select(seen(laid(item("green_cube", 0.85, 0.0)), 0))
    assert answer.status == "ask"
    return answer


def answers() -> Iterator[Selection]:
    """Grasps and asks of many kinds."""
    yield a_grasp()
    yield an_ask()
    yield GraspSelector({"unchecked": True}).select(seen(drawn(0), 0))
    yield GraspSelector({"candidates": {"lines": 1, "faces": ["front"]}}).select(seen(drawn(1), 1))
    yield GraspSelector({"candidates": {"lines": 7}}).select(seen(drawn(2), 2))
    scene = build_scene({"target": item("beans_can", 0.85, 0.0), "obstacles": [], "camera": CAMERA})
    view = to_capture(scene, noise=False)[0]
    bare = Capture(view.depth, view.intrinsics, target_pixel=view.target_pixel)
    yield GraspSelector().select(bare)  # frame: support
    points, _ = view.valid_points()
    T = scene.T_base_camera
    cloud = points @ T[:3, :3].T.astype(np.float32) + T[:3, 3].astype(np.float32)
    unknown = Capture.from_cloud(cloud[::3], cloud_frame="base")
    yield GraspSelector({"unchecked": True}).select(unknown, Target(object=1))


def valid(answer: dict[str, Any]) -> bool:
    return bool(Draft202012Validator(SCHEMA).is_valid(answer))


def line_of(answer: Selection) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(answer.to_json())
    return found


def test_schema_is_a_schema_that_names_every_field() -> None:
    Draft202012Validator.check_schema(SCHEMA)
    assert SCHEMA["$schema"] == "https://json-schema.org/draft/2020-12/schema"
    places = (
        (SCHEMA, Selection),
        (SCHEMA["properties"]["box"], BoxReport),
        (SCHEMA["$defs"]["candidate"], Candidate),
    )
    for place, kind in places:
        names = {field.name for field in fields(kind)}
        assert set(place["properties"]) == names == set(place["required"])
        assert place["additionalProperties"] is False
        for name, told in place["properties"].items():
            assert told.get("description", "").endswith("."), name
            if name.endswith("_m") or name.startswith("T_"):
                assert "meters" in told["description"], name
            if name.startswith("T_base"):
                assert "base frame" in told["description"], name


def test_every_kind_of_answer_follows_the_schema() -> None:
    statuses = set()
    for answer in answers():
        Draft202012Validator(SCHEMA).validate(line_of(answer))
        statuses.add(answer.status)
    assert statuses == {"grasp", "ask"}


def test_order_of_fields_is_the_published_one() -> None:
    line = line_of(a_grasp())
    assert list(line) == list(SCHEMA["properties"])
    assert list(line["candidates"][0]) == list(SCHEMA["$defs"]["candidate"]["properties"])


@pytest.mark.parametrize("field", GRASP_FIELDS)
def test_a_grasp_has_and_an_ask_lacks(field: str) -> None:
    grasp, ask = line_of(a_grasp()), line_of(an_ask())
    assert grasp[field] is not None and ask[field] is None
    assert not valid({**grasp, field: None})
    assert not valid({**ask, field: grasp[field]})


@pytest.mark.parametrize(
    "change",
    [
        {"schema": 2},
        {"status": "maybe"},
        {"frame": "camera"},
        {"unknown": 1},
        {"blocking": "a wall"},
        {"clearance_m": 0.51},
        {"clearance_m": -0.01},
        {"label": 0},
        {"face": 6},
        {"position_m": [0, 0]},
        {"quaternion_xyzw": [0, 0, 0, 2]},
        {"T_base_gripper": [[1, 0, 0, 0]] * 3},
        {"config_hash": "abc"},
        {"timings_ms": {}},
        {"timings_ms": {"total": -1}},
        {"candidates": []},
        {"reason": ""},
        {"box": {"T_base_box": np.eye(4).tolist()}},
        {"box": {"T_base_box": np.eye(4).tolist(), "dimensions_m": [0.1, 0.1, 0.0]}},
    ],
)
def test_schema_refuses(change: dict[str, Any]) -> None:
    assert valid(line_of(a_grasp()))
    assert not valid({**line_of(a_grasp()), **change})


def test_schema_refuses_an_ask_with_a_way_out() -> None:
    ask = line_of(an_ask())
    assert valid(ask)
    assert not valid({**ask, "blocking": None})
    assert not valid({**ask, "best_rejected": None})
    passing = deepcopy(ask)
    passing["candidates"][3]["rejected"] = None
    assert not valid(passing)


def test_round_trip() -> None:
    for answer in answers():
        text = answer.to_json()
        assert "\n" not in text and "NaN" not in text and "Infinity" not in text
        again = Selection.from_json(text)
        assert again.to_json() == text
        for field in fields(Selection):
            before, after = getattr(answer, field.name), getattr(again, field.name)
            assert isinstance(after, type(before)), field.name
            if isinstance(before, np.ndarray):
                np.testing.assert_array_equal(before, after)
                assert not after.flags.writeable
        assert [o.label for o in again.candidates] == list(range(1, len(again.candidates) + 1))
        assert again.candidate(2).label == 2


@pytest.mark.parametrize(
    "text",
    ["", "{", "[]", "3", "null", "{}", '{"schema": 2}', '{"schema": 1}', "[" * 100_000],
)
def test_what_is_no_answer_is_refused_in_one_line(text: str) -> None:
    with pytest.raises(BoxgraspError) as caught:
        Selection.from_json(text)
    assert "\n" not in str(caught.value) and str(caught.value).startswith("not an answer")


@pytest.mark.parametrize(
    "change",
    [
        {"more": 1},
        {"box": 3},
        {"box": None},
        {"candidates": [3]},
        {"candidates": None},
        {"T_base_gripper": [[1, 2], [3, 4]]},
        {"T_base_gripper": [[1, 2], [3]]},
        {"position_m": ["x", "y", "z"]},
        {"warnings": 7},
    ],
)
def test_an_answer_with_a_wrong_part_is_refused(change: dict[str, Any]) -> None:
    test_what_is_no_answer_is_refused_in_one_line(json.dumps({**line_of(a_grasp()), **change}))


@pytest.mark.parametrize("name", ["box", "candidates", "version", "capture", "label"])
def test_an_answer_that_lacks_a_part_is_refused(name: str) -> None:
    line = line_of(a_grasp())
    line.pop(name)
    test_what_is_no_answer_is_refused_in_one_line(json.dumps(line))


def test_an_answer_cannot_be_changed() -> None:
    answer = a_grasp()
    with pytest.raises(AttributeError):
        answer.status = "ask"  # type: ignore[misc]
    for array in (answer.T_base_gripper, answer.position_m, answer.box.T_base_box):
        assert array is not None
        with pytest.raises(ValueError):
            array[0] = 0
    with pytest.raises(ValueError):
        answer.candidates[0].T_base_gripper[0, 0] = 2
