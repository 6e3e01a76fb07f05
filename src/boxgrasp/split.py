"""Part things that stand closer than the Euclidean rule can tell."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from boxgrasp.frames import Points


def split_clusters(
    points: Points, labels: NDArray[np.int64], colours: Points | None
) -> NDArray[np.int64]:
    return labels
