"""A pose that an operator reached by teleoperation is a label: that of the nearest candidate."""

from __future__ import annotations

import math
import uuid
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from typing import Any, Final

import numpy as np

from boxgrasp.arrays import Floats
from boxgrasp.config import Config
from boxgrasp.errors import BoxgraspError, ConfigError
from boxgrasp.geometry.transforms import validate_transform
from boxgrasp.io.pose import gripper_pose
from boxgrasp.labeling.captures import CaptureStore
from boxgrasp.labeling.record import Record
from boxgrasp.labeling.sources import load_scene, source_at
from boxgrasp.labeling.words import LabelScene, OperatorLabel, overridden
from boxgrasp.result import Candidate, Selection
from boxgrasp.selector import GraspSelector
from boxgrasp.strict import plain
from boxgrasp.version import __version__

_HALF_TURN: Final = (1.0, -1.0, -1.0)  # about the approach, x: the fingers change places


@dataclass(frozen=True)
class PoseParams:
    """How a pose is mapped to a candidate.

    Attributes:
        lever_m: what a turn of one radian counts, m: half the length of the thesis's hand, by
            which its fingertips move when it turns about its middle.
        most_m: from a pose to its candidate, m: the middle of the thesis's hand stands that far
            from the face that it grasps at, so one farther away is at no face of this box.
        most_rad: between their directions: faces are 90 degrees apart, so beyond 45 a pose is as
            much another face's.
        lead_m: by which the nearest candidate must lead one of another thing: two things that a
            pose fits alike are told apart by no pose.
    """

    lever_m: float = 0.11
    most_m: float = 0.10
    most_rad: float = math.pi / 4
    lead_m: float = 0.01


PARAMS: Final = PoseParams()


@dataclass(frozen=True)
class Nearest:
    """The candidate that a pose is nearest to.

    Attributes:
        label: of the candidate.
        distance_m: between their positions, m.
        angle_rad: of the turn between them, radians; a half turn about the approach is none.
    """

    label: int
    distance_m: float
    angle_rad: float

    def cost_m(self, params: PoseParams = PARAMS) -> float:
        """How far it is, position and direction together, m.

        Args:
            params: what a turn counts.

        Returns:
            The distance, and the way of the fingertips by the turn.
        """
        return self.distance_m + params.lever_m * self.angle_rad


def nearest_candidate(
    candidates: Sequence[Candidate], T_base_gripper: Floats, params: PoseParams = PARAMS
) -> Nearest:
    """The candidate that a pose is nearest to, by position and direction together.

    Args:
        candidates: of one box.
        T_base_gripper: (4, 4) of the hand's box when it closes, m.
        params: what a turn counts.

    Returns:
        The nearest, of equals the one of the lowest label; however far it is.

    Raises:
        BoxgraspError: no candidates, or no rigid transform.
    """
    T = validate_transform(T_base_gripper, "T_base_gripper")
    if not candidates:
        raise BoxgraspError("no candidates; valid: those of an answer")
    poses = np.array([item.T_base_gripper for item in candidates])
    distance_m = np.linalg.norm(poses[:, :3, 3] - T[:3, 3], axis=1)
    angle_rad = np.minimum(
        _angles(poses[:, :3, :3], T[:3, :3]),
        _angles(poses[:, :3, :3] * np.array(_HALF_TURN), T[:3, :3]),
    )
    k = int(np.argmin(distance_m + params.lever_m * angle_rad))
    return Nearest(candidates[k].label, float(distance_m[k]), float(angle_rad[k]))


def _angles(rotations: Floats, rotation: Floats) -> Floats:
    """(M,) radians of the turn from each of (M, 3, 3) to one; exact for small ones too."""
    # The chord between two rotations is 2 sqrt(2) sin(angle / 2).
    chord = np.linalg.norm(rotations - rotation, axis=(1, 2)) / (2 * math.sqrt(2.0))
    return np.asarray(2 * np.arcsin(np.minimum(chord, 1.0)))


@dataclass(frozen=True, eq=False)
class _Fit:
    """A scene's answer, and the candidate of it that a pose is nearest to."""

    scene: LabelScene
    selection: Selection
    nearest: Nearest


