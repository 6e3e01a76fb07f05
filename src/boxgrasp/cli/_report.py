"""Answers in words and tables, for people; every number is read from the answer."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from boxgrasp.grasps.candidates import FACES, line_name
from boxgrasp.grasps.checks.check import measured, spelled
from boxgrasp.result import PERSON, Candidate, CheckValue, Selection


def summary(selection: Selection, name: str) -> str:
    """An answer in a few lines.

    Args:
        selection: any.
        name: of its capture.

    Returns:
        Name, status and headline; below it the pose, or where the target is; how many candidates
        pass; and warnings.
    """
    lines = [f"{name}: {selection.status}: {selection.headline()}"]
    if selection.grasp is not None:
        position = " ".join(f"{value:.3f}" for value in selection.grasp.position_m)
        turn = " ".join(f"{value:.4f}" for value in selection.grasp.quaternion_xyzw)
        lines.append(f"  gripper at {position} m, quaternion xyzw {turn}, {selection.frame} frame")
        shown = selection.candidate(selection.grasp.label)
        why = "overridden" if selection.ranker == PERSON else "unchecked"
        lines += [f"  {why}: {reason.sentence}" for reason in shown.rejections]
    else:
        center = " ".join(f"{value:.3f}" for value in selection.box.T_base_box[:3, 3])
        lines.append(f"  target at {center} m, {selection.frame} frame")
    lines.append(
        f"  {len(selection.passing)} of {len(selection.candidates)} candidates pass, "
        f"{selection.chosen_by}"
    )
    lines += [f"  warning: {warning.message}" for warning in selection.warnings]
    return "\n".join(lines)


def timings(selection: Selection) -> str:
    """How long each stage took.

    Args:
        selection: any.

    Returns:
        `scene 12.3 ms, box 0.5 ms, ...`.
    """
    return ", ".join(f"{stage} {ms:.1f} ms" for stage, ms in selection.timings_ms.items())


def candidates_table(selection: Selection) -> str:
    """Every candidate with the value of every check, whatever checks there are.

    Args:
        selection: any.

    Returns:
        A head with each check's name and limit, then a line a candidate. A star stands beside
        what failed.
    """
    names = tuple(selection.candidates[0].checks)
    titles = [f"{name.replace('_', ' ')} " for name in names]
    limits = [_limit(selection.candidates, name) for name in names]
    head = _stacked(["label", "face", "line", "rank", *titles, "result"])
    rows = [_candidate_row(candidate, selection) for candidate in selection.candidates]
    lines = [*head[1:], ["", "limit", "", "", *limits, ""], *rows]
    return table(head[0], lines, left=(1, 2, 4 + len(names)))


def rejections(selection: Selection) -> str:
    """Why each candidate that does not pass was rejected.

    Args:
        selection: any.

    Returns:
        A line a reason, the first beside the candidate's label and name; empty where all pass.
    """
    rows = []
    for candidate in selection.candidates:
        name = (str(candidate.label), candidate.name)
        for reason in candidate.rejections:
            rows.append((*name, reason.sentence))
            name = ("", "")
    return table(("label", "rejected", "because"), rows, left=(1, 2)) if rows else ""


def table(head: Sequence[str], rows: Iterable[Sequence[str]], left: Sequence[int] = ()) -> str:
    """Columns lined up.

    Args:
        head: a title a column.
        rows: a text a column.
        left: columns that are lined up on the left; the others are on the right.

    Returns:
        Lines of equal columns, two blanks between them.
    """
    lines = [head, *rows]
    widths = [max(len(line[k]) for line in lines) for k in range(len(head))]
    return "\n".join(
        "  ".join(
            cell.ljust(width) if k in left else cell.rjust(width)
            for k, (cell, width) in enumerate(zip(line, widths, strict=True))
        ).rstrip()
        for line in lines
    )


def _stacked(titles: Sequence[str]) -> list[list[str]]:
    """Titles of several words as lines of one word, the last words on the last line."""
    words = [[word + " " * title.endswith(" ") for word in title.split()] for title in titles]
    height = max(len(title) for title in words)
    padded = [[""] * (height - len(title)) + title for title in words]
    return [list(line) for line in zip(*padded, strict=True)]


def _limit(candidates: Sequence[Candidate], name: str) -> str:
    """A check's limit; nothing where it is not the same for all."""
    limits = {spelled(item.checks[name].limit, item.checks[name].unit) for item in candidates}
    return f"{limits.pop()} " if len(limits) == 1 else ""


def _candidate_row(candidate: Candidate, selection: Selection) -> list[str]:
    lines = len(selection.candidates) // len(FACES)
    return [
        str(candidate.label),
        candidate.face_name,
        f"{candidate.line} {line_name(candidate.face, candidate.line, lines)}".rstrip(),
        str(candidate.rank),
        *(_cell(said) for said in candidate.checks.values()),
        _result(candidate, selection),
    ]


def _cell(said: CheckValue) -> str:
    return measured(said.value, said.unit) + (" " if said.passed else "*")


def _result(candidate: Candidate, selection: Selection) -> str:
    if selection.grasp is not None and candidate.label == selection.grasp.label:
        return "chosen" if candidate.passed else "chosen, unchecked"
    if selection.refusal is not None and candidate.label == selection.refusal.nearest_label:
        return "passes, not taken" if candidate.passed else "rejected, nearest"
    return "passes" if candidate.passed else "rejected"
