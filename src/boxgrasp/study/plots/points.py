"""Points with 95 % intervals, a line a name: the thesis's figures beside ours, and rankers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from boxgrasp.study.intervals import Estimate
from boxgrasp.study.plots.sheet import COLORS, known, sheet, svg
from boxgrasp.study.report import Row

_LINE_IN = 0.27  # inches a line


@dataclass(frozen=True)
class _Style:
    """How a point looks: its mark, its color, and whether it is full."""

    mark: str
    color: str
    full: bool


_OURS = _Style("o", COLORS[0], True)
_THESIS, _OUTSIDE = _Style("D", COLORS[1], False), _Style("D", COLORS[1], True)
_BARE, _CHECKED = _Style("s", COLORS[1], False), _OURS


def forest(rows: Sequence[Row], what: str = "score") -> str:
    """Ours with its interval and the thesis's number, a row a line; full where it lies outside.

    Args:
        rows: of a report.
        what: is measured.

    Returns:
        SVG.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    with sheet(6.4, 1.2 + _LINE_IN * len(rows)) as figure:
        axes = figure.subplots()
        _lines(axes, [row.name for row in rows])
        ours = [_estimate(row.ours) for row in rows]
        for k, value, down, up in known(ours):
            _point(axes, (value, k), (down, up), _OURS, f"ours-{k}")
        for k, row in enumerate(rows):
            if isinstance(row.thesis, int | float):
                style = _OUTSIDE if row.aside in ("higher", "lower") else _THESIS
                axes.plot(
                    row.thesis, k, style.mark, color=style.color, markersize=6.5,
                    markeredgewidth=1.4, markerfacecolor=style.color if style.full else "none",
                    gid=f"thesis-{k}", zorder=4,
                )  # fmt: skip
        axes.set_xlabel(what)
        keys = [
            _key(_OURS, "ours, 95 % interval"),
            _key(_THESIS, "thesis"),
            _key(_OUTSIDE, "thesis, outside our interval"),
        ]
        figure.legend(handles=keys, loc="outside upper center", ncols=3)
        return svg(figure)


def ranker_points(
    names: Sequence[str],
    bare: Sequence[Estimate],
    checked: Sequence[Estimate],
    what: str = "strict score",
) -> str:
    """Two points with intervals for each name: bare (hollow) and checked (full).

    Args:
        names: of the rankers, N of them.
        bare: N estimates of their first choices.
        checked: N estimates of the first that pass every check.
        what: is measured.

    Returns:
        SVG.

    Raises:
        MissingExtraError: matplotlib is not installed.
        ValueError: another number of estimates.
    """
    with sheet(6.4, 1.2 + 1.5 * _LINE_IN * len(names)) as figure:
        axes = figure.subplots()
        _lines(axes, names)
        for kind, estimates, style, off in (
            ("bare", bare, _BARE, -0.16), ("checked", checked, _CHECKED, 0.16),
        ):  # fmt: skip
            if len(estimates) != len(names):
                raise ValueError(f"{len(estimates)} estimates; valid: {len(names)}, one a name")
            for k, value, down, up in known(estimates):
                _point(axes, (value, k + off), (down, up), style, f"{kind}-{k}")
        axes.set_xlabel(what)
        keys = [_key(_BARE, "bare"), _key(_CHECKED, "checked")]
        figure.legend(handles=keys, loc="outside upper center", ncols=2)
        return svg(figure)


def _estimate(ours: object) -> Estimate:
    if isinstance(ours, Estimate):
        return ours
    if isinstance(ours, int | float):
        return Estimate(float(ours), None, None, 1)
    return Estimate(None, None, None, 0)


def _lines(axes: Any, names: Sequence[str]) -> None:
    axes.set_yticks(range(len(names)), list(names))
    axes.set_ylim(len(names) - 0.4, -0.6)
    axes.grid(axis="both")
    axes.tick_params(axis="y", length=0)
    axes.margins(x=0.04)
    axes.spines["left"].set_visible(False)


def _point(
    axes: Any, place: tuple[float, float], reach: tuple[float, float], style: _Style, gid: str
) -> None:
    """A mark at x, y, and its interval from reach[0] below x to reach[1] above."""
    (x, y), ends = place, (place[0] - reach[0], place[0] + reach[1])
    axes.plot(ends, [y, y], color=style.color, linewidth=1.6, solid_capstyle="butt")
    for end in ends:
        axes.plot([end, end], [y - 0.12, y + 0.12], color=style.color, linewidth=1.6)
    axes.plot(
        x, y, style.mark, color=style.color, markersize=6, markeredgewidth=1.4,
        markerfacecolor=style.color if style.full else "white", gid=gid, zorder=3,
    )  # fmt: skip


def _key(style: _Style, text: str) -> Any:
    from matplotlib.lines import Line2D

    return Line2D(
        [], [], marker=style.mark, color=style.color, linestyle="none", markersize=6,
        markeredgewidth=1.4, markerfacecolor=style.color if style.full else "none", label=text,
    )  # fmt: skip
