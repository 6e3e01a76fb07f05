"""The answer: a grasp or a request for help, with its evidence, and its JSON (schema 2)."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from boxgrasp.arrays import Array, Floats, readonly
from boxgrasp.errors import BoxgraspError, CodedWarning
from boxgrasp.geometry.transforms import validate_transform
from boxgrasp.grasps.candidates import face_name
from boxgrasp.grasps.checks.check import Rejection, spelled
from boxgrasp.grasps.gripper import Gripper
from boxgrasp.strict import build, plain

if TYPE_CHECKING:
    from boxgrasp.sensing.capture import Capture

SCHEMA = 2
JSON_SCHEMA_PATH = Path(__file__).with_name("result.schema.json")


@dataclass(frozen=True)
class CheckValue:
    """What one check says of one candidate.

    Attributes:
        value: what was measured, in `unit`.
        limit: what it was compared with, in `unit`.
        unit: "m", "fraction", or None for yes (1) or no (0).
        passed: whether the candidate met it.
        object: number of the object that decided, 0 for an obstacle without a number; or None.
        nearest_point_m: (x, y, z), base frame, m, where it decided; or None.
    """

    value: float
    limit: float
    unit: str | None
    passed: bool
    object: int | None
    nearest_point_m: tuple[float, float, float] | None


@dataclass(frozen=True, eq=False)
class Candidate:
    """One face and line with its pose, and what every check says of it.

    Attributes:
        label: (face - 1) * l + line.
        face: 1 to 5.
        line: 1 to l.
        rank: place in the ranker's order, 1 first.
        T_base_gripper: (4, 4) float64, m.
        width_m: the target's width between the fingers, m.
        checks: by the check's name, in the order of the checks.
    """

    label: int
    face: int
    line: int
    rank: int
    T_base_gripper: Floats
    width_m: float
    checks: Mapping[str, CheckValue]

    @property
    def face_name(self) -> str:
        """`left`, `front`, `right`, `top-parallel` or `top-perpendicular`."""
        return face_name(self.face)

    @property
    def name(self) -> str:
        """The face's name and the line: `front line 2`."""
        return f"{self.face_name} line {self.line}"

    @property
    def passed(self) -> bool:
        """Whether it passed every check."""
        return all(said.passed for said in self.checks.values())

    @cached_property
    def rejections(self) -> tuple[Rejection, ...]:
        """The checks that it failed; one that another one says already is left out.

        A hand that meets a visible obstacle meets its hidden side and has no free way in either:
        the same object at the same distance is told once.
        """
        found: list[Rejection] = []
        for name, said in self.checks.items():
            if said.passed:
                continue
            told = said.object is not None and any(
                (said.value, said.object) == (other.value, other.object) for other in found
            )
            if not told:
                found.append(
                    Rejection(
                        name, said.value, said.limit, said.unit, said.object, said.nearest_point_m
                    )
                )
        return tuple(found)

    def __repr__(self) -> str:
        why = "passed" if self.passed else "; ".join(item.sentence for item in self.rejections)
        return f"Candidate({self.label}, {self.name}, {why})"


@dataclass(frozen=True, eq=False)
class Grasp:
    """The chosen candidate.

    Attributes:
        label: (face - 1) * l + line.
        face: 1 to 5.
        line: 1 to l.
        T_base_gripper: (4, 4) float64, m, the hand's box when it closes.
        T_base_tcp: (4, 4) float64, m, its tool point then.
        T_base_pregrasp: (4, 4) float64, m, the hand's box at the start of its approach.
        position_m: (3,) float64, m, of T_base_gripper.
        quaternion_xyzw: (4,) float64, of T_base_gripper, w not negative.
        opening_m: how far the fingers open, m.
        width_m: the target's width between them, m.
        clearance_m: from the hand's box to visible obstacles, m; None where nobody measured it.
        clearance_at_least_m: a bound that holds for hidden ones too, m; None where the ranker
            gives none.
        probability_clear: odds that it is clear; None where the ranker gives none.
        confidence: the ranker's, in [0, 1].
        T_base_flange: (4, 4) float64, m; None where the hand's file gives no flange.
    """

    label: int
    face: int
    line: int
    T_base_gripper: Floats
    T_base_tcp: Floats
    T_base_pregrasp: Floats
    position_m: Floats
    quaternion_xyzw: Floats
    opening_m: float
    width_m: float
    clearance_m: float | None
    clearance_at_least_m: float | None
    probability_clear: float | None
    confidence: float | None
    T_base_flange: Floats | None

    @property
    def face_name(self) -> str:
        """`left`, `front`, `right`, `top-parallel` or `top-perpendicular`."""
        return face_name(self.face)


