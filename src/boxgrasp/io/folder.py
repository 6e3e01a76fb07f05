"""Captures as folders: images beside small JSON files."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any, Final

import numpy as np
from numpy.typing import NDArray

from boxgrasp.errors import CaptureError, CodedWarning
from boxgrasp.io.images import read_color, read_depth_png, read_mask
from boxgrasp.io.lens import FISHEYE, Lens, lens_of, undistorted
from boxgrasp.sensing.capture import Capture

_CAMERA: Final = "intrinsics.json"
_CAMERA_KEYS: Final = ("fx", "fy", "cx", "cy", "width", "height")
_CAPTURE_KEYS: Final = ("T_base_camera", "depth_scale", "target_pixel")
_COLOR_NAMES: Final = ("color.png", "color.jpg", "color.jpeg")
_DISTORTION: Final = re.compile(r"(?i)k[1-9]|p[1-9]|s[1-4]|tau.*|[dk]|.*(dist|coef).*")
_NAMED: Final = re.compile(r"(?i)k[1-9]|p[1-9]|s[1-4]|tau.*")  # a coefficient by its own name
_ORDER: Final = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
_FOURTH: Final = "k4"  # of two models, which do not mean the same by it
_FISHEYE_ORDER: Final = ("k1", "k2", "k3", "k4")
_MAX_JSON_BYTES: Final = 1 << 20  # a few numbers take less
_MILLIMETER: Final = 0.001  # m


def load_folder(folder: Path) -> Capture:
    """A capture of depth.png, intrinsics.json, and what else of the format is there.

    Args:
        folder: may also hold color.png or .jpg, mask.png, robot_mask.png, and capture.json with
            T_base_camera, depth_scale (meters a unit) and target_pixel.

    Returns:
        The capture.

    Raises:
        CaptureError: a file is missing, damaged, or does not fit the others.
    """
    camera = _read_json(folder / _CAMERA)
    told, warnings = _read_told(folder / "capture.json")
    color = next((folder / name for name in _COLOR_NAMES if (folder / name).exists()), None)
    mask, robot_mask = folder / "mask.png", folder / "robot_mask.png"
    parts = FolderParts(
        depth=_regular(folder / "depth.png"),
        camera=camera,
        told=told,
        color=_regular(color) if color is not None else None,
        mask=_regular(mask) if mask.exists() else None,
        robot_mask=_regular(robot_mask) if robot_mask.exists() else None,
    )
    return capture_of_parts(parts).with_warnings(*warnings)


@dataclass(frozen=True, eq=False)
class FolderParts:
    """What a folder of a capture holds, wherever it comes from.

    Attributes:
        depth: path or open file of the 16-bit PNG.
        camera: the object in intrinsics.json.
        told: the object in capture.json.
        color: path or open file of a PNG or JPEG, or None.
        mask: path or open file of a PNG, or None.
        robot_mask: path or open file of a PNG, or None.
    """

    depth: Path | IO[bytes]
    camera: dict[str, Any]
    told: Mapping[str, Any] = field(default_factory=dict)
    color: Path | IO[bytes] | None = None
    mask: Path | IO[bytes] | None = None
    robot_mask: Path | IO[bytes] | None = None


def capture_of_parts(parts: FolderParts) -> Capture:
    """The capture that such parts make.

    Args:
        parts: of one capture.

    Returns:
        The capture.

    Raises:
        CaptureError: a part is damaged, or does not fit the others.
    """
    intrinsics, size = _intrinsics(parts.camera)
    lens = _lens(parts.camera)
    told, color, mask, robot_mask = parts.told, parts.color, parts.mask, parts.robot_mask
    raw = read_depth_png(parts.depth, size)
    capture = Capture(
        (raw * _depth_scale(told)).astype(np.float32),
        intrinsics,
        told.get("T_base_camera"),
        read_color(color, size) if color is not None else None,
        read_mask(mask, size) if mask is not None else None,
        target_pixel=told.get("target_pixel"),
        robot_mask=read_mask(robot_mask, size) if robot_mask is not None else None,
    )
    return capture if lens is None else undistorted(capture, lens, _CAMERA)


def _regular(path: Path) -> Path:
    if not path.is_file():
        what = "is no file" if path.exists() else "is missing"
        raise CaptureError(
            f"{path.name} {what}; valid: depth.png and intrinsics.json in the folder"
        )
    return path


def _read_json(path: Path) -> dict[str, Any]:
    """The object in a small JSON file."""
    with _regular(path).open("rb") as stream:
        text = stream.read(_MAX_JSON_BYTES + 1)
    if len(text) > _MAX_JSON_BYTES:
        raise CaptureError(f"{path.name} is over {_MAX_JSON_BYTES} bytes; valid: a small JSON file")
    try:
        found = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise CaptureError(f"{path.name} is no JSON: {error}") from None
    if not isinstance(found, dict):
        raise CaptureError(f"{path.name} holds no object; valid: {{...}}")
    return found


def _intrinsics(found: dict[str, Any]) -> tuple[NDArray[np.float64], tuple[int, int]]:
    """(3, 3) rows in pixels, and (width, height)."""
    for key in _CAMERA_KEYS:
        if not _is_number(found.get(key)):
            what = "lacks" if key not in found else "has no finite number as"
            raise CaptureError(f"{_CAMERA} {what} {key}; valid: {', '.join(_CAMERA_KEYS)}")
    fx, fy, cx, cy, width, height = (float(found[key]) for key in _CAMERA_KEYS)
    if not (width.is_integer() and height.is_integer() and width > 0 and height > 0):
        raise CaptureError(f"{_CAMERA} has size {width:g} x {height:g}; valid: whole pixels")
    K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    return K, (int(width), int(height))


def _lens(found: dict[str, Any]) -> Lens | None:
    """The lens distortion that the camera's file tells of, under one of the names it goes by."""
    model = found.get("distortion_model", "")
    told = {
        key: value
        for key, value in found.items()
        if _DISTORTION.fullmatch(key) and key != "distortion_model" and _any_nonzero(value)
    }
    if not told:
        return None
    key, value = next(iter(told.items()))
    if isinstance(value, dict):
        value = value.get("data", value)
    if _NAMED.fullmatch(key):
        value = told
    elif len(told) > 1:
        raise CaptureError(
            f"{_CAMERA} has lens distortion in {', '.join(told)!r:.60}; valid: one, or a rectified "
            "image"
        )
    if isinstance(value, dict):
        if not model and _FOURTH in {str(name).lower() for name in value}:
            raise CaptureError(
                f"{_CAMERA} has lens distortion in {_FOURTH}; valid: a rectified image, or "
                "distortion_model rational_polynomial or equidistant beside it"
            )
        value = _in_order(value, str(model) in FISHEYE)
    if not isinstance(value, list) or not all(map(_is_number, value)):
        raise CaptureError(
            f"{_CAMERA} has lens distortion in {key}; valid: a rectified image, or coefficients "
            f"{', '.join(_ORDER)} in OpenCV's order or by name"
        )
    return lens_of(str(model), value, f"{_CAMERA} in {key}")


