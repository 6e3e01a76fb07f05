"""The objects that were found, numbered in the image and listed beside it."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from boxgrasp.arrays import Floats
from boxgrasp.draw.backdrops import camera_panel
from boxgrasp.draw.canvas import Canvas, Stroke
from boxgrasp.draw.clouds import base_cloud, painted
from boxgrasp.draw.files import save, validate_place
from boxgrasp.draw.marks import draw_edges
from boxgrasp.draw.page import MARGIN, WIDTH, Page, blank
from boxgrasp.draw.palette import BLACK, FAINT, GRIPPER, RULE, WHITE
from boxgrasp.draw.planar import XY
from boxgrasp.draw.scales import draw_grid
from boxgrasp.draw.shapes import corners
from boxgrasp.draw.text import Lettering, fit, text_size
from boxgrasp.draw.views import View, plan_view
from boxgrasp.geometry.transforms import make_transform
from boxgrasp.perception.numbering import SceneObject
from boxgrasp.perception.scene import Scene
from boxgrasp.sensing.capture import Capture

if TYPE_CHECKING:
    from PIL.Image import Image

_PANEL_PX: Final = (1060, 795)
_LEAST_M: Final = 0.5  # that the view from above shows
_ROW_PX: Final = 30
_MOST_ROWS: Final = 60
_APART_PX: Final = 37.0
_EDGE_PX: Final = 20.0
_COLUMNS: Final = ((10, "no."), (60, "distance"), (160, "size x, y, z (cm)"), (330, "points"))
_HEADING: Final = Lettering(15, FAINT)
_CELL: Final = Lettering(17)


def draw_objects(
    capture: Capture, scene: Scene, path: str | os.PathLike[str] | None = None
) -> Image:
    """Draw each object's number and outline into the camera's image, with a list beside it.

    A cloud without an image is shown from above.

    Args:
        capture: the view.
        scene: what `GraspSelector.scene` found in it.
        path: where to save it too; .png, .jpg, .jpeg or .webp.

    Returns:
        A Pillow image, RGB, 1600 px wide.

    Raises:
        BoxgraspError: the path cannot be written, or its suffix is no image's.
    """
    place = validate_place(path)
    objects = scene.objects
    count = f"{len(objects)} object{'' if len(objects) == 1 else 's'} on the support plane"
    page = Page(("OBJECTS", f"{count}, numbered from the nearest"))
    page.left.append((_panel(capture, scene),))
    page.right.append((_list(objects, WIDTH - _PANEL_PX[0] - 3 * MARGIN),))
    image = page.finished()
    save(image, place)
    return image


def _panel(capture: Capture, scene: Scene) -> Image:
    objects = scene.objects
    cloud = base_cloud(capture, scene.T_base_camera)
    floor_m = min((float(item.center_m[2] - item.size_m[2] / 2) for item in objects), default=0.0)
    if capture.shape is not None and scene.T_base_camera is not None:
        backdrop = camera_panel(capture, cloud, None, _PANEL_PX, floor_m)
        view, caption = backdrop.view, backdrop.caption
        canvas = Canvas(backdrop.image)
    else:
        places = [_corners(item) for item in objects]
        focus = np.vstack(places) if places else cloud.points[:1].astype(np.float64)
        view, caption = plan_view("above", focus, _PANEL_PX, _LEAST_M), "From above"
        canvas = Canvas(painted(cloud, view, _PANEL_PX, floor_m))
        draw_grid(canvas, view, "above", floor_m)
    _number_objects(canvas, view, objects)
    canvas.text((8, 6), caption, Lettering(19, WHITE, halo=BLACK))
    return canvas.finish()


def _number_objects(canvas: Canvas, view: View, objects: Sequence[SceneObject]) -> None:
    """Outlines first, then the numbers over them, pushed apart where they would meet."""
    for item in objects:
        draw_edges(canvas, view, _corners(item), Stroke(WHITE, 1.5, halo=BLACK))
    placed: list[XY] = []
    for item in objects:
        foot = view.point(item.center_m)
        if foot is None:
            continue
        at = _apart(foot, placed, canvas)
        placed.append(at)
        canvas.line(foot, at, Stroke(WHITE, 2.0, halo=BLACK))
        for radius, color in ((17.5, BLACK), (15.5, WHITE), (13.5, GRIPPER)):
            canvas.dot(at, radius, color)
        number = str(item.number)
        width, height = text_size(number, 18)
        place = (at[0] - width / 2, at[1] - height / 2 + 1)
        canvas.text(place, number, Lettering(18, WHITE))


def _apart(foot: XY, placed: list[XY], canvas: Canvas) -> XY:
    """The nearest place to the foot, inside, where a number covers no other one."""
    right, lower = canvas.width - _EDGE_PX, canvas.height - _EDGE_PX
    foot = (min(max(foot[0], _EDGE_PX), right), min(max(foot[1], _EDGE_PX), lower))
    for step in range(120):
        away, turn = 7.0 * np.sqrt(step), 2.4 * step  # a sunflower: even in all directions
        x = foot[0] + away * float(np.cos(turn))
        y = foot[1] + away * float(np.sin(turn))
        inside = _EDGE_PX <= x <= right and _EDGE_PX <= y <= lower
        if inside and all(np.hypot(x - a, y - b) > _APART_PX for a, b in placed):
            return x, y
    return foot


def _corners(item: SceneObject) -> Floats:
    return corners(make_transform(np.eye(3), item.center_m), item.size_m)


def _list(objects: Sequence[SceneObject], width: int) -> Image:
    """Number, distance, size and points of each object."""
    shown = list(objects[:_MOST_ROWS])
    rest = len(objects) - len(shown)
    canvas = blank(width, 40 + _ROW_PX * max(1, len(shown) + (rest > 0)))
    for x, name in _COLUMNS:
        canvas.text((x, 9), name, _HEADING)
    if not shown:
        canvas.text((10, 42), "no object found", _CELL)
    for k, item in enumerate(shown):
        y = 36 + _ROW_PX * k
        canvas.line((6, y), (width - 6, y), Stroke(RULE, 1.0))
        size = " x ".join(f"{100 * value:.0f}" for value in item.size_m)
        cells = (str(item.number), f"{item.distance_m:.2f} m", size, str(item.points))
        for (x, _), text in zip(_COLUMNS, cells, strict=True):
            room = 158 if x == 160 else width - x - 4
            canvas.text((x, y + 5), fit(text, _CELL.size_px, room), _CELL)
    if rest > 0:
        canvas.text((10, 41 + _ROW_PX * len(shown)), f"and {rest} more", Lettering(17, FAINT))
    return canvas.finish()
