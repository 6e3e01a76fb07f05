"""The page round the panels: headline, text, table of candidates, legend; and the saved file."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from boxgrasp.draw.canvas import XY, Canvas, fit, text_size, wrap
from boxgrasp.draw.palette import (
    BLOCKED,
    CARD,
    CATEGORY,
    FAINT,
    GRIPPER,
    INK,
    NIGHT,
    OBSTACLE,
    PAPER,
    RGB,
    RULE,
    SHAPE,
    WHITE,
)
from boxgrasp.draw.words import face_name, style_of
from boxgrasp.errors import BoxgraspError
from boxgrasp.grasps.gripper import Gripper
from boxgrasp.grasps.scoring import GREEN_FROM_M, RED_BELOW_M, category
from boxgrasp.result import Candidate, Selection

if TYPE_CHECKING:
    from PIL.Image import Image

WIDTH: Final = 1600
MARGIN: Final = 14
HEADER: Final = 70
SUFFIXES: Final = {".png": "PNG", ".jpg": "JPEG", ".jpeg": "JPEG", ".webp": "WEBP"}
_MOST_COLUMNS = 4


def validated_suffix(path: str | os.PathLike[str] | None) -> Path | None:
    """The path, with a suffix that names an image format and a folder that is there.

    Raises:
        BoxgraspError: it does not.
    """
    if path is None:
        return None
    place = Path(path)
    if place.suffix.lower() not in SUFFIXES:
        valid = ", ".join(SUFFIXES)
        raise BoxgraspError(f"picture {place} has suffix {place.suffix!r}; valid: {valid}")
    if not place.parent.is_dir():
        raise BoxgraspError(
            f"picture {place}: no folder {place.parent}; valid: a folder that exists"
        )
    return place


def save(image: Image, path: Path | None) -> None:
    """Write the picture where a path is given; the same picture gives the same bytes.

    Raises:
        BoxgraspError: it cannot be written.
    """
    if path is None:
        return
    from io import BytesIO

    held = BytesIO()
    options: dict[str, Any] = {".png": {"compress_level": 3}}.get(
        path.suffix.lower(), {"quality": 92}
    )
    try:
        image.save(held, SUFFIXES[path.suffix.lower()], **options)
        path.write_bytes(held.getvalue())
    except OSError as error:
        what = error.strerror or str(error)
        raise BoxgraspError(f"picture {path} cannot be written: {what}") from None


class Page:
    """Panels in two columns under a headline; the text below takes the height that it needs."""

    def __init__(self, headline: tuple[str, str], mark: tuple[str, str] | None) -> None:
        self._headline, self._mark = headline, mark
        self._left: list[Image] = []
        self._right: list[Image] = []

    def left(self, panel: Image) -> None:
        """Add a panel to the left column."""
        self._left.append(panel)

    def right(self, panel: Image) -> None:
        """Add a panel to the right column."""
        self._right.append(panel)

    def finished(
        self, facts: list[tuple[str, str]], selection: Selection, gripper: Gripper
    ) -> Image:
        """The whole picture."""
        from PIL import Image as Images

        column = self._left[0].width
        table = _table(selection, 500)
        words = _facts(facts, column - table.width - MARGIN)
        legend = _legend(self._right[0].width, selection)
        left = [*self._left, (words, table)]
        right = [*self._right, legend]
        heights = [_height(left), _height(right)]
        image = Images.new("RGB", (WIDTH, HEADER + MARGIN + max(heights)), PAPER)
        image.paste(banner(self._headline, self._mark), (0, 0))
        _stack(image, left, MARGIN)
        _stack(image, right, 2 * MARGIN + column)
        return image


Row = Any


def _height(rows: list[Row]) -> int:
    return sum(max(part.height for part in _parts(row)) + MARGIN for row in rows)


def _parts(row: Row) -> tuple[Image, ...]:
    return row if isinstance(row, tuple) else (row,)


def _stack(image: Image, rows: list[Row], x: int) -> None:
    y = HEADER + MARGIN
    for row in rows:
        across = x
        for part in _parts(row):
            image.paste(part, (across, y))
            across += part.width + MARGIN
        y += max(part.height for part in _parts(row)) + MARGIN


def blank(width: int, height: int, color: RGB = CARD) -> Canvas:
    """An empty card."""
    from PIL import Image as Images

    return Canvas(Images.new("RGB", (width, height), color))


def banner(headline: tuple[str, str], mark: tuple[str, str] | None) -> Image:
    """The headline: a mark, the status, one sentence."""
    canvas = blank(WIDTH, HEADER, NIGHT)
    x = 20.0
    if mark is not None:
        kind, style = mark
        canvas.mark((x + 18, HEADER / 2), SHAPE[kind], CATEGORY[kind], 17, style)
        x += 54
    status, sentence = headline
    canvas.text((x, 16), status, 32, WHITE, halo=NIGHT)
    x += text_size(status, 32)[0] + 26
    lines = wrap(sentence, 24, WIDTH - x - 20, 1)
    if len(wrap(sentence, 24, WIDTH - x - 20)) > 1:
        lines = wrap(sentence, 18, WIDTH - x - 20, 2)
        for k, line in enumerate(lines):
            canvas.text((x, 11 + 25 * k), line, 18, WHITE)
    elif lines:
        canvas.text((x, 21), lines[0], 24, WHITE)
    return canvas.finish()


def _facts(facts: list[tuple[str, str]], width: int) -> Image:
    size, indent = 16, 96
    rows = [
        (name, line, k)
        for name, value in facts
        for k, line in enumerate(wrap(value, size, width - indent - 16, 4))
    ]
    canvas = blank(width, 18 + 23 * len(rows))
    for n, (name, line, k) in enumerate(rows):
        y = 9 + 23 * n
        if k == 0 and name:
            warning = name == "Warning"
            canvas.text((10, y), name, size, CATEGORY["red"] if warning else FAINT)
        canvas.text((indent, y), line, size, INK)
    return canvas.finish()


def _table(selection: Selection, width: int) -> Image:
    """Every candidate with its mark, its clearance and why it fell out."""
    lines = max((candidate.line for candidate in selection.candidates), default=0)
    if not selection.candidates or lines > _MOST_COLUMNS:
        return _summary(selection, width)
    head, high, first = 30, 64, 108
    cell = (width - first) / lines
    canvas = blank(width, head + 5 * high + 4)
    canvas.text((10, 7), "Candidate", 14, FAINT)
    for line in range(1, lines + 1):
        canvas.text((first + (line - 1) * cell + 6, 7), f"line {line}", 14, FAINT)
    for face in range(1, 6):
        y = head + (face - 1) * high
        canvas.line((6, y), (width - 6, y), RULE, 1.0)
        name = face_name(face).split("-")
        canvas.text((10, y + (12 if len(name) > 1 else 20)), name[0], 16, INK)
        if len(name) > 1:
            canvas.text((10, y + 31), name[1], 14, INK)
    chosen = selection.label if selection.label is not None else selection.best_rejected
    for candidate in selection.candidates:
        if not 1 <= candidate.face <= 5:
            continue
        x, y = first + (candidate.line - 1) * cell, head + (candidate.face - 1) * high
        _cell(
            canvas,
            candidate,
            (x, y),
            cell,
            high,
            candidate.label == chosen,
            selection.status == "grasp",
        )
    return canvas.finish()


def _cell(
    canvas: Canvas,
    candidate: Candidate,
    at: XY,
    cell: float,
    high: float,
    chosen: bool,
    grasp: bool,
) -> None:
    x, y = at
    if chosen:
        edge = GRIPPER if grasp else BLOCKED
        dash = None if grasp else (6.0, 4.0)
        box = (
            (x + 1, y + 3),
            (x + cell - 3, y + 3),
            (x + cell - 3, y + high - 3),
            (x + 1, y + high - 3),
        )
        for a, b in zip(box, (*box[1:], box[0]), strict=True):
            canvas.line(a, b, edge, 2.5, dash=dash)
    kind = category(candidate.visible_clearance_m)
    style = style_of(candidate)
    canvas.mark((x + 16, y + 16), SHAPE[kind], CATEGORY[kind], 7.5, style)
    canvas.text((x + 28, y + 7), f"{candidate.label}:", 14, FAINT)
    after = x + 32 + text_size(f"{candidate.label}:", 14)[0]
    canvas.text(
        (after, y + 6),
        fit(f"{100 * candidate.visible_clearance_m:.1f} cm", 15, x + cell - after - 4),
        15,
        INK,
    )
    note = candidate.rejected if candidate.rejected is not None else "passes"
    for k, line in enumerate(wrap(note, 13, cell - 16, 2)):
        canvas.text((x + 8, y + 28 + 15 * k), line, 13, FAINT if candidate.rejected else INK)


def _summary(selection: Selection, width: int) -> Image:
    """Counts a face, where there are too many lines for a table."""
    canvas = blank(width, 40 + 5 * 28)
    canvas.text((10, 8), "Candidates, by face", 14, FAINT)
    for face in range(1, 6):
        own = [candidate for candidate in selection.candidates if candidate.face == face]
        kept = sum(candidate.rejected is None for candidate in own)
        best = max((candidate.visible_clearance_m for candidate in own), default=0.0)
        text = f"{face_name(face)}: {kept} of {len(own)} pass, at most {100 * best:.1f} cm"
        canvas.text((10, 34 + 28 * (face - 1)), fit(text, 16, width - 20), 16, INK)
    return canvas.finish()


def _legend(width: int, selection: Selection) -> Image:
    """What the marks and the lines mean."""
    near, far = 100 * RED_BELOW_M, 100 * GREEN_FROM_M
    canvas = blank(width, 152)
    marks = (
        ("green", "kept", f"safe: {far:.0f} cm and more free"),
        ("yellow", "kept", f"feasible: {near:.0f} to {far:.0f} cm free"),
        ("red", "kept", f"too close: under {near:.0f} cm"),
        ("green", "dropped", "crossed: rejected by the check"),
        ("red", "wide", "arrow: too wide, or width unknown"),
    )
    for k, (kind, style, word) in enumerate(marks):
        y = 20.0 + 28 * k
        canvas.mark((20, y), SHAPE[kind], CATEGORY[kind], 8, style)
        canvas.text((38, y - 10), word, 16, INK)
    x = width / 2 + 10
    grasp = selection.status == "grasp"
    hand = (
        (GRIPPER, None, "gripper chosen; faint: 15 cm before")
        if grasp
        else (BLOCKED, (8.0, 5.0), "best try, rejected")
    )
    lines: tuple[tuple[RGB, Any, str], ...] = (
        hand,
        (WHITE, None, "box round the target"),
        (OBSTACLE, None, "obstacle nearest to the gripper" if grasp else "what stands in the way"),
    )
    for k, (color, dash, word) in enumerate(lines):
        y = 20.0 + 28 * k
        canvas.line(
            (x, y), (x + 34, y), color, 4.0, halo=INK if color == WHITE else None, dash=dash
        )
        canvas.text((x + 44, y - 10), word, 16, INK)
    canvas.text((x, 20.0 + 28 * 3 - 10), "lines on the box: where the fingers close", 16, INK)
    canvas.text((x, 20.0 + 28 * 4 - 10), "numbers: labels of the candidates", 16, INK)
    return canvas.finish()
