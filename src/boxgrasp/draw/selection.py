"""One answer as a picture: in the camera's image, from above, from the side, and in words."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Final

import numpy as np

from boxgrasp.arrays import Floats
from boxgrasp.draw.backdrops import Backdrop, camera_panel
from boxgrasp.draw.canvas import Canvas
from boxgrasp.draw.cards import candidates_card, checks_card, facts_card, legend_card
from boxgrasp.draw.clouds import Cloud, base_cloud, painted
from boxgrasp.draw.evidence import dot_held, dot_obstacles, draw_marks, held_points, marks_of
from boxgrasp.draw.files import encoded, save, validate_place
from boxgrasp.draw.marks import draw_box, draw_candidates, draw_contacts, draw_hand
from boxgrasp.draw.page import MARGIN, Page
from boxgrasp.draw.palette import BLACK, BLOCKED, GRIPPER, WHITE
from boxgrasp.draw.scales import draw_grid
from boxgrasp.draw.shapes import Hand, corners
from boxgrasp.draw.text import Lettering
from boxgrasp.draw.views import View, plan_view
from boxgrasp.draw.words import facts_of, headline_of, look_of
from boxgrasp.forks import cached_property
from boxgrasp.result import Selection
from boxgrasp.sensing.capture import Capture

if TYPE_CHECKING:
    from PIL.Image import Image

_CAMERA_PX: Final = (908, 681)
_ABOVE_PX: Final = (652, 640)
_SIDE_PX: Final = (652, 480)
_CHECKS_PX: Final = 384
_SLAB_M: Final = 0.30  # before and behind the target, shown from the side
_LEAST_ABOVE_M: Final = 0.52  # that the view from above shows
_LEAST_SIDE_M: Final = 0.34


def draw_selection(
    capture: Capture, selection: Selection, path: str | os.PathLike[str] | None = None
) -> Image:
    """Draw an answer into the camera's image, from above (base x up) and from the side.

    Colors are safe for the color-blind and never the only mark. All that is said comes from the
    answer: its checks, its rejections, its gripper.

    Args:
        capture: what the answer was given for.
        selection: the answer.
        path: where to save it too; .png, .jpg, .jpeg or .webp.

    Returns:
        A Pillow image, RGB, 1600 px wide.

    Raises:
        BoxgraspError: the path cannot be written, or its suffix is no image's.
    """
    place = validate_place(path)
    image = _Picture(capture, selection).drawn()
    save(image, place)
    return image


def selection_png(capture: Capture, selection: Selection) -> bytes:
    """The picture of `draw_selection` as a PNG, as notebooks ask for it.

    Args:
        capture: what the answer was given for.
        selection: the answer.

    Returns:
        The PNG file's content.
    """
    return encoded(_Picture(capture, selection).drawn())


class _Picture:
    """The steps of one picture, over what they share."""

    def __init__(self, capture: Capture, selection: Selection) -> None:
        self.capture, self.selection, self.box = capture, selection, selection.box
        self.color = BLOCKED if selection.grasp is None else GRIPPER
        self.floor_m = float(self.box.T_base_box[2, 3] - self.box.dimensions_m[2] / 2)
        self.cloud = base_cloud(capture, selection.T_base_camera)
        self.marks = marks_of(selection)
        self.held = held_points(selection, self.cloud.points)

    @cached_property
    def hand(self) -> Hand | None:
        """The hand at the candidate that is shown."""
        grasp, shown = self.selection.grasp, self.selection.shown
        if shown is None:
            return None
        start = None if grasp is None else grasp.T_base_pregrasp
        return Hand(self.selection.gripper, shown.T_base_gripper, start)

    def drawn(self) -> Image:
        """The page with its three panels and its cards."""
        shown = self.selection.shown
        page = Page(headline_of(self.selection), None if shown is None else look_of(shown))
        width = _CAMERA_PX[0]
        facts = facts_of(self.selection)
        page.left.append((self._camera(),))
        if shown is None:
            page.left.append((facts_card(facts, width),))
        else:
            words = facts_card(facts, width - MARGIN - _CHECKS_PX)
            page.left.append((words, checks_card(shown, _CHECKS_PX)))
        page.left.append((candidates_card(self.selection, width),))
        page.right.append((self._plan("above", _ABOVE_PX, _LEAST_ABOVE_M, "From above"),))
        caption = "From the side (robot on the left)"
        page.right.append((self._plan("side", _SIDE_PX, _LEAST_SIDE_M, caption),))
        page.right.append((legend_card(self.selection, _SIDE_PX[0]),))
        return page.finished()

    def _camera(self) -> Image:
        focus = np.vstack(self._things())
        backdrop = camera_panel(self.capture, self.cloud, focus, _CAMERA_PX, self.floor_m)
        return self._panel(backdrop, "camera")

    def _plan(self, kind: str, size: tuple[int, int], least_m: float, caption: str) -> Image:
        things = self._things()
        if self.hand is not None and self.hand.T_base_pregrasp is not None:
            things.append(corners(self.hand.T_base_pregrasp, self.hand.size_m)[:4])  # its back
        view = plan_view(kind, np.vstack(things), size, least_m)
        cloud = self.cloud if kind == "above" else self._slab()
        image = painted(cloud, view, size, self.floor_m)
        return self._panel(Backdrop(view, image, caption), kind)

    def _things(self) -> list[Floats]:
        """(M, 3) base points each that every panel shows: the box, the hand, what is near it."""
        things = [corners(self.box.T_base_box, self.box.dimensions_m)]
        if self.hand is not None:
            things.append(corners(self.hand.T_base_gripper, self.hand.size_m))
        for mark in self.marks:
            if mark.point_m is not None and mark.is_near:
                things.append(mark.point_m[None])
        return things

    def _slab(self) -> Cloud:
        """The points that the view from the side shows: none far before or behind the target."""
        away = np.abs(self.cloud.points[:, 1] - np.float32(self.box.T_base_box[1, 3]))
        return self.cloud.part(away < _SLAB_M + float(self.box.dimensions_m[1]) / 2)

    def _panel(self, backdrop: Backdrop, kind: str) -> Image:
        canvas, view = Canvas(backdrop.image), backdrop.view
        ask = self.selection.grasp is None
        if kind != "camera":
            draw_grid(canvas, view, kind, self.floor_m)
        canvas.taken.append((0, 0, 330, 34))
        draw_box(canvas, view, self.box)
        if self.hand is not None:
            draw_hand(canvas, view, self.hand, self.color, dashed=ask)
        if ask:
            dot_obstacles(canvas, view, self.cloud.points, self.marks)
        self._close(canvas, view)
        draw_candidates(canvas, view, self.selection, self.held, kind)
        draw_marks(canvas, view, self.selection, self.marks)
        if kind == "camera":
            self._name_things(canvas, view)
        canvas.text((8, 6), backdrop.caption, Lettering(19, WHITE, halo=BLACK))
        return canvas.finish()

    def _close(self, canvas: Canvas, view: View) -> None:
        """Where the fingers close, and what they hold: under the shown candidate's line alone."""
        shown, candidates = self.selection.shown, self.selection.candidates
        draw_contacts(canvas, view, (c for c in candidates if c is not shown), self.box)
        dot_held(canvas, view, self.held)
        draw_contacts(canvas, view, (c for c in candidates if c is shown), self.box)

    def _name_things(self, canvas: Canvas, view: View) -> None:
        top = self.box.T_base_box[:3, 3] + (0.0, 0.0, self.box.dimensions_m[2] / 2)
        at = view.point(top)
        if at is not None:
            size = " x ".join(f"{100 * value:.1f}" for value in self.box.dimensions_m)
            lettering = Lettering(17, WHITE, halo=BLACK)
            canvas.text_beside(at, f"target {size} cm", lettering, away=60, must=True)
        at = None if self.hand is None else view.point(self.hand.T_base_gripper[:3, 3])
        if at is not None:
            shown = self.selection.shown
            asked = "the best, not taken" if shown and shown.passed else "nearest, rejected"
            words = "gripper" if self.selection.grasp is not None else asked
            lettering = Lettering(17, WHITE, halo=self.color)
            canvas.text_beside(at, words, lettering, away=44, must=True)
