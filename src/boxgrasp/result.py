"""The answer: a grasp or a request for help, with its evidence, and its JSON (schema 2)."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any, ClassVar, Final

import numpy as np

from boxgrasp.arrays import Floats, readonly
from boxgrasp.errors import BoxgraspError, CaptureError, CodedWarning, require, shown
from boxgrasp.forks import cached_property
from boxgrasp.geometry.transforms import (
    invert,
    make_transform,
    quaternion_xyzw,
    validate_transform,
)
from boxgrasp.grasps.candidates import face_name
from boxgrasp.grasps.checks.check import Rejection, measured, spelled
from boxgrasp.grasps.gripper import Gripper
from boxgrasp.sensing.capture import Capture
from boxgrasp.strict import build

SCHEMA = 2
# Why a person is asked: codes of a `Refusal`.
NO_CANDIDATE_PASSES = "no_candidate_passes"
RANKER_ASKS = "ranker_asks"  # it predicts that its operator would help, whatever passes
PERSON_WOULD_HELP = "person_would_help"  # a person says that no candidate would do
BOX_WRONG = "box_wrong"  # a person says that the box is not the target's
# Of an answer that a person was asked for.
PERSON = "person"  # its ranker, where the person took a candidate
PERSON_OVERRODE_CHECKS = "person_overrode_checks"  # a warning: that candidate failed some
NOBODY_ANSWERED = "nobody_answered"  # a warning: the time ran out
JSON_SCHEMA_PATH = Path(__file__).with_name("result.schema.json")
_FARTHEST_PREGRASP_M: Final = 10.0  # no arm reaches as far


@dataclass(frozen=True)
class CheckValue:
    """What one check says of one candidate.

    Attributes:
        value: what was measured, in `unit`.
        limit: what it was compared with, in `unit`.
        unit: "m", "m2", "fraction", or None for yes (1) or no (0).
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


def grasp_of(
    chosen: Candidate, gripper: Gripper, pregrasp_distance_m: float, confidence: float | None
) -> Grasp:
    """The grasp that a candidate is, whoever chose it.

    Args:
        chosen: the candidate.
        gripper: the hand.
        pregrasp_distance_m: from the start of the approach to the grasp, m.
        confidence: of who chose it, in [0, 1]; None where none is told.

    Returns:
        Its poses in the base frame.
    """
    T, flange = chosen.T_base_gripper, gripper.flange_pose
    back = make_transform(np.eye(3), (-pregrasp_distance_m, 0.0, 0.0))
    visible = chosen.checks.get("visible_clearance")
    return Grasp(
        label=chosen.label,
        face=chosen.face,
        line=chosen.line,
        T_base_gripper=T,
        T_base_tcp=readonly(T @ gripper.tcp_pose),
        T_base_pregrasp=readonly(T @ back),
        position_m=readonly(T[:3, 3].copy()),
        quaternion_xyzw=readonly(quaternion_xyzw(T[:3, :3])),
        opening_m=gripper.fingers_open_m,
        width_m=chosen.width_m,
        clearance_m=None if visible is None else visible.value,
        clearance_at_least_m=None,
        probability_clear=None,
        confidence=confidence,
        T_base_flange=None if flange is None else readonly(T @ invert(flange)),
    )


