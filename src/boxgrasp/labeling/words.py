"""What the record, the page and the learning hand to each other."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any, Literal, get_args

from boxgrasp.result import Candidate

SceneKind = Literal["capture", "scenario"]
Verdict = Literal["candidate", "none", "box_wrong", "withdrawn"]
Origin = Literal["page", "assist", "ask", "pose", "import"]
VERDICTS: tuple[Verdict, ...] = get_args(Verdict)
ORIGINS: tuple[Origin, ...] = get_args(Origin)


@dataclass(frozen=True)
class LabelScene:
    """One thing to label: a target in a capture, or a scenario that is cast again from its seed.

    Attributes:
        key: what tells it from every other one, of its content alone; at most 120 characters
            of letters, digits, `-`, `_` and `.`.
        kind: `capture` or `scenario`.
        name: what people call it: the capture's path in its source and the target, or its number.
        box_kind: `aligned` or `yaw`, how the box that is labeled was fitted.
        lines: l, lines a face.
        capture_sha256: content of the capture in the capture store; None for a scenario.
        target: which thing of the capture, plain values as JSON has: `{"pixel": [u, v]}` or
            `{"mask": true}` for the capture's own; None for a scenario.
        row_config: `plain` of the scenario's RowConfig; None for a capture.
        number: of the scenario's row in its set; None for a capture.
    """

    key: str
    kind: SceneKind
    name: str
    box_kind: str
    lines: int
    capture_sha256: str | None = None
    target: Mapping[str, Any] | None = None
    row_config: Mapping[str, Any] | None = None
    number: int | None = None


@dataclass(frozen=True)
class OperatorLabel:
    """What an operator said of a scene, as it is kept; a correction is a new one that supersedes.

    Attributes:
        id: a UUID, made before it is saved, so that saving it twice keeps it once.
        scene_key: of the scene.
        operator: who said it.
        verdict: `candidate`, `none` (the operator would help), `box_wrong`, or `withdrawn` for a
            label that is taken back.
        label: (face - 1) * l + line of a `candidate`; None else.
        labeled_at: when, with a time zone.
        seconds: from shown to saved, s; None where nobody looked (an import, a pose).
        gripper: the hand, `plain` of it.
        box_kind: `aligned` or `yaw`.
        lines: l, lines a face.
        version: of the package.
        model: name of the ranker and version of its models; empty where the robot proposed nothing.
        proposed: what the robot proposed; None where it asked or was not asked.
        overridden: the checks that the candidate failed and the operator overrode:
            `[{"check", "value", "limit", "unit"}]`.
        note: the operator's own words.
        pixel: (u, v) of the right thing, where the box is wrong and the operator clicked on it.
        origin: `page`, `assist`, `ask`, `pose` or `import`.
        T_base_gripper: 4 x 4 rows, m, of a pose reached by teleoperation; None else.
        pose_distance_m: from that pose's position to the candidate's, m.
        pose_angle_rad: between their directions, radians.
        supersedes: id of the label that it takes the place of; None for a first one.
    """

    id: str
    scene_key: str
    operator: str
    verdict: Verdict
    label: int | None
    labeled_at: datetime
    seconds: float | None
    gripper: Mapping[str, Any]
    box_kind: str
    lines: int
    version: str
    model: str = ""
    proposed: int | None = None
    overridden: tuple[Mapping[str, Any], ...] = ()
    note: str = ""
    pixel: tuple[int, int] | None = None
    origin: Origin = "page"
    T_base_gripper: tuple[tuple[float, ...], ...] | None = None
    pose_distance_m: float | None = None
    pose_angle_rad: float | None = None
    supersedes: str | None = None


@dataclass(frozen=True)
class Turn:
    """A scene that an operator is to label now; nobody else is given it meanwhile.

    Attributes:
        scene: what to label.
        again: whether this operator labeled it before (agreement of an operator with itself).
        second: whether another operator labeled it before (agreement of two).
    """

    scene: LabelScene
    again: bool = False
    second: bool = False


@dataclass(frozen=True)
class TurnRules:
    """Which scenes come twice.

    Attributes:
        second_share: share of the scenes that are labeled by two operators, 0 to 1.
        again_share: share of the scenes that come to the same operator twice, 0 to 1.
        lease_s: how long a scene stays with an operator who says nothing, s.
    """

    second_share: float = 0.0
    again_share: float = 0.0
    lease_s: float = 600.0


@dataclass(frozen=True)
class Progress:
    """How far one operator, and all of them, are.

    Attributes:
        scenes: of the source.
        done: scenes that have a label by anybody.
        mine: labels of this operator that stand.
        rate_per_hour: labels an hour of this operator's last 20, None before the second.
        seconds_left: for all that is left at that rate, s; None where no rate is known.
    """

    scenes: int
    done: int
    mine: int
    rate_per_hour: float | None
    seconds_left: float | None


@dataclass(frozen=True)
class Agreement:
    """How often two say the same of the same scene.

    Attributes:
        first: an operator.
        second: another one, or the same: of an operator with itself.
        scenes: that both labeled.
        same: share of these with the same answer, a candidate's label, `none` or `box_wrong`.
        kappa: Cohen's kappa (Cohen 1960); None where chance alone agrees always.
    """

    first: str
    second: str
    scenes: int
    same: float
    kappa: float | None


@dataclass(frozen=True)
class Ask:
    """A robot that is stuck asks the operators; a label of origin `ask` on its scene answers.

    Attributes:
        id: a UUID, made by who asks, so that asking twice asks once.
        scene_key: of the scene.
        asked_at: when, with a time zone.
        expires_at: from when on the answer is of no use any more.
        asker: who asks, as operators read it.
        selection: JSON text of the robot's own answer.
    """

    id: str
    scene_key: str
    asked_at: datetime
    expires_at: datetime
    asker: str
    selection: str


def overridden(candidate: Candidate) -> tuple[dict[str, Any], ...]:
    """The checks that an operator overrides by taking a candidate.

    Args:
        candidate: that is taken.

    Returns:
        Name, value, limit and unit of each check that it failed.
    """
    return tuple(
        {"check": name, "value": said.value, "limit": said.limit, "unit": said.unit}
        for name, said in candidate.checks.items()
        if not said.passed
    )
