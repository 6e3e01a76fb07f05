"""Where a camera or a gripper is, from a small file: a matrix, or position and quaternion."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from typing import Any, Final

import numpy as np

from boxgrasp.arrays import Floats
from boxgrasp.errors import CaptureError
from boxgrasp.geometry.transforms import make_transform, rotation_of, validate_transform
from boxgrasp.io.npz import read_npy
from boxgrasp.io.refusals import refusals_of
from boxgrasp.sensing.validation import validate_pose
from boxgrasp.strict import parse_yaml

_MAX_BYTES: Final = 1 << 16  # sixteen numbers take less
_GRIPPER: Final = "T_base_gripper"
_FARTHEST_M: Final = 20.0  # of a gripper from its base; an arm on a rail reaches less
_NORM_TOLERANCE: Final = 1e-2  # of a quaternion's length from 1
_PLACES: Final = ("position", "translation", "position_m")
_TURNS: Final = ("quaternion", "quaternion_xyzw", "rotation", "orientation")
_VALID: Final = "valid: 4 rows of 4, or position (x, y, z) and quaternion (x, y, z, w)"


def load_pose(path: str | os.PathLike[str]) -> Floats:
    """The pose of a camera's optical frame in the base frame.

    Args:
        path: of a .json, .yaml, .yml or .npy file: 4 rows of 4; x, y, z and a quaternion x, y, z, w
            in one list; or an object with `T_base_camera`, or with `position` and `quaternion`,
            lists or objects of x, y, z and w, also under the names that ROS has for them.

    Returns:
        (4, 4) float64 T_base_camera, m, read-only.

    Raises:
        CaptureError: missing, unreadable, or no rigid transform in meters; names the path.
    """
    place = Path(path)
    with refusals_of(place):
        return pose_of(_read(place))


def pose_of(found: Any) -> Floats:
    """The same pose of what stands in such a file.

    Args:
        found: lists, numbers and objects as JSON has them.

    Returns:
        (4, 4) float64 T_base_camera, m, read-only.

    Raises:
        CaptureError: no rigid transform in meters.
    """
    pose = validate_pose(_matrix(found))
    assert pose is not None
    return pose


def gripper_pose(text: str) -> Floats:
    """The pose of a gripper's frame in the base frame.

    Args:
        text: path of such a file, whose object may hold `T_base_gripper`; or seven numbers, x, y, z
            and a quaternion x, y, z, w, with blanks or commas between them.

    Returns:
        (4, 4) float64 T_base_gripper, m, read-only.

    Raises:
        CaptureError: missing, unreadable, or no rigid transform in meters.
    """
    words = text.replace(",", " ").split()
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        numbers = []
    with refusals_of("pose" if numbers else Path(text)):
        found = numbers or _read(Path(text))
        if isinstance(found, Mapping) and _GRIPPER in found:
            found = found[_GRIPPER]
        matrix = validate_transform(_matrix(found), _GRIPPER)
        if np.abs(matrix[:3, 3]).max() > _FARTHEST_M:
            raise CaptureError(
                f"{_GRIPPER} is at {matrix[:3, 3].tolist()}, which looks like millimeters; "
                "valid: meters"
            )
        return matrix


def _read(path: Path) -> Any:
    suffix = path.suffix.lower()
    if suffix not in (".json", ".yaml", ".yml", ".npy"):
        raise CaptureError(f"suffix {suffix!r}; valid: .json, .yaml, .yml, .npy")
    with path.open("rb") as stream:
        text = stream.read(_MAX_BYTES + 1)
    if len(text) > _MAX_BYTES:
        raise CaptureError(f"over {_MAX_BYTES} bytes; {_VALID}")
    if suffix == ".npy":
        return read_npy(BytesIO(text), len(text), "pose")
    if suffix != ".json":
        return parse_yaml(BytesIO(text), "pose", CaptureError)
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise CaptureError(f"no JSON: {error}") from None


def _matrix(found: Any) -> Floats:
    """(4, 4), not yet judged."""
    if isinstance(found, Mapping):
        if "T_base_camera" in found:
            return _matrix(found["T_base_camera"])
        return _of_parts(_part(found, _PLACES, "xyz"), _part(found, _TURNS, "xyzw"))
    try:
        values = np.asarray(found)
    except ValueError:
        raise CaptureError(f"rows of different lengths; {_VALID}") from None
    if values.dtype.kind not in "fiu":
        raise CaptureError(f"no numbers; {_VALID}")
    if values.shape == (7,):
        return _of_parts(values[:3].astype(np.float64), values[3:].astype(np.float64))
    if values.shape != (4, 4):
        raise CaptureError(f"numbers of shape {values.shape}; {_VALID}")
    return values.astype(np.float64)


def _part(found: Mapping[Any, Any], names: tuple[str, ...], axes: str) -> Floats:
    """One part of a pose, as a list or by its axes."""
    name = next((name for name in names if name in found), None)
    if name is None:
        listed = ", ".join(str(key) for key in found)
        raise CaptureError(f"keys {listed!r:.80} without {names[0]}; {_VALID}")
    part = found[name]
    if isinstance(part, Mapping):
        part = [part.get(axis) for axis in axes]
    if not isinstance(part, list) or len(part) != len(axes) or not all(map(_is_number, part)):
        raise CaptureError(f"{name} is {part!r:.80}; valid: {', '.join(axes)}, numbers")
    return np.array(part, np.float64)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _of_parts(position_m: Floats, quaternion: Floats) -> Floats:
    norm = float(np.linalg.norm(quaternion))
    if not abs(norm - 1) <= _NORM_TOLERANCE:  # false for NaN
        raise CaptureError(f"quaternion of length {norm:.4g}; valid: x, y, z, w of length 1")
    return make_transform(rotation_of(quaternion / norm), position_m)
