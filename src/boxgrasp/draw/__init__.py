"""Pictures of answers and of found objects. An outer room; Pillow is imported on first use."""

from __future__ import annotations

from boxgrasp.draw.answer import draw_selection
from boxgrasp.draw.numbers import draw_objects

__all__ = ["draw_objects", "draw_selection"]
