"""One answer as a picture: in the camera's image, from above, from the side, and in words."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import numpy as np

from boxgrasp.arrays import Floats
from boxgrasp.draw.backdrops import Cloud, base_cloud, camera_panel, painted
from boxgrasp.draw.canvas import Canvas
from boxgrasp.draw.evidence import Mark, dot_obstacles, draw_evidence, evidence_of
from boxgrasp.draw.marks import draw_box, draw_candidates, draw_gripper
from boxgrasp.draw.page import Page, save, validated_suffix
from boxgrasp.draw.palette import BLACK, BLOCKED, GRIPPER, RGB, WHITE
from boxgrasp.draw.scales import draw_grid
from boxgrasp.draw.shapes import corners
from boxgrasp.draw.views import View, plan_view
from boxgrasp.draw.words import facts_of, headline_of, style_of
from boxgrasp.grasps.gripper import Gripper
from boxgrasp.grasps.scoring import category
from boxgrasp.result import Candidate, Selection
from boxgrasp.sensing.capture import Capture

if TYPE_CHECKING:
    from PIL.Image import Image

_CAMERA = (908, 681)
_ABOVE = (652, 560)
_SIDE = (652, 400)
_SLAB_M = 0.30


def draw_selection(
    capture: Capture,
    selection: Selection,
    path: str | os.PathLike[str] | None = None,
    *,
    gripper: Gripper | None = None,
) -> Image:
    """The answer drawn into the camera's image, from above (base x up) and from the side.

    Colors are safe for the color-blind and never the only mark. gripper: the hand that was
    selected for, the default hand where none is said. Saved where a path is given, too.

    Raises:
        BoxgraspError: the path cannot be written, or its suffix is no image's.
    """
    target = validated_suffix(path)
    image = _Answer(capture, selection, gripper if gripper is not None else Gripper()).drawn()
    save(image, target)
    return image


class _Answer:
    """The steps of one picture, over what they share."""

    def __init__(self, capture: Capture, selection: Selection, gripper: Gripper) -> None:
        self.selection, self.gripper, self.capture = selection, gripper, capture
        self.box = selection.box
        self.T_base_camera = selection.T_base_camera
        self.floor_m = float(self.box.T_base_box[2, 3] - self.box.dimensions_m[2] / 2)
        self.cloud = base_cloud(capture, self.T_base_camera)
        self.best = _best(selection)
        self.grasp = selection.status == "grasp"
        self.marks: list[Mark] = []
        if self.best is not None:
            self.marks = evidence_of(self.cloud.points, selection, self.best, gripper, self.floor_m)

    def drawn(self) -> Image:
        focus = self._focus()
        view, image, caption = camera_panel(
            self.capture, self.cloud, self.T_base_camera, focus[:16], _CAMERA, self.floor_m
        )
        page = Page(headline_of(self.selection), self._mark_of_status())
        page.left(self._panel(Canvas(image), view, caption, "camera"))
        for kind, size, name in (
            ("above", _ABOVE, "From above"),
            ("side", _SIDE, "From the side (robot on the left)"),
        ):
            view = plan_view(kind, focus, size, 0.52 if kind == "above" else 0.34)
            cloud = self.cloud if kind == "above" else self._slab()
            canvas = Canvas(painted(cloud, view, size, self.floor_m))
            draw_grid(canvas, view, kind, self.floor_m)
            page.right(self._panel(canvas, view, name, kind))
        facts = facts_of(self.selection, self.gripper)
        return page.finished(facts, self.selection, self.gripper)

    def _focus(self) -> Floats:
        """(M, 3) base points that every panel shows: the box, the hand, the way it comes."""
        parts = [corners(self.box.T_base_box, self.box.dimensions_m)]
        if self.best is not None:
            sizes = 2 * self.gripper.half_m
            parts.append(corners(self.best.T_base_gripper, sizes))
            if self.selection.T_base_pregrasp is not None:
                parts.append(corners(self.selection.T_base_pregrasp, sizes)[:4])
        return np.vstack(parts)

    def _slab(self) -> Cloud:
        """The points that the view from the side shows: none far before or behind the target."""
        away = np.abs(self.cloud.points[:, 1] - np.float32(self.box.T_base_box[1, 3]))
        return self.cloud.part(away < _SLAB_M + float(self.box.dimensions_m[1]) / 2)

    def _panel(self, canvas: Canvas, view: View, caption: str, kind: str) -> Image:
        canvas.taken.append((0, 0, 330, 34))
        draw_box(canvas, view, self.box)
        best = self.best
        if best is not None:
            color: RGB = GRIPPER if self.grasp else BLOCKED
            T_pre = self.selection.T_base_pregrasp
            draw_gripper(
                canvas, view, best.T_base_gripper, T_pre, self.gripper, color, not self.grasp
            )
        if not self.grasp:
            dot_obstacles(canvas, view, self.marks)
        draw_candidates(canvas, view, self.selection, None if best is None else best.label, kind)
        if best is not None:
            draw_evidence(canvas, view, self.marks, self.selection, best, self.gripper)
        if kind == "camera":
            self._name_things(canvas, view)
        canvas.text((8, 6), caption, 19, WHITE, halo=BLACK)
        return canvas.finish()

    def _name_things(self, canvas: Canvas, view: View) -> None:
        top = self.box.T_base_box[:3, 3] + (0.0, 0.0, self.box.dimensions_m[2] / 2)
        at = view.point(top)
        if at is not None:
            size = " x ".join(f"{100 * value:.1f}" for value in self.box.dimensions_m)
            canvas.label(at, f"target {size} cm", 17, WHITE, halo=BLACK, away=60, must=True)
        if self.best is not None:
            at = view.point(self.best.T_base_gripper[:3, 3])
            word = "gripper" if self.grasp else "best try, rejected"
            if at is not None:
                canvas.label(
                    at, word, 17, WHITE, halo=GRIPPER if self.grasp else BLOCKED, away=44, must=True
                )

    def _mark_of_status(self) -> tuple[str, str] | None:
        if self.best is None:
            return None
        return category(self.best.visible_clearance_m), style_of(self.best)


def _best(selection: Selection) -> Candidate | None:
    """The chosen candidate, or the one that came nearest."""
    label = selection.label if selection.status == "grasp" else selection.best_rejected
    if label is None or not 1 <= label <= len(selection.candidates):
        return None
    return selection.candidate(label)
