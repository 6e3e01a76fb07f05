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
from boxgrasp.errors import BoxgraspError, CodedWarning
from boxgrasp.grasps.checks import Rejection
from boxgrasp.grasps.gripper import Gripper, HandBox
from boxgrasp.result import (
    JSON_SCHEMA_PATH,
    Candidate,
    CheckValue,
    Grasp,
    Refusal,
    Selection,
    TargetBox,
)
from boxgrasp.simulate import build_scene, to_capture

SCHEMA = json.loads(JSON_SCHEMA_PATH.read_text("utf-8"))
CLEAR = CheckValue(0.05, 0.02, "m", True, 3, (0.0, 0.0, 0.0))


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
    yield GraspSelector({"ranker": "top-down"}, checks=[]).select(seen(drawn(0), 0))
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


def changed(answer: Selection, *path: str | int, to: Any) -> dict[str, Any]:
    """The answer's line with one value changed."""
    line = line_of(answer)
    place: Any = line
    for step in path[:-1]:
        place = place[step]
    place[path[-1]] = to
    return line


def test_schema_is_a_schema_that_names_every_field() -> None:
    Draft202012Validator.check_schema(SCHEMA)
    assert SCHEMA["$schema"] == "https://json-schema.org/draft/2020-12/schema"
    defs = SCHEMA["$defs"]
    places = (
        (SCHEMA, Selection, {"schema", "status", "passing"}),
        (defs["box"], TargetBox, set()),
        (defs["candidate"], Candidate, {"face_name", "passed", "rejections"}),
        (defs["check"], CheckValue, set()),
        (defs["grasp"], Grasp, {"face_name"}),
        (defs["refusal"], Refusal, set()),
        (defs["violation"], Rejection, set()),
        (defs["gripper"], Gripper, set()),
        (defs["hand_box"], HandBox, set()),
        (defs["warning"], CodedWarning, set()),
    )
    for place, kind, derived in places:
        names = {field.name for field in fields(kind)} - {"_seen"} | derived
        assert set(place["properties"]) == names == set(place["required"]), kind
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
    defs = SCHEMA["$defs"]
    grasp, ask = line_of(a_grasp()), line_of(an_ask())
    assert list(grasp) == list(SCHEMA["properties"])
    assert list(grasp["candidates"][0]) == list(defs["candidate"]["properties"])
    assert list(grasp["grasp"]) == list(defs["grasp"]["properties"])
    assert list(grasp["box"]) == list(defs["box"]["properties"])
    assert list(ask["refusal"]) == list(defs["refusal"]["properties"])
    assert list(ask["refusal"]["violations"][0]) == list(defs["violation"]["properties"])


def test_a_grasp_has_and_an_ask_lacks() -> None:
    grasp, ask = line_of(a_grasp()), line_of(an_ask())
    assert not valid({**grasp, "grasp": None}) and not valid({**ask, "refusal": None})
    assert not valid({**grasp, "refusal": ask["refusal"]})
    assert not valid({**ask, "grasp": grasp["grasp"]})


@pytest.mark.parametrize(
    ("path", "to"),
    [
        (("schema",), 1),
        (("status",), "maybe"),
        (("status",), "ask"),
        (("frame",), "camera"),
        (("unknown",), 1),
        (("grasp", "clearance_m"), 0.51),
        (("grasp", "clearance_m"), -0.01),
        (("grasp", "label"), 0),
        (("grasp", "face"), 6),
        (("grasp", "face_name"), "bottom"),
        (("grasp", "position_m"), [0, 0]),
        (("grasp", "quaternion_xyzw"), [0, 0, 0, 2]),
        (("grasp", "T_base_gripper"), [[1, 0, 0, 0]] * 3),
        (("grasp", "confidence"), 1.1),
        (("config_hash",), "abc"),
        (("timings_ms",), {}),
        (("timings_ms",), {"total": -1}),
        (("candidates",), []),
        (("candidates", 0, "checks", "width", "unit"), ""),
        (("candidates", 0, "checks", "width", "value"), None),
        (("candidates", 0, "checks", "width"), {}),
        (("warnings",), ["text"]),
        (("box",), {"T_base_box": np.eye(4).tolist()}),
        (("box", "dimensions_m"), [0.1, 0.1, 0.0]),
        (("gripper", "max_opening_m"), 0),
        (("risk",), 0.1),
    ],
)
def test_schema_refuses(path: tuple[str | int, ...], to: Any) -> None:
    assert valid(line_of(a_grasp()))
    assert not valid(changed(a_grasp(), *path, to=to))


