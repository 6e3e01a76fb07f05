"""Points nearer than a tolerance are one thing: the thesis's segmentation (appendix A)."""

from __future__ import annotations

import numpy as np

from boxgrasp.arrays import Points
from boxgrasp.kernels import cells
from boxgrasp.perception.segmentation.clusters import Clusters
from boxgrasp.perception.segmentation.protocol import SeenPoints, SegmentationConfig, Segments

_SPECK = 8  # points; what is smaller is noise and no obstacle either


def euclidean_segments(seen: SeenPoints, config: SegmentationConfig) -> Segments:
    """Euclidean clusters, exactly, but for specks.

    Args:
        seen: its points alone are looked at.
        config: the tolerance.

    Returns:
        Clusters that may all be objects.
    """
    return Segments.all_objects(clusters_without_specks(seen.points, config.cluster_tolerance_m))


def clusters_without_specks(points: Points, tolerance_m: float) -> Clusters:
    """Euclidean clusters of 8 points and more.

    Args:
        points: (K, 3) float32, m.
        tolerance_m: points nearer than this belong together, m.

    Returns:
        (K,) int64 cluster ids, -1 for specks.
    """
    if len(points) == 0:
        return np.empty(0, dtype=np.int64)
    clusters = cells.euclidean_clusters(points, tolerance_m)
    sizes = np.bincount(clusters)
    clusters[sizes[clusters] < _SPECK] = -1
    return clusters
