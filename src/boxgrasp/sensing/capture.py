"""One view by a depth camera, validated once, so that no later step meets a NaN or a stray shape.

Depth images and clouds, organized or not. Files are read by `boxgrasp.io.load_capture`.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from boxgrasp.arrays import Bools, Floats, Points, readonly
from boxgrasp.errors import CaptureError, CodedWarning, require
from boxgrasp.sensing.validation import (
    LOOKS_AWAY,
    Bytes,
    CloudFrame,
    in_order,
    looks_away,
    validate_cloud,
    validate_cloud_frame,
    validate_colors,
    validate_depth,
    validate_intrinsics,
    validate_mask,
    validate_pixel,
    validate_points,
    validate_pose,
)

Pixels = NDArray[np.int32]

_SAME_POSE = 1e-6  # m, and of a rotation's entries: what text files lose

# An organized cloud's focal length.
_MEASURED_PIXELS = 500  # tell it
_LEAST_SPAN_PX = 8  # between the outermost of them
_PINHOLE_PX = 1.0  # what they may be off


@dataclass(frozen=True, eq=False)
class Capture:
    """A depth image with its camera, or a cloud (`Capture.from_cloud`).

    Attributes:
        depth: (H, W) float32, m along the optical axis; None for a cloud. Given with 0, NaN
            (invalid), -inf (too near) or +inf (nothing in range) for missing, as REP 117 says;
            kept with 0.
        intrinsics: (3, 3) float64, pixels, pixel centers at integers; None for a cloud.
        T_base_camera: (4, 4) float64, or None when unknown; the camera frame is optical.
        rgb: (H, W, 3) uint8, or None.
        mask: (H, W) bool, True on the target; (N,) for an unorganized cloud; or None.
        target_pixel: (u, v) on the target, or None.
        robot_mask: (H, W) bool, or (N,) like `mask`, True on the robot's own arm, whose points are
            dropped; or None.
        points: (N, 3) float32, m, in `cloud_frame`; None for a depth image. Missing points of
            an organized cloud are NaN; an unorganized cloud has none and is sorted, so that
            the order in which it came changes nothing.
        colors: (N, 3) uint8 beside `points`, or None.
        cloud_frame: 'optical' (camera at the origin, z forward) or 'base'.
        cloud_shape: (H, W) of an organized cloud, or None.
        warnings: what was found degraded and mended.

    Raises:
        CaptureError: not a usable view: types or shapes that do not fit, no rigid pose, no
            measured depth, over 0.1 % of it negative, or millimeters.
    """

    depth: Points | None
    intrinsics: Floats | None
    T_base_camera: Floats | None = None
    rgb: Bytes | None = None
    mask: Bools | None = None
    target_pixel: tuple[int, int] | None = field(default=None, kw_only=True)
    robot_mask: Bools | None = field(default=None, kw_only=True)
    points: Points | None = field(default=None, init=False)
    colors: Bytes | None = field(default=None, init=False)
    cloud_frame: CloudFrame = field(default="optical", init=False)
    cloud_shape: tuple[int, int] | None = field(default=None, init=False)
    warnings: tuple[CodedWarning, ...] = field(default=(), init=False)

    def __post_init__(self) -> None:
        depth, warnings = validate_depth(self.depth)
        shape = (depth.shape[0], depth.shape[1])
        robot_mask = validate_mask(self.robot_mask, shape, "robot_mask")
        if robot_mask is not None and not ((depth > 0) & ~robot_mask).any():
            raise CaptureError("robot_mask covers every pixel that has depth; valid: the arm only")
        self._set(
            depth=readonly(depth),
            intrinsics=validate_intrinsics(self.intrinsics, shape),
            T_base_camera=validate_pose(self.T_base_camera),
            rgb=validate_colors(self.rgb, shape, "rgb"),
            mask=validate_mask(self.mask, shape, "mask"),
            target_pixel=validate_pixel(self.target_pixel, shape),
            robot_mask=robot_mask,
            warnings=warnings,
        )

    @classmethod
    def from_cloud(
        cls,
        points: ArrayLike,
        *,
        cloud_frame: CloudFrame = "optical",
        colors: ArrayLike | None = None,
        T_base_camera: ArrayLike | None = None,
        mask: ArrayLike | None = None,
        target_pixel: ArrayLike | None = None,
        robot_mask: ArrayLike | None = None,
    ) -> Capture:
        """The capture of a cloud; a point that is not finite or 0, 0, 0 is missing (REP 117).

        Args:
            points: (N, 3) or organized (H, W, 3) float, m, in `cloud_frame`.
            cloud_frame: 'optical', or 'base' with the camera's place in `T_base_camera` or unknown.
            colors: (N, 3) or (H, W, 3) uint8 beside the points, or None.
            T_base_camera: (4, 4), or None.
            mask: (N,) or (H, W) bool, True on the target, or None.
            target_pixel: (u, v) on the target of an organized cloud, or None.
            robot_mask: (N,) or (H, W) bool, True on the robot's own arm, or None.

        Returns:
            The capture.

        Raises:
            CaptureError: shapes or types do not fit, no point is valid, over 0.1 % of the points
                lie behind the camera, or millimeters.
        """
        cloud_frame = validate_cloud_frame(cloud_frame)
        T = validate_pose(T_base_camera)
        xyz, shape = validate_points(points)
        beside = shape if shape is not None else (len(xyz),)
        rgb = validate_colors(colors, beside, "colors")
        rgb = rgb.reshape(-1, 3) if rgb is not None else None
        target = validate_mask(mask, beside, "mask")
        robot = validate_mask(robot_mask, beside, "robot_mask")
        pixel = validate_pixel(target_pixel, shape)
        keep, warnings = validate_cloud(xyz, cloud_frame, T)
        if robot is not None and not (keep & ~robot.reshape(-1)).any():
            raise CaptureError("robot_mask covers every valid point; valid: the arm only")
        if shape is not None:
            xyz[~keep] = np.nan
        else:
            xyz, rgb, target, robot = in_order(keep, xyz, rgb, target, robot)
        capture = object.__new__(cls)
        capture._set(
            depth=None,
            intrinsics=None,
            T_base_camera=T,
            rgb=None,
            mask=target,
            target_pixel=pixel,
            robot_mask=robot,
            points=readonly(xyz),
            colors=readonly(rgb) if rgb is not None else None,
            cloud_frame=cloud_frame,
            cloud_shape=shape,
            warnings=warnings,
        )
        return capture

    @property
    def shape(self) -> tuple[int, int] | None:
        """(H, W) of the depth image or organized cloud; None without an image."""
        return (
            self.cloud_shape if self.depth is None else (self.depth.shape[0], self.depth.shape[1])
        )

    @property
    def has_camera(self) -> bool:
        """Whether the camera's place relative to the points is known, so free space can be."""
        return self.cloud_frame == "optical" or self.T_base_camera is not None

    @property
    def focal_px(self) -> float | None:
        """Focal length along u, px; of an organized cloud as measured, else None."""
        if self.intrinsics is not None:
            return float(self.intrinsics[0, 0])
        if self.points is None or self.cloud_shape is None or self.cloud_frame != "optical":
            return None
        return measured_focal_px(self.points, self.cloud_shape)

    def valid_points(self, left_out: Bools | None = None) -> tuple[Points, Pixels]:
        """All points but missing ones and the robot's.

        Args:
            left_out: (H, W) bool, further pixels of an image to leave out, or None.

        Returns:
            (N, 3) float32, m, in the optical frame, or in the base frame where `cloud_frame` is
            'base'; and (N,) int32, each one's row-major pixel v * W + u, rising, or -1 without an
            image.

        Raises:
            CaptureError: the capture holds neither depth nor points, or `left_out` is no such
                image.
        """
        if left_out is not None:
            require(left_out, np.ndarray, "left_out", "bool pixels, or None", CaptureError)
            if left_out.dtype != np.bool_ or left_out.shape != self.shape:
                found = f"{left_out.dtype} {left_out.shape}"
                raise CaptureError(f"left_out is {found}; valid: bool {self.shape}")
        if self.depth is not None and self.intrinsics is not None:
            return _depth_points(self.depth, self.intrinsics, _either(self.robot_mask, left_out))
        if self.points is None:
            raise CaptureError("capture holds neither depth nor points")
        keep: NDArray[np.bool_] = np.ones(len(self.points), bool)
        if self.cloud_shape is not None:
            keep = ~np.isnan(self.points[:, 2])
        if self.robot_mask is not None:
            keep &= ~self.robot_mask.reshape(-1)
        if left_out is not None:
            keep &= ~left_out.reshape(-1)
        kept = np.flatnonzero(keep)
        points = self.points if len(kept) == len(keep) else np.take(self.points, kept, axis=0)
        pixels: NDArray[np.int32] = kept.astype(np.int32)
        if self.cloud_shape is None:
            pixels = np.full(len(points), -1, np.int32)
        return readonly(points), readonly(pixels)

    def with_pose(self, T_base_camera: ArrayLike | None) -> Capture:
        """The same capture with its camera elsewhere, whatever pose it had.

        Args:
            T_base_camera: (4, 4), m; None where it is unknown.

        Returns:
            A copy that shares the arrays; warned of where another pose is replaced.

        Raises:
            CaptureError: not a rigid transform, or in millimeters.
        """
        T, had = validate_pose(T_base_camera), self.T_base_camera
        kept = tuple(w for w in self.warnings if w != LOOKS_AWAY)
        if T is not None and self.points is not None and self.cloud_frame == "base":
            kept += (LOOKS_AWAY,) if looks_away(self.points, T) else ()
        if T is not None and had is not None and not np.allclose(T, had, atol=_SAME_POSE):
            kept += (_replaced(had, T),)
        other = copy.copy(self)
        other._set(T_base_camera=T, warnings=kept)
        return other

    def with_warnings(self, *warnings: CodedWarning) -> Capture:
        """The same capture with more warnings, as a reader has them.

        Args:
            warnings: what follows those that it has.

        Returns:
            A copy that shares the arrays.
        """
        for warning in warnings:
            require(warning, CodedWarning, "warning", "a CodedWarning", CaptureError)
        if not warnings:
            return self
        other = copy.copy(self)
        other._set(warnings=(*self.warnings, *warnings))
        return other

    def _set(self, **values: Any) -> None:
        for name, value in values.items():
            object.__setattr__(self, name, value)


