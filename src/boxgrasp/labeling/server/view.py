"""The cloud that an operator turns: one viser server on the loopback for each operator.

viser listens on every interface unless told, and asks for no token: so it is bound to 127.0.0.1,
and the app, which does ask, passes its WebSocket through.
"""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable
from typing import Any, Final

import numpy as np

from boxgrasp.arrays import Floats
from boxgrasp.draw.palette import BLACK, CATEGORY, GRIPPER, INK, RGB
from boxgrasp.draw.shapes import EDGES, Hand, contact_line, corners, fingers, skeleton
from boxgrasp.geometry.transforms import quaternion_xyzw
from boxgrasp.grasps.candidates import FACES, TOP_PERPENDICULAR
from boxgrasp.labeling.server.prepared import PreparedScene, told
from boxgrasp.result import Candidate

LOOPBACK: Final = "127.0.0.1"
# Okabe and Ito 2008: colors that the color-blind tell apart; numbers stand beside them.
FACE_COLORS: Final[tuple[RGB, ...]] = (
    (0, 114, 178),
    (230, 159, 0),
    (204, 121, 167),
    (0, 158, 115),
    (86, 180, 233),
)
_FACE_WORDS: Final = ("left", "front", "right", "top", "top")
_LETTER_SCALE: Final = 1.6  # of viser's own letters, which are small on a tablet
_BAR_M: Final = 0.005  # of a line's bar
_CHOSEN_BAR_M: Final = 0.009
_RAISED_M: Final = 0.006  # between the lines of the two top faces, which cross
_POINT_M: Final = 0.0022
_EDGE_M: Final = 0.0022
_REACH_M: Final = 0.012  # from a click's ray to the point that is meant
_ROUND_M: Final = 0.30  # round the target that the robot's view shows
_TRIANGLES: Final = np.array(
    [
        (0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1),
        (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3),
    ],
    dtype=np.int32,
)  # fmt: skip

_starting = threading.Lock()


