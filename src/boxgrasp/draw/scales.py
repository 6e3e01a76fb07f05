"""What makes a plan readable: a grid of 10 cm with its meters, the support, axes, a scale."""

from __future__ import annotations

from typing import Final

import numpy as np

from boxgrasp.draw.canvas import Canvas, Stroke
from boxgrasp.draw.palette import FAINT, INK, WHITE
from boxgrasp.draw.text import Lettering
from boxgrasp.draw.views import View

_EVERY_M: Final = 0.1
_FINEST_PX: Final = 9.0
_GRID: Final = Stroke(FAINT, 1.0, alpha=70)
_AXIS: Final = Stroke(INK, 2.5, halo=WHITE)
_DARK: Final = Lettering(14, INK, halo=WHITE)
_PALE: Final = Lettering(14, FAINT, halo=WHITE)


def draw_grid(canvas: Canvas, view: View, kind: str, floor_m: float) -> None:
    """Draw lines every 10 cm of the base frame, with their meters.

    Args:
        canvas: the panel.
        view: of `plan_view`.
        kind: `above` (x up, y to the left) or `side` (x to the right, z up).
        floor_m: height of the support, base frame.
    """
    scale = view.fx
    if scale * _EVERY_M >= _FINEST_PX:
        # Base x falls upwards from above and to the right from the side; y runs to the left.
        _lines(canvas, scale, view.cx, 1.0 if kind == "side" else -1.0, upright=True)
        _lines(canvas, scale, view.cy, -1.0, upright=False)
    if kind == "side":
        level = view.cy - scale * floor_m
        canvas.line((0, level), (canvas.width, level), Stroke(INK, 2.5))
        canvas.text((canvas.width - 66, level + 3), "support", _DARK)
    _axes(canvas, kind)
    _scale(canvas, scale * _EVERY_M)


def _scale(canvas: Canvas, length: float) -> None:
    right, y = canvas.width - 24.0, 30.0
    canvas.line((right - length, y), (right, y), Stroke(INK, 3.0, halo=WHITE))
    for end in (right - length, right):
        canvas.line((end, y - 6), (end, y + 6), Stroke(INK, 2.0, halo=WHITE))
    canvas.text((right - length / 2 - 20, y - 24), f"{100 * _EVERY_M:.0f} cm", _DARK)


def _lines(canvas: Canvas, scale: float, zero: float, sign: float, *, upright: bool) -> None:
    length = canvas.width if upright else canvas.height
    ends = sorted((sign * (0 - zero) / scale, sign * (length - zero) / scale))
    every = max(1, int(np.ceil(44.0 / (scale * _EVERY_M))))
    first, last = int(np.ceil(ends[0] / _EVERY_M)), int(np.floor(ends[1] / _EVERY_M))
    for step in range(first, last + 1):
        at = zero + sign * scale * step * _EVERY_M
        a, b = ((at, 0.0), (at, canvas.height)) if upright else ((0.0, at), (canvas.width, at))
        canvas.line(a, b, _GRID)
        if step % every == 0 and 40 < at < length - 40:
            place = (at - 10, canvas.height - 20.0) if upright else (5.0, at - 9)
            canvas.text(place, f"{step * _EVERY_M:.1f}", _PALE)


def _axes(canvas: Canvas, kind: str) -> None:
    if kind == "above":
        x, y = canvas.width - 40.0, canvas.height - 50.0
        canvas.arrow((x, y), (x, y - 60), _AXIS, head=11)
        canvas.arrow((x, y), (x - 60, y), _AXIS, head=11)
        canvas.text((x - 96, y - 84), "x, away from robot", _DARK)
        canvas.text((x - 78, y - 8), "y", _DARK)
    else:
        x, y = canvas.width - 110.0, 100.0
        canvas.arrow((x, y), (x, y - 46), _AXIS, head=11)
        canvas.arrow((x, y), (x + 60, y), _AXIS, head=11)
        canvas.text((x - 12, y - 50), "z", _DARK)
        canvas.text((x + 64, y - 9), "x", _DARK)
