"""What makes a plan readable: a grid of 10 cm with its meters, the support, axes, a scale."""

from __future__ import annotations

import numpy as np

from boxgrasp.draw.canvas import Canvas
from boxgrasp.draw.palette import FAINT, INK, WHITE
from boxgrasp.draw.views import View

_EVERY_M = 0.1
_FINEST_PX = 9.0


def draw_grid(canvas: Canvas, view: View, kind: str, floor_m: float) -> None:
    """Lines every 10 cm of the base frame (`above`: x up, y left; `side`: x right, z up)."""
    scale = view.fx
    if scale * _EVERY_M >= _FINEST_PX:
        # Base x falls upwards from above and to the right from the side; y runs to the left.
        _lines(canvas, scale, view.cx, 1.0 if kind == "side" else -1.0, True)
        _lines(canvas, scale, view.cy, -1.0, False)
    if kind == "side":
        level = view.cy - scale * floor_m
        canvas.line((0, level), (canvas.width, level), INK, 2.5)
        canvas.text((canvas.width - 66, level + 3), "support", 14, INK, halo=WHITE)
    _axes(canvas, kind)
    right, lower = canvas.width - 24.0, 30.0
    canvas.line((right - scale * _EVERY_M, lower), (right, lower), INK, 3.0, halo=WHITE)
    for end in (right - scale * _EVERY_M, right):
        canvas.line((end, lower - 6), (end, lower + 6), INK, 2.0, halo=WHITE)
    canvas.text((right - scale * _EVERY_M / 2 - 20, lower - 24), "10 cm", 14, INK, halo=WHITE)


def _lines(canvas: Canvas, scale: float, zero: float, sign: float, upright: bool) -> None:
    length = canvas.width if upright else canvas.height
    ends = sorted((sign * (0 - zero) / scale, sign * (length - zero) / scale))
    every = max(1, int(np.ceil(44.0 / (scale * _EVERY_M))))
    first, last = int(np.ceil(ends[0] / _EVERY_M)), int(np.floor(ends[1] / _EVERY_M))
    for step in range(first, last + 1):
        at = zero + sign * scale * step * _EVERY_M
        a, b = ((at, 0.0), (at, canvas.height)) if upright else ((0.0, at), (canvas.width, at))
        canvas.line(a, b, FAINT, 1.0, alpha=70)
        if step % every == 0 and 40 < at < length - 40:
            place = (at - 10, canvas.height - 20.0) if upright else (5.0, at - 9)
            canvas.text(place, f"{step * _EVERY_M:.1f}", 14, FAINT, halo=WHITE)


def _axes(canvas: Canvas, kind: str) -> None:
    if kind == "above":
        x, y = canvas.width - 40.0, canvas.height - 50.0
        canvas.arrow((x, y), (x, y - 60), INK, 2.5, halo=WHITE, head=11)
        canvas.arrow((x, y), (x - 60, y), INK, 2.5, halo=WHITE, head=11)
        canvas.text((x - 96, y - 84), "x, away from robot", 14, INK, halo=WHITE)
        canvas.text((x - 78, y - 8), "y", 14, INK, halo=WHITE)
    else:
        x, y = canvas.width - 110.0, 100.0
        canvas.arrow((x, y), (x, y - 46), INK, 2.5, halo=WHITE, head=11)
        canvas.arrow((x, y), (x + 60, y), INK, 2.5, halo=WHITE, head=11)
        canvas.text((x - 12, y - 50), "z", 14, INK, halo=WHITE)
        canvas.text((x + 64, y - 9), "x", 14, INK, halo=WHITE)
