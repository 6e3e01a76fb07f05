"""Fields of ROS messages, whoever decoded them: each is there and of its type, or refused."""

from __future__ import annotations

import operator
from typing import Any, Final

import numpy as np

from boxgrasp.errors import CaptureError
from boxgrasp.sensing.validation import Bytes

_NANOSECONDS: Final = 1_000_000_000  # of a second


def field_of(message: Any, name: str) -> Any:
    """A field of a message.

    Args:
        message: any object.
        name: of the field.

    Returns:
        Its value.

    Raises:
        CaptureError: there is none.
    """
    try:
        return getattr(message, name)
    except AttributeError:
        raise CaptureError(f"message has no field {name!r}; valid: those of its ROS type") from None


def text_of(message: Any, name: str) -> str:
    """A field that is text.

    Args:
        message: any object.
        name: of the field.

    Returns:
        Its value.

    Raises:
        CaptureError: there is none, or it is something else.
    """
    value = field_of(message, name)
    if not isinstance(value, str):
        raise CaptureError(f"message has {name} of type {type(value).__name__}; valid: text")
    return value


def count_of(message: Any, name: str) -> int:
    """A field that is a whole number from 0 on.

    Args:
        message: any object.
        name: of the field.

    Returns:
        Its value.

    Raises:
        CaptureError: there is none, or it is something else.
    """
    value = field_of(message, name)
    try:
        number = operator.index(value)
    except TypeError:
        raise CaptureError(f"message has {name} {value!r:.40}; valid: a whole number") from None
    if number < 0:
        raise CaptureError(f"message has {name} {number!s:.40}; valid: 0 or more")
    return number


def flag_of(message: Any, name: str) -> bool:
    """A field that is yes or no, as bool or as a number.

    Args:
        message: any object.
        name: of the field.

    Returns:
        Its value.

    Raises:
        CaptureError: there is none, or it is something else.
    """
    value = field_of(message, name)
    if not isinstance(value, (bool, int, np.bool_, np.integer)):
        raise CaptureError(f"message has {name} {value!r:.40}; valid: true or false")
    return bool(value)


def bytes_of(message: Any) -> Bytes:
    """The data of a message.

    Args:
        message: any object whose `data` is a contiguous buffer.

    Returns:
        (n,) uint8, in the message's own memory.

    Raises:
        CaptureError: there is none, or it is something else.
    """
    data = field_of(message, "data")
    try:
        return np.frombuffer(data, np.uint8)
    except (TypeError, ValueError, BufferError):
        raise CaptureError(
            f"message has data of type {type(data).__name__}; valid: a contiguous buffer of bytes"
        ) from None


def frame_id_of(message: Any) -> str:
    """The frame in which a message is.

    Args:
        message: any object with a header.

    Returns:
        Its name, without the slashes that ROS 1 may put before it.

    Raises:
        CaptureError: no header, or no frame_id in it.
    """
    return text_of(field_of(message, "header"), "frame_id").lstrip("/")


def stamp_ns(message: Any) -> int:
    """The time of a message.

    Args:
        message: any object with a header, of ROS 2 (sec, nanosec) or ROS 1 (secs, nsecs).

    Returns:
        ns since its clock's start.

    Raises:
        CaptureError: no header, no stamp in it, or no time.
    """
    stamp = field_of(field_of(message, "header"), "stamp")
    ros1 = hasattr(stamp, "secs") and not hasattr(stamp, "sec")
    seconds = count_of(stamp, "secs" if ros1 else "sec")
    nanoseconds = count_of(stamp, "nsecs" if ros1 else "nanosec")
    if nanoseconds >= _NANOSECONDS or seconds >= 1 << 32:
        raise CaptureError(
            f"message has stamp {seconds!s:.40} s and {nanoseconds!s:.40} ns; "
            "valid: 32 bits of seconds, below 1000000000 ns"
        )
    return seconds * _NANOSECONDS + nanoseconds
