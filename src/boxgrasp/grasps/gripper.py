"""A two-finger hand as the checks see it: its boxes, opening, tool point and flange."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Final

import numpy as np
from msgspec import Meta

from boxgrasp.arrays import Floats, readonly
from boxgrasp.errors import BoxgraspError, GripperError
from boxgrasp.forks import cached_property
from boxgrasp.geometry.transforms import make_transform, validate_transform
from boxgrasp.strict import validate_types

LEAST_OPENING_M = 0.005  # m: no camera tells a target's sides well enough for a narrower one
UNKNOWN_FINGER_M: Final = 0.045  # m: free length of common parallel grippers' fingers

_SLACK_M = 1e-4  # m, between a hand's sizes and those of its boxes: they are typed from a sheet

Length = Annotated[float, Meta(gt=0.0, le=1.0)]
Row = tuple[float, float, float, float]
Rows = tuple[Row, Row, Row, Row]
Range = tuple[float, float]


@dataclass(frozen=True)
class HandBox:
    """One box of a hand, in the hand's axes.

    Their origin is on the hand's mounting face, where the arm's flange is; x is the approach, from
    there to the fingertips, y the finger opening, z = x cross y.

    Attributes:
        x_m: from and to, m.
        y_m: from and to, m.
        z_m: from and to, m.

    Raises:
        GripperError: a range that ends before it starts.
    """

    x_m: Range
    y_m: Range
    z_m: Range

    def __post_init__(self) -> None:
        validate_types(self, "gripper box", GripperError)
        for name in ("x_m", "y_m", "z_m"):
            start, end = getattr(self, name)
            if not -1.0 <= start < end <= 1.0:
                raise GripperError(
                    f"gripper box {name} is from {start} to {end}; valid: rising, within 1 m"
                )


@dataclass(frozen=True)
class Gripper:
    """The hand; section `gripper` of the configuration, or a YAML file of its own.

    The gripper frame's origin is the middle of the hand's outer box, length by width by thickness;
    x is the approach, y the finger opening. The defaults are the thesis's: one box, 12 cm opening,
    17 cm width, 22 cm for gripper and attached link (sections 3-1, 3-2). Thickness and the box
    centered on the pose are ours. With `palm` and `finger` the hand is those boxes.

    Attributes:
        name: what answers and pictures call it.
        length_m: along x, from the mounting face to the fingertips, m.
        width_m: along y, at full opening, m; twice the farthest from the middle.
        thickness_m: along z, m; twice the farthest from the middle.
        max_opening_m: how far the fingers open, m.
        opening_m: how far they stand open on the way in, m; None for full opening.
        insertion_depth_m: how far the fingertips pass the target's face, m.
        closing_advance_m: how much farther along x closed fingertips are than open ones, m: the
            fingers of some hands swing.
        palm: boxes that do not move.
        finger: boxes of the finger at positive y at full opening; the other is its mirror image.
        T_gripper_tcp: 4 rows of 4, the tool point; None for the middle between the fingertips.
        T_flange_gripper: 4 rows of 4, the gripper frame in the arm's flange, as the arm's maker and
            MoveIt have it: z points out of it. None where it is not known.

    Raises:
        GripperError: the gripper cannot hold anything, or its sizes contradict each other.
    """

    name: str = "thesis"
    length_m: Length = 0.22
    width_m: Length = 0.17
    thickness_m: Length = 0.07
    max_opening_m: Length = 0.12
    opening_m: Length | None = None
    insertion_depth_m: Annotated[float, Meta(ge=-0.5, le=0.5)] = 0.01
    closing_advance_m: Annotated[float, Meta(ge=0.0, le=0.1)] = 0.0
    palm: tuple[HandBox, ...] = ()
    finger: tuple[HandBox, ...] = ()
    T_gripper_tcp: Rows | None = None
    T_flange_gripper: Rows | None = None

    RENAMED: ClassVar[dict[str, str]] = {"reach_past_face_m": "insertion_depth_m"}

    def __post_init__(self) -> None:
        validate_types(self, "gripper", GripperError)
        self._validate_sizes()
        if self.palm or self.finger:
            self._validate_boxes()
        if not 0.0 < self.insertion_depth_m < self.finger_length_m:
            raise GripperError(
                f"gripper insertion_depth_m is {self.insertion_depth_m}, so it cannot hold "
                f"anything; valid: above 0, below the fingers' {self.finger_length_m:g} m"
            )
        for name in ("T_gripper_tcp", "T_flange_gripper"):
            if getattr(self, name) is not None:
                try:
                    validate_transform(getattr(self, name), name)
                except BoxgraspError as error:
                    raise GripperError(str(error)) from None
        if self.tcp_pose[0, 3] > self.length_m / 2 + _SLACK_M:
            beyond_m = self.tcp_pose[0, 3] - self.length_m / 2
            raise GripperError(
                f"gripper T_gripper_tcp lies {100 * beyond_m:.2f} cm beyond the fingertips, at "
                f"x {self.tcp_pose[0, 3]:g}; valid: at most {self.length_m / 2:g}, half of "
                "length_m, or null for the fingertips"
            )

    def _validate_sizes(self) -> None:
        for name in ("length_m", "width_m", "thickness_m", "max_opening_m"):
            value = getattr(self, name)
            if not 0.0 < value <= 1.0:
                raise GripperError(f"gripper {name} is {value}; valid: above 0, at most 1 m")
        if not 0.0 <= self.closing_advance_m <= 0.1:
            raise GripperError(
                f"gripper closing_advance_m is {self.closing_advance_m}; valid: 0 to 0.1 m"
            )
        for name in ("max_opening_m", "opening_m"):
            value = getattr(self, name)
            if value is not None and value < LEAST_OPENING_M:
                raise GripperError(
                    f"gripper {name} is {value}, so it cannot hold anything; "
                    f"valid: {LEAST_OPENING_M} m and more"
                )
        if self.max_opening_m > self.width_m:
            raise GripperError(
                f"gripper max_opening_m {self.max_opening_m} exceeds width_m {self.width_m}; "
                "valid: the box holds the open fingers"
            )
        if self.fingers_open_m > self.max_opening_m:
            raise GripperError(
                f"gripper opening_m {self.opening_m} exceeds max_opening_m {self.max_opening_m}; "
                "valid: at most that"
            )

    def _validate_boxes(self) -> None:
        if not (self.palm and self.finger):
            given, lacking = ("palm", "finger") if self.palm else ("finger", "palm")
            raise GripperError(
                f"gripper {given} is given and {lacking} is not; valid: both, or none for one box"
            )
        low = min(box.y_m[0] for box in self.finger)
        if low < self.max_opening_m / 2 - _SLACK_M:
            raise GripperError(
                f"gripper finger starts at y {low:g}, between the fingers; valid: from "
                f"{self.max_opening_m / 2:g}, half of max_opening_m, up"
            )
        boxes = (*self.palm, *self.finger)
        if any(box.x_m[0] < -_SLACK_M for box in boxes):
            raise GripperError("gripper box starts behind the mounting face; valid: x from 0 up")
        outer = {
            "length_m": max(box.x_m[1] for box in boxes),
            "width_m": 2 * max(max(-box.y_m[0], box.y_m[1]) for box in boxes),
            "thickness_m": 2 * max(max(-box.z_m[0], box.z_m[1]) for box in boxes),
        }
        for name, size in outer.items():
            if abs(getattr(self, name) - size) > _SLACK_M:
                raise GripperError(
                    f"gripper {name} is {getattr(self, name)}, its boxes reach {size:.4f}; "
                    "valid: alike"
                )
        if self.length_m - max(box.x_m[1] for box in self.finger) > _SLACK_M:
            raise GripperError("gripper palm reaches past the fingertips; valid: behind them")

    @property
    def fingers_open_m(self) -> float:
        """How far the fingers stand open on the way in, m."""
        return self.max_opening_m if self.opening_m is None else self.opening_m

    def advance_m(self, width_m: Floats) -> Floats:
        """How far the fingertips go along x as they close on something.

        They go on a circle, so most of the way comes first: at most the share that it would be of a
        quarter turn.

        Args:
            width_m: (M,) what is between them, m.

        Returns:
            (M,) float64, m.
        """
        open_still = np.clip(width_m / self.max_opening_m, 0.0, 1.0)
        advance_m = self.closing_advance_m * np.sqrt(1.0 - open_still**2)
        standing = np.sqrt(1.0 - (self.fingers_open_m / self.max_opening_m) ** 2)
        return np.asarray(np.maximum(advance_m - self.closing_advance_m * standing, 0.0))

    @property
    def standoff_m(self) -> float:
        """From the face to the gripper's center (0.10 m for the thesis's gripper)."""
        return self.length_m / 2 - self.insertion_depth_m

    @cached_property
    def finger_length_m(self) -> float:
        """From the fingertips back to what of the palm is between the fingers, m.

        One box does not say where its palm is; its whole length there, for what may be asked.
        """
        gap = self.fingers_open_m / 2
        between = [box.x_m[1] for box in self.palm if box.y_m[0] < gap and box.y_m[1] > -gap]
        return self.length_m - max(between, default=0.0)

    @property
    def free_length_m(self) -> float:
        """How deep a target may reach between the fingers, from their tips, m."""
        return self.finger_length_m if self.palm else UNKNOWN_FINGER_M

    @cached_property
    def boxes_m(self) -> Floats:
        """(B, 2, 3) float64, gripper frame, m: lowest and highest corner of each of its boxes.

        The palm's first, then each finger's, where they stand on the way in.
        """
        if not self.palm:
            return readonly(np.array([[-self.half_m, self.half_m]]))
        both = [_corners(box) for box in self.finger]
        shift = np.array((0.0, (self.max_opening_m - self.fingers_open_m) / 2, 0.0))
        left = [corners - shift for corners in both]
        right = [np.sort(corners * (1.0, -1.0, 1.0), axis=0) for corners in left]
        boxes = np.array([*(_corners(box) for box in self.palm), *left, *right])
        boxes[:, :, 0] -= self.length_m / 2
        return readonly(boxes)

    @cached_property
    def finger_boxes_m(self) -> Floats:
        """(F, 2, 3) float64, m, as `boxes_m`: where the fingers are on the way in.

        For a hand of one box all of it that is beyond the opening.
        """
        if self.palm:
            return self.boxes_m[len(self.palm) :]
        boxes = np.repeat(self.boxes_m, 2, axis=0)
        boxes[0, 0, 1], boxes[1, 1, 1] = self.fingers_open_m / 2, -self.fingers_open_m / 2
        return readonly(boxes)

    @cached_property
    def between_m(self) -> Floats:
        """(2, 3) float64, gripper frame, m: corners of the space between the fingers."""
        off = self.finger_boxes_m[:, :, 2]
        front, gap = self.length_m / 2 - self.free_length_m, self.fingers_open_m / 2
        return readonly(np.array(((front, -gap, off.min()), (self.length_m / 2, gap, off.max()))))

    @cached_property
    def half_m(self) -> Floats:
        """(3,) float64, m: half sizes of the outer box along the gripper's x, y, z."""
        return readonly(np.array([self.length_m, self.width_m, self.thickness_m]) / 2)

    @cached_property
    def tcp_pose(self) -> Floats:
        """(4, 4) float64, m: `T_gripper_tcp`, or what None stands for."""
        if self.T_gripper_tcp is not None:
            return readonly(np.array(self.T_gripper_tcp, dtype=np.float64))
        return readonly(make_transform(np.eye(3), (self.length_m / 2, 0.0, 0.0)))

    @cached_property
    def flange_pose(self) -> Floats | None:
        """(4, 4) float64, m: `T_flange_gripper` as an array, None where it is not known."""
        if self.T_flange_gripper is None:
            return None
        return readonly(np.array(self.T_flange_gripper, dtype=np.float64))


def _corners(box: HandBox) -> Floats:
    """(2, 3) lowest and highest corner, hand's axes, m."""
    return np.array((box.x_m, box.y_m, box.z_m), dtype=np.float64).T
