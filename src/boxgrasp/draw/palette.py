"""Colors and marks that stay apart for the color-blind (Okabe and Ito 2008): never hue alone."""

from __future__ import annotations

from typing import Final

RGB = tuple[int, int, int]

BLACK: Final[RGB] = (0, 0, 0)
WHITE: Final[RGB] = (255, 255, 255)
INK: Final[RGB] = (28, 32, 38)
FAINT: Final[RGB] = (105, 112, 122)
PAPER: Final[RGB] = (246, 246, 243)
CARD: Final[RGB] = (255, 255, 255)
RULE: Final[RGB] = (208, 208, 204)
NIGHT: Final[RGB] = (38, 42, 50)

# Okabe-Ito; the words red, yellow and green are those of section 3-4.
CATEGORY: Final[dict[str, RGB]] = {
    "green": (0, 158, 115),
    "yellow": (240, 228, 66),
    "red": (213, 94, 0),
}
GRIPPER: Final[RGB] = (0, 114, 178)
BLOCKED: Final[RGB] = (213, 94, 0)
OBSTACLE: Final[RGB] = (204, 121, 167)
HELD: Final[RGB] = (86, 180, 233)

SHAPE: Final[dict[str, str]] = {"green": "circle", "yellow": "triangle", "red": "square"}
WORD: Final[dict[str, str]] = {"green": "safe", "yellow": "feasible", "red": "too close"}
