"""An OctoMap of octomap_server or of MoveIt's planning scene, in place of the node's own map."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from boxgrasp_msgs.msg import Status
from numpy.typing import NDArray

from boxgrasp.config import Config
from boxgrasp.errors import CaptureError
from boxgrasp.io.fields import stamp_ns
from boxgrasp.io.frames import TransformBuffer
from boxgrasp.io.octomap import octomap_cells
from boxgrasp.mapping.octomap_leaves import MapCells
from boxgrasp_ros.failures import Failure
from boxgrasp_ros.settings import NodeConfig

_SAME: Final = 1e-6  # m between two cell sizes; between entries of two frames' transforms


@dataclass(frozen=True, eq=False)
class _Held:
    """The newest map: its message, its frame, where its origin lies, its time, its topic."""

    message: Any
    frame: str
    origin: Any
    stamp_ns: int
    topic: str


class Maps:
    """The newest OctoMap, read when it is first asked for."""

    def __init__(self) -> None:
        """Start empty."""
        self._held: _Held | None = None
        self._read: tuple[_Held, MapCells] | None = None

    def put(self, message: Any, topic: str, now_ns: int) -> None:
        """Take a map in place of the one before.

        Args:
            message: octomap_msgs/Octomap.
            topic: it came on.
            now_ns: time of a map whose stamp is 0.
        """
        self._hold(message, message, None, topic, now_ns)

    def put_scene(self, message: Any, topic: str, now_ns: int) -> None:
        """Take the map out of a planning scene; most updates hold none.

        Args:
            message: moveit_msgs/PlanningScene; its map has frame and origin beside it.
            topic: it came on.
            now_ns: time of a map whose stamp is 0, as MoveIt leaves it.
        """
        found = message.world.octomap
        if len(found.octomap.data):
            self._hold(found.octomap, found, found.origin, topic, now_ns)

    def _hold(self, message: Any, stamped: Any, origin: Any, topic: str, now_ns: int) -> None:
        try:
            stamp = stamp_ns(stamped)
        except CaptureError:
            stamp = 0
        frame = str(stamped.header.frame_id).lstrip("/")
        self._held = _Held(message, frame, origin, stamp or now_ns, topic)

    def cells(
        self,
        stamp: int,
        transforms: TransformBuffer,
        config: Config,
        node_config: NodeConfig,
    ) -> MapCells:
        """The map for a view.

        Args:
            stamp: of the view, ns.
            transforms: of /tf and /tf_static.
            config: of the cells' size.
            node_config: of the base frame and the oldest map.

        Returns:
            Its leaves, in the base frame.

        Raises:
            Failure: no map, one too old, of another resolution, or in another frame.
            MapError: it is damaged.
            TransformError: its frame is not known.
        """
        held = self._held
        if held is None:
            raise Failure(Status.BAD_MAP, "use_octomap is set, but no map came; valid: a map")
        age_s = (stamp - held.stamp_ns) / 1e9
        if age_s > node_config.max_octomap_age_s:
            raise Failure(
                Status.BAD_MAP,
                f"map on {held.topic} is {age_s:.1f} s older than the view; valid: up to "
                f"{node_config.max_octomap_age_s:g} s (max_octomap_age_s)",
            )
        found_m, wanted_m = float(held.message.resolution), config.mapping.resolution_m
        if not abs(found_m - wanted_m) <= _SAME:  # NaN too
            raise Failure(
                Status.BAD_MAP,
                f"map on {held.topic} has cells of {found_m:g} m; valid: {wanted_m:g} m "
                "(mapping.resolution_m)",
            )
        self._check_frame(held, stamp, transforms, node_config)
        if self._read is None or self._read[0] is not held:
            self._read = held, octomap_cells(held.message)
        return self._read[1]

    def _check_frame(
        self, held: _Held, stamp: int, transforms: TransformBuffer, node_config: NodeConfig
    ) -> None:
        """An OctoMap's cells lie along its own axes, so its frame must be the base's."""
        frame, base_frame = held.frame, node_config.base_frame
        if not frame:
            raise Failure(Status.BAD_MAP, f"map on {held.topic} has no frame_id; valid: a frame")
        off: NDArray[np.float64] = np.zeros(1)
        if frame != base_frame:
            wait_s = node_config.wait_for_transform_s
            off = transforms.wait(base_frame, frame, stamp, wait_s) - np.eye(4)
        if held.origin is not None:
            at, turn = held.origin.position, held.origin.orientation
            off = np.append(off, (at.x, at.y, at.z, turn.x, turn.y, turn.z))
        if not np.abs(off).max() <= _SAME:  # NaN too
            raise Failure(
                Status.BAD_MAP,
                f"map on {held.topic} is in the frame {frame!r:.60}, moved or turned against "
                f"{base_frame!r}; valid: a map in the base frame",
            )
