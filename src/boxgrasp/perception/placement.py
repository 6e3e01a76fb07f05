"""Where a view lies: its support plane, and with it every frame (docs/conventions.md)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Floats, Points, readonly
from boxgrasp.geometry.plane import Plane
from boxgrasp.geometry.transforms import invert, transform
from boxgrasp.perception.support_plane import find_support_plane, patch_over, support_frame
from boxgrasp.perception.supports import Supports, find_supports
from boxgrasp.sensing.capture import Capture
from boxgrasp.sensing.sensor_model import XTION, SensorModel


@dataclass(frozen=True, eq=False)
class Placement:
    """The support plane in the view's own frame (source), and how the frames lie to each other.

    Attributes:
        plane: the support plane, source frame.
        supports: it and the level surfaces beside it, table frame.
        T_source_table: (4, 4), z on the plane's normal, z = 0 on it.
        T_base_source: (4, 4).
        T_base_table: (4, 4).
        T_base_camera: (4, 4), or None where the camera's place is unknown.
        frame: `given`, or `support` where the base frame is the plane's.
    """

    plane: Plane
    supports: Supports
    T_source_table: Floats
    T_base_source: Floats
    T_base_table: Floats
    T_base_camera: Floats | None
    frame: str

    def camera_position_table_m(self, T_base_camera: Floats | None) -> Floats | None:
        """Where a camera stands over the table.

        Args:
            T_base_camera: (4, 4), or None where it is unknown.

        Returns:
            (3,) float64, table frame, m, or None.
        """
        if T_base_camera is None:
            return None
        position: Floats = transform(invert(self.T_base_table), T_base_camera[None, :3, 3])[0]
        return position

    def heights(self, points: Points) -> Points:
        """Signed heights over what each point stands over.

        Args:
            points: (N, 3) float32, source frame, m.

        Returns:
            (N,) float32, m.
        """
        return self.supports.heights(transform(invert(self.T_source_table), points))

    def over_seen(self, points: Points, above: Points) -> NDArray[np.bool_]:
        """Whether points stand over the part of a surface that was seen.

        Args:
            points: (N, 3) float32 of the view, source frame, m.
            above: (K, 3) float32, the points in question, table frame, m.

        Returns:
            (K,) bool.
        """
        return patch_over(points, self.T_source_table, above) | (self.supports.owners(above) > 0)


def place_view(
    capture: Capture, points: Points, max_range_m: float, sensor: SensorModel = XTION
) -> Placement:
    """Find the plane that carries the objects, and lay the frames by it or as they are given.

    Args:
        capture: the view.
        points: (N, 3) float32 its points, source frame, m.
        max_range_m: how far from the camera objects are looked for, m.
        sensor: whose noise the points have.

    Returns:
        Plane and frames.

    Raises:
        SceneError: no support plane.
    """
    optical, given = capture.cloud_frame == "optical", capture.T_base_camera
    up: Floats | None = np.array([0.0, 0.0, 1.0])
    # A copy in one piece: for a view into T a kernel would be compiled once more.
    camera_position_m = None if given is None else np.array(given[:3, 3])
    if optical:
        up, camera_position_m = None if given is None else given[2, :3], np.zeros(3)
    plane = find_support_plane(points, up, camera_position_m, max_range_m, sensor)
    T_source_table = support_frame(plane, optical)
    supports = find_supports(points, T_source_table, camera_position_m, max_range_m)
    T_base_source = np.eye(4)
    if optical:
        T_base_source = np.array(given) if given is not None else invert(T_source_table)
    readonly(T_base_source)
    return Placement(
        plane=plane,
        supports=supports,
        T_source_table=T_source_table,
        T_base_source=T_base_source,
        T_base_table=readonly(T_base_source @ T_source_table),
        T_base_camera=T_base_source if optical else given,
        frame="support" if optical and given is None else "given",
    )
