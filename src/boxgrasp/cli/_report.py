"""Answers in words and tables, for people."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from boxgrasp.grasps.candidates import FACES
from boxgrasp.result import OptionReport, Selection


def summary(selection: Selection) -> str:
    """An answer in a few lines."""
    lines = [f"{selection.capture}: {_headline(selection)}"]
    if selection.position_m is not None and selection.quaternion_xyzw is not None:
        position = " ".join(f"{value:.3f}" for value in selection.position_m)
        turn = " ".join(f"{value:.4f}" for value in selection.quaternion_xyzw)
        lines.append(f"  gripper at {position} m, quaternion xyzw {turn}, {selection.frame} frame")
    lines += [f"  warning: {warning}" for warning in selection.warnings]
    return "\n".join(lines)


def _headline(selection: Selection) -> str:
    if selection.face is None or selection.line is None or selection.clearance_m is None:
        best, blocking = selection.best_rejected, selection.blocking
        nearest = f" ({spell(selection.option(best))})" if best else ""
        more = f"; {blocking}" if blocking and blocking not in selection.reason else ""
        return f"ask: {selection.reason}{more}{nearest}"
    where = f"{FACES[selection.face - 1]} line {selection.line}"
    clear, opening = 100 * selection.clearance_m, 100 * (selection.opening_m or 0.0)
    return f"grasp: {where}, {clear:.1f} cm clear, opening {opening:.1f} cm"


def timings(selection: Selection) -> str:
    """How long each stage took."""
    return ", ".join(f"{stage} {ms:.1f} ms" for stage, ms in selection.timings_ms.items())


def spell(option: OptionReport) -> str:
    """An option by the name of its face and its line."""
    return f"{FACES[option.face - 1]} line {option.line}"


def options_table(selection: Selection) -> str:
    """Every option with its numbers, in cm, and why it was kept or dropped."""
    head = ("label", "face", "line", "width", "seen", "unseen", "support", "approach", "", "")
    rows = [_option_row(option, selection) for option in selection.options]
    return table(head, rows, left=(1, 8, 9))


def _option_row(option: OptionReport, selection: Selection) -> tuple[str, ...]:
    lengths = ("width_m", "seen_m", "unseen_m", "support_m", "approach_m")
    chosen = option.label == selection.label
    kept = f"kept, choice {option.preference}"
    return (
        str(option.label),
        FACES[option.face - 1],
        str(option.line),
        *(f"{100 * getattr(option, name):.1f}" for name in lengths),
        "=>" if chosen else "",
        "chosen" if chosen else option.rejected or kept,
    )


def table(head: Sequence[str], rows: Iterable[Sequence[str]], left: Sequence[int] = ()) -> str:
    """Columns lined up; those in `left` to the left, the others to the right."""
    lines = [head, *rows]
    widths = [max(len(line[k]) for line in lines) for k in range(len(head))]
    return "\n".join(
        "  ".join(
            cell.ljust(width) if k in left else cell.rjust(width)
            for k, (cell, width) in enumerate(zip(line, widths, strict=True))
        ).rstrip()
        for line in lines
    )