@dataclass(frozen=True, eq=False)
class Refusal:
    """Why a person is asked.

    Attributes:
        code: `no_candidate_passes`.
        message: one sentence.
        nearest_label: label of the candidate that failed fewest checks, and those by least.
        violations: the checks that it failed.
    """

    code: str
    message: str
    nearest_label: int
    violations: tuple[Rejection, ...]


@dataclass(frozen=True, eq=False)
class TargetBox:
    """The target's box.

    Attributes:
        T_base_box: (4, 4) float64 at its center, m.
        dimensions_m: (3,) float64, m, along its x, y, z.
        dimensions_at_least_m: (3,) float64, m, what is seen.
        dimensions_at_most_m: (3,) float64, m, infinite where an edge is hidden and nothing
            bounds it.
    """

    T_base_box: Floats
    dimensions_m: Floats
    dimensions_at_least_m: Floats
    dimensions_at_most_m: Floats


@dataclass(frozen=True, eq=False)
class Selection:
    """What `select` answers; field by field the JSON line of the command line.

    Transforms are (4, 4) float64, meters; arrays are read-only.

    Attributes:
        grasp: the grasp; None where a person is asked.
        refusal: why a person is asked; None where there is a grasp.
        candidates: all 5 l, in the order of their labels.
        box: the target's.
        gripper: the hand that was used.
        ranker: name of what ordered the candidates.
        frame: `given` where the capture came with T_base_camera, else `support`.
        T_base_camera: (4, 4) float64, m, the camera's pose; None where it is unknown.
        warnings: what the user should know.
        config_hash: 16 hexadecimal digits of the configuration.
        timings_ms: wall time by stage, and the `total` without reading files, ms.
        version: of the package.
        capture: its path as given, None from Python.
        risk: None so far.
    """

    grasp: Grasp | None
    refusal: Refusal | None
    candidates: tuple[Candidate, ...]
    box: TargetBox
    gripper: Gripper
    ranker: str
    frame: str
    T_base_camera: Floats | None
    warnings: tuple[CodedWarning, ...]
    config_hash: str
    timings_ms: dict[str, float]
    version: str
    capture: str | None = None
    risk: None = None
    _seen: Capture | None = field(default=None, repr=False)

    @property
    def status(self) -> str:
        """`grasp` or `ask`."""
        return "ask" if self.grasp is None else "grasp"

    @cached_property
    def passing(self) -> tuple[Candidate, ...]:
        """The candidates that pass every check, best first: the next one when a planner fails."""
        return tuple(sorted((c for c in self.candidates if c.passed), key=lambda c: c.rank))

    def candidate(self, label: int) -> Candidate:
        """A candidate by its label.

        Args:
            label: 1 to 5 l.

        Returns:
            The candidate.

        Raises:
            BoxgraspError: there is none.
        """
        if not 1 <= label <= len(self.candidates):
            raise BoxgraspError(f"no candidate {label}; valid: 1 to {len(self.candidates)}")
        return self.candidates[label - 1]

    @property
    def shown(self) -> Candidate | None:
        """The candidate that pictures show: the grasp's, or the one that came nearest."""
        if self.grasp is not None:
            return self.candidate(self.grasp.label)
        return None if self.refusal is None else self.candidate(self.refusal.nearest_label)

    def headline(self) -> str:
        """The answer in one sentence.

        Returns:
            `front line 2, 4.2 cm clear, opening 12.0 cm`, or why a person is asked.
        """
        if self.grasp is None:
            return "" if self.refusal is None else self.refusal.message
        clear = self.grasp.clearance_m
        return (
            f"{self.candidate(self.grasp.label).name}, "
            + ("" if clear is None else f"{spelled(clear, 'm')} clear, ")
            + f"opening {spelled(self.grasp.opening_m, 'm')}"
        )

    def summary(self) -> str:
        """The answer as a paragraph.

        Returns:
            Plain text: status, pose, how many candidates pass, warnings.
        """
        said = [f"{self.status.capitalize()}: {self.headline()}."]
        if self.grasp is not None:
            position = ", ".join(f"{value:.3f}" for value in self.grasp.position_m)
            turn = ", ".join(f"{value:.4f}" for value in self.grasp.quaternion_xyzw)
            said.append(
                f"The gripper is at ({position}) m, quaternion xyzw ({turn}), in the "
                f"{self.frame} frame."
            )
        said.append(
            f"{len(self.passing)} of {len(self.candidates)} candidates pass, ordered by "
            f"{self.ranker}."
        )
        said += [f"Warning: {warning.message}." for warning in self.warnings]
        return " ".join(said)

    def __repr__(self) -> str:
        counts = f"{len(self.passing)} of {len(self.candidates)} candidates pass"
        return f"Selection({self.status}: {self.headline()}; {counts})"

    def _repr_png_(self) -> bytes | None:
        """The picture, for a notebook; None for an answer read from a file."""
        if self._seen is None:
            return None
        # Drawing is an outer package; asked for here alone, and only when a notebook asks.
        png: bytes = import_module("boxgrasp.draw").selection_png(self._seen, self)
        return png

    def to_dict(self) -> dict[str, Any]:
        """The answer as JSON has it.

        Returns:
            Plain lists, numbers and strings, in the order of the published schema.
        """
        return {
            "schema": SCHEMA,
            "capture": self.capture,
            "status": self.status,
            "frame": self.frame,
            "T_base_camera": _listed(self.T_base_camera),
            "ranker": self.ranker,
            "grasp": None if self.grasp is None else _grasp_dict(self.grasp),
            "refusal": None if self.refusal is None else _refusal_dict(self.refusal),
            "passing": [candidate.label for candidate in self.passing],
            "box": {item.name: _listed(getattr(self.box, item.name)) for item in fields(TargetBox)},
            "gripper": plain(self.gripper),
            "candidates": [_candidate_dict(candidate) for candidate in self.candidates],
            "risk": self.risk,
            "warnings": [plain(warning) for warning in self.warnings],
            "config_hash": self.config_hash,
            "timings_ms": dict(self.timings_ms),
            "version": self.version,
        }

    def to_json(self) -> str:
        """The answer as one line of JSON.

        Returns:
            Schema 2.
        """
        return json.dumps(self.to_dict(), allow_nan=False)

    @staticmethod
    def from_json(text: str) -> Selection:
        """The selection that a line of JSON holds.

        Args:
            text: what `to_json` gave.

        Returns:
            The same selection, without its picture.

        Raises:
            BoxgraspError: not JSON, another schema, or missing, unknown or wrong fields.
        """
        try:
            data = json.loads(text)
        except (ValueError, RecursionError):
            raise BoxgraspError("not an answer: the line is not JSON") from None
        found = data.get("schema") if isinstance(data, dict) else type(data).__name__
        if found == 1:
            raise BoxgraspError(
                "not an answer of this version: schema is 1, by a version before 0.1.0; valid: "
                f"{SCHEMA} (answer the capture again)"
            )
        if found != SCHEMA or isinstance(found, bool):
            raise BoxgraspError(f"not an answer: schema is {found!r}; valid: {SCHEMA}")
        try:
            return _selection(data)
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise BoxgraspError(f"not an answer: {' '.join(str(error).split())}") from None