@dataclass(frozen=True)
class PoseOf:
    """A pose and who reached it.

    Attributes:
        pose: path of a pose's file, or `x y z qx qy qz qw`; of the gripper in the base frame, m.
        operator: who did.
        note: the operator's own words.
    """

    pose: str
    operator: str
    note: str = ""


def label_from_pose(
    source: str,
    reached: PoseOf,
    record: Record,
    captures: CaptureStore,
    config: Config | None = None,
) -> OperatorLabel:
    """Keep the label that a pose reached by teleoperation is.

    Args:
        source: one capture. Of several things in it, the one with the nearest candidate is meant.
        reached: the pose, and by whom.
        record: where the label is kept.
        captures: where the capture is kept.
        config: of the robot; None for the defaults.

    Returns:
        The label, saved, with the distance from the pose to its candidate.

    Raises:
        BoxgraspError: no single capture, no pose, or one that is beyond the limits of
            `PoseParams` from every candidate, or as near to two things: nothing is kept then.
    """
    own = Config() if config is None else config
    T = gripper_pose(reached.pose)
    found = source_at(source, captures, config=own)
    scenes = found.scenes()
    if len({scene.capture_sha256 for scene in scenes}) != 1 or scenes[0].kind != "capture":
        raise ConfigError(f"{source}: {len(scenes)} scenes of several views; valid: one capture")
    fit = _nearest_fit(_fits(scenes, T, captures, GraspSelector(own)), source)
    label = _label(fit, reached, T, own)
    record.add_scenes(found.name, scenes)
    return record.save(label)


def _fits(
    scenes: Sequence[LabelScene], T: Floats, captures: CaptureStore, selector: GraspSelector
) -> list[_Fit]:
    """What the pose is nearest to in each scene, the nearest first."""
    fits = []
    for scene in scenes:
        loaded = load_scene(scene, captures)
        selection = selector.select(loaded.capture, loaded.target)
        fits.append(_Fit(scene, selection, nearest_candidate(selection.candidates, T)))
    return sorted(fits, key=lambda fit: fit.nearest.cost_m())


def _nearest_fit(fits: Sequence[_Fit], source: str) -> _Fit:
    """The first of them.

    Raises:
        ConfigError: it is too far, or another thing's is as near.
    """
    best = fits[0]
    nearest = best.nearest
    if nearest.distance_m > PARAMS.most_m or nearest.angle_rad > PARAMS.most_rad:
        name = best.selection.candidate(nearest.label).name
        raise ConfigError(
            f"{source}: the pose is {100 * nearest.distance_m:.1f} cm and "
            f"{math.degrees(nearest.angle_rad):.0f} degrees from the nearest candidate, {name}; "
            f"valid: within {100 * PARAMS.most_m:.0f} cm and {math.degrees(PARAMS.most_rad):.0f} "
            "degrees, of the gripper in the base frame, meters"
        )
    if len(fits) > 1 and fits[1].nearest.cost_m() - nearest.cost_m() < PARAMS.lead_m:
        names = f"{best.scene.name} and {fits[1].scene.name}"
        raise ConfigError(
            f"{source}: the pose is as near to {names}; valid: a capture with its target, or a "
            "pose at one thing"
        )
    return best


def _label(fit: _Fit, reached: PoseOf, T: Floats, config: Config) -> OperatorLabel:
    selection, nearest = fit.selection, fit.nearest
    rows: Any = T.tolist()
    return OperatorLabel(
        id=str(uuid.uuid4()),
        scene_key=fit.scene.key,
        operator=reached.operator,
        verdict="candidate",
        label=nearest.label,
        labeled_at=datetime.now(timezone.utc),
        seconds=None,
        gripper=plain(config.gripper),
        box_kind=fit.scene.box_kind,
        lines=fit.scene.lines,
        version=__version__,
        model=config.ranker if config.models is None else f"{config.ranker} {config.models}",
        proposed=None if selection.grasp is None else selection.grasp.label,
        overridden=overridden(selection.candidate(nearest.label)),
        note=reached.note,
        origin="pose",
        T_base_gripper=tuple(tuple(row) for row in rows),
        pose_distance_m=nearest.distance_m,
        pose_angle_rad=nearest.angle_rad,
    )