@dataclass(frozen=True, eq=False)
class Refusal:
    """Why a person is asked.

    Attributes:
        code: `no_candidate_passes`; `ranker_asks` where the ranker predicts that its operator
            would help; `person_would_help` or `box_wrong` where a person was asked and said so.
        message: one sentence.
        nearest_label: label of the best candidate that passes, which only a ranker that asks
            leaves; else of the one that failed fewest checks, and those by least.
        violations: the checks that it failed; none where it passes.
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

    _seen: ClassVar[Capture | None] = None  # of an answer that `seen_in` made

    def seen_in(self, capture: Capture) -> Selection:
        """The same answer, which a notebook shows drawn into its capture.

        Args:
            capture: the view that was answered; it is kept as long as the answer.

        Returns:
            A copy.

        Raises:
            CaptureError: it is none.
        """
        require(capture, Capture, "capture", "a Capture", CaptureError)
        answer = replace(self)
        object.__setattr__(answer, "_seen", capture)
        return answer

    def taken(self, label: int, pregrasp_distance_m: float, by: str = PERSON) -> Selection:
        """The same answer with a candidate that somebody else chose, whatever the checks say.

        Args:
            label: of the candidate.
            pregrasp_distance_m: as the configuration's `checks.pregrasp_distance_m`, m.
            by: who chose it, told as the ranker.

        Returns:
            A grasp with that candidate's poses and numbers, without confidence; it warns of every
            check that the candidate fails.

        Raises:
            BoxgraspError: there is no such candidate, or an argument of another type.
        """
        chosen = self.candidate(label)
        require(pregrasp_distance_m, (int, float), "pregrasp_distance_m", "meters")
        if not 0 <= pregrasp_distance_m <= _FARTHEST_PREGRASP_M:
            said = shown(pregrasp_distance_m)
            raise BoxgraspError(f"pregrasp_distance_m is {said}; valid: 0 to 10 m")
        require(by, str, "by", "who chose it")
        failed = [name for name, said in chosen.checks.items() if not said.passed]
        warnings = self.warnings
        if failed:
            reasons = "; ".join(item.sentence for item in chosen.rejections)
            said = f"{chosen.name} was taken by a {by} although {', '.join(failed)} failed"
            warnings += (CodedWarning(PERSON_OVERRODE_CHECKS, f"{said}: {reasons}"),)
        grasp = grasp_of(chosen, self.gripper, pregrasp_distance_m, None)
        return replace(self, grasp=grasp, refusal=None, ranker=by, warnings=warnings)

    def asking(self, code: str, message: str) -> Selection:
        """The same answer as a question, for another reason.

        Args:
            code: why, for programs.
            message: why, in a sentence.

        Returns:
            An `ask`; it names the candidate that was the grasp, or was nearest to one.
        """
        nearest = self.shown
        assert nearest is not None  # an answer has a grasp or a refusal
        refusal = Refusal(code, message, nearest.label, nearest.rejections)
        return replace(self, grasp=None, refusal=refusal)

    def with_warnings(self, *warnings: CodedWarning) -> Selection:
        """The same answer with more warnings.

        Args:
            warnings: what follows those that it has.

        Returns:
            A copy.
        """
        return replace(self, warnings=(*self.warnings, *warnings))

    @property
    def schema(self) -> int:
        """Version of the JSON form."""
        return SCHEMA

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
        number: Any = label
        known = isinstance(number, int | np.integer) and not isinstance(number, bool)
        if not known or not 1 <= label <= len(self.candidates):
            raise BoxgraspError(f"no candidate {shown(label)}; valid: 1 to {len(self.candidates)}")
        return self.candidates[label - 1]

    @property
    def shown(self) -> Candidate | None:
        """The candidate that pictures show: the grasp's, or the one that came nearest."""
        if self.grasp is not None:
            return self.candidate(self.grasp.label)
        return None if self.refusal is None else self.candidate(self.refusal.nearest_label)

    @property
    def chosen_by(self) -> str:
        """Who ordered the candidates, or took one, in words."""
        return "taken by a person" if self.ranker == PERSON else f"ordered by {self.ranker}"

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
            + ("" if clear is None else f"{measured(clear, 'm')} clear, ")
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
            f"{len(self.passing)} of {len(self.candidates)} candidates pass, {self.chosen_by}."
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
        answer: dict[str, Any] = _plain(self)
        return answer

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
        require(text, str, "answer", "a line of JSON")
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
        return _selection(data)