def _listed(array: Array | None) -> Any:
    """Nested lists; null for what is infinite."""
    if array is None:
        return None
    return [
        None if isinstance(value, float) and not np.isfinite(value) else value
        for value in array.tolist()
    ]


def _grasp_dict(grasp: Grasp) -> dict[str, Any]:
    values: dict[str, Any] = {}
    for item in fields(Grasp):
        value = getattr(grasp, item.name)
        values[item.name] = _listed(value) if isinstance(value, np.ndarray) else value
        if item.name == "face":
            values["face_name"] = grasp.face_name
    return values


def _refusal_dict(refusal: Refusal) -> dict[str, Any]:
    return {
        "code": refusal.code,
        "message": refusal.message,
        "nearest_label": refusal.nearest_label,
        "violations": [plain(violation) for violation in refusal.violations],
    }


def _candidate_dict(candidate: Candidate) -> dict[str, Any]:
    return {
        "label": candidate.label,
        "face": candidate.face,
        "face_name": candidate.face_name,
        "line": candidate.line,
        "rank": candidate.rank,
        "T_base_gripper": candidate.T_base_gripper.tolist(),
        "width_m": candidate.width_m,
        "passed": candidate.passed,
        "checks": {name: plain(said) for name, said in candidate.checks.items()},
        "rejections": [rejection.sentence for rejection in candidate.rejections],
    }


