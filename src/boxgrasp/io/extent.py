"""What a header claims is checked against the bytes that are there, before memory is taken."""

from __future__ import annotations

import os
from typing import IO, Final

from boxgrasp.errors import CaptureError

MAX_POINTS: Final = 100_000_000  # 1.2 GB as float32
MAX_PIXELS: Final = 64_000_000  # 256 MB as float32
MAX_HEADER_BYTES: Final = 1 << 16  # comments included


def remaining_bytes(stream: IO[bytes]) -> int:
    """How much of a file is left.

    Args:
        stream: of the file; its position stays.

    Returns:
        Bytes from there to the end.
    """
    here = stream.tell()
    end = stream.seek(0, os.SEEK_END)
    stream.seek(here)
    return end - here


def validate_cloud_size(count: int, bytes_needed: int, bytes_there: int) -> None:
    """Refuse a cloud that cannot be held, or that the file is too short for.

    Args:
        count: points that the header claims.
        bytes_needed: for them.
        bytes_there: in the file.

    Raises:
        CaptureError: none, too many, or truncated.
    """
    if count <= 0:
        raise CaptureError("cloud is empty; valid: at least one point")
    if count > MAX_POINTS:
        raise CaptureError(f"cloud claims {count} points; valid: at most {MAX_POINTS}")
    if bytes_needed > bytes_there:
        raise CaptureError(
            f"cloud is truncated: {count} points need {bytes_needed} bytes, {bytes_there} are there"
        )


def header_lines(stream: IO[bytes], last: str) -> list[str]:
    """A text header.

    Args:
        stream: at the start of the header; left behind it.
        last: first word of the header's last line.

    Returns:
        The lines up to and with that one, comments in any language left out.

    Raises:
        CaptureError: no such line, or not text.
    """
    lines: list[str] = []
    while stream.tell() < MAX_HEADER_BYTES:
        raw = stream.readline(MAX_HEADER_BYTES)
        if not raw:
            break
        try:
            line = raw.decode("ascii").strip()
        except UnicodeDecodeError:
            if raw.lstrip().startswith((b"#", b"comment", b"obj_info")):
                continue  # a comment may be in any language
            raise CaptureError("header is not text; valid: the format its suffix says") from None
        lines.append(line)
        if line.split(" ", 1)[0] == last:
            return lines
    raise CaptureError(f"header has no {last} line; valid: the format its suffix says")
