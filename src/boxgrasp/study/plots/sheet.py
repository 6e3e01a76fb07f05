"""A sheet to plot on: the same look everywhere, the same SVG bytes for the same numbers."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from textwrap import fill
from typing import Any, Final

from boxgrasp.draw.palette import BLOCKED, FAINT, GRIPPER, INK, OBSTACLE, RGB, RULE
from boxgrasp.errors import MissingExtraError
from boxgrasp.study.intervals import Estimate

# Series are told apart by mark and dash too, never by hue alone.
_DARK: Final[tuple[RGB, ...]] = (GRIPPER, BLOCKED, INK, OBSTACLE, (0, 158, 115), (86, 180, 233))
MARKS: Final = ("o", "s", "^", "D", "v", "P")
DASHES: Final = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)), (0, (1, 1)))


def hexed(color: RGB) -> str:
    """A color as matplotlib takes it.

    Args:
        color: red, green, blue, 0 to 255.

    Returns:
        `#rrggbb`.
    """
    return "#{:02x}{:02x}{:02x}".format(*color)


COLORS: Final = tuple(hexed(color) for color in _DARK)
INK_HEX: Final = hexed(INK)
FAINT_HEX: Final = hexed(FAINT)
RULE_HEX: Final = hexed(RULE)

_LOOK: Final[dict[str, Any]] = {
    "axes.axisbelow": True,
    "axes.edgecolor": FAINT_HEX,
    "axes.labelcolor": INK_HEX,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlesize": 10,
    "figure.facecolor": "white",
    "font.size": 10,
    "grid.color": RULE_HEX,
    "grid.linewidth": 0.6,
    "hatch.linewidth": 0.7,
    "legend.fontsize": 9,
    "legend.frameon": False,
    "svg.fonttype": "path",
    "svg.hashsalt": "boxgrasp",
    "text.color": INK_HEX,
    "text.parse_math": False,
    "xtick.color": INK_HEX,
    "xtick.labelsize": 9,
    "ytick.color": INK_HEX,
    "ytick.labelsize": 9,
}


_PLACE: Final = re.compile(r'(?<= )([xy])="(-?\d+\.\d+)"')


@contextmanager
def sheet(width_in: float, height_in: float) -> Iterator[Any]:
    """A sheet to draw on, and to take `svg` of, inside the block.

    Args:
        width_in: inches.
        height_in: inches.

    Yields:
        A matplotlib figure.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    try:
        import matplotlib
        from matplotlib.figure import Figure
    except ImportError:
        raise MissingExtraError(
            "the report's plots need matplotlib; install with: pip install 'boxgrasp[train]'"
        ) from None
    with matplotlib.rc_context():
        # A user's own settings must not change the bytes.
        matplotlib.rcdefaults()
        settings: Any = matplotlib.rcParams
        settings.update(_LOOK)
        yield Figure(figsize=(width_in, height_in), layout="constrained")


def svg(figure: Any, dpi: int = 140) -> str:
    """A figure as text, without a date.

    Args:
        figure: of matplotlib.
        dpi: of what is drawn as pixels.

    Returns:
        SVG.
    """
    held = io.StringIO()
    nothing = {"Date": None, "Creator": None, "Format": None, "Type": None}
    figure.savefig(held, format="svg", dpi=dpi, metadata=nothing)
    # A hundredth of a point is finer than any screen, and a cloud of marks is a third smaller.
    return _PLACE.sub(lambda m: f'{m[1]}="{float(m[2]):.2f}"', held.getvalue())


def wrapped(name: str, width: int = 11) -> str:
    """A name in short lines, for below a column.

    Args:
        name: any.
        width: letters a line, about.

    Returns:
        The name with line breaks.
    """
    return fill(name, width, break_long_words=False)


def known(estimates: Sequence[Estimate]) -> list[tuple[int, float, float, float]]:
    """The estimates that are there.

    Args:
        estimates: missing ones among them.

    Returns:
        Index, value, and how far its interval reaches down and up, of each.
    """
    found = []
    for k, e in enumerate(estimates):
        if e.value is not None:
            low = e.value if e.low is None else e.low
            high = e.value if e.high is None else e.high
            found.append((k, e.value, e.value - low, high - e.value))
    return found
