"""Rigid transforms. `T_a_b` maps b-coordinates into a; meters, radians (docs/conventions.md)."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from boxgrasp.arrays import Array, Floats, readonly
from boxgrasp.errors import BoxgraspError

# A camera's optical frame (z forward, x right, y down) in its link (x forward, y left, z up).
T_LINK_OPTICAL: Final = readonly(
    np.array(
        [[0.0, 0.0, 1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
    )
)
_ROTATION_TOLERANCE = 1e-3  # of R^T R from the identity: what float32 and text files lose


def make_transform(rotation: ArrayLike, translation: ArrayLike) -> Floats:
    """A transform of its parts.

    Args:
        rotation: (3, 3).
        translation: (3,), m.

    Returns:
        (4, 4) float64.
    """
    T = np.eye(4)
    T[:3, :3] = rotation
    T[:3, 3] = translation
    return T


def rotation_z(yaw_rad: float) -> Floats:
    """A turn about z, counter-clockwise seen from above; exact at quarter turns.

    Args:
        yaw_rad: rad.

    Returns:
        (3, 3) float64.
    """
    quarters = yaw_rad / (np.pi / 2)
    if quarters == round(quarters):
        c, s = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[round(quarters) % 4]
    else:
        c, s = float(np.cos(yaw_rad)), float(np.sin(yaw_rad))
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def invert(T_a_b: Floats) -> Floats:
    """The inverse of a rigid transform.

    Args:
        T_a_b: (4, 4).

    Returns:
        (4, 4) T_b_a.
    """
    rotation = T_a_b[:3, :3].T
    return make_transform(rotation, -rotation @ T_a_b[:3, 3])


def transform(T_a_b: Floats, points: Array) -> Array:
    """Points of one frame in another.

    Args:
        T_a_b: (4, 4).
        points: (..., 3) in frame b, m.

    Returns:
        (..., 3) in frame a, m, of the points' own dtype.
    """
    moved = points @ T_a_b[:3, :3].T.astype(points.dtype) + T_a_b[:3, 3].astype(points.dtype)
    return np.asarray(moved, dtype=points.dtype)


def validate_transform(T: ArrayLike, name: str) -> Floats:
    """A rigid transform, refused where it is none.

    Args:
        T: (4, 4), m.
        name: of the transform, in messages.

    Returns:
        (4, 4) float64, a read-only copy.

    Raises:
        BoxgraspError: wrong shape, NaN, mirrored, scaled or otherwise not a rigid transform.
    """
    try:
        matrix = np.array(T, dtype=np.float64, order="C")  # one form for the kernels
    except (TypeError, ValueError, OverflowError):
        raise BoxgraspError(f"{name} is not numeric; valid: a (4, 4) rigid transform") from None
    if matrix.shape != (4, 4):
        raise BoxgraspError(f"{name} has shape {matrix.shape}; valid: (4, 4)")
    if not np.isfinite(matrix).all():
        raise BoxgraspError(f"{name} holds NaN or infinity; valid: finite numbers")
    if not np.allclose(matrix[3], (0.0, 0.0, 0.0, 1.0), atol=1e-9):
        turned = np.allclose(matrix[:, 3], (0.0, 0.0, 0.0, 1.0), atol=1e-9)
        hint = " (the matrix is transposed)" if turned else ""
        raise BoxgraspError(f"{name} has last row {matrix[3].tolist()}{hint}; valid: [0, 0, 0, 1]")
    rotation = matrix[:3, :3]
    if np.linalg.det(rotation) < 0:
        raise BoxgraspError(
            f"{name} is mirrored, its axes left-handed (determinant below 0); valid: a rotation"
        )
    if not np.allclose(rotation.T @ rotation, np.eye(3), atol=_ROTATION_TOLERANCE):
        scale = float(np.cbrt(np.linalg.det(rotation)))
        raise BoxgraspError(f"{name} is not a rotation (scale {scale:.4g}); valid: orthonormal")
    readonly(matrix)
    return matrix


def rotation_of(quaternion_xyzw: ArrayLike) -> Floats:
    """The rotation of a quaternion.

    Args:
        quaternion_xyzw: (4,) unit quaternion x, y, z, w.

    Returns:
        (3, 3) float64.
    """
    x, y, z, w = np.asarray(quaternion_xyzw, np.float64).tolist()
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def quaternion_xyzw(rotation: Floats) -> Floats:
    """The quaternion of a rotation (Shepperd 1978).

    Args:
        rotation: (3, 3).

    Returns:
        (4,) float64 unit quaternion x, y, z, w with w >= 0.
    """
    m = rotation
    squares = np.array(
        [
            1 + m[0, 0] - m[1, 1] - m[2, 2],
            1 - m[0, 0] + m[1, 1] - m[2, 2],
            1 - m[0, 0] - m[1, 1] + m[2, 2],
            1 + m[0, 0] + m[1, 1] + m[2, 2],
        ]
    )
    k = int(np.argmax(squares))
    q = np.array(
        [
            (squares[0], m[1, 0] + m[0, 1], m[2, 0] + m[0, 2], m[2, 1] - m[1, 2]),
            (m[1, 0] + m[0, 1], squares[1], m[2, 1] + m[1, 2], m[0, 2] - m[2, 0]),
            (m[2, 0] + m[0, 2], m[2, 1] + m[1, 2], squares[2], m[1, 0] - m[0, 1]),
            (m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], squares[3]),
        ][k]
    )
    q = q / np.linalg.norm(q)
    return np.asarray(-q if q[3] < 0 else q)
