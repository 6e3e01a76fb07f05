"""Errors and warnings a user can meet: one line each, saying what was found and what is valid."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

FrameCode = Literal[
    "no_level_plane", "support_plane_tilted", "larger_plane_tilted", "cloud_in_base_frame"
]
PoseReading = Literal["inverse", "camera_link", "opengl"]
TransformCode = Literal["unknown_frame", "not_connected", "too_old", "too_new", "malformed"]


@dataclass(frozen=True)
class CodedWarning:
    """What an answer warns of: a code for programs, a sentence for people.

    Attributes:
        code: lower case words joined by underscores; stays when the sentence is reworded.
        message: one sentence.
    """

    code: str
    message: str

    def __str__(self) -> str:
        return self.message


class BoxgraspError(Exception):
    """Root of every error that boxgrasp raises on purpose."""


class CaptureError(BoxgraspError):
    """A capture cannot be read, or what it holds is not a depth view."""


class SceneError(BoxgraspError):
    """No support plane, or nothing stands on it."""


class FramesError(SceneError):
    """The frames that a view was given in do not fit what it shows.

    Attributes:
        code: 'no_level_plane', the plane that is seen is tilted against `T_base_camera`; or
            'cloud_in_base_frame', a cloud taken as optical has z up.
        tilt_rad: of that plane, rad; None where no pose is doubted.
        fits: under which readings of the pose it would be level: 'inverse'; 'camera_link', x
            forward, y left, z up; 'opengl', y up, z backward.
    """

    code: FrameCode
    tilt_rad: float | None
    fits: tuple[PoseReading, ...]

    def __init__(
        self,
        code: FrameCode,
        message: str,
        tilt_rad: float | None = None,
        fits: tuple[PoseReading, ...] = (),
    ) -> None:
        super().__init__(code, message, tilt_rad, fits)
        self.code = code
        self.tilt_rad = tilt_rad
        self.fits = fits

    def __str__(self) -> str:
        return str(self.args[1])


class TargetError(BoxgraspError):
    """The target cannot be found where the caller pointed."""


class MapError(BoxgraspError):
    """An occupancy map cannot be read or does not fit the request."""


class TransformError(BoxgraspError):
    """A transform between two frames is not known at a time, or a message of transforms is wrong.

    Attributes:
        code: 'unknown_frame'; 'not_connected'; 'too_old', the time is before what is kept;
            'too_new', it is after the newest, so that waiting may help; or 'malformed'.
    """

    code: TransformCode

    def __init__(self, code: TransformCode, message: str) -> None:
        super().__init__(code, message)
        self.code = code

    def __str__(self) -> str:
        return str(self.args[1])


class GripperError(BoxgraspError):
    """A gripper file is wrong, or the gripper cannot hold anything."""


class ConfigError(BoxgraspError):
    """A configuration has an unknown key, or a value out of range."""


class ModelError(BoxgraspError):
    """A model file is damaged, is none, or does not fit the code's features."""


class MissingExtraError(BoxgraspError):
    """An optional part is not installed."""


class StoreError(BoxgraspError):
    """A folder or URL cannot be listed, read or written."""


class LabelError(BoxgraspError):
    """A label or a scene is not one, or contradicts what the record of labels holds."""


class WorkError(BoxgraspError):
    """Workers cannot be started, reached, or kept alive."""


_LONGEST = 60  # characters of a value in a message


def shown(value: Any) -> str:
    """A value in a message: short, on one line.

    Args:
        value: anything that a caller handed over.

    Returns:
        Plain values and short lists of them as Python writes them; of anything else its type.
    """
    if isinstance(value, type):
        return f"the class {value.__name__}"
    parts = value if isinstance(value, list | tuple) else (value,)
    if len(parts) <= 4 and all(isinstance(part, _PLAIN) for part in parts):
        try:
            text = repr(value)
        except ValueError:  # more digits than Python writes
            text = "a number of thousands of digits"
        return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}..."
    return f"of type {type(value).__name__}"


_PLAIN = (bool, int, float, str, type(None))


def require(
    value: Any,
    kinds: type | tuple[type, ...],
    name: str,
    valid: str,
    error: type[BoxgraspError] = BoxgraspError,
) -> None:
    """Refuse what is not of a type.

    Args:
        value: anything that a caller handed over.
        kinds: that it may be of.
        name: of the value.
        valid: what it may be, in words.
        error: of which class the refusal is.

    Raises:
        BoxgraspError: of that class.
    """
    if not isinstance(value, kinds):
        raise error(f"{name} is {shown(value)}; valid: {valid}")
