"""Where space is sampled: the flat spiral (2-6), its layers (2-7), samplings (2-5 to 3-9)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from boxgrasp.arrays import Floats
from boxgrasp.study.plots.sheet import COLORS, FAINT_HEX, MARKS, sheet, svg

_GOLDEN = math.pi * (3.0 - math.sqrt(5.0))
_MOST_MARKS = 400  # in a view; more are drawn as pixels, or the file would be large
_MOST_LAYERS = 6


def golden_spiral(count: int = 256) -> str:
    """Vogel's spiral on a unit disc (thesis algorithm 1, figure 2-6), growing in four steps.

    Args:
        count: of points.

    Returns:
        SVG.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    k = np.arange(1, count + 1)
    radius, angle = np.sqrt(k / count), _GOLDEN * k
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    with sheet(6.4, 6.4) as figure:
        shown = [max(1, round(count * share)) for share in (10 / 256, 50 / 256, 100 / 256, 1)]
        for axes, n in zip(figure.subplots(2, 2).flat, shown, strict=True):
            axes.scatter(
                x[:n], y[:n], c=k[:n], cmap="cividis", vmin=1, vmax=n, s=22,
                edgecolors="#333333", linewidths=0.4, gid=f"spiral-{n}",
            )  # fmt: skip
            if n <= 10:
                axes.plot(x[:n], y[:n], color=FAINT_HEX, linewidth=0.5, zorder=0)
            axes.set(xlim=(-1.08, 1.08), ylim=(-1.08, 1.08), aspect="equal")
            axes.set_title(f"all {n}" if n == count else f"first {n}")
            axes.set_xticks((-1, 0, 1))
            axes.set_yticks((-1, 0, 1))
        return svg(figure)


def spiral_layers(points: Floats, slab_m: float = 0.036) -> str:
    """One layer of a spiral sampling, and a section through all (thesis figure 2-7).

    Args:
        points: (P, 3) on half spheres, map frame, m.
        slab_m: samples so near to the plane x = 0 are in the section, m; half of their spacing.

    Returns:
        SVG.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    radii = np.round(np.linalg.norm(points, axis=1), 4)
    layers, which = np.unique(radii, return_inverse=True)
    reach = float(layers[-1])
    turn = np.linspace(0.0, math.pi, 91)
    with sheet(5.0, 7.4) as figure:
        aslant = figure.add_subplot(2, 1, 1, projection="3d")
        aslant.computed_zorder = False
        outer = points[which == len(layers) - 1]
        _scatter(aslant, outer, COLORS[0], f"layer-{len(layers)}", 22)
        aslant.set_title(f"one layer: {len(outer)} samples at {100 * reach:.1f} cm")
        _dress(aslant, (0, 1, 2), reach)
        section = figure.add_subplot(2, 1, 2)
        near = np.abs(points[:, 0]) <= slab_m
        for k, radius in enumerate(layers.tolist()):
            color, mark = COLORS[k % len(COLORS)], MARKS[k % len(MARKS)]
            section.plot(radius * np.cos(turn), radius * np.sin(turn), color=color, linewidth=0.8)
            section.scatter(
                *points[near & (which == k)][:, 1:].T, c=color, marker=mark, s=34, linewidths=0.3,
                edgecolors="#333333", label=f"{100 * radius:.1f} cm", gid=f"section-{k + 1}",
                clip_on=False, zorder=3,
            )  # fmt: skip
        section.set_title(f"section: samples within {100 * slab_m:.1f} cm of x = 0, by layer")
        _dress(section, (1, 2), reach)
        section.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=len(layers))
        return svg(figure, dpi=90)


def samples_3d(points: Floats, portion: Floats | None = None) -> str:
    """Samples seen aslant, from above, from the robot and from its right.

    Colored by layer where they lie on few spheres, else by height; a portion is colored and the
    rest is faint.

    Args:
        points: (P, 3) map frame, m.
        portion: (p, 3) of them, or None.

    Returns:
        SVG.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    reach = float(np.ceil(20 * np.linalg.norm(points, axis=1).max() - 1e-6) / 20)
    with sheet(7.0, 6.2) as figure:
        aslant = figure.add_subplot(2, 2, 1, projection="3d")
        aslant.computed_zorder = False
        views: list[tuple[Any, tuple[int, ...], str]] = [(aslant, (0, 1, 2), "aslant")]
        views += [
            (figure.add_subplot(2, 2, k), axes, title)
            for k, axes, title in (
                (2, (1, 0), "from above"),
                (3, (1, 2), "from the robot"),
                (4, (0, 2), "from its right"),
            )
        ]
        for view, axes, title in views:
            if portion is None:
                _scatter(view, points[:, axes], _shade(points), title, 15)
            else:
                _scatter(view, points[:, axes], FAINT_HEX, f"rest, {title}", 3)
                _scatter(view, portion[:, axes], COLORS[0], f"portion, {title}", 17)
            view.set_title(title)
            _dress(view, axes, reach)
        return svg(figure, dpi=90)


def _shade(points: Floats) -> Any:
    """(P,) numbers for the colors: the layer, or the height."""
    radii = np.round(np.linalg.norm(points, axis=1), 4)
    layers, which = np.unique(radii, return_inverse=True)
    return which.ravel() if len(layers) <= _MOST_LAYERS else points[:, 2]


def _scatter(axes: Any, points: Floats, color: Any, gid: str, size: float) -> None:
    flat = points.shape[1] == 2
    if flat:
        # Of samples behind one another only the last, the highest, is seen.
        _, first = np.unique(np.round(points[::-1], 6), axis=0, return_index=True)
        kept = np.sort(len(points) - 1 - first)
        points = points[kept]
        color = color if isinstance(color, str) else color[kept]
    extra: dict[str, Any] = {} if flat else {"depthshade": False}
    if not isinstance(color, str):
        extra["cmap"] = "cividis"
    axes.scatter(
        *points.T, c=color, s=size, linewidths=0.3, edgecolors="#333333" if size > 10 else "none",
        clip_on=False, rasterized=len(points) > _MOST_MARKS,
        gid=gid.replace(", ", "-").replace(" ", "-"), **extra,
    )  # fmt: skip


def _dress(axes: Any, which: tuple[int, ...], reach: float) -> None:
    """Limits, ticks and names of the axes; which: the coordinates that they show."""
    both = (-reach, 0.0, reach)
    for name, k in zip("xyz", which, strict=False):
        getattr(axes, f"{name}axis").set_ticks((0.0, reach / 2, reach) if k == 2 else both)
    names = [f"{'xyz'[k]}, m" for k in which]
    limits = [((-0.04 if k == 2 else -1.04) * reach, 1.04 * reach) for k in which]
    axes.set_xlabel(names[0])
    axes.set_ylabel(names[1])
    axes.set_ylim(*limits[1])
    if len(which) == 3:
        axes.set_xlim(*limits[0])
        axes.set_zlim(*limits[2])
        axes.set_box_aspect((2, 2, 1), zoom=1.2)
        axes.view_init(elev=25, azim=-145)
        return
    # y points to the robot's left, so it falls to the right as the robot sees it.
    axes.set_xlim(*(limits[0][::-1] if which[0] == 1 else limits[0]))
    axes.set_aspect("equal")
    axes.grid()
