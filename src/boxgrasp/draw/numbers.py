"""The objects that were found, numbered in the image and listed beside it."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import ArrayLike

from boxgrasp.arrays import Floats
from boxgrasp.draw.backdrops import base_cloud, camera_panel, painted
from boxgrasp.draw.canvas import XY, Canvas, fit, text_size
from boxgrasp.draw.page import HEADER, MARGIN, WIDTH, banner, blank, save, validated_suffix
from boxgrasp.draw.palette import BLACK, FAINT, GRIPPER, INK, PAPER, RULE, WHITE
from boxgrasp.draw.scales import draw_grid
from boxgrasp.draw.shapes import EDGES, corners
from boxgrasp.draw.views import View, plan_view
from boxgrasp.errors import BoxgraspError
from boxgrasp.geometry.transforms import invert, make_transform, validate_transform
from boxgrasp.perception.scene import SceneConfig, SceneObject
from boxgrasp.perception.support_plane import find_support_plane, support_frame
from boxgrasp.sensing.capture import Capture

if TYPE_CHECKING:
    from PIL.Image import Image

_PANEL: Final = (1060, 795)
_ROW: Final = 30
_ROWS_MOST: Final = 60


def draw_objects(
    capture: Capture,
    objects: Sequence[SceneObject],
    path: str | os.PathLike[str] | None = None,
    *,
    T_base_camera: ArrayLike | None = None,
) -> Image:
    """Each object's number and outline in the camera's image, with a list beside it.

    A cloud without an image is shown from above. T_base_camera: (4, 4), the capture's own where
    none is given; where that has none either, the support plane's, as in an answer.

    Raises:
        BoxgraspError: the path cannot be written, or its suffix is no image's; a transform that
            is none.
    """
    target = validated_suffix(path)
    if T_base_camera is not None:
        T: Floats | None = validate_transform(T_base_camera, "T_base_camera")
    else:
        T = capture.T_base_camera if capture.T_base_camera is not None else _support_pose(capture)
    image = _drawn(capture, objects, T)
    save(image, target)
    return image


def _support_pose(capture: Capture) -> Floats | None:
    """T_base_camera of the support plane, as the scene finds it; None where it cannot."""
    if capture.cloud_frame != "optical":
        return None
    try:
        plane = find_support_plane(
            capture.valid_points()[0], None, np.zeros(3), SceneConfig().max_range_m
        )
    except BoxgraspError:
        return None
    return invert(support_frame(plane, True))


def _drawn(capture: Capture, objects: Sequence[SceneObject], T: Floats | None) -> Image:
    from PIL import Image as Images

    cloud = base_cloud(capture, T)
    floor_m = min((float(item.center_m[2] - item.size_m[2] / 2) for item in objects), default=0.0)
    if capture.shape is not None and (T is not None or capture.intrinsics is not None):
        known = T if T is not None else np.eye(4)
        view, image, caption = camera_panel(capture, cloud, known, None, _PANEL, floor_m)
        canvas = Canvas(image)
    else:
        places = [corners(_upright(item), item.size_m) for item in objects]
        focus = np.vstack(places) if places else cloud.points[:1].astype(np.float64)
        view, caption = plan_view("above", focus, _PANEL, 0.5), "From above"
        canvas = Canvas(painted(cloud, view, _PANEL, floor_m))
        draw_grid(canvas, view, "above", floor_m)
    pixels = capture.intrinsics if T is None else None
    number_objects(canvas, view, objects, pixels)
    canvas.text((8, 6), caption, 19, WHITE, halo=BLACK)
    panel, table = canvas.finish(), _list(objects, WIDTH - _PANEL[0] - 3 * MARGIN)
    page = Images.new("RGB", (WIDTH, HEADER + 2 * MARGIN + max(panel.height, table.height)), PAPER)
    count = f"{len(objects)} object{'' if len(objects) == 1 else 's'} on the support plane"
    page.paste(banner(("OBJECTS", f"{count}, numbered from the nearest"), None), (0, 0))
    page.paste(panel, (MARGIN, HEADER + MARGIN))
    page.paste(table, (2 * MARGIN + _PANEL[0], HEADER + MARGIN))
    return page


def number_objects(
    canvas: Canvas, view: View, objects: Sequence[SceneObject], K: Floats | None = None
) -> None:
    """Outlines first, then the numbers over them, pushed apart where they would meet.

    K: (3, 3) intrinsics where the camera's place is unknown: numbers go to the objects' pixels.
    """
    for item in objects if K is None else ():
        places = corners(_upright(item), item.size_m)
        for a, b in EDGES:
            ends = view.segment(places[a], places[b])
            if ends is not None:
                canvas.line(*ends, WHITE, 1.5, halo=BLACK)
    placed: list[XY] = []
    for item in objects:
        foot = view.point(item.center_m) if K is None else _at_pixel(view, K, item.pixel)
        if foot is None:
            continue
        at = _apart(foot, placed, canvas)
        placed.append(at)
        canvas.line(foot, at, WHITE, 2.0, halo=BLACK)
        canvas.dot(at, 17.5, BLACK)
        canvas.dot(at, 15.5, WHITE)
        canvas.dot(at, 13.5, GRIPPER)
        text = str(item.number)
        width, height = text_size(text, 18)
        canvas.text((at[0] - width / 2, at[1] - height / 2 + 1), text, 18, WHITE)


def _at_pixel(view: View, K: Floats, pixel: tuple[int, int] | None) -> XY | None:
    """A pixel of the camera's image, in panel pixels."""
    if pixel is None:
        return None
    x = (pixel[0] - K[0, 2]) * view.fx / K[0, 0] + view.cx
    y = (pixel[1] - K[1, 2]) * view.fy / K[1, 1] + view.cy
    return float(x), float(y)


