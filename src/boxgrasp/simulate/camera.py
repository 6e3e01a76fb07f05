"""A pinhole depth camera by ray casting: exact against geometry, pixel centers at integers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from boxgrasp.arrays import Floats, readonly
from boxgrasp.errors import SceneError
from boxgrasp.geometry.transforms import invert, make_transform, validate_transform
from boxgrasp.kernels._threads import run_chunks
from boxgrasp.kernels.raycast import CONE, CUP, paint, raycast
from boxgrasp.sensing.sensor_model import XTION
from boxgrasp.simulate.primitives import Primitive, Solids

SHAPE = (480, 640)
SKY = (22, 36, 36)
_MIN_ROWS = 60
# Unit vector to a lamp up left behind the camera, camera frame.
_LIGHT = readonly(np.array([-0.46, -0.30, -0.836]))


@dataclass(frozen=True, eq=False)
class CastView:
    """What the camera sees; read-only arrays.

    Attributes:
        depth: (H, W) float32, z not range, m, 0 where nothing is.
        rgb: (H, W, 3) uint8.
        object_ids: (H, W) int32, number of the object that each pixel shows, -1 for nothing.
        solids: (H, W) int32, index of the primitive, -1 for nothing.
    """

    depth: NDArray[np.float32]
    rgb: NDArray[np.uint8]
    object_ids: NDArray[np.int32]
    solids: NDArray[np.int32]


def intrinsics_matrix(focal_px: float = XTION.focal_px, shape: tuple[int, int] = SHAPE) -> Floats:
    """Intrinsics of an undistorted camera whose axis meets the image's middle.

    Args:
        focal_px: focal length, px.
        shape: height and width, px.

    Returns:
        (3, 3) float64, px.
    """
    height, width = shape
    return readonly(
        np.array(
            [
                [focal_px, 0.0, (width - 1) / 2],
                [0.0, focal_px, (height - 1) / 2],
                [0.0, 0.0, 1.0],
            ]
        )
    )


def look_at(position_m: ArrayLike, gaze_m: ArrayLike) -> Floats:
    """The pose of a camera at a place, looking at another, with the image's x level.

    Args:
        position_m: (3,) of the camera, base frame, m.
        gaze_m: (3,) of what it looks at, base frame, m.

    Returns:
        T_base_camera (4, 4), optical frame.

    Raises:
        SceneError: the two coincide or lie above each other.
    """
    position = np.asarray(position_m, dtype=np.float64)
    forward = np.asarray(gaze_m, dtype=np.float64) - position
    right = np.array([forward[1], -forward[0], 0.0])
    if np.linalg.norm(right) < 1e-9:
        raise SceneError("the gaze is vertical; valid: a gaze point beside the camera")
    forward = forward / np.linalg.norm(forward)
    right = right / np.linalg.norm(right)
    rotation = np.column_stack([right, np.cross(forward, right), forward])
    return readonly(make_transform(np.round(rotation, 12), position))


def cast(
    primitives: Sequence[Primitive],
    intrinsics: ArrayLike,
    T_base_camera: ArrayLike,
    shape: tuple[int, int] = SHAPE,
    *,
    shading: float = 0.0,
) -> CastView:
    """The exact view of the primitives; of equal depths the first primitive wins.

    Args:
        primitives: what is there, base frame.
        intrinsics: (3, 3) px, without skew.
        T_base_camera: (4, 4), optical frame.
        shape: height and width, px.
        shading: 0 (flat colors) to 1 (black where the surface turns away), for pictures that
            read well.

    Returns:
        Depth, colors and object numbers.

    Raises:
        SceneError: nothing to cast, or shading out of range.
        BoxgraspError: T_base_camera is not rigid.
    """
    if not primitives:
        raise SceneError("no primitives; valid: at least one")
    if not 0.0 <= shading <= 1.0:
        raise SceneError(f"shading is {shading}; valid: 0 to 1")
    K = np.asarray(intrinsics, dtype=np.float64)
    focal = np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2]])
    T = validate_transform(T_base_camera, "T_base_camera")
    rays = SolidsSeen.of(Solids.of(primitives), T)
    solids, rectangles = rays.arrays, rays.rectangles(focal, shape)
    colors = np.array([*(p.color for p in primitives), SKY], dtype=np.uint8)
    numbers = np.array([*(p.object_id for p in primitives), -1], dtype=np.int32)
    exact, index = np.empty(shape), np.empty(shape, dtype=np.int32)
    depth, object_ids = np.empty(shape, dtype=np.float32), np.empty(shape, dtype=np.int32)
    rgb = np.empty((*shape, 3), dtype=np.uint8)

    def rows(start: int, stop: int) -> None:
        raycast(*solids, rectangles, focal, start, stop, exact, index)
        paint(
            *solids, colors, numbers, _LIGHT, shading, focal, start, stop,
            exact, index, depth, rgb, object_ids,
        )  # fmt: skip

    run_chunks(rows, shape[0], smallest=_MIN_ROWS)
    return CastView(readonly(depth), readonly(rgb), readonly(object_ids), readonly(index))


@dataclass(frozen=True, eq=False)
class SolidsSeen:
    """P solids as the kernels of the ray caster take them.

    Attributes:
        kinds: (P,) int32, of `kernels.raycast`.
        T_solid_camera: (P, 4, 4).
        sizes: (P, 3), as `raycast` takes them, m.
    """

    kinds: NDArray[np.int32]
    T_solid_camera: Floats
    sizes: Floats

    @staticmethod
    def of(solids: Solids, T_base_camera: Floats) -> SolidsSeen:
        """Solids that stand in the base frame, before a camera.

        Args:
            solids: what is there.
            T_base_camera: (4, 4), optical frame.

        Returns:
            The solids.
        """
        poses = np.array([invert(T) @ T_base_camera for T in solids.T_base_solid])
        return SolidsSeen(solids.kinds, poses, solids.sizes)

    @property
    def arrays(self) -> tuple[NDArray[np.int32], Floats, Floats, Floats]:
        """Kinds (P,), rotations (P, 3, 3), origins (P, 3) and sizes (P, 3) for the kernels."""
        return (
            self.kinds,
            np.ascontiguousarray(self.T_solid_camera[:, :3, :3]),
            np.ascontiguousarray(self.T_solid_camera[:, :3, 3]),
            self.sizes,
        )

    def rectangles(self, focal: Floats, shape: tuple[int, int]) -> NDArray[np.int64]:
        """Pixels outside which no ray meets a solid.

        Args:
            focal: (4,) fx, fy, cx, cy, px.
            shape: height and width, px.

        Returns:
            (P, 4) int64 u0, u1, v0, v1, half open.
        """
        each = zip(self.kinds, self.T_solid_camera, self.sizes, strict=True)
        found = [_rectangle(invert(T), half_size(kind, s), focal, shape) for kind, T, s in each]
        return np.array(found, dtype=np.int64)


def half_size(kind: int, size: Floats) -> Floats:
    """Half lengths of the box that holds a solid.

    Args:
        kind: of `kernels.raycast`.
        size: (3,), as `raycast` takes it, m.

    Returns:
        (3,) m.
    """
    if kind not in (CONE, CUP):
        return size
    radius = max(size[0], size[1])
    return np.array([radius, radius, size[2]])


def _rectangle(
    T_camera_solid: Floats, half: Floats, focal: Floats, shape: tuple[int, int]
) -> tuple[int, int, int, int]:
    """Pixel bounds u0, u1, v0, v1 (half open) outside which no ray meets the solid."""
    height, width = shape
    whole = (0, width, 0, height)
    if not np.isfinite(half).all():
        return whole
    signs = np.array([(i & 1, i >> 1 & 1, i >> 2) for i in range(8)]) * 2.0 - 1.0
    corners = signs * half @ T_camera_solid[:3, :3].T + T_camera_solid[:3, 3]
    z = corners[:, 2]
    if z.max() <= 0.0:
        return (0, 0, 0, 0)
    if z.min() <= 1e-3:
        return whole
    u = corners[:, 0] / z * focal[0] + focal[2]
    v = corners[:, 1] / z * focal[1] + focal[3]
    # One pixel more each way: rounding must not cut a grazing ray.
    u0, v0 = np.floor((u.min(), v.min())).astype(int) - 1
    u1, v1 = np.ceil((u.max(), v.max())).astype(int) + 2
    return (max(u0, 0), min(max(u1, 0), width), max(v0, 0), min(max(v1, 0), height))
