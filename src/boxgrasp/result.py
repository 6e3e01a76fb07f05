"""The answer: a grasp or a request for help, with its evidence, and its JSON (schema 1)."""

from __future__ import annotations

import json
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from boxgrasp.arrays import Floats, readonly
from boxgrasp.errors import BoxgraspError

SCHEMA = 1
JSON_SCHEMA_PATH = Path(__file__).with_name("result.schema.json")


@dataclass(frozen=True, eq=False)
class Candidate:
    """One candidate with the numbers of the check; meters, capped at 0.50.

    T_base_gripper: (4, 4). rejected: None, or why the candidate fell out in a few words.
    preference: place in the ranker's order, 1 first.
    """

    label: int
    face: int
    line: int
    T_base_gripper: Floats
    width_m: float
    visible_clearance_m: float
    unseen_distance_m: float
    plane_clearance_m: float
    approach_clearance_m: float
    fits: bool
    rejected: str | None
    ranking: int


@dataclass(frozen=True, eq=False)
class BoxReport:
    """The target's box: T_base_box (4, 4) at its center, dimensions_m (3,) along its x, y, z."""

    T_base_box: Floats
    dimensions_m: Floats


@dataclass(frozen=True, eq=False)
class Selection:
    """What `select` answers; field by field the JSON line of the command line.

    status: `grasp` or `ask`. In an `ask`, face to clearance_m are None, `best_rejected` is the
    label that came nearest to passing and `blocking` says what stands in its way.
    Transforms are (4, 4) float64, read-only; meters, quaternion x, y, z, w.
    """

    status: str
    reason: str
    frame: str
    T_base_camera: Floats | None
    ranker: str
    face: int | None
    line: int | None
    label: int | None
    T_base_gripper: Floats | None
    T_base_tcp: Floats | None
    T_base_pregrasp: Floats | None
    position_m: Floats | None
    quaternion_xyzw: Floats | None
    opening_m: float | None
    clearance_m: float | None
    box: BoxReport
    best_rejected: int | None
    blocking: str | None
    candidates: tuple[Candidate, ...]
    warnings: tuple[str, ...]
    config_hash: str
    timings_ms: dict[str, float]
    version: str
    capture: str | None = None
    schema: int = SCHEMA

    def candidate(self, label: int) -> Candidate:
        """The report of the candidate with this label (labels count from 1)."""
        return self.candidates[label - 1]

    def to_dict(self) -> dict[str, Any]:
        """Plain lists, numbers and strings, in the order of the published schema."""
        plain: dict[str, Any] = _plain(self)
        return {"schema": plain.pop("schema"), "capture": plain.pop("capture"), **plain}

    def to_json(self) -> str:
        """One line of JSON."""
        return json.dumps(self.to_dict(), allow_nan=False)

    @staticmethod
    def from_json(text: str) -> Selection:
        """The selection that a line of JSON holds.

        Raises:
            BoxgraspError: not JSON, another schema, or missing or unknown fields.
        """
        try:
            data = json.loads(text)
        except (ValueError, RecursionError):
            raise BoxgraspError("not an answer: the line is not JSON") from None
        if not isinstance(data, dict) or data.get("schema") != SCHEMA:
            found = data.get("schema") if isinstance(data, dict) else type(data).__name__
            raise BoxgraspError(f"not an answer: schema is {found!r}; valid: {SCHEMA}")
        try:
            box = _build(BoxReport, data.pop("box"))
            candidates = tuple(
                _build(Candidate, candidate) for candidate in _listed(data, "candidates")
            )
            selection: Selection = _build(Selection, {**data, "box": box, "candidates": candidates})
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise BoxgraspError(f"not an answer: {' '.join(str(error).split())}") from None
        return selection


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    if isinstance(value, Candidate | BoxReport | Selection):
        return {field.name: _plain(getattr(value, field.name)) for field in fields(value)}
    return value


def _build(kind: type[Any], data: dict[str, Any]) -> Any:
    names = {field.name for field in fields(kind)}
    if set(data) != names:
        wrong = sorted(set(data) ^ names)
        raise ValueError(f"missing or unknown fields {wrong}")
    return kind(**{key: _array_or_same(key, value) for key, value in data.items()})


def _listed(data: dict[str, Any], key: str) -> list[Any]:
    value = data.pop(key)
    if not isinstance(value, list):
        raise ValueError(f"{key} is no list")
    return value


def _array_or_same(key: str, value: Any) -> Any:
    if key == "warnings":
        return tuple(_listed({key: value}, key))
    if isinstance(value, list):
        array = np.array(value, dtype=np.float64)
        valid = {"position_m": (3,), "dimensions_m": (3,), "quaternion_xyzw": (4,)}
        if array.shape != valid.get(key, (4, 4)):
            raise ValueError(f"{key} has shape {array.shape}")
        return readonly(array)
    return value
