"""What a segmentation is."""

from __future__ import annotations

from typing import Protocol

from boxgrasp.arrays import Floats, Points
from boxgrasp.perception.segmentation.clusters import Clusters


class SegmentationConfig(Protocol):
    """What a segmentation reads of the settings in section `scene`."""

    @property
    def cluster_tolerance_m(self) -> float:
        """Points nearer than this are one thing, m."""


class Segmentation(Protocol):
    """A function that says which points over the support plane belong together."""

    def __call__(
        self,
        points: Points,
        colors: Points | None,
        camera_position_m: Floats | None,
        config: SegmentationConfig,
    ) -> Clusters:
        """Group the points.

        Args:
            points: (K, 3) float32 voxel centroids, table frame (z = 0 on the plane), m.
            colors: (K, 3) float32 mean colors, 0 to 255, NaN where unknown; None without any.
            camera_position_m: (3,) table frame, m, or None where it is unknown.
            config: the settings.

        Returns:
            (K,) int64 cluster ids from 0, -1 for points of no thing.
        """