def measured_focal_px(points: Points, shape: tuple[int, int]) -> float | None:
    """The focal length that an organized cloud was made with.

    Args:
        points: (H W, 3) float32, optical frame, m, NaN where missing.
        shape: (H, W).

    Returns:
        px, or None where the points are not those of a pinhole camera's pixels.
    """
    held = np.flatnonzero(points[:, 2] > 0)
    held = held[:: max(1, len(held) // _MEASURED_PIXELS)]
    u = (held % shape[1]).astype(np.float64)
    if len(held) == 0 or np.ptp(u) < _LEAST_SPAN_PX:
        return None
    tangent = points[held, 0].astype(np.float64) / points[held, 2]
    slope, start = np.polyfit(u, tangent, 1)
    off_px = np.abs(tangent - slope * u - start).max() / abs(slope) if slope else np.inf
    return float(1.0 / slope) if slope > 0 and off_px < _PINHOLE_PX else None


def _replaced(had: Floats, T: Floats) -> CodedWarning:
    apart_m = float(np.linalg.norm(had[:3, 3] - T[:3, 3]))
    cosine = (np.trace(had[:3, :3].T @ T[:3, :3]) - 1) / 2
    apart_deg = float(np.rad2deg(np.arccos(np.clip(cosine, -1, 1))))
    return CodedWarning(
        "pose_replaced",
        f"the capture's own T_base_camera, {apart_m * 100:.1f} cm and {apart_deg:.1f} degrees "
        "from the one given, is not used",
    )


def _either(one: Bools | None, other: Bools | None) -> Bools | None:
    if one is None or other is None:
        return other if one is None else one
    return readonly(one | other)


def _depth_points(
    depth: Points, intrinsics: Floats, dropped: Bools | None
) -> tuple[Points, Pixels]:
    from boxgrasp.kernels.backproject import backproject  # numba, only where it is used

    count = int(np.count_nonzero(depth))
    points, pixels = np.empty((count, 3), np.float32), np.empty(count, np.int32)
    dropped = dropped if dropped is not None else readonly(np.zeros((0, 0), bool))
    (fx, _, cx), (_, fy, cy) = intrinsics[:2].tolist()
    count = backproject(depth, fx, fy, cx, cy, dropped, points, pixels)
    return readonly(points[:count]), readonly(pixels[:count])
