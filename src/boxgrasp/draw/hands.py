"""A hand on its own, from above, from the side and from the front, with its sizes."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from boxgrasp.arrays import Floats
from boxgrasp.draw.canvas import Canvas, Look, Stroke
from boxgrasp.draw.cards import facts_card
from boxgrasp.draw.files import save, validate_place
from boxgrasp.draw.page import MARGIN, WIDTH, Page, blank
from boxgrasp.draw.palette import BLOCKED, CATEGORY, FAINT, GRIPPER, INK, WHITE
from boxgrasp.draw.planar import XY
from boxgrasp.draw.text import Lettering, text_size
from boxgrasp.geometry.transforms import invert
from boxgrasp.grasps.gripper import Gripper

if TYPE_CHECKING:
    from PIL.Image import Image

_LEFT_PX: Final = 960
_ROUND_PX: Final = 112.0  # free about the hand for its sizes
_MOST_PX: Final = 560.0  # of the hand's width or thickness
_AXIS_PX: Final = 62.0
_PALM: Final = Stroke(FAINT, 2.0)
_FINGER: Final = Stroke(GRIPPER, 2.5)
_SIZE: Final = Stroke(INK, 1.6, halo=WHITE)
_HELP: Final = Stroke(FAINT, 1.0, dash=(5.0, 4.0))
_FLANGE: Final = Stroke(BLOCKED, 3.0, halo=WHITE)
_CAPTION: Final = Lettering(19)
_WORDS: Final = Lettering(16, INK, halo=WHITE)
_FLANGE_WORDS: Final = Lettering(16, BLOCKED, halo=WHITE)
_TCP: Final = Look("diamond", CATEGORY["green"])


@dataclass(frozen=True)
class _Sheet:
    """A view square to two of the gripper's axes, the first to the right, the second up."""

    canvas: Canvas
    axes: tuple[int, int]
    scale: float
    center: XY

    def at(self, point_m: Sequence[float] | Floats) -> XY:
        """Where a point of the gripper's frame is drawn, px."""
        a, b = self.axes
        return (
            self.center[0] + self.scale * float(point_m[a]),
            self.center[1] - self.scale * float(point_m[b]),
        )


def draw_gripper(gripper: Gripper, path: str | os.PathLike[str] | None = None) -> Image:
    """Draw a hand's boxes, opening, tool point and flange in three views.

    Args:
        gripper: the hand.
        path: of the picture; None writes none.

    Returns:
        An RGB image, 1600 px wide.

    Raises:
        BoxgraspError: the picture cannot be written.
    """
    place = validate_place(path)
    right_px = WIDTH - _LEFT_PX - 3 * MARGIN
    length, width, thickness = 2 * gripper.half_m
    scale = min(
        (_LEFT_PX - 2 * _ROUND_PX) / (length + _behind_m(gripper)),
        min(_MOST_PX, right_px - 1.6 * _ROUND_PX) / width,
        _MOST_PX / thickness,
    )
    said = f"{_cm(length)} long, opens {_cm(gripper.max_opening_m)}"
    page = Page((gripper.name.upper(), said))
    high = int(scale * width + 2 * _ROUND_PX), int(scale * thickness + 2 * _ROUND_PX)
    page.left.append((_above(gripper, scale, (_LEFT_PX, high[0])),))
    page.left.append((_side(gripper, scale, (_LEFT_PX, high[1])),))
    page.right.append((_front(gripper, scale, (right_px, high[1])),))
    page.right.append((facts_card(gripper_facts(gripper), right_px),))
    image = page.finished()
    save(image, place)
    return image


