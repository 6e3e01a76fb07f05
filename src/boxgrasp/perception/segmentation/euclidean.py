"""Points nearer than a tolerance are one thing: the thesis's segmentation (appendix A)."""

from __future__ import annotations

import numpy as np

from boxgrasp.arrays import Floats, Points
from boxgrasp.kernels import cells
from boxgrasp.perception.segmentation.clusters import Clusters
from boxgrasp.perception.segmentation.protocol import SegmentationConfig

_SPECK = 8  # points; what is smaller is noise and no obstacle either


def euclidean_clusters(
    points: Points,
    colors: Points | None,
    camera_position_m: Floats | None,
    config: SegmentationConfig,
) -> Clusters:
    """Euclidean clusters, exactly; as `Segmentation` says, -1 for specks.

    Args:
        points: (K, 3) float32, table frame, m.
        colors: (K, 3) float32 or None, not looked at.
        camera_position_m: (3,) or None, m, not looked at.
        config: the settings.

    Returns:
        (K,) int64 cluster ids.
    """
    if len(points) == 0:
        return np.empty(0, dtype=np.int64)
    clusters = cells.euclidean_clusters(points, config.cluster_tolerance_m)
    sizes = np.bincount(clusters)
    clusters[sizes[clusters] < _SPECK] = -1
    return clusters
