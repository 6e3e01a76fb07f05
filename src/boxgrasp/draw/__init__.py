"""Pictures of answers, of found objects and of hands; Pillow is imported on first use."""

from __future__ import annotations

from boxgrasp.draw.hands import draw_gripper
from boxgrasp.draw.objects import draw_objects
from boxgrasp.draw.selection import draw_selection, selection_png

__all__ = ["draw_gripper", "draw_objects", "draw_selection", "selection_png"]
