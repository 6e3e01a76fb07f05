"""What a segmentation is given, and what it answers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Floats, Points
from boxgrasp.perception.segmentation.clusters import Clusters
from boxgrasp.sensing.sensor_model import XTION, SensorModel


@dataclass(frozen=True, eq=False)
class DepthImage:
    """The depth image that points were seen in.

    Attributes:
        depth_m: (H, W) float32 along the optical axis, 0 where it is missing.
        focal_px: along u, px.
        height_m: (H, W) float32 over the support plane, 0 where depth is missing.
        pixels: (S,) int32, rising, flat pixels v * W + u that show one of the points.
        rows: (S,) int64, the row of the point that each of them shows.
    """

    depth_m: NDArray[np.float32]
    focal_px: float
    height_m: NDArray[np.float32]
    pixels: NDArray[np.int32]
    rows: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class SeenPoints:
    """The points over the support plane, and how they were seen.

    Attributes:
        points: (K, 3) float32 voxel centroids, table frame (z = 0 on the plane), m.
        colors: (K, 3) float32 mean colors, 0 to 255, NaN where unknown; None without any.
        camera_position_m: (3,) table frame, m, or None where it is unknown.
        image: of the first view; None for a cloud.
        sensor: what saw them.
    """

    points: Points
    colors: Points | None
    camera_position_m: Floats | None
    image: DepthImage | None
    sensor: SensorModel = XTION


@dataclass(frozen=True, eq=False)
class Segments:
    """Which points belong together.

    Attributes:
        clusters: (K,) int64 ids from 0, -1 for points that are left out.
        objects: (C,) bool, whether each cluster may be an object; the others are obstacles alone.
    """

    clusters: Clusters
    objects: NDArray[np.bool_]

    @staticmethod
    def all_objects(clusters: Clusters) -> Segments:
        """Clusters that may all be objects.

        Args:
            clusters: (K,) int64 ids from 0, -1 for points that are left out.

        Returns:
            The segments.
        """
        return Segments(clusters, np.ones(int(clusters.max(initial=-1)) + 1, dtype=np.bool_))


class SegmentationConfig(Protocol):
    """What a segmentation reads of the settings in section `scene`."""

    @property
    def cluster_tolerance_m(self) -> float:
        """Points nearer than this are one thing, m."""

    @property
    def network(self) -> str | None:
        """Path of the network's file, None for the one that ships."""


class Segmentation(Protocol):
    """A function that says which points over the support plane belong together."""

    def __call__(self, seen: SeenPoints, config: SegmentationConfig) -> Segments:
        """Group the points.

        Args:
            seen: K points, and how they were seen.
            config: the settings.

        Returns:
            Their clusters.
        """
