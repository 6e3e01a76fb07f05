"""Bars: grasps by category (figures 4-1, 4-3, 4-4, 4-6, 4-9, 4-10), labels by class (4-2)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from boxgrasp.draw.palette import CATEGORY, WORD
from boxgrasp.grasps.candidates import FACES
from boxgrasp.grasps.scoring import CATEGORIES
from boxgrasp.study.plots.sheet import FAINT_HEX, INK_HEX, hexed, sheet, svg, wrapped

_HATCH: Final = {"red": "xxx", "yellow": "//", "green": ""}
_LINE_HATCH: Final = ("//", "", "\\\\", "..", "xx", "--", "++")
_SMALLEST = 0.055  # of a column, that holds its own number
_BEHIND_TEXT: Final = {"boxstyle": "round,pad=0.15", "facecolor": "white", "edgecolor": "none"}


def category_shares(names: Sequence[str], counts: Sequence[tuple[int, int, int]]) -> str:
    """Shares of red, yellow and green, a column a name.

    Args:
        names: of the columns.
        counts: how many are red, yellow and green, a column each.

    Returns:
        SVG.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    wide = len(names) > 3
    with sheet((1.0 if wide else 2.6) + 1.05 * len(names), 3.5) as figure:
        axes = figure.subplots()
        for k, (_, column) in enumerate(zip(names, counts, strict=True)):
            _column(axes, k, column)
        from matplotlib.patches import Patch

        keys = [
            Patch(
                facecolor=hexed(CATEGORY[c]),
                hatch=_HATCH[c],
                edgecolor=INK_HEX,
                label=f"{c}: {WORD[c]}",
            )
            for c in (CATEGORIES if wide else CATEGORIES[::-1])
        ]
        place = "outside upper center" if wide else "outside right center"
        figure.legend(handles=keys, loc=place, ncols=3 if wide else 1, handleheight=1.2)
        axes.set_xlim(-0.6, len(names) - 0.3)
        axes.set_ylim(0, 1)
        axes.set_yticks(np.linspace(0, 1, 6), [f"{20 * k} %" for k in range(6)])
        axes.grid(axis="y")
        axes.set_xticks(
            range(len(names)),
            [f"{wrapped(n)}\n({sum(c):,})" for n, c in zip(names, counts, strict=True)],
        )
        axes.tick_params(axis="x", length=0)
        return svg(figure)


def _column(axes: Any, at: int, counts: tuple[int, int, int]) -> None:
    total = sum(counts)
    if total == 0:
        axes.text(at, 0.5, "none", ha="center", color=FAINT_HEX)
        return
    below = 0.0
    aside_from = -0.03
    for name, count in zip(CATEGORIES, counts, strict=True):
        part = count / total
        axes.bar(
            at, part, 0.62, below, color=hexed(CATEGORY[name]), hatch=_HATCH[name],
            edgecolor=INK_HEX, linewidth=0.7, gid=f"share-{at}-{name}",
        )  # fmt: skip
        middle = below + part / 2
        text = f"{100 * part:.0f} %" if part >= 0.1 or count == 0 else f"{100 * part:.1f} %"
        if part >= _SMALLEST:
            axes.text(at, middle, text, ha="center", va="center", fontsize=9, bbox=_BEHIND_TEXT)
        elif count:
            # Too thin for its number, which stands beside it and over the one below.
            aside_from = max(middle, aside_from + 0.055)
            axes.text(at + 0.33, aside_from, text, ha="left", va="center", fontsize=7.5)
        below += part


def label_distribution(labels: ArrayLike) -> str:
    """Labels by class and by line.

    Args:
        labels: (5, l) how many on each face and line.

    Returns:
        SVG.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    counts = np.asarray(labels)
    lines = counts.shape[1]
    few = lines < 5
    with sheet(7.4, 3.3) as figure:
        left, right = figure.subplots(1, 2, width_ratios=(3.4, 1), sharey=False)
        width = 0.84 / lines
        shades = _shades(lines)
        for line in range(lines):
            at = np.arange(len(FACES)) + (line - (lines - 1) / 2) * width
            for face, x in enumerate(at):
                left.bar(
                    x, counts[face, line], width, color=shades[line], edgecolor=INK_HEX,
                    hatch=_LINE_HATCH[line % len(_LINE_HATCH)], linewidth=0.7,
                    gid=f"label-{face * lines + line + 1}",
                    label=f"line {line + 1}" if face == 0 else None,
                )  # fmt: skip
                left.annotate(
                    f"{counts[face, line]:,}", (x, counts[face, line]), (0, 2),
                    textcoords="offset points", ha="center", fontsize=8 if few else 7,
                    rotation=0 if few else 90,
                )  # fmt: skip
        by_face = counts.sum(axis=1)
        left.set_xticks(
            range(len(FACES)),
            [f"{wrapped(n)}\n({t:,})" for n, t in zip(FACES, by_face.tolist(), strict=True)],
        )
        left.set_ylabel("labels")
        left.legend(loc="upper left", ncols=min(lines, 4))
        left.set_ylim(0, max(1, counts.max()) * (1.25 if few else 1.45))
        by_line = counts.sum(axis=0)
        right.bar(
            range(lines), by_line, 0.7, color=shades, edgecolor=INK_HEX, linewidth=0.7,
            hatch=[_LINE_HATCH[k % len(_LINE_HATCH)] for k in range(lines)],
        )  # fmt: skip
        for line, count in enumerate(by_line.tolist()):
            right.annotate(
                f"{count:,}", (line, count), (0, 2), textcoords="offset points", ha="center",
                fontsize=8 if few else 6.5,
            )  # fmt: skip
        right.set_xticks(range(lines), [f"{k + 1}" for k in range(lines)])
        right.set_xlabel("line, all faces")
        right.set_ylim(0, max(1, by_line.max()) * 1.1)
        for axes in (left, right):
            axes.grid(axis="y")
            axes.tick_params(axis="x", length=0)
        return svg(figure)


def _shades(count: int) -> list[Any]:
    import matplotlib

    scale = matplotlib.colormaps["cividis"]
    return [scale(0.35 + 0.6 * k / max(1, count - 1)) for k in range(count)]
