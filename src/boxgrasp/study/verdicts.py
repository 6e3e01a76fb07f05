"""One standard by which every result of the thesis is judged, said before anything is judged."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

from boxgrasp.study.intervals import NOTHING, Estimate, less, share

Verdict = Literal[
    "reproduced", "weaker", "not reproduced", "higher", "lower", "cannot be judged here"
]
Kind = Literal["count", "figure", "share", "difference", "above", "below", "alike", "open"]
Ours = Estimate | int | float | str | None

REACHED: Final = 0.5  # of the thesis's difference
STANDARD: Final = (
    "A difference is `reproduced` where our 95 % interval excludes 0 on the thesis's side and our "
    "value is at least half of the thesis's; `weaker` where it excludes 0 but is less than half; "
    "else `not reproduced`. Where the thesis gives a side but no size, the side is enough.",
    "A level, as more than 90 %, is `reproduced` where our whole interval lies on the claimed "
    "side, `weaker` where only our value does, else `not reproduced`.",
    "A figure, as a score or a share, is `reproduced` where theirs and ours agree within the joint "
    "95 % interval of both (Newcombe's for two independent figures); else ours is `higher` or "
    "`lower`. The sampling error of theirs comes from its number of scenes: a share's by Wilson, "
    "a score's with the scatter that ours has. A figure of few scenes agrees with much: its number "
    "of scenes stands beside it.",
    "What is counted without chance must be equal, to the digits printed, or it is "
    "`not reproduced`.",
    "Words are judged by the difference or level that they imply: mostly, preferred and typically "
    "are more than half, often is more than a tenth, never is less than one in a hundred, some is "
    "more than none, remarkable is more than nine tenths. Alike, comparable or the same is a "
    "difference that lies within 0.04 to either side: 0.03 is the largest that the thesis calls "
    "comparable, 0.04 the least that it calls better.",
    "`cannot be judged here` says why: a place, a person, a scene or a bar's height that no text "
    "keeps. It is counted apart and never as agreement.",
)


@dataclass(frozen=True)
class Said:
    """What the thesis says of one result, as a thing to be held against.

    Attributes:
        kind: by which rule it is judged.
        value: the count, figure, share, difference, bar, or half width of what is alike; None where
            a difference has a side but no size, and where nothing can be judged.
        of: its number of scenes, for a figure and a share.
    """

    kind: Kind
    value: float | int | str | None = None
    of: int | None = None

    def __str__(self) -> str:
        """As it stands in a table."""
        if self.kind == "share" and self.of is not None and isinstance(self.value, int):
            return f"{self.value} of {self.of} ({self.value / self.of:.3f})"
        if self.kind == "difference":
            return "above 0" if self.value is None else f"{self.value:+.2f}"
        if self.value is None:
            return "–"
        if self.kind in ("above", "below"):
            return f"{self.kind} {self.value:.2f}"
        if self.kind == "alike":
            return f"within ±{self.value:.2f}"
        text = f"{self.value:,}" if isinstance(self.value, int) else str(self.value)
        return f"{text} (of {self.of})" if self.of else text


def judge(said: Said, ours: Ours) -> Verdict:
    """The verdict on one result.

    Args:
        said: by the thesis.
        ours: our count, or our figure with its interval.

    Returns:
        By the rule of its kind.

    Raises:
        ValueError: a figure that needs an interval and has none.
    """
    if said.kind == "open":
        return "cannot be judged here"
    if said.kind == "count":
        return _count(said, ours)
    if not isinstance(ours, Estimate):
        raise ValueError(f"ours is {ours!r}; valid for a {said.kind}: an estimate")
    if ours.value is None or ours.low is None or ours.high is None:
        return "cannot be judged here"
    if said.kind in ("figure", "share"):
        return _figure(said, ours)
    value, low, high = ours.value, ours.low, ours.high
    if said.kind == "difference":
        least = 0.0 if said.value is None else REACHED * float(said.value)
        if low <= 0.0:
            return "not reproduced"
        return "reproduced" if value >= least else "weaker"
    assert said.value is not None
    bar = float(said.value)
    if said.kind == "above":
        whole, part = low > bar, value > bar
    elif said.kind == "below":
        whole, part = high < bar, value < bar
    else:
        whole, part = low >= -bar and high <= bar, -bar <= value <= bar
    return "reproduced" if whole else "weaker" if part else "not reproduced"


def _count(said: Said, ours: Ours) -> Verdict:
    theirs = said.value
    if ours is None or isinstance(ours, Estimate):
        return "cannot be judged here"
    if isinstance(theirs, float) and isinstance(ours, int | float):
        ours = round(ours, len(str(theirs).partition(".")[2]))
    return "reproduced" if ours == theirs else "not reproduced"


def _figure(said: Said, ours: Estimate) -> Verdict:
    gap = less(ours, theirs_of(said, ours))
    assert gap.low is not None and gap.high is not None and gap.value is not None
    if gap.low <= 0.0 <= gap.high:
        return "reproduced"
    return "higher" if gap.value > 0 else "lower"


def theirs_of(said: Said, ours: Estimate) -> Estimate:
    """The thesis's figure with an interval for its number of scenes.

    Args:
        said: a figure or a share of so many scenes.
        ours: whose scatter a score is given.

    Returns:
        The figure; with no interval where ours has none.
    """
    assert said.value is not None and said.of is not None
    if said.kind == "share":
        return share(int(said.value), said.of)
    if ours.low is None or ours.high is None:
        return NOTHING
    value = float(said.value)
    half = (ours.high - ours.low) / 2 * (ours.count / said.of) ** 0.5
    return Estimate(value, value - half, value + half, said.of)
