"""A scene made ready to be looked at: the cloud, the camera's image, the candidates."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Floats, Points, readonly
from boxgrasp.draw.backdrops import camera_panel
from boxgrasp.draw.canvas import Canvas
from boxgrasp.draw.clouds import Cloud, base_cloud, shades
from boxgrasp.draw.files import encoded
from boxgrasp.draw.marks import draw_box
from boxgrasp.draw.words import visible_clearance
from boxgrasp.geometry.transforms import invert, transform
from boxgrasp.grasps.scoring import category
from boxgrasp.labeling.words import LabelScene
from boxgrasp.perception.target import Target
from boxgrasp.result import Candidate, Selection
from boxgrasp.selector import GraspSelector
from boxgrasp.sensing.capture import Capture


@dataclass(frozen=True)
class ShownParams:
    """How much of a scene is sent to the browser.

    Attributes:
        most_points: of the cloud; 50,000 are drawn fluently by a tablet and take 0.5 MB.
        round_target_m: round the target within which points are kept first, m: where a hand moves.
        farthest_m: beyond it nothing is shown, m: the floor and the walls of the room.
        image_px: width of the camera's image beside the cloud, px.
    """

    most_points: int = 50_000
    round_target_m: float = 0.35
    farthest_m: float = 1.2
    image_px: int = 720


SHOWN = ShownParams()


@dataclass(frozen=True, eq=False)
class PreparedScene:
    """All that the page shows of a scene.

    Attributes:
        scene: what is labeled.
        capture: the view.
        selection: the robot's own answer, with every candidate and its checks.
        points: (N, 3) float32, base frame, m.
        colors: (N, 3) uint8 of them.
        image: the camera's view with the target's box in it, JPEG.
    """

    scene: LabelScene
    capture: Capture
    selection: Selection
    points: Points
    colors: NDArray[np.uint8]
    image: bytes

    @property
    def camera_position_m(self) -> Floats:
        """(3,) where the robot looks from, base frame, m; obliquely from its side if unknown."""
        T = self.selection.T_base_camera
        if T is not None:
            return T[:3, 3]
        return readonly(self.selection.box.T_base_box[:3, 3] + (-0.7, 0.0, 0.5))

    def pixel_of(self, point_m: Floats) -> tuple[int, int] | None:
        """The pixel that shows a point.

        Args:
            point_m: (3,) base frame, m.

        Returns:
            (u, v), or None outside the image or without one.
        """
        T, K, shape = self.selection.T_base_camera, self.capture.intrinsics, self.capture.shape
        if T is None or K is None or shape is None:
            return None
        x, y, z = transform(invert(T), np.asarray(point_m, np.float64)[None])[0]
        if z <= 0:
            return None
        u, v = int(round(K[0, 0] * x / z + K[0, 2])), int(round(K[1, 1] * y / z + K[1, 2]))
        return (u, v) if 0 <= u < shape[1] and 0 <= v < shape[0] else None


def prepare(
    scene: LabelScene, capture: Capture, target: Target | None, selector: GraspSelector
) -> PreparedScene:
    """Make a scene ready.

    Args:
        scene: what is labeled.
        capture: the view.
        target: which thing of it; None for the capture's own.
        selector: whose candidates are shown, and whose answer is the robot's.

    Returns:
        The scene with all that is shown.

    Raises:
        BoxgraspError: no support plane, or no such target.
    """
    selection = selector.select(capture, target)
    cloud = base_cloud(capture, selection.T_base_camera)
    box = selection.box
    floor_m = float(box.T_base_box[2, 3] - box.dimensions_m[2] / 2)
    kept = cloud.part(_nearest_first(cloud.points, box.T_base_box[:3, 3], SHOWN))
    shape = capture.shape or (3, 4)
    size = (SHOWN.image_px, round(SHOWN.image_px * shape[0] / shape[1]))
    backdrop = camera_panel(capture, cloud, None, size, floor_m)
    canvas = Canvas(backdrop.image)
    draw_box(canvas, backdrop.view, box)
    return PreparedScene(
        scene,
        capture,
        selection,
        readonly(np.ascontiguousarray(kept.points, dtype=np.float32)),
        readonly(_colors(kept, floor_m)),
        encoded(canvas.finish(), ".jpg"),
    )


def _nearest_first(points: Points, middle_m: Floats, params: ShownParams) -> NDArray[np.int64]:
    """Rows, rising, of the points that are shown: those near the target, then some of the rest."""
    distance = np.linalg.norm(points - middle_m.astype(np.float32), axis=1)
    near = np.flatnonzero(distance <= params.round_target_m)
    rest = np.flatnonzero((distance > params.round_target_m) & (distance <= params.farthest_m))
    # A third is kept for the rest, so that a view full of near points still has its surroundings.
    room = max(params.most_points - len(near), params.most_points // 3)
    rest = _thinned(rest, room)
    near = _thinned(near, params.most_points - len(rest))
    return np.sort(np.concatenate([near, rest]))


def _thinned(rows: NDArray[np.int64], most: int) -> NDArray[np.int64]:
    if len(rows) <= most:
        return rows
    return rows[np.linspace(0, len(rows) - 1, most).astype(np.int64)]


def _colors(cloud: Cloud, floor_m: float) -> NDArray[np.uint8]:
    """(N, 3) the capture's own colors; without any, gray that darkens with the height."""
    if cloud.colors is None:
        return np.ascontiguousarray(shades(cloud, floor_m))
    return np.ascontiguousarray(cloud.colors[:, :3])


def told(candidate: Candidate) -> dict[str, Any]:
    """What the robot thinks of a candidate, for an operator who asks.

    Args:
        candidate: any.

    Returns:
        Plain values: category, clearance to visible obstacles in meters, whether it passed, and
        the sentence of each check that it failed.
    """
    near = visible_clearance(candidate)
    return {
        "label": candidate.label,
        "category": None if near is None else category(near.value),
        "clearance_m": None if near is None else near.value,
        "passed": candidate.passed,
        "failed": [item.sentence for item in candidate.rejections],
    }
