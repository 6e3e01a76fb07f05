"""The messages have a place for every field of the answer's JSON, and nothing that it lacks."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from boxgrasp_msgs.msg import CheckResult, GraspCandidate, GraspSelection

import boxgrasp

SCHEMA = json.loads((Path(boxgrasp.__file__).parent / "result.schema.json").read_text("utf-8"))
SIMPLE = {"integer": "int32", "number": "double", "boolean": "boolean", "string": "string"}
POSE, POINT, VECTOR = (f"geometry_msgs/{name}" for name in ("Pose", "Point", "Vector3"))

# Parts of the answer whose fields the selection has itself, and what stands before their names.
INLINED = {"grasp": "", "refusal": "refusal_", "box": "box_"}
UNPREFIXED = {"nearest_label", "violations"}  # there is one of each in the whole answer

# What needs no field, and why.
ELSEWHERE = {
    "schema": "the message's definition says it",
    "capture": "null from Python: there is no file",
    "frame": "the header names it",
    "gripper": "the node's parameters give it",
    "risk": "always null",
    "position_m": "of the pose",
    "quaternion_xyzw": "of the pose",
}

# Fields that are ours alone.
OWN = {
    "GraspSelection": {"header": "std_msgs/Header", "json": "string"},
    "GraspCandidate": {},
    "CheckResult": {"name": "string"},  # the key in the candidate's checks
}

Fields = dict[str, str]


def without_null(part: dict[str, Any]) -> tuple[dict[str, Any], bool]:
    """A part of the schema, its reference followed, and whether it may be null."""
    options = [option for option in part.get("oneOf", [part]) if option.get("type") != "null"]
    null = len(options) < len(part.get("oneOf", [part]))
    (option,) = options
    kinds = option.get("type", "string" if "enum" in option else None)
    if isinstance(kinds, list):
        null = True
        option = {**option, "type": next(kind for kind in kinds if kind != "null")}
    if "$ref" in option:
        option = SCHEMA["$defs"][option["$ref"].split("/")[-1]] | {"ref": option["$ref"]}
    return option, null


def place_of(name: str, part: dict[str, Any], prefix: str) -> Fields:
    """The fields of a message that hold a field of the JSON, by the rule."""
    option, null = without_null(part)
    kind = option.get("type", "string")
    field = name if name in UNPREFIXED else prefix + name
    if option.get("ref", "").endswith("/transform"):
        body = name.split("_")[-1]  # T_base_tcp: tcp_pose; the gripper's own is the pose
        field = "pose" if body == "gripper" else f"{body}_pose"
        return {field: POSE} | ({f"has_{field}": "boolean"} if null else {})
    if name == "nearest_point_m":
        return {"nearest_point": POINT, "has_nearest_point": "boolean"}
    if name == "timings_ms":  # names beside values
        return {"timing_stages": "sequence<string>", field: "sequence<double>"}
    if name == "warnings":
        return {
            f"warning_{key}s": "sequence<string>" for key in SCHEMA["$defs"]["warning"]["required"]
        }
    if name == "checks":
        return {field: "sequence<boxgrasp_msgs/CheckResult>"}
    if kind == "array":
        return {field: array_type(option)}
    return {field: SIMPLE[kind]}  # null is NaN, -1 or empty, as the message says


def array_type(part: dict[str, Any]) -> str:
    if part.get("minItems") == part.get("maxItems") == 3:
        return VECTOR
    of = part["items"].get("$ref", "").split("/")[-1]
    named = {"candidate": "boxgrasp_msgs/GraspCandidate", "violation": "string"}  # in words
    return f"sequence<{named.get(of) or SIMPLE[part['items']['type']]}>"


def places(part: dict[str, Any], prefix: str = "") -> Fields:
    """The fields of a message for a whole object of the JSON."""
    fields: Fields = {}
    for name, inner in part["properties"].items():
        if name in INLINED:
            fields |= places(without_null(inner)[0], INLINED[name])
        elif name not in ELSEWHERE:
            fields |= place_of(name, inner, prefix)
    return fields


@pytest.mark.parametrize(
    ("message", "part"),
    [
        (GraspSelection, SCHEMA),
        (GraspCandidate, SCHEMA["$defs"]["candidate"]),
        (CheckResult, SCHEMA["$defs"]["check"]),
    ],
    ids=lambda value: getattr(value, "__name__", ""),
)
def test_a_message_mirrors_the_schema(message: Any, part: dict[str, Any]) -> None:
    assert places(part) | OWN[message.__name__] == message.get_fields_and_field_types()


def test_what_needs_no_field_is_in_the_schema() -> None:
    names = set(SCHEMA["properties"])
    for part in SCHEMA["$defs"].values():
        names |= set(part.get("properties", ()))
    assert set(ELSEWHERE) <= names and set(INLINED) <= names


def test_a_field_without_a_place_is_noticed() -> None:
    part = {"properties": {**SCHEMA["$defs"]["check"]["properties"], "new_m": {"type": "number"}}}
    assert places(part)["new_m"] == "double"
    assert "new_m" not in CheckResult.get_fields_and_field_types()
