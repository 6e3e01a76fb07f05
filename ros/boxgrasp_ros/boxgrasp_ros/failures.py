"""Why a request has no answer: a status code for programs, a sentence for people."""

from __future__ import annotations

from typing import Final

from boxgrasp_msgs.msg import Status

from boxgrasp.errors import (
    BoxgraspError,
    CaptureError,
    MapError,
    MissingExtraError,
    SceneError,
    TargetError,
    TransformError,
)

_LONGEST: Final = 400  # characters of a sentence
_CODES: Final[tuple[tuple[type[BoxgraspError], int], ...]] = (
    (CaptureError, Status.BAD_VIEW),
    (MissingExtraError, Status.BAD_VIEW),  # what would undo its lens distortion is not installed
    (SceneError, Status.BAD_SCENE),
    (TargetError, Status.BAD_TARGET),
    (MapError, Status.BAD_MAP),
)


class Failure(Exception):  # noqa: N818 - a cancelled goal is no error
    """A request that ends without an answer."""

    def __init__(self, code: int, sentence: str) -> None:
        """Keep what is told.

        Args:
            code: one of the constants of boxgrasp_msgs/Status.
            sentence: what was found, and what is valid.
        """
        super().__init__(sentence)
        self.code = code


def failure_of(error: Exception) -> Failure:
    """The failure that an exception stands for.

    Args:
        error: of the library, or any other.

    Returns:
        It, or the error itself where it is one.
    """
    if isinstance(error, Failure):
        return error
    if isinstance(error, TransformError):
        in_time = error.code in ("too_old", "too_new")
        code = Status.TRANSFORM_TOO_OLD if in_time else Status.NO_TRANSFORM
        return Failure(code, str(error))
    for kind, code in _CODES:
        if isinstance(error, kind):
            return Failure(code, str(error))
    told = str(error) if isinstance(error, BoxgraspError) else f"{type(error).__name__}: {error}"
    return Failure(Status.FAILED, told)


def status(failure: Failure | None, elapsed_ms: float) -> Status:
    """The status of a request.

    Args:
        failure: None where it was answered.
        elapsed_ms: since the node saw the request.

    Returns:
        The message.
    """
    if failure is None:
        return Status(code=Status.SUCCEEDED, elapsed_ms=elapsed_ms)
    # A message's own texts may be in the sentence, with what a terminal would obey.
    line = " ".join("".join(c if c.isprintable() else " " for c in str(failure)).split())
    return Status(code=failure.code, message=line[:_LONGEST], elapsed_ms=elapsed_ms)