# What JSON tells of a class, in this order, where it is more than the fields; of others the fields.
_JSON_NAMES: dict[type[Any], tuple[str, ...]] = {
    Selection: (
        *("schema", "capture", "status", "frame", "T_base_camera", "ranker", "grasp", "refusal"),
        *("passing", "box", "gripper", "candidates", "risk", "warnings", "config_hash"),
        *("timings_ms", "version"),
    ),
    Candidate: (
        *("label", "face", "face_name", "line", "rank", "T_base_gripper", "width_m", "passed"),
        *("checks", "rejections"),
    ),
    Grasp: (
        *("label", "face", "face_name", "line", "T_base_gripper", "T_base_tcp"),
        *("T_base_pregrasp", "position_m", "quaternion_xyzw", "opening_m", "width_m"),
        *("clearance_m", "clearance_at_least_m", "probability_clear", "confidence"),
        "T_base_flange",
    ),
}
_SCALARS = frozenset((str, int, bool, type(None)))
_SHAPES = {
    "position_m": (3,),
    "quaternion_xyzw": (4,),
    "dimensions_m": (3,),
    "dimensions_at_least_m": (3,),
    "dimensions_at_most_m": (3,),
}


def _plain(value: Any) -> Any:
    """Nested lists, maps, numbers and strings; null for an infinite bound."""
    kind: Any = type(value)
    if kind in _SCALARS:
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, np.ndarray):
        return [_plain(item) for item in value.tolist()]
    if kind in _JSON_NAMES:
        return {name: _told(value, name) for name in _JSON_NAMES[kind]}
    if is_dataclass(value):
        return {name: _plain(getattr(value, name)) for name in _field_names(kind)}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, Mapping):
        return {name: _plain(item) for name, item in value.items()}
    return value


@cache
def _field_names(kind: type[Any]) -> tuple[str, ...]:
    return tuple(item.name for item in fields(kind))


def _told(value: Any, name: str) -> Any:
    """A field or property as JSON has it: reasons in words, passing candidates by their labels."""
    found = getattr(value, name)
    if name == "rejections":
        return [rejection.sentence for rejection in found]
    return [candidate.label for candidate in found] if name == "passing" else _plain(found)


def _selection(data: dict[str, Any]) -> Selection:
    """The selection of a JSON object of schema 2.

    Raises:
        BoxgraspError: missing, unknown or wrong fields, or some that contradict each other.
    """
    own = _fields_alone(data, Selection)
    if isinstance(own["candidates"], list):
        own["candidates"] = [_fields_alone(item, Candidate) for item in own["candidates"]]
    own["grasp"] = _fields_alone(own["grasp"], Grasp)
    selection = build(Selection, _with_arrays(own), "not an answer", BoxgraspError)
    if (selection.grasp is None) == (selection.refusal is None):
        raise BoxgraspError("not an answer: neither or both of grasp and refusal; valid: one")
    for name in ("status", "passing"):
        if data[name] != _told(selection, name):
            raise BoxgraspError(
                f"not an answer: {name} is {data[name]!r:.40}, but its candidates and grasp say "
                f"{_told(selection, name)!r:.40}"
            )
    return selection


def _fields_alone(data: Any, kind: type[Any]) -> Any:
    """The data of a class without what JSON tells beside its fields.

    Raises:
        BoxgraspError: missing or unknown names.
    """
    if not isinstance(data, dict):
        return data
    if set(data) != set(_JSON_NAMES[kind]):
        wrong = sorted(set(data) ^ set(_JSON_NAMES[kind]))
        raise BoxgraspError(f"not an answer: missing or unknown fields {wrong}")
    names = {item.name for item in fields(kind)}
    return {name: value for name, value in data.items() if name in names}


def _with_arrays(data: Any, name: str = "") -> Any:
    """The data with read-only arrays for transforms, positions and dimensions."""
    if isinstance(data, dict):
        return {key: _with_arrays(value, str(key)) for key, value in data.items()}
    if name in ("T_gripper_tcp", "T_flange_gripper") or not isinstance(data, list):
        return data
    if name.startswith("T_"):
        return validate_transform(data, name)
    if name not in _SHAPES:
        return [_with_arrays(value) for value in data]
    try:
        array = np.array([np.inf if item is None else item for item in data], dtype=np.float64)
    except (TypeError, ValueError):
        raise BoxgraspError(f"not an answer: {name} is not numeric; valid: numbers") from None
    if array.shape != _SHAPES[name]:
        raise BoxgraspError(
            f"not an answer: {name} has shape {array.shape}; valid: {_SHAPES[name]}"
        )
    return readonly(array)