def _apart(foot: XY, placed: list[XY], canvas: Canvas) -> XY:
    """The nearest place to the foot, inside, where a number covers no other one."""
    edge = 20.0
    foot = (
        min(max(foot[0], edge), canvas.width - edge),
        min(max(foot[1], edge), canvas.height - edge),
    )
    for step in range(120):
        away, turn = 7.0 * np.sqrt(step), 2.4 * step  # a sunflower: even in all directions
        at = (foot[0] + away * float(np.cos(turn)), foot[1] + away * float(np.sin(turn)))
        inside = edge <= at[0] <= canvas.width - edge and edge <= at[1] <= canvas.height - edge
        if inside and all(np.hypot(at[0] - x, at[1] - y) > 37 for x, y in placed):
            return at
    return foot


def _upright(item: SceneObject) -> Floats:
    return make_transform(np.eye(3), item.center_m)


def _list(objects: Sequence[SceneObject], width: int) -> Image:
    """Number, distance, size and points of each object."""
    shown = list(objects[:_ROWS_MOST])
    rest = len(objects) - len(shown)
    canvas = blank(width, 40 + _ROW * max(1, len(shown) + (rest > 0)))
    columns = ((10, "no."), (60, "distance"), (160, "size x, y, z (cm)"), (330, "points"))
    for x, name in columns:
        canvas.text((x, 9), name, 15, FAINT)
    if not shown:
        canvas.text((10, 42), "no object found", 17, INK)
    for k, item in enumerate(shown):
        y = 36 + _ROW * k
        canvas.line((6, y), (width - 6, y), RULE, 1.0)
        size = " x ".join(f"{100 * value:.0f}" for value in item.size_m)
        cells = (str(item.number), f"{item.distance_m:.2f} m", size, str(item.points))
        for (x, _), text in zip(columns, cells, strict=True):
            canvas.text((x, y + 5), fit(text, 17, 158 if x == 160 else width - x - 4), 17, INK)
    if rest > 0:
        canvas.text((10, 41 + _ROW * len(shown)), f"and {rest} more", 17, FAINT)
    return canvas.finish()