def gripper_facts(gripper: Gripper) -> list[tuple[str, str]]:
    """A hand's sizes in words.

    Args:
        gripper: the hand.

    Returns:
        Names and values.
    """
    length, width, thickness = (_cm(float(size)) for size in 2 * gripper.half_m)
    free = f"{_cm(gripper.free_length_m)} before the palm"
    boxes = f"{len(gripper.palm)} of the palm, {len(gripper.finger)} of each finger"
    tcp = gripper.tcp_pose[:3, 3] + (gripper.length_m / 2, 0.0, 0.0)
    rows = [
        ("Outer box", f"{length} x {width} x {thickness}"),
        ("Boxes", boxes if gripper.palm else "one"),
        ("Opens", f"{_cm(gripper.max_opening_m)}, stands at {_cm(gripper.fingers_open_m)}"),
        ("Fingers", free if gripper.palm else f"taken to be {free}"),
        ("Inserts", f"{_cm(gripper.insertion_depth_m)} past the target's face"),
        ("Tool point", f"{_cm(float(tcp[0]))} from the hand's back"),
    ]
    flange = gripper.flange_pose
    if flange is None:
        return [*rows, ("Flange", "not known")]
    turned = "; ".join(f"{name} = {_axis(flange[:3, k])}" for k, name in enumerate("xyz"))
    ahead = " ".join(f"{100 * value:.2f}" for value in flange[:3, 3])
    return [*rows, ("Flange", f"gripper's {turned} of the flange; center at {ahead} cm")]


def _axis(column: Floats) -> str:
    """A direction in words: `-y`, or numbers where it is along no axis."""
    k = int(np.argmax(np.abs(column)))
    if abs(column[k]) > 0.9999:
        return ("-" if column[k] < 0 else "") + "xyz"[k]
    return "(" + " ".join(f"{value:.2f}" for value in column) + ")"


def _above(gripper: Gripper, scale: float, size: tuple[int, int]) -> Image:
    sheet = _sheet(gripper, (0, 1), scale, size, "From above: x to the right, y up")
    half = gripper.half_m
    gap, tip = gripper.fingers_open_m / 2, float(half[0])
    _measure(sheet, ((-half[0], -half[1]), (half[0], -half[1])), (0.0, 34.0), _cm(2 * half[0]))
    away = (-34.0 - scale * _behind_m(gripper), 0.0)
    _measure(sheet, ((-half[0], -half[1]), (-half[0], half[1])), away, _cm(2 * half[1]))
    _measure(sheet, ((tip, -gap), (tip, gap)), (30.0, 0.0), _cm(2 * gap))
    depth = gripper.insertion_depth_m
    face = sheet.at((tip - depth, half[1], 0)), sheet.at((tip - depth, -half[1], 0))
    sheet.canvas.line((face[0][0], face[0][1] - 30), (face[1][0], face[1][1] + 8), _HELP)
    _measure(sheet, ((tip - depth, half[1]), (tip, half[1])), (0.0, -30.0), _cm(depth))
    sheet.canvas.text_beside((face[0][0] - 60, face[0][1] - 52), "face", _WORDS)
    for side in (gap, -gap):
        sheet.canvas.line(sheet.at((tip, side, 0)), sheet.at((tip - 2 * tip, side, 0)), _HELP)
    return _finished(sheet, gripper)


def _side(gripper: Gripper, scale: float, size: tuple[int, int]) -> Image:
    sheet = _sheet(gripper, (0, 2), scale, size, "From the side: x to the right, z up")
    half = gripper.half_m
    ends = ((-half[0], -half[2]), (-half[0], half[2]))
    away = (-34.0 - scale * _behind_m(gripper), 0.0)
    _measure(sheet, ends, away, _cm(2 * half[2]))
    free = gripper.free_length_m
    low = ((half[0] - free, -half[2]), (half[0], -half[2]))
    _measure(sheet, low, (0.0, 34.0), f"{_cm(free)} free")
    return _finished(sheet, gripper)


def _front(gripper: Gripper, scale: float, size: tuple[int, int]) -> Image:
    sheet = _sheet(gripper, (1, 2), scale, size, "From the front: y to the right, z up")
    half, gap = gripper.half_m, gripper.fingers_open_m / 2
    _measure(sheet, ((-gap, -half[2]), (gap, -half[2])), (0.0, 34.0), _cm(2 * gap))
    return _finished(sheet, gripper)


