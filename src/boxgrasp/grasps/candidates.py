"""The 5 l grasps of a box: five faces, l lines on each, a pose for every one (section 2-4)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from boxgrasp.arrays import Floats, readonly
from boxgrasp.errors import ConfigError
from boxgrasp.geometry.box import Box
from boxgrasp.grasps.gripper import Gripper

FACES = ("left", "front", "right", "top-parallel", "top-perpendicular")
LEFT, FRONT, RIGHT, TOP_PARALLEL, TOP_PERPENDICULAR = range(1, 6)

# Columns are the gripper's x (approach), y (finger opening) and z in the box frame.
_AXES = {
    LEFT: ((0, 1, 0), (-1, 0, 0), (0, 0, 1)),
    FRONT: ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    RIGHT: ((0, -1, 0), (1, 0, 0), (0, 0, 1)),
    TOP_PARALLEL: ((0, 0, 1), (0, 1, 0), (-1, 0, 0)),
    TOP_PERPENDICULAR: ((0, 1, 0), (0, 0, -1), (-1, 0, 0)),
}
# Box axis that the lines of a face step along, and box axis that the fingers close on.
_STEP_AXIS = {LEFT: 2, FRONT: 2, RIGHT: 2, TOP_PARALLEL: 0, TOP_PERPENDICULAR: 1}
_WIDTH_AXIS = {LEFT: 0, FRONT: 1, RIGHT: 0, TOP_PARALLEL: 1, TOP_PERPENDICULAR: 0}


@dataclass(frozen=True)
class CandidatesConfig:
    """How many lines a face has, and which faces may be chosen."""

    lines: Annotated[int, Meta(ge=1, le=99)] = 3
    faces: tuple[str, ...] = FACES

    def __post_init__(self) -> None:
        unknown = [face for face in self.faces if face not in FACES]
        if unknown or not self.faces:
            found = ", ".join(unknown) or "none"
            raise ConfigError(f"unknown face: {found}; valid: {', '.join(FACES)}")


@dataclass(frozen=True, eq=False)
class Candidates:
    """All candidates of one box, in label order; (M,) arrays with M = 5 lines.

    T_base_gripper: (M, 4, 4) float64; width_m: (M,) target's width between the fingers;
    width_axis: (M,) box axis (0 = x, 1 = y) that the fingers close on.
    """

    lines: int
    label: NDArray[np.int64]
    face: NDArray[np.int64]
    line: NDArray[np.int64]
    T_base_gripper: Floats
    width_m: Floats
    width_axis: NDArray[np.int64]


def label_of(face: Any, line: Any, lines: int) -> Any:
    """(face - 1) * l + line, as table 3-4; of numbers or of arrays."""
    return (face - 1) * lines + line


def candidates_of(box: Box, gripper: Gripper, lines: int = 3) -> Candidates:
    """Every option of a box with its pose, standoff away from the middle of its line."""
    faces = np.repeat(np.arange(1, 6), lines)
    steps = np.tile(np.arange(1, lines + 1), 5)
    T_box_gripper = np.tile(np.eye(4), (5 * lines, 1, 1))
    for k, (face, line) in enumerate(zip(faces.tolist(), steps.tolist(), strict=True)):
        axes = np.array(_AXES[face], dtype=np.float64)
        approach = axes[:, 0]
        position = -approach * (box.dimensions_m / 2 + gripper.standoff_m)
        step = _STEP_AXIS[face]
        position[step] += box.dimensions_m[step] * ((line - 0.5) / lines - 0.5)
        T_box_gripper[k, :3, :3] = axes
        T_box_gripper[k, :3, 3] = position
    width_axis = np.array([_WIDTH_AXIS[face] for face in faces.tolist()])
    return Candidates(
        lines=lines,
        label=readonly(label_of(faces, steps, lines)),
        face=readonly(faces),
        line=readonly(steps),
        T_base_gripper=readonly(box.T_base_box @ T_box_gripper),
        width_m=readonly(box.dimensions_m[width_axis]),
        width_axis=readonly(width_axis),
    )