def test_schema_refuses_an_ask_with_a_way_out() -> None:
    ask = line_of(an_ask())
    assert valid(ask)
    assert not valid({**ask, "passing": [4]})
    assert not valid(changed(an_ask(), "refusal", "violations", to=[]))
    passing = deepcopy(ask)
    passing["candidates"][3]["passed"] = True
    assert not valid(passing)


def same(before: Any, after: Any) -> bool:
    """Whether two values hold the same, arrays bit by bit and closed to writing."""
    if isinstance(before, np.ndarray):
        return np.array_equal(before, after) and not after.flags.writeable
    if isinstance(before, tuple):
        return len(before) == len(after) and all(map(same, before, after))
    if isinstance(before, Candidate | Grasp | Refusal | TargetBox):
        return all(
            same(getattr(before, field.name), getattr(after, field.name))
            for field in fields(before)
        )
    return bool(before == after)


def test_round_trip() -> None:
    for answer in answers():
        text = answer.to_json()
        assert "\n" not in text and "NaN" not in text and "Infinity" not in text
        again = Selection.from_json(text)
        assert again.to_json() == text
        for field in fields(Selection):
            if field.name != "_seen":
                assert same(getattr(answer, field.name), getattr(again, field.name)), field.name
        assert [o.label for o in again.candidates] == list(range(1, len(again.candidates) + 1))
        assert again.candidate(2).label == 2
        assert [c.label for c in again.passing] == [c.label for c in answer.passing]
        assert again.summary() == answer.summary() and repr(again) == repr(answer)


def test_an_answer_of_schema_1_is_refused_with_a_word() -> None:
    with pytest.raises(BoxgraspError, match="schema is 1.*answer the capture again") as caught:
        Selection.from_json('{"schema": 1, "status": "ask"}')
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "text",
    ["", "{", "[]", "3", "null", "{}", '{"schema": 2}', '{"schema": 3}', "[" * 100_000],
)
def test_what_is_no_answer_is_refused_in_one_line(text: str) -> None:
    with pytest.raises(BoxgraspError) as caught:
        Selection.from_json(text)
    assert "\n" not in str(caught.value) and str(caught.value).startswith("not an answer")


@pytest.mark.parametrize(
    ("path", "to"),
    [
        (("more",), 1),
        (("box",), 3),
        (("box",), None),
        (("candidates",), [3]),
        (("candidates",), None),
        (("candidates", 0, "checks"), [1]),
        (("candidates", 0, "checks", "width"), {"value": 1}),
        (("candidates", 0, "checks", "width", "more"), 1),
        (("candidates", 0, "checks", "width", "value"), "wide"),
        (("candidates", 0, "more"), 1),
        (("candidates", 0, "rank"), "first"),
        (("grasp", "T_base_gripper"), [[1, 2], [3, 4]]),
        (("grasp", "T_base_gripper"), [[1, 2], [3]]),
        (("grasp", "T_base_gripper"), np.zeros((4, 4)).tolist()),
        (("grasp", "position_m"), ["x", "y", "z"]),
        (("grasp", "label"), True),
        (("grasp",), None),
        (("gripper",), {"opening": 0.1}),
        (("gripper",), {"max_opening_m": 0.5}),
        (("warnings",), 7),
        (("warnings",), ["x"]),
        (("passing",), [99]),
        (("status",), "ask"),
        (("timings_ms",), {"total": "long"}),
    ],
)
def test_an_answer_with_a_wrong_part_is_refused(path: tuple[str | int, ...], to: Any) -> None:
    text = json.dumps(changed(a_grasp(), *path, to=to))
    with pytest.raises(BoxgraspError) as caught:
        Selection.from_json(text)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", list(SCHEMA["properties"]))
def test_an_answer_that_lacks_a_part_is_refused(name: str) -> None:
    line = line_of(a_grasp())
    line.pop(name)
    test_what_is_no_answer_is_refused_in_one_line(json.dumps(line))