def _in_order(named: dict[str, Any], is_fisheye: bool) -> list[Any] | None:
    """Coefficients by their names in OpenCV's order; None for a name that is not there."""
    lower = {key.lower(): value for key, value in named.items()}
    order = _FISHEYE_ORDER if is_fisheye else _ORDER
    if not set(lower) <= set(order):
        return None
    count = 4 if is_fisheye else (8 if set(lower) & set(order[5:]) else 5)
    return [lower.get(name, 0.0) for name in order[:count]]


def _is_number(value: Any) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    try:
        return math.isfinite(float(value))
    except OverflowError:
        return False


def _any_nonzero(value: Any) -> bool:
    """Whether a number other than 0 stands in a value, list or object of JSON."""
    if isinstance(value, dict):
        return any(_any_nonzero(part) for part in value.values())
    if isinstance(value, list):
        return any(_any_nonzero(part) for part in value)
    return isinstance(value, int | float) and value != 0


def _read_told(path: Path) -> tuple[dict[str, Any], list[CodedWarning]]:
    """What capture.json holds, if it is there, and a note for each key that says nothing."""
    if not path.exists():
        return {}, []
    found = _read_json(path)
    valid = ", ".join(_CAPTURE_KEYS)
    unknown = [key for key in found if key not in _CAPTURE_KEYS]
    warnings = [
        CodedWarning(
            "unknown_capture_key",
            f"{path.name} has {key!r:.40}, which is passed over; known: {valid}",
        )
        for key in unknown
    ]
    return found, warnings


def _depth_scale(told: Mapping[str, Any]) -> float:
    scale = told.get("depth_scale", _MILLIMETER)
    if not _is_number(scale) or not 1e-6 <= float(scale) <= 0.1:
        raise CaptureError(
            f"capture.json has depth_scale {scale!r:.40}; valid: meters a unit, as 0.001"
        )
    return float(scale)
