"""Curves and maps: heat maps over C and gamma (3-12), scores (3-14), curves with intervals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from boxgrasp.draw.palette import CATEGORY
from boxgrasp.grasps.scoring import CATEGORIES, GREEN_FROM_M, RED_BELOW_M
from boxgrasp.study.intervals import Estimate
from boxgrasp.study.metrics import SCORE_FUNCTIONS
from boxgrasp.study.plots.sheet import COLORS, DASHES, FAINT_HEX, MARKS, hexed, known, sheet, svg

_MOST_TICKS = 10


def heat_map(found: Mapping[str, Any], name: str) -> str:
    """Accuracies over C and gamma, coarse and fine, the chosen pair outlined.

    Args:
        found: a search's `C`, `gamma`, `accuracy`, and `coarse` and `fine` with `costs` (values of
            C), `gammas`, and `accuracies` (len(gammas), len(costs)).
        name: of the SVM.

    Returns:
        SVG.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    with sheet(7.4, 3.7) as figure:
        grids = [kind for kind in ("coarse", "fine") if kind in found]
        for axes, kind in zip(figure.subplots(1, len(grids), squeeze=False)[0], grids, strict=True):
            grid = found[kind]
            values = 100 * np.asarray(grid["accuracies"], np.float64)
            axes.set_facecolor("#dddddd")
            shown = axes.imshow(
                np.ma.masked_invalid(values), origin="lower", cmap="cividis", aspect="auto",
                interpolation="nearest", gid=f"map-{kind}",
            )  # fmt: skip
            _ticks(axes.xaxis, grid["costs"])
            _ticks(axes.yaxis, grid["gammas"])
            axes.tick_params(axis="x", rotation=90)
            axes.set_xlabel("C")
            axes.set_ylabel("gamma")
            axes.set_title(f"{kind} grid")
            axes.spines[:].set_visible(False)
            bar = figure.colorbar(shown, ax=axes, shrink=0.9)
            bar.set_label("accuracy, %")
            bar.outline.set_visible(False)
            _outline(axes, grid, float(found["C"]), float(found["gamma"]))
        figure.suptitle(
            f"{name}: C = {found['C']:.4g}, gamma = {found['gamma']:.4g}, "
            f"accuracy {100 * found['accuracy']:.1f} %",
            fontsize=10,
        )
        return svg(figure)


def _ticks(axis: Any, values: Sequence[float]) -> None:
    step = -(-len(values) // _MOST_TICKS)
    at = range(0, len(values), step)
    axis.set_ticks(list(at), [f"{values[k]:.3g}" for k in at])


def _outline(axes: Any, grid: Mapping[str, Any], C: float, gamma: float) -> None:
    from matplotlib.patches import Rectangle

    at = [
        (column, row)
        for column, cost in enumerate(grid["costs"])
        for row, value in enumerate(grid["gammas"])
        if np.isclose(cost, C) and np.isclose(value, gamma)
    ]
    for column, row in at:
        # White within black is seen on every color of the map.
        for color, wide in (("black", 4.0), ("white", 1.8)):
            axes.add_patch(
                Rectangle(
                    (column - 0.5, row - 0.5), 1, 1, fill=False, edgecolor=color, linewidth=wide,
                    clip_on=False, gid=f"chosen-{color}",
                )
            )  # fmt: skip


def score_functions() -> str:
    """Score over clearance: the thesis's (figure 3-14) and the others it speaks of.

    Returns:
        SVG.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    clearance_m = np.linspace(0.0, 0.08, 321)
    with sheet(6.4, 3.6) as figure:
        axes = figure.subplots()
        edges = (0.0, RED_BELOW_M, GREEN_FROM_M, float(clearance_m[-1]))
        for name, low, high in zip(CATEGORIES, edges, edges[1:], strict=False):
            axes.axvspan(
                100 * low, 100 * high, color=hexed(CATEGORY[name]), alpha=0.16, linewidth=0
            )
            axes.text(50 * (low + high), 1.03, name, ha="center", fontsize=9, color=FAINT_HEX)
        kinds: list[str] = []
        for k, function in enumerate(SCORE_FUNCTIONS):
            kind = function.name.partition(",")[0]
            kinds += [kind] if kind not in kinds else []
            values = function(clearance_m, np.full(len(clearance_m), np.inf))
            # Where a score jumps, the line breaks.
            gaps = np.flatnonzero(np.abs(np.diff(values)) > 0.2) + 1
            axes.plot(
                np.insert(100 * clearance_m, gaps, np.nan), np.insert(values, gaps, np.nan),
                color=COLORS[kinds.index(kind)], linewidth=3.0 if k == 0 else 1.6,
                linestyle="-" if function.green_m == GREEN_FROM_M else "--",
                label=f"{function.name} (thesis)" if k == 0 else function.name, gid=f"score-{k}",
                zorder=3 if k == 0 else 2,
            )  # fmt: skip
        axes.set_xlim(0, 100 * edges[-1])
        axes.set_ylim(-0.03, 1.1)
        axes.set_xlabel("clearance, cm")
        axes.set_ylabel("score")
        axes.grid(axis="y")
        figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=3)
        return svg(figure)


def curves(
    at: Sequence[float],
    series: Mapping[str, Sequence[Estimate]],
    x_title: str,
    y_title: str,
    log_x: bool = False,
) -> str:
    """Curves with 95 % intervals.

    Args:
        at: places along x, N of them.
        series: N estimates by name, missing ones among them.
        x_title: of the axis.
        y_title: of the axis.
        log_x: x grows by factors.

    Returns:
        SVG.

    Raises:
        MissingExtraError: matplotlib is not installed.
        ValueError: a series of another length.
    """
    places = np.asarray(at, np.float64)
    steps = np.log(places) if log_x else places
    # Series stand a little beside each other, or their intervals would hide one another.
    gap = 0.05 * float(np.diff(np.sort(steps)).min()) if len(places) > 1 else 0.0
    with sheet(6.4, 3.8) as figure:
        axes = figure.subplots()
        for k, (name, estimates) in enumerate(series.items()):
            if len(estimates) != len(places):
                raise ValueError(
                    f"series {name!r} has {len(estimates)} values; valid: {len(places)}"
                )
            found = known(estimates)
            moved = steps[[item[0] for item in found]] + (k - (len(series) - 1) / 2) * gap
            axes.errorbar(
                np.exp(moved) if log_x else moved,
                [item[1] for item in found],
                yerr=[[item[2] for item in found], [item[3] for item in found]],
                color=COLORS[k % len(COLORS)], marker=MARKS[k % len(MARKS)], markersize=5.5,
                linestyle=DASHES[k % len(DASHES)], linewidth=1.5, elinewidth=1.1, capsize=2.5,
                label=name,
            )[0].set_gid(f"curve-{k}")  # fmt: skip
        if log_x:
            axes.set_xscale("log")
        axes.set_xticks(places, [f"{x:g}" for x in at])
        axes.set_xticks([], minor=True)
        axes.set_xlabel(x_title)
        axes.set_ylabel(y_title)
        axes.grid(axis="both")
        if len(series) > 1:
            columns = 6 if max(map(len, series)) <= 12 else 2 if len(series) == 4 else 3
            figure.legend(
                *axes.get_legend_handles_labels(), loc="outside upper center", ncols=columns
            )
        return svg(figure)
