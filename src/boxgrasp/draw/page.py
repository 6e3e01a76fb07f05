"""The page round the panels: a headline, and panels in two columns."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from boxgrasp.draw.canvas import Canvas, Look
from boxgrasp.draw.palette import CARD, NIGHT, PAPER, RGB, WHITE
from boxgrasp.draw.text import Lettering, text_size, wrap

if TYPE_CHECKING:
    from PIL.Image import Image

WIDTH: Final = 1600
MARGIN: Final = 14
HEADER: Final = 70
_LARGE: Final = Lettering(24, WHITE)
_SMALL: Final = Lettering(18, WHITE)
_LINE_PX: Final = 25
_MOST_LINES: Final = 8


class Page:
    """Panels in two columns under a headline; the page is as high as they need.

    Attributes:
        left: rows of the left column, each of panels side by side.
        right: of the right column.
    """

    def __init__(self, headline: tuple[str, str], look: Look | None = None) -> None:
        """Start with a headline.

        Args:
            headline: the status in capitals, and one sentence.
            look: of the marker before it, None for none.
        """
        self._banner = banner(headline, look)
        self.left: list[tuple[Image, ...]] = []
        self.right: list[tuple[Image, ...]] = []

    def finished(self) -> Image:
        """The whole page.

        Returns:
            An RGB image, 1600 px wide.
        """
        from PIL import Image as Images

        top = self._banner.height + MARGIN
        height = top + max(_height(self.left), _height(self.right))
        image = Images.new("RGB", (WIDTH, height), PAPER)
        image.paste(self._banner, (0, 0))
        _stack(image, self.left, (MARGIN, top))
        column = max(_width(row) for row in self.left)
        _stack(image, self.right, (2 * MARGIN + column, top))
        return image


def blank(width: int, height: int, color: RGB = CARD) -> Canvas:
    """An empty card.

    Args:
        width: px.
        height: px.
        color: of its ground.

    Returns:
        A canvas to draw on.
    """
    from PIL import Image as Images

    return Canvas(Images.new("RGB", (width, height), color))


def banner(headline: tuple[str, str], look: Look | None = None) -> Image:
    """The headline: a marker, the status, and one sentence in as many lines as it needs.

    Args:
        headline: the status in capitals, and the sentence.
        look: of the marker, None for none.

    Returns:
        An RGB image, 1600 px wide.
    """
    status, sentence = headline
    x = 20.0 if look is None else 74.0
    after = x + text_size(status, 32)[0] + 26
    room = WIDTH - after - 20
    lines, lettering = wrap(sentence, _LARGE.size_px, room), _LARGE
    if len(lines) > 1:
        lines, lettering = wrap(sentence, _SMALL.size_px, room, _MOST_LINES), _SMALL
    height = max(HEADER, 20 + _LINE_PX * len(lines))
    canvas = blank(WIDTH, height, NIGHT)
    if look is not None:
        canvas.mark((38.0, height / 2), look, 17)
    canvas.text((x, height / 2 - 19), status, Lettering(32, WHITE))
    first = (height - _LINE_PX * len(lines)) / 2 - (2 if lettering is _LARGE else -1)
    for k, line in enumerate(lines):
        canvas.text((after, first + _LINE_PX * k), line, lettering)
    return canvas.finish()


def _width(row: tuple[Image, ...]) -> int:
    return sum(panel.width for panel in row) + MARGIN * (len(row) - 1)


def _height(rows: list[tuple[Image, ...]]) -> int:
    return sum(max(panel.height for panel in row) + MARGIN for row in rows)


def _stack(image: Image, rows: list[tuple[Image, ...]], at: tuple[int, int]) -> None:
    x, y = at
    for row in rows:
        across = x
        for panel in row:
            image.paste(panel, (across, y))
            across += panel.width + MARGIN
        y += max(panel.height for panel in row) + MARGIN
