"""Points with 95 % intervals, a line a name: the thesis's figures beside ours, and rankers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from boxgrasp.study.intervals import Estimate
from boxgrasp.study.plots.sheet import COLORS, known, sheet, svg
from boxgrasp.study.report import Row

_OURS, _THEIRS = COLORS[0], COLORS[1]
_LINE_IN = 0.27  # inches a line


def forest(rows: Sequence[Row], what: str = "score") -> str:
    """Ours with its interval and the thesis's number, a row a line; full where it lies outside.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    with sheet(6.4, 1.2 + _LINE_IN * len(rows)) as figure:
        axes = figure.subplots()
        _lines(axes, [row.name for row in rows])
        ours = [_estimate(row.ours) for row in rows]
        for k, value, down, up in known(ours):
            _point(axes, value, k, down, up, _OURS, "o", True, f"ours-{k}")
        for k, row in enumerate(rows):
            if isinstance(row.thesis, int | float):
                outside = row.aside in ("higher", "lower")
                axes.plot(
                    row.thesis, k, "D", color=_THEIRS, markersize=6.5, markeredgewidth=1.4,
                    markerfacecolor=_THEIRS if outside else "none", gid=f"thesis-{k}", zorder=4,
                )  # fmt: skip
        axes.set_xlabel(what)
        keys = [
            _key("o", _OURS, True, "ours, 95 % interval"),
            _key("D", _THEIRS, False, "thesis"),
            _key("D", _THEIRS, True, "thesis, outside our interval"),
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

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    with sheet(6.4, 1.2 + 1.5 * _LINE_IN * len(names)) as figure:
        axes = figure.subplots()
        _lines(axes, names)
        for estimates, full, color, mark, off in (
            (bare, False, _THEIRS, "s", -0.16), (checked, True, _OURS, "o", 0.16),
        ):  # fmt: skip
            if len(estimates) != len(names):
                raise ValueError(f"{len(estimates)} estimates; valid: {len(names)}, one a name")
            kind = "checked" if full else "bare"
            for k, value, down, up in known(estimates):
                _point(axes, value, k + off, down, up, color, mark, full, f"{kind}-{k}")
        axes.set_xlabel(what)
        keys = [_key("s", _THEIRS, False, "bare"), _key("o", _OURS, True, "checked")]
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
    axes: Any, x: float, y: float, down: float, up: float, color: str, mark: str, full: bool,
    gid: str,
) -> None:  # fmt: skip
    axes.plot([x - down, x + up], [y, y], color=color, linewidth=1.6, solid_capstyle="butt")
    for end in (x - down, x + up):
        axes.plot([end, end], [y - 0.12, y + 0.12], color=color, linewidth=1.6)
    axes.plot(
        x, y, mark, color=color, markersize=6, markeredgewidth=1.4,
        markerfacecolor=color if full else "white", gid=gid, zorder=3,
    )  # fmt: skip


def _key(mark: str, color: str, full: bool, label: str) -> Any:
    from matplotlib.lines import Line2D

    return Line2D(
        [], [], marker=mark, color=color, linestyle="none", markersize=6, markeredgewidth=1.4,
        markerfacecolor=color if full else "none", label=label,
    )  # fmt: skip
