"""A two-finger hand as the checks see it: a box, an opening, a tool point."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from msgspec import Meta

from boxgrasp.arrays import Floats, readonly
from boxgrasp.errors import BoxgraspError, GripperError
from boxgrasp.forks import cached_property
from boxgrasp.geometry.transforms import validate_transform

LEAST_OPENING_M = 0.005  # m: no camera tells a target's sides well enough for a narrower one

Length = Annotated[float, Meta(gt=0.0, le=1.0)]
Row = tuple[float, float, float, float]

TCP_AT_FINGERTIPS: tuple[Row, Row, Row, Row] = (
    (1.0, 0.0, 0.0, 0.11),
    (0.0, 1.0, 0.0, 0.0),
    (0.0, 0.0, 1.0, 0.0),
    (0.0, 0.0, 0.0, 1.0),
)


@dataclass(frozen=True)
class Gripper:
    """The hand as one box; section `gripper` of the configuration, or a YAML file of its own.

    The frame's origin is the box's center, x the approach, y the finger opening. The defaults are
    the thesis's: 12 cm opening, 17 cm width, 22 cm for gripper and attached link (sections 3-1,
    3-2). Thickness and the box centered on the pose are ours.

    Attributes:
        length_m: along x, m.
        width_m: along y, m.
        thickness_m: along z, m.
        max_opening_m: how far the fingers open, m.
        insertion_depth_m: how far the fingertips pass the target's face, m.
        T_gripper_tcp: 4 rows of 4, the tool point.

    Raises:
        GripperError: the gripper cannot hold anything, or its sizes contradict each other.
    """

    length_m: Length = 0.22
    width_m: Length = 0.17
    thickness_m: Length = 0.07
    max_opening_m: Length = 0.12
    insertion_depth_m: Annotated[float, Meta(ge=-0.5, le=0.5)] = 0.01
    T_gripper_tcp: tuple[Row, Row, Row, Row] = TCP_AT_FINGERTIPS

    RENAMED: ClassVar[dict[str, str]] = {
        "opening_m": "max_opening_m",
        "reach_past_face_m": "insertion_depth_m",
    }

    def __post_init__(self) -> None:
        for name in ("length_m", "width_m", "thickness_m", "max_opening_m"):
            value = getattr(self, name)
            if not 0.0 < value <= 1.0:
                raise GripperError(f"gripper {name} is {value}; valid: above 0, at most 1 m")
        if self.max_opening_m < LEAST_OPENING_M:
            raise GripperError(
                f"gripper max_opening_m is {self.max_opening_m}, so it cannot hold anything; "
                f"valid: {LEAST_OPENING_M} m and more"
            )
        if self.max_opening_m > self.width_m:
            raise GripperError(
                f"gripper max_opening_m {self.max_opening_m} exceeds width_m {self.width_m}; "
                "valid: the box holds the open fingers"
            )
        if not 0.0 < self.insertion_depth_m < self.length_m:
            raise GripperError(
                f"gripper insertion_depth_m is {self.insertion_depth_m}, so it cannot hold "
                f"anything; valid: above 0, below length_m {self.length_m}"
            )
        try:
            validate_transform(self.T_gripper_tcp, "T_gripper_tcp")
        except BoxgraspError as error:
            raise GripperError(str(error)) from None

    @property
    def standoff_m(self) -> float:
        """From the face to the gripper's center (0.10 m for the thesis's gripper)."""
        return self.length_m / 2 - self.insertion_depth_m

    @cached_property
    def half_m(self) -> Floats:
        """(3,) float64, m: half sizes along the gripper's x, y, z."""
        return readonly(np.array([self.length_m, self.width_m, self.thickness_m]) / 2)
