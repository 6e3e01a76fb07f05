"""The points that one capture shows, and where it was taken from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Floats, Points, readonly
from boxgrasp.errors import SceneError
from boxgrasp.kernels.backproject import every_step
from boxgrasp.perception.flying_pixels import flying_pixels
from boxgrasp.sensing.capture import Capture, Pixels
from boxgrasp.sensing.sensor_model import SensorModel


@dataclass(frozen=True, eq=False)
class View:
    """One capture's points in its own frame, `source`: optical, or base for a cloud in it.

    Attributes:
        points: (N, 3) float32, source frame, m.
        pixels: (N,) int32, rising: each point's pixel v * W + u, or, without an image, its row in
            the capture's cloud.
        shape: (H, W) of the image, or None.
        T_base_source: (4, 4) maps the view's own frame into the base frame.
        T_base_camera: (4, 4), or None where the camera's place is unknown.
        flying: how many pixels were left out because they lie between two surfaces.
    """

    points: Points
    pixels: Pixels
    shape: tuple[int, int] | None
    T_base_source: Floats
    T_base_camera: Floats | None
    flying: int = 0

    def thinned(self, step: int) -> Points:
        """The points of every `step`-th row and column of the image.

        Args:
            step: 1 for all; without an image all are taken too.

        Returns:
            (n, 3) float32, source frame, m, in the order of `points`.
        """
        if step == 1 or self.shape is None:
            return self.points
        height, width = self.shape
        most = -(-height // step) * -(-width // step)
        kept = np.empty((min(most, len(self.points)), 3), dtype=np.float32)
        return readonly(kept[: every_step(self.points, self.pixels, width, step, kept)])


def seen_points(capture: Capture, sensor: SensorModel) -> tuple[Points, Pixels, int]:
    """The points of a capture that show a surface, and where each stands in it.

    Args:
        capture: the view.
        sensor: what saw it.

    Returns:
        (N, 3) float32, source frame, m; (N,) int32 pixels as `View` has them; and how many pixels
        lie between two surfaces: they are no points, and tell of no free space.
    """
    if capture.shape is not None:
        flying = flying_pixels(capture, sensor)
        count = int(np.count_nonzero(flying))
        return *capture.valid_points(flying if count else None), count
    points, _ = capture.valid_points()
    if capture.robot_mask is None:
        return points, readonly(np.arange(len(points), dtype=np.int32)), 0
    return points, readonly(np.flatnonzero(~capture.robot_mask).astype(np.int32)), 0


def scan_views(scans: Sequence[Capture], sensor: SensorModel) -> tuple[View, ...]:
    """Further captures of the same scene as views.

    Args:
        scans: each with its pose, or in the base frame.
        sensor: what saw them.

    Returns:
        One view a scan.

    Raises:
        SceneError: a scan does not say where its camera stood.
    """
    views = []
    for scan in scans:
        if scan.cloud_frame == "base":
            T_base_source = readonly(np.eye(4))
        elif scan.T_base_camera is not None:
            T_base_source = scan.T_base_camera
        else:
            raise SceneError("a further scan has no T_base_camera; valid: every scan with its pose")
        points, pixels, flying = seen_points(scan, sensor)
        views.append(View(points, pixels, scan.shape, T_base_source, scan.T_base_camera, flying))
    return tuple(views)


def rows_of(values: NDArray[np.int64], among: NDArray[np.int32]) -> NDArray[np.int64]:
    """Where values stand in a rising array.

    Args:
        values: (...,) int64.
        among: (N,) int32, rising.

    Returns:
        (...,) int64 rows of `among`, -1 where a value is not in it.
    """
    if len(among) == 0:
        return np.full(np.shape(values), -1, dtype=np.int64)
    at = np.minimum(np.searchsorted(among, np.asarray(values, dtype=among.dtype)), len(among) - 1)
    return np.where(among[at] == values, at, -1)