class OperatorView:
    """What one operator sees and clicks on; safe from several threads.

    Args:
        on_line: called with a candidate's label when its line is clicked.
        on_point: called with a point of the cloud, (3,) base frame, m, that is clicked while
            `pick_points` is on.
    """

    def __init__(self, on_line: Callable[[int], None], on_point: Callable[[Floats], None]) -> None:
        self._server: Any = _quiet_server()
        self._server.gui.configure_theme(show_logo=False, show_share_button=False)
        self._server.gui.main_panel.minimize()
        self._on_line, self._on_point = on_line, on_point
        self._lock = threading.RLock()
        self._prepared: PreparedScene | None = None
        self._bars: list[Any] = []
        self._labels: list[Any] = []
        self._picking = False
        self._server.on_client_connect(lambda client: self._look(client.camera))

    @property
    def port(self) -> int:
        """Of the viser server, on the loopback."""
        return int(self._server.get_port())

    def close(self) -> None:
        """Stop the viser server."""
        self._server.stop()

    def show(self, prepared: PreparedScene) -> None:
        """Show another scene, from the robot's side.

        Args:
            prepared: the scene.
        """
        with self._lock, self._server.atomic():
            self._prepared = prepared
            scene = self._server.scene
            scene.add_point_cloud(
                "/cloud",
                points=prepared.points,
                colors=prepared.colors,
                point_size=_POINT_M,
                point_shape="circle",
                point_shading="flat",
                precision="float32",
            )
            box = prepared.selection.box
            places = corners(box.T_base_box, box.dimensions_m)
            scene.add_line_segments(
                "/box", np.array([places[list(pair)] for pair in EDGES]), INK, thickness=_EDGE_M
            )
            for bar in self._bars:
                bar.remove()
            self._bars = [self._bar(candidate) for candidate in prepared.selection.candidates]
            self.choose(None, None, revealed=False)
            self.pick_points(on=False)
        self.reset_camera()

    def clear(self) -> None:
        """Show nothing."""
        with self._lock:
            self._prepared = None
            self._bars, self._labels = [], []
            self._server.scene.reset()

    def _bar(self, candidate: Candidate) -> Any:
        """A candidate's line, as a bar that can be clicked."""
        prepared = self._shown()
        ends = contact_line(candidate, prepared.selection.box)
        out = -candidate.T_base_gripper[:3, 0]
        raised = _RAISED_M if candidate.face == TOP_PERPENDICULAR else 0.0
        turned = quaternion_xyzw(candidate.T_base_gripper[:3, :3])
        length = max(float(np.linalg.norm(ends[1] - ends[0])), 0.02)
        bar = self._server.scene.add_box(
            f"/lines/{candidate.label}",
            dimensions=(_BAR_M, length, _BAR_M),
            color=FACE_COLORS[candidate.face - 1],
            position=tuple(ends.mean(axis=0) + out * (_BAR_M / 2 + raised)),
            wxyz=tuple(turned[[3, 0, 1, 2]]),
        )
        bar.on_click(functools.partial(self._clicked, candidate.label))
        return bar

    def _clicked(self, label: int, _event: Any) -> None:
        if not self._picking:
            self._on_line(label)

    def _numbers(self, face: int | None) -> None:
        """The number of each face, over its middle; of a chosen face those of its lines."""
        prepared = self._shown()
        lines = prepared.scene.lines
        for handle in self._labels:
            handle.remove()
        self._labels = []
        if face is not None:
            for line in range(1, lines + 1):
                candidate = prepared.selection.candidates[(face - 1) * lines + line - 1]
                self._label(f"/numbers/{line}", f"{line}", _beside(candidate, prepared))
            return
        for k in range(1, len(FACES) + 1):
            middle = prepared.selection.candidates[(k - 1) * lines + lines // 2]
            ends = contact_line(middle, prepared.selection.box)
            # Both top faces lie on one another: their numbers stand at the ends of their lines.
            place = ends[0] if k >= TOP_PERPENDICULAR - 1 else ends.mean(axis=0)
            out = -middle.T_base_gripper[:3, 0]
            self._label(f"/numbers/{k}", f"{k} {_FACE_WORDS[k - 1]}", place + out * 0.03)

    def _label(self, name: str, text: str, place_m: Floats) -> None:
        self._labels.append(
            self._server.scene.add_label(
                name,
                text,
                position=tuple(place_m),
                font_screen_scale=_LETTER_SCALE,
                anchor="center-center",
            )
        )

    def choose(self, face: int | None, label: int | None, *, revealed: bool) -> None:
        """Show what is chosen: a face's lines by number, or a candidate with the hand there.

        Args:
            face: 1 to 5, None for none.
            label: of a candidate of that face, None for none.
            revealed: whether lines have the color of their candidate's category.
        """
        with self._lock, self._server.atomic():
            prepared = self._prepared
            if prepared is None:
                return
            for bar, candidate in zip(self._bars, prepared.selection.candidates, strict=True):
                bar.color = _color(candidate, revealed=revealed)
                chosen = candidate.label == label
                wide = _CHOSEN_BAR_M if chosen else _BAR_M
                bar.dimensions = (wide, bar.dimensions[1], wide)
                bar.visible = face is None or candidate.face == face
            self._numbers(face)
            self._hand(None if label is None else prepared.selection.candidate(label))

    def _hand(self, candidate: Candidate | None) -> None:
        scene = self._server.scene
        if candidate is None:
            for name in ("/hand", "/fingers", "/way"):
                scene.remove_by_name(name)
            return
        gripper = self._shown().selection.gripper
        T = candidate.T_base_gripper
        outer = Hand(gripper, T).solids(T)
        _add_solids(scene, "/hand", outer, GRIPPER, 0.22)
        _add_solids(scene, "/fingers", fingers(T, gripper), GRIPPER, 1.0)
        strokes = np.array(skeleton(T, gripper))
        scene.add_line_segments("/way", strokes, BLACK, thickness=_EDGE_M * 1.5)

    def pick_points(self, *, on: bool) -> None:
        """Whether a click means a point of the cloud.

        Args:
            on: whether it does.
        """
        with self._lock:
            if on == self._picking:
                return
            self._picking = on
            if on:
                self._server.scene.on_click()(self._point)
            else:
                self._server.scene.remove_click_callback()

    def _point(self, event: Any) -> None:
        prepared = self._prepared
        if prepared is None or not self._picking:
            return
        origin = np.asarray(event.ray_origin, np.float64)
        way = np.asarray(event.ray_direction, np.float64)
        away = prepared.points - origin
        along = away @ way
        off = np.linalg.norm(away - along[:, None] * way, axis=1)
        hit = np.flatnonzero((off < _REACH_M) & (along > 0))
        if len(hit):
            self._on_point(prepared.points[hit[np.argmin(along[hit])]].astype(np.float64))

    def mark(self, point_m: Floats | None) -> None:
        """Mark the right thing where the box is wrong.

        Args:
            point_m: (3,) base frame, m; None takes the mark away.
        """
        if point_m is None:
            self._server.scene.remove_by_name("/mark")
            return
        self._server.scene.add_icosphere(
            "/mark", radius=0.012, color=CATEGORY["red"], position=tuple(point_m)
        )

    def reset_camera(self) -> None:
        """Return every browser of this operator to the robot's view."""
        self._look(self._server.initial_camera)
        for client in self._server.get_clients().values():
            self._look(client.camera)

    def _look(self, camera: Any) -> None:
        prepared = self._prepared
        if prepared is None:
            return
        target = prepared.selection.box.T_base_box[:3, 3]
        camera.position = tuple(prepared.camera_position_m)
        camera.look_at = tuple(target)
        setattr(camera, "up" if hasattr(camera, "up") else "up_direction", (0.0, 0.0, 1.0))
        camera.fov = opening_rad(prepared)

    def _shown(self) -> PreparedScene:
        assert self._prepared is not None
        return self._prepared


def opening_rad(prepared: PreparedScene) -> float:
    """How wide the robot's view is: the target and a hand round it.

    Args:
        prepared: the scene.

    Returns:
        From its lower to its upper edge, rad.
    """
    away = np.linalg.norm(prepared.selection.box.T_base_box[:3, 3] - prepared.camera_position_m)
    return float(np.clip(2 * np.arctan2(_ROUND_M, away), 0.25, 1.2))


def _quiet_server() -> Any:
    """A viser server on a free port of the loopback, without the table that it prints."""
    import rich
    import viser

    with _starting:
        console = rich.get_console()
        before, console.quiet = console.quiet, True
        try:
            return viser.ViserServer(host=LOOPBACK, port=0, verbose=False)
        finally:
            console.quiet = before


def _color(candidate: Candidate, *, revealed: bool) -> RGB:
    kind = told(candidate)["category"] if revealed else None
    return FACE_COLORS[candidate.face - 1] if kind is None else CATEGORY[kind]


def _beside(candidate: Candidate, prepared: PreparedScene) -> Floats:
    """(3,) where a line's number stands: beyond its end that is nearer to the camera."""
    ends = contact_line(candidate, prepared.selection.box)
    away = np.linalg.norm(ends - prepared.camera_position_m, axis=1)
    near, far = ends[np.argmin(away)], ends[np.argmax(away)]
    reach = near - far
    out = -candidate.T_base_gripper[:3, 0]
    return np.asarray(near + 0.015 * reach / max(float(np.linalg.norm(reach)), 1e-6) + out * 0.01)


def _add_solids(scene: Any, name: str, solids: list[Floats], color: RGB, opacity: float) -> None:
    """Boxes, (8, 3) corners each, as one mesh."""
    scene.add_mesh_simple(
        name,
        vertices=np.concatenate(solids).astype(np.float32),
        faces=np.concatenate([_TRIANGLES + 8 * k for k in range(len(solids))]),
        color=color,
        opacity=None if opacity == 1.0 else opacity,
        flat_shading=True,
        side="double",
    )
