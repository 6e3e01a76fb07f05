"""Answers in words and tables, for people."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from boxgrasp.grasps.candidates import FACES
from boxgrasp.result import Candidate, Selection


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
        nearest = f" ({spell(selection.candidate(best))})" if best else ""
        more = f"; {blocking}" if blocking and blocking not in selection.reason else ""
        return f"ask: {selection.reason}{more}{nearest}"
    where = f"{FACES[selection.face - 1]} line {selection.line}"
    clear, opening = 100 * selection.clearance_m, 100 * (selection.opening_m or 0.0)
    return f"grasp: {where}, {clear:.1f} cm clear, opening {opening:.1f} cm"


def timings(selection: Selection) -> str:
    """How long each stage took."""
    return ", ".join(f"{stage} {ms:.1f} ms" for stage, ms in selection.timings_ms.items())


def spell(candidate: Candidate) -> str:
    """A candidate by the name of its face and its line."""
    return f"{FACES[candidate.face - 1]} line {candidate.line}"


def candidates_table(selection: Selection) -> str:
    """Every candidate with its numbers, in cm, and why it was kept or dropped."""
    head = ("label", "face", "line", "width", "seen", "unseen", "support", "approach", "", "")
    rows = [_candidate_row(candidate, selection) for candidate in selection.candidates]
    return table(head, rows, left=(1, 8, 9))


def _candidate_row(candidate: Candidate, selection: Selection) -> tuple[str, ...]:
    lengths = (
        "width_m",
        "visible_clearance_m",
        "unseen_distance_m",
        "plane_clearance_m",
        "approach_clearance_m",
    )
    chosen = candidate.label == selection.label
    kept = f"kept, choice {candidate.ranking}"
    return (
        str(candidate.label),
        FACES[candidate.face - 1],
        str(candidate.line),
        *(f"{100 * getattr(candidate, name):.1f}" for name in lengths),
        "=>" if chosen else "",
        "chosen" if chosen else candidate.rejected or kept,
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