def test_an_answer_cannot_be_changed() -> None:
    answer = a_grasp()
    with pytest.raises(AttributeError):
        answer.grasp = None  # type: ignore[misc]
    assert answer.grasp is not None
    for array in (answer.grasp.T_base_gripper, answer.grasp.position_m, answer.box.T_base_box):
        with pytest.raises(ValueError):
            array[0] = 0
    with pytest.raises(ValueError):
        answer.candidates[0].T_base_gripper[0, 0] = 2


def test_an_answer_tells_itself_in_a_line_and_in_a_paragraph() -> None:
    grasp, ask = a_grasp(), an_ask()
    for answer in (grasp, ask):
        assert "\n" not in repr(answer) and len(repr(answer)) < 300
        assert "\n" not in answer.summary()
        assert f"{len(answer.passing)} of 15 candidates pass" in answer.summary()
        assert answer.summary().startswith(answer.status.capitalize())
    assert grasp.grasp is not None and ask.refusal is not None
    name = f"{grasp.grasp.face_name} line {grasp.grasp.line}"
    assert repr(grasp).startswith(f"Selection(grasp: {name}, ")
    assert grasp.grasp.clearance_m == 0.5 and ", at least 50 cm clear, " in grasp.summary()
    near = GraspSelector().select(
        seen(laid(item("green_cube", 0.85, 0.0), item("mug", 0.8, 0.2)), 0)
    )
    assert near.grasp is not None and near.grasp.clearance_m is not None
    assert f", {100 * near.grasp.clearance_m:.1f} cm clear, " in near.summary()
    assert ask.refusal.message in repr(ask) and ask.refusal.message in ask.summary()
    assert "passed" in repr(grasp.passing[0])
    assert ask.candidates[0].rejections[0].sentence in repr(ask.candidates[0])


def test_a_notebook_shows_the_picture_of_an_answer_that_saw_its_capture() -> None:
    png = a_grasp()._repr_png_()
    assert png is not None and png.startswith(b"\x89PNG")
    assert Selection.from_json(a_grasp().to_json())._repr_png_() is None


@pytest.mark.parametrize("label", [0, -1, 16])
def test_a_candidate_that_is_none_is_refused(label: int) -> None:
    with pytest.raises(BoxgraspError, match=f"no candidate {label}; valid: 1 to 15"):
        a_grasp().candidate(label)


@pytest.mark.parametrize(
    ("rejection", "sentence"),
    [
        (
            Rejection("visible_clearance", 0.012, 0.023, "m", 3, (0.0, 0.0, 0.0)),
            "visible clearance to object 3: 1.2 cm, needs 2.3 cm",
        ),
        (
            Rejection("occluded_clearance", 0.0, 0.02, "m", 0),
            "occluded clearance to an unnumbered obstacle: 0.0 cm, needs 2.0 cm",
        ),
        (Rejection("width", 0.14, 0.117, "m"), "width: 14.0 cm, at most 11.7 cm"),
        (
            Rejection("unseen_fraction", 0.432, 0.25, "fraction"),
            "unseen fraction: 43 %, at most 25 %",
        ),
        (
            Rejection("approach_clearance", 0.00496, 0.005, "m"),
            "approach clearance: 0.496 cm, needs 0.500 cm",
        ),
        (Rejection("width_known", 0.0, 1.0, None), "width known: no"),
        (Rejection("payload", 2.5, 2.0, "kg"), "payload: 2.5 kg, at most 2 kg"),
    ],
)
def test_a_reason_is_put_into_words(rejection: Rejection, sentence: str) -> None:
    assert rejection.sentence == sentence


def test_what_another_reason_says_already_is_not_said_again() -> None:
    """A hand in an object: no clearance, and no way in, at the same distance to the same one."""
    met = CheckValue(0.01, 0.02, "m", False, 3, (0.0, 0.0, 0.0))
    other = CheckValue(0.01, 0.02, "m", False, 4, (0.0, 0.0, 0.0))
    wide = CheckValue(0.14, 0.12, "m", False, None, None)
    checks = {"visible_clearance": met, "occluded_clearance": met, "width": wide, "more": other}
    found = Candidate(1, 1, 1, 1, np.eye(4), 0.14, {**checks, "clear": CLEAR})
    assert [item.check for item in found.rejections] == ["visible_clearance", "width", "more"]
    assert not found.passed
    assert Candidate(1, 1, 1, 1, np.eye(4), 0.1, {"clear": CLEAR}).passed