def _selection(data: dict[str, Any]) -> Selection:
    names = {"schema", "status", "passing", *(f.name for f in fields(Selection))} - {"_seen"}
    _only(data, names)
    candidates = tuple(_candidate(item) for item in _list(data, "candidates"))
    grasp = None if data["grasp"] is None else _grasp(data["grasp"])
    refusal = None if data["refusal"] is None else _refusal(data["refusal"])
    if (grasp is None) == (refusal is None):
        raise ValueError("neither or both of grasp and refusal; valid: one")
    box = data["box"]
    _only(box, {item.name for item in fields(TargetBox)})
    selection = Selection(
        grasp=grasp,
        refusal=refusal,
        candidates=candidates,
        box=TargetBox(
            _array(box, "T_base_box", (4, 4)),
            *(_array(box, item.name, (3,)) for item in fields(TargetBox)[1:]),
        ),
        gripper=build(Gripper, data["gripper"], "gripper", BoxgraspError),
        ranker=_of(str, data, "ranker"),
        frame=_of(str, data, "frame"),
        T_base_camera=_optional(_transform, data, "T_base_camera"),
        warnings=tuple(
            build(CodedWarning, item, "warning", BoxgraspError) for item in _list(data, "warnings")
        ),
        config_hash=_of(str, data, "config_hash"),
        timings_ms={name: float(ms) for name, ms in _of(dict, data, "timings_ms").items()},
        version=_of(str, data, "version"),
        capture=_optional(lambda d, k: _of(str, d, k), data, "capture"),
    )
    said = {"status": selection.status, "passing": [item.label for item in selection.passing]}
    for name, value in said.items():
        if data[name] != value:
            raise ValueError(f"{name} is {data[name]!r} but its fields say {value!r}")
    return selection


def _candidate(data: dict[str, Any]) -> Candidate:
    derived = {"face_name", "passed", "rejections"}
    _only(data, {item.name for item in fields(Candidate)} | derived)
    checks = {name: _check_value(said) for name, said in _of(dict, data, "checks").items()}
    return Candidate(
        label=_of(int, data, "label"),
        face=_of(int, data, "face"),
        line=_of(int, data, "line"),
        rank=_of(int, data, "rank"),
        T_base_gripper=_transform(data, "T_base_gripper"),
        width_m=_number(data, "width_m"),
        checks=checks,
    )


def _check_value(data: dict[str, Any]) -> CheckValue:
    return build(CheckValue, data, "check", BoxgraspError)


def _grasp(data: dict[str, Any]) -> Grasp:
    _only(data, {item.name for item in fields(Grasp)} | {"face_name"})
    return Grasp(
        label=_of(int, data, "label"),
        face=_of(int, data, "face"),
        line=_of(int, data, "line"),
        T_base_gripper=_transform(data, "T_base_gripper"),
        T_base_tcp=_transform(data, "T_base_tcp"),
        T_base_pregrasp=_transform(data, "T_base_pregrasp"),
        position_m=_array(data, "position_m", (3,)),
        quaternion_xyzw=_array(data, "quaternion_xyzw", (4,)),
        opening_m=_number(data, "opening_m"),
        width_m=_number(data, "width_m"),
        clearance_m=_optional(_number, data, "clearance_m"),
        clearance_at_least_m=_optional(_number, data, "clearance_at_least_m"),
        probability_clear=_optional(_number, data, "probability_clear"),
        confidence=_optional(_number, data, "confidence"),
        T_base_flange=_optional(_transform, data, "T_base_flange"),
    )


def _refusal(data: dict[str, Any]) -> Refusal:
    _only(data, {item.name for item in fields(Refusal)})
    return Refusal(
        _of(str, data, "code"),
        _of(str, data, "message"),
        _of(int, data, "nearest_label"),
        tuple(
            build(Rejection, item, "violation", BoxgraspError) for item in _list(data, "violations")
        ),
    )


def _only(data: Mapping[str, Any], names: Iterable[str]) -> None:
    if set(data) != set(names):
        raise ValueError(f"missing or unknown fields {sorted(set(data) ^ set(names))}")


def _of(kind: type[Any], data: Mapping[str, Any], name: str) -> Any:
    value = data[name]
    if not isinstance(value, kind) or (kind is int and isinstance(value, bool)):
        raise ValueError(f"{name} is {value!r:.40}; valid: {kind.__name__}")
    return value


def _list(data: Mapping[str, Any], name: str) -> list[Any]:
    found: list[Any] = _of(list, data, name)
    return found


def _number(data: Mapping[str, Any], name: str) -> float:
    value = data[name]
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"{name} is {value!r:.40}; valid: a number")
    return float(value)


def _optional(read: Callable[[Any, str], Any], data: Mapping[str, Any], name: str) -> Any:
    return None if data[name] is None else read(data, name)


def _transform(data: Mapping[str, Any], name: str) -> Floats:
    return validate_transform(data[name], name)


def _array(data: Mapping[str, Any], name: str, shape: tuple[int, ...]) -> Floats:
    value = data[name]
    if name == "dimensions_at_most_m" and isinstance(value, list):
        value = [np.inf if item is None else item for item in value]
    array = np.array(value, dtype=np.float64)
    if array.shape != shape:
        raise ValueError(f"{name} has shape {array.shape}; valid: {shape}")
    return readonly(array)
