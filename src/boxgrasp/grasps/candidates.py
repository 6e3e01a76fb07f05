"""The 5 l grasps of a box: five faces, l lines on each, a pose for every one (section 2-4)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from boxgrasp.arrays import Floats, readonly
from boxgrasp.errors import ConfigError
from boxgrasp.geometry.box import Box
from boxgrasp.grasps.gripper import Gripper

LINES = 3  # a face (thesis section 2-4)
FACES = ("left", "front", "right", "top-parallel", "top-perpendicular")
LEFT, FRONT, RIGHT, TOP_PARALLEL, TOP_PERPENDICULAR = range(1, 6)

# A matrix a face: its columns are the gripper's x (approach), y (finger opening) and z in the box
# frame.
_AXES = np.array(
    (
        ((0, 1, 0), (-1, 0, 0), (0, 0, 1)),
        ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
        ((0, -1, 0), (1, 0, 0), (0, 0, 1)),
        ((0, 0, 1), (0, 1, 0), (-1, 0, 0)),
        ((0, 1, 0), (0, 0, -1), (-1, 0, 0)),
    ),
    dtype=np.float64,
)
# Box axis that the lines of a face step along, and box axis that the fingers close on.
_STEP_AXIS = np.array((2, 2, 2, 0, 1))
_WIDTH_AXIS = np.array((0, 1, 0, 1, 0))

# Where the first and the last line of a face lie.
_LINE_ENDS = (*(("lowest", "highest"),) * 3, ("nearest", "farthest"), ("right", "left"))


@dataclass(frozen=True)
class CandidatesConfig:
    """Which grasps are considered; section `candidates` of the configuration.

    Attributes:
        lines: l, lines a face (thesis: 3).
        faces: names of the faces that may be chosen.
        refine: `surface` moves each candidate along its approach to the target's own surface;
            `none` keeps the thesis's poses at the box's faces.

    Raises:
        ConfigError: a face that is none, or no face.
    """

    lines: Annotated[int, Meta(ge=1, le=99)] = LINES
    faces: tuple[str, ...] = FACES
    refine: Literal["surface", "none"] = "surface"

    def __post_init__(self) -> None:
        unknown = [face for face in self.faces if face not in FACES]
        if unknown or not self.faces:
            found = ", ".join(unknown) or "none"
            raise ConfigError(f"unknown face: {found}; valid: {', '.join(FACES)}")


@dataclass(frozen=True, eq=False)
class Candidates:
    """All candidates of one box, in the order of their labels; M = 5 l.

    Attributes:
        lines: l, lines a face.
        label: (M,) int64, (face - 1) * l + line.
        face: (M,) int64, 1 to 5.
        line: (M,) int64, 1 to l.
        T_base_gripper: (M, 4, 4) float64, m.
        width_m: (M,) float64, the target's width between the fingers, m.
        width_axis: (M,) int64, box axis that the fingers close on, 0 for x, 1 for y.
    """

    lines: int
    label: NDArray[np.int64]
    face: NDArray[np.int64]
    line: NDArray[np.int64]
    T_base_gripper: Floats
    width_m: Floats
    width_axis: NDArray[np.int64]


def face_name(face: int) -> str:
    """The name of a face.

    Args:
        face: 1 to 5.

    Returns:
        One of `FACES`.
    """
    return FACES[face - 1]


def line_name(face: int, line: int, lines: int) -> str:
    """Where a line lies on its face (docs/conventions.md).

    Args:
        face: 1 to 5.
        line: 1 to l.
        lines: l.

    Returns:
        `lowest` to `highest` on a side, `nearest` to `farthest` on top-parallel, `right` to `left`
        on top-perpendicular, `middle` for the middle one of an odd number, else an empty text.
    """
    ends = _LINE_ENDS[face - 1]
    places = {lines: ends[1], 1: ends[0]} | ({(lines + 1) // 2: "middle"} if lines % 2 else {})
    return places.get(line, "")


def label_of(face: Any, line: Any, lines: int) -> Any:
    """The label of a face and line (thesis table 3-4).

    Args:
        face: 1 to 5, a number or an array.
        line: 1 to l, likewise.
        lines: l.

    Returns:
        (face - 1) * l + line.
    """
    return (face - 1) * lines + line


def candidates_of(box: Box, gripper: Gripper, lines: int = LINES) -> Candidates:
    """Every candidate of a box, its pose at the standoff from the middle of its line.

    Args:
        box: the target's.
        gripper: the hand.
        lines: l, lines a face.

    Returns:
        5 l candidates.
    """
    faces = np.repeat(np.arange(1, 6), lines)
    steps = np.tile(np.arange(1, lines + 1), 5)
    axes, step_axis, width_axis = (of[faces - 1] for of in (_AXES, _STEP_AXIS, _WIDTH_AXIS))
    T_box_gripper = np.tile(np.eye(4), (5 * lines, 1, 1))
    T_box_gripper[:, :3, :3] = axes
    T_box_gripper[:, :3, 3] = -axes[:, :, 0] * (box.dimensions_m / 2 + gripper.standoff_m)
    strips = box.dimensions_m[step_axis] * ((steps - 0.5) / lines - 0.5)
    T_box_gripper[np.arange(5 * lines), step_axis, 3] += strips
    return Candidates(
        lines=lines,
        label=readonly(label_of(faces, steps, lines)),
        face=readonly(faces),
        line=readonly(steps),
        T_base_gripper=readonly(box.T_base_box @ T_box_gripper),
        width_m=readonly(box.dimensions_m[width_axis]),
        width_axis=readonly(width_axis),
    )