def _sheet(
    gripper: Gripper, axes: tuple[int, int], scale: float, size: tuple[int, int], caption: str
) -> _Sheet:
    canvas = blank(*size)
    canvas.text((10, 8), caption, _CAPTION)
    ahead = scale * _behind_m(gripper) / 2 if axes[0] == 0 else 0.0
    sheet = _Sheet(canvas, axes, scale, (size[0] / 2 + ahead, size[1] / 2 + 8))
    half = gripper.half_m
    _outline(sheet, np.array((-half, half)), _HELP)
    fingers = len(gripper.finger_boxes_m) if gripper.palm else 0
    boxes = list(gripper.boxes_m)
    for k, box in enumerate(boxes):
        _draw_box(sheet, box, _FINGER if k >= len(boxes) - fingers else _PALM)
    return sheet


def _draw_box(sheet: _Sheet, box: Floats, stroke: Stroke) -> None:
    sheet.canvas.polygon(_outline(sheet, box, stroke), stroke.color, 40)


def _outline(sheet: _Sheet, box: Floats, stroke: Stroke) -> list[XY]:
    low, high = sheet.at(box[0]), sheet.at(box[1])
    corners = [low, (high[0], low[1]), high, (low[0], high[1])]
    for a, b in zip(corners, [*corners[1:], corners[0]], strict=True):
        sheet.canvas.line(a, b, stroke)
    return corners


def _behind_m(gripper: Gripper) -> float:
    """How far the flange lies behind the hand, m."""
    if gripper.flange_pose is None:
        return 0.0
    return max(0.0, -gripper.length_m / 2 - float(invert(gripper.flange_pose)[0, 3]))


def _measure(
    sheet: _Sheet, ends: tuple[tuple[float, float], tuple[float, float]], away: XY, said: str
) -> None:
    """A size with its two arrows, beside the hand by `away`, px."""
    points = []
    for end in ends:
        point = [0.0, 0.0, 0.0]
        point[sheet.axes[0]], point[sheet.axes[1]] = end
        at = sheet.at(point)
        moved = (at[0] + away[0], at[1] + away[1])
        sheet.canvas.line(at, (at[0] + 1.15 * away[0], at[1] + 1.15 * away[1]), _HELP)
        points.append(moved)
    middle = ((points[0][0] + points[1][0]) / 2, (points[0][1] + points[1][1]) / 2)
    for end in points:
        sheet.canvas.arrow(middle, end, _SIZE, head=9.0)
    wide, tall = text_size(said, _WORDS.size_px)
    upright = abs(away[0]) > abs(away[1])
    x = middle[0] + (np.sign(away[0]) * 8 - (wide if away[0] < 0 else 0) if upright else -wide / 2)
    y = middle[1] + (-tall / 2 if upright else (6 if away[1] > 0 else -tall - 6))
    sheet.canvas.text((float(x), float(y)), said, _WORDS)


def _finished(sheet: _Sheet, gripper: Gripper) -> Image:
    """Flange and tool point over everything else."""
    flange = gripper.flange_pose
    if flange is not None:
        T = invert(flange)
        origin = sheet.at(T[:3, 3])
        for k, name in enumerate("xyz"):
            way = (float(T[sheet.axes[0], k]), -float(T[sheet.axes[1], k]))
            _draw_axis(sheet.canvas, origin, way, name)
        sheet.canvas.dot(origin, 5.0, BLOCKED)
    tcp = sheet.at(gripper.tcp_pose[:3, 3])
    sheet.canvas.mark(tcp, _TCP, 8.0)
    sheet.canvas.take(tcp, 10.0)
    sheet.canvas.text_beside(tcp, "tool point", _WORDS, must=True)
    return sheet.canvas.finish()


def _draw_axis(canvas: Canvas, origin: XY, way: XY, name: str) -> None:
    """One of the flange's axes; nothing of one that points at the viewer or away."""
    length = float(np.hypot(*way))
    if length < 0.2:
        return
    tip = (origin[0] + _AXIS_PX * way[0], origin[1] + _AXIS_PX * way[1])
    canvas.arrow(origin, tip, _FLANGE, head=12.0)
    said = f"flange {name}"
    left = text_size(said, _FLANGE_WORDS.size_px)[0] if way[0] < -0.3 else 0
    canvas.text((tip[0] + (-left - 5 if left else 5), tip[1] - 10), said, _FLANGE_WORDS)


def _cm(length_m: float) -> str:
    return f"{100 * float(length_m):.1f} cm"
