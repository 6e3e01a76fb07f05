"""Cards beside the panels: words, the shown candidate's checks, all candidates, the legend."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

from boxgrasp.draw.canvas import Canvas, Look, Stroke
from boxgrasp.draw.page import blank
from boxgrasp.draw.palette import (
    BLACK,
    BLOCKED,
    CATEGORY,
    FAINT,
    GRIPPER,
    HELD,
    INK,
    OBSTACLE,
    RULE,
    SHAPE,
    WHITE,
)
from boxgrasp.draw.planar import XY
from boxgrasp.draw.shapes import Hand
from boxgrasp.draw.text import Lettering, fit, text_size, wrap
from boxgrasp.draw.words import UNMEASURED, look_of, visible_clearance
from boxgrasp.grasps.candidates import FACES, face_name
from boxgrasp.grasps.checks.check import measured, spelled
from boxgrasp.grasps.checks.holds import Holds
from boxgrasp.grasps.scoring import GREEN_FROM_M, RED_BELOW_M
from boxgrasp.result import Candidate, CheckValue, Selection

if TYPE_CHECKING:
    from PIL.Image import Image

_MOST_COLUMNS: Final = 4  # lines a face, beyond which candidates are only counted
_MOST_REASONS: Final = 4
_MOST_LINES: Final = 12
_HEAD_PX: Final = 30
_ROW_PX: Final = 23
_REASON_PX: Final = 16
_NAMES_PX: Final = 112
_RULE: Final = Stroke(RULE, 1.0)
_BODY: Final = Lettering(16)
_PALE: Final = Lettering(16, FAINT)
_HEADING: Final = Lettering(14, FAINT)
_SMALL: Final = Lettering(13)
_SMALL_PALE: Final = Lettering(13, FAINT)
_ALARM: Final = Lettering(16, BLOCKED)


def facts_card(facts: Sequence[tuple[str, str]], width: int) -> Image:
    """Names and values, one below the other.

    Args:
        facts: of `facts_of`.
        width: px.

    Returns:
        An RGB image, as high as its texts.
    """
    indent = 96
    rows = [
        (name if k == 0 else "", line)
        for name, value in facts
        for k, line in enumerate(wrap(value, _BODY.size_px, width - indent - 16, _MOST_LINES))
    ]
    canvas = blank(width, 18 + _ROW_PX * len(rows))
    for n, (name, line) in enumerate(rows):
        y = 9 + _ROW_PX * n
        if name:
            canvas.text((10, y), name, _ALARM if name in ("Warning", "Rejected") else _PALE)
        canvas.text((indent, y), line, _BODY)
    return canvas.finish()


def checks_card(candidate: Candidate, width: int) -> Image:
    """What every check says of one candidate.

    Args:
        candidate: the one that the picture shows.
        width: px.

    Returns:
        An RGB image: name, value and limit of each, those it failed marked and told apart.
    """
    values, limits = 0.48 * width, 0.83 * width
    canvas = blank(width, _HEAD_PX + 8 + _ROW_PX * len(candidate.checks))
    title = f"Checks of candidate {candidate.label}"
    for x, text in ((10, title), (values, "value"), (limits, "limit")):
        canvas.text((x, 7), text, _HEADING)
    canvas.line((6, _HEAD_PX - 2), (width - 6, _HEAD_PX - 2), _RULE)
    for n, (name, said) in enumerate(candidate.checks.items()):
        y = _HEAD_PX + 3 + _ROW_PX * n
        _check_row(canvas, (10, y), (values, limits), name, said)
    return canvas.finish()


def _check_row(
    canvas: Canvas, at: XY, columns: tuple[float, float], name: str, said: CheckValue
) -> None:
    x, y = at
    values, limits = columns
    size = _BODY.size_px
    canvas.text(at, fit(name.replace("_", " "), size, values - x - 22), _PALE)
    if not said.passed:
        canvas.mark((values - 12, y + 11), Look("square", BLOCKED, "dropped"), 6.0)
    value = fit(measured(said.value, said.unit), size, limits - values - 6)
    canvas.text((values, y), value, _BODY if said.passed else _ALARM)
    if said.unit is not None:
        limit = fit(spelled(said.limit, said.unit), size, canvas.width - limits - 8)
        canvas.text((limits, y), limit, _BODY)


def candidates_card(selection: Selection, width: int) -> Image:
    """Every candidate with its marker, its visible clearance and the checks that it failed.

    Args:
        selection: the answer.
        width: px.

    Returns:
        An RGB image: a row a face and a column a line; counts where there are too many lines.
    """
    lines = max((candidate.line for candidate in selection.candidates), default=0)
    if not 1 <= lines <= _MOST_COLUMNS:
        return _counts(selection, width)
    cell = (width - _NAMES_PX) / lines
    faces = range(1, len(FACES) + 1)
    rows = {face: [c for c in selection.candidates if c.face == face] for face in faces}
    heights = {face: _row_height(row) for face, row in rows.items()}
    canvas = blank(width, _HEAD_PX + sum(heights.values()) + 4)
    canvas.text((10, 7), "Candidate", _HEADING)
    for line in range(1, lines + 1):
        canvas.text((_NAMES_PX + (line - 1) * cell + 6, 7), f"line {line}", _HEADING)
    y = float(_HEAD_PX)
    for face, row in rows.items():
        canvas.line((6, y), (width - 6, y), _RULE)
        _write_face(canvas, face, (10, y + 9))
        for candidate in row:
            at = (_NAMES_PX + (candidate.line - 1) * cell, y)
            _write_cell(canvas, candidate, at, cell)
            if candidate is selection.shown:
                _frame(canvas, at, (cell, heights[face]), passed=selection.grasp is not None)
        y += heights[face]
    return canvas.finish()


def _row_height(row: Sequence[Candidate]) -> int:
    return 38 + _REASON_PX * max((len(_reasons(candidate)) for candidate in row), default=1)


def _write_face(canvas: Canvas, face: int, at: XY) -> None:
    first, *rest = face_name(face).split("-")
    canvas.text(at, first, _BODY)
    for word in rest:
        canvas.text((at[0], at[1] + 19), word, Lettering(14))


def _write_cell(canvas: Canvas, candidate: Candidate, at: XY, width: float) -> None:
    x, y = at
    canvas.mark((x + 16, y + 18), look_of(candidate), 7.5)
    number = f"{candidate.label}:"
    canvas.text((x + 28, y + 9), number, _HEADING)
    near = visible_clearance(candidate)
    if near is not None:
        after = x + 32 + text_size(number, _HEADING.size_px)[0]
        value = fit(measured(near.value, near.unit), 15, x + width - after - 4)
        canvas.text((after, y + 8), value, Lettering(15))
    for k, line in enumerate(_reasons(candidate)):
        place = (x + 8, y + 31 + _REASON_PX * k)
        line = fit(line, _SMALL.size_px, width - 16)
        canvas.text(place, line, _SMALL if candidate.passed else _SMALL_PALE)


def _reasons(candidate: Candidate) -> list[str]:
    """The failed checks with their values; for one that passed its place in the order."""
    if candidate.passed:
        return [f"passes, rank {candidate.rank}"]
    said = [
        f"{item.check.replace('_', ' ')} {measured(item.value, item.unit)}"
        for item in candidate.rejections
    ]
    more = len(said) - _MOST_REASONS
    return said if more <= 0 else [*said[: _MOST_REASONS - 1], f"and {more + 1} more"]


def _frame(canvas: Canvas, at: XY, size: tuple[float, float], *, passed: bool) -> None:
    """A frame round the cell of the candidate that the picture shows."""
    (x, y), (width, height) = at, size
    low, high = (x + 1, y + 3), (x + width - 4, y + height - 3)
    stroke = Stroke(GRIPPER, 2.5) if passed else Stroke(BLOCKED, 2.5, dash=(6.0, 4.0))
    places = (low, (high[0], low[1]), high, (low[0], high[1]))
    for a, b in zip(places, (*places[1:], places[0]), strict=True):
        canvas.line(a, b, stroke)


def _counts(selection: Selection, width: int) -> Image:
    """Counts a face, where there are too many lines for a table."""
    canvas = blank(width, 40 + len(FACES) * 28)
    canvas.text((10, 8), "Candidates, by face", _HEADING)
    for k, name in enumerate(FACES):
        own = [candidate for candidate in selection.candidates if candidate.face_name == name]
        passing = sum(candidate.passed for candidate in own)
        near = [said.value for said in map(visible_clearance, own) if said is not None]
        best = f", the best {measured(max(near), 'm')} clear" if near else ""
        text = fit(f"{name}: {passing} of {len(own)} pass{best}", _BODY.size_px, width - 20)
        canvas.text((10, 34 + 28 * k), text, _BODY)
    return canvas.finish()


def legend_card(selection: Selection, width: int) -> Image:
    """What the markers and the lines mean.

    Args:
        selection: the answer.
        width: px.

    Returns:
        An RGB image.
    """
    near, far = 100 * RED_BELOW_M, 100 * GREEN_FROM_M
    marks = [
        (Look(SHAPE["green"], CATEGORY["green"]), f"safe: {far:.0f} cm and more clear"),
        (Look(SHAPE["yellow"], CATEGORY["yellow"]), f"feasible: {near:.0f} to {far:.0f} cm clear"),
        (Look(SHAPE["red"], CATEGORY["red"]), f"too close: under {near:.0f} cm"),
        (Look(SHAPE["green"], CATEGORY["green"], "dropped"), "crossed: a check rejects it"),
        (Look(SHAPE["red"], CATEGORY["red"], "wide"), "arrow: too wide, or width unknown"),
    ]
    if any(visible_clearance(candidate) is None for candidate in selection.candidates):
        marks.append((UNMEASURED, "diamond: clearance not measured"))
    lines = _lines(selection)
    notes = ("lines on the box: where the fingers close", "numbers: labels of the candidates")
    canvas = blank(width, 12 + 28 * max(len(marks), len(lines) + len(notes)))
    for k, (look, words) in enumerate(marks):
        canvas.mark((20, 20.0 + 28 * k), look, 8)
        canvas.text((38, 10.0 + 28 * k), words, _BODY)
    x = width / 2 + 10
    for k, (stroke, words) in enumerate(lines):
        canvas.line((x, 20.0 + 28 * k), (x + 34, 20.0 + 28 * k), stroke)
        canvas.text((x + 44, 10.0 + 28 * k), words, _BODY)
    for k, words in enumerate(notes, len(lines)):
        canvas.text((x, 10.0 + 28 * k), words, _BODY)
    return canvas.finish()


def _lines(selection: Selection) -> tuple[tuple[Stroke, str], ...]:
    grasp, shown = selection.grasp, selection.shown
    rejected = shown is not None and not shown.passed
    why = "why it is rejected" if rejected else "obstacle nearest to the gripper"
    if grasp is None:
        words = "nearest to passing, rejected" if rejected else "the best that passes, not taken"
        hand = (Stroke(BLOCKED, 4.0, dash=(8.0, 5.0)), words)
    else:
        way = Hand(selection.gripper, grasp.T_base_gripper, grasp.T_base_pregrasp).approach_m
        hand = (Stroke(GRIPPER, 4.0), f"gripper; faint: {100 * way:.3g} cm before")
    box = (Stroke(WHITE, 4.0, halo=INK), "box round the target")
    lines = (hand, box, (Stroke(OBSTACLE, 4.0), why))
    holds = None if shown is None else shown.checks.get(Holds.name)
    if holds is None:
        return lines
    words = f"held by the fingertips, {measured(holds.value, holds.unit)}"
    return (*lines, (Stroke(HELD, 8.0, halo=BLACK), words))
