"""Clouds after each stage of appendix A (A-1 to A-3), and boxes round what is left (5-6)."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from boxgrasp.arrays import Array, Floats, Points
from boxgrasp.draw.palette import BLOCKED, GRIPPER, HELD, INK, OBSTACLE
from boxgrasp.geometry.box import Box
from boxgrasp.geometry.transforms import transform
from boxgrasp.study.plots.sheet import hexed, sheet, svg

_WIDTH_IN = 4.2  # as wide as a phone's screen shows without making letters smaller
_MOST_MARKS = 60_000  # a panel: more cannot be told apart
_MARGIN_M = 0.01
_AZIMUTH, _ELEVATION = np.deg2rad(20.0), np.deg2rad(38.0)  # of who looks, from the robot's left
# Corners whose numbers differ by one bit; see `_moved_corners`.
_EDGES: Final = [
    (a, b) for a, b in itertools.combinations(range(8), 2) if (a ^ b) in (1, 2, 4)
]  # fmt: skip


@dataclass(frozen=True, eq=False)
class Panel:
    """A cloud to draw.

    Attributes:
        title: over it.
        points: (N, 3) float32, base frame, m.
        colors: (N, 3) uint8.
        size: of a mark, square points.
    """

    title: str
    points: Points
    colors: Array
    size: float = 1.0


@dataclass(frozen=True, eq=False)
class BoxPanel:
    """What is left of a target in one view, the box round it and the hand at its pick.

    Attributes:
        title: over it.
        cluster: (N, 3) float32, the selected cluster, base frame, m.
        dropped: (N, 3) float32, the target's points that are not in it.
        others: (N, 3) float32, other things' points.
        box: round the cluster.
        exact: the true box.
        T_base_hand: (4, 4) of the hand's box.
        half_m: (3,) its half sizes, m.
    """

    title: str
    cluster: Points
    dropped: Points
    others: Points
    box: Box
    exact: Box
    T_base_hand: Floats
    half_m: Floats


def clouds(panels: Sequence[Panel]) -> str:
    """Clouds one below the other, seen from over the robot's left shoulder, to one scale.

    Args:
        panels: from the top.

    Returns:
        SVG.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    flats = [_aslant(panel.points) for panel in panels]
    every = np.concatenate([flat for flat, _ in flats])
    low, high = every.min(axis=0) - _MARGIN_M, every.max(axis=0) + _MARGIN_M
    tall_in = (_WIDTH_IN - 0.2) * (high[1] - low[1]) / (high[0] - low[0]) + 0.3
    with sheet(_WIDTH_IN, tall_in * len(panels)) as figure:
        for k, (panel, (flat, depth)) in enumerate(zip(panels, flats, strict=True)):
            axes = figure.add_subplot(len(panels), 1, k + 1)
            # The farthest first, so that what is before it hides it.
            order = np.argsort(-depth, kind="stable")[:: -(-len(flat) // _MOST_MARKS)]
            axes.scatter(
                *flat[order].T, c=panel.colors[order] / 255, s=panel.size, marker="s",
                linewidths=0, rasterized=True, gid=f"cloud-{k}",
            )  # fmt: skip
            axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
            axes.set_xticks(())
            axes.set_yticks(())
            axes.spines[:].set_visible(False)
            axes.set_title(panel.title, wrap=True)
        return svg(figure)


def _aslant(points: Array) -> tuple[Floats, Floats]:
    """(N, 2) to the right and up on the sheet, and (N,) how far away."""
    x, y, z = np.asarray(points, dtype=np.float64).T
    ahead = np.cos(_AZIMUTH) * x - np.sin(_AZIMUTH) * y
    right = -np.sin(_AZIMUTH) * x - np.cos(_AZIMUTH) * y
    up = np.sin(_ELEVATION) * ahead + np.cos(_ELEVATION) * z
    return np.column_stack((right, up)), np.cos(_ELEVATION) * ahead - np.sin(_ELEVATION) * z


def boxes(panels: Sequence[BoxPanel], from_above: bool) -> str:
    """Boxes round what is left of a target, one view below the other, to one scale.

    Args:
        panels: from the top.
        from_above: the top view, as in figure 5-6; else from the robot's right.

    Returns:
        SVG.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    axes_of = (1, 0) if from_above else (0, 2)
    held = [
        p
        for panel in panels
        for p in (_corners(panel.exact), _corners(panel.box), _hand_corners(panel))
    ]
    every = np.concatenate(held)[:, axes_of]
    low, high = every.min(axis=0) - 0.03, every.max(axis=0) + 0.03
    tall_in = (_WIDTH_IN - 0.8) * (high[1] - low[1]) / (high[0] - low[0]) + 0.85
    with sheet(_WIDTH_IN, tall_in * len(panels) + 0.5) as figure:
        for k, panel in enumerate(panels):
            axes = figure.add_subplot(len(panels), 1, k + 1)
            _draw(axes, panel, axes_of)
            # y points to the robot's left, so it falls to the right as the robot sees it.
            side = (high[0], low[0]) if from_above else (low[0], high[0])
            axes.set(xlim=side, ylim=(low[1], high[1]), aspect="equal")
            axes.set_title(panel.title, wrap=True)
            axes.set_ylabel("xyz"[axes_of[1]] + ", m")
        axes.set_xlabel("xyz"[axes_of[0]] + ", m")
        figure.legend(
            *axes.get_legend_handles_labels(), loc="outside lower center", ncols=2, markerscale=4
        )
        return svg(figure)


def _draw(axes: Any, panel: BoxPanel, axes_of: tuple[int, int]) -> None:
    clouds_of = (
        (panel.others, OBSTACLE, "other things", 1.5),
        (panel.cluster, HELD, "selected cluster", 3.0),
        (panel.dropped, BLOCKED, "target's, not in it", 4.0),
    )
    for points, color, name, size in clouds_of:
        axes.scatter(
            *points[:, axes_of].T, color=hexed(color), s=size, linewidths=0, rasterized=True,
            label=name,
        )  # fmt: skip
    solids = (
        (_corners(panel.exact), INK, "--", "true box"),
        (_corners(panel.box), INK, "-", "its box"),
        (_hand_corners(panel), GRIPPER, "-.", "hand at the pick"),
    )
    for corners, color, dash, name in solids:
        flat = corners[:, axes_of]
        for n, (a, b) in enumerate(_EDGES):
            axes.plot(
                *flat[[a, b]].T, color=hexed(color), linestyle=dash, linewidth=1.3,
                label=name if n == 0 else None,
            )  # fmt: skip


def _corners(box: Box) -> Floats:
    return _moved_corners(box.T_base_box, box.dimensions_m / 2)


def _hand_corners(panel: BoxPanel) -> Floats:
    return _moved_corners(panel.T_base_hand, panel.half_m)


def _moved_corners(T_base_box: Floats, half_m: Floats) -> Floats:
    """(8, 3), base frame, m; the bits of a corner's number say on which side it lies."""
    signs = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
    return np.asarray(transform(T_base_box, signs * half_m))
