"""How far down a column under a point may reach before a cell that was seen free."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from boxgrasp.kernels._jit import jit


@jit
def lowest_layers(
    cells: NDArray[np.int64],
    inside: NDArray[np.bool_],
    state: NDArray[np.uint8],
    free: int,
) -> NDArray[np.int64]:
    """How far down the column under each point reaches before a free cell.

    Args:
        cells: (N, 3) int64 cell of each point.
        inside: (N,) bool, whether it is in the map.
        state: (nx, ny, nz) uint8.
        free: the state of a free cell.

    Returns:
        (N,) int64 lowest layer, -1 for down to the plane, 2^30 for points outside.
    """
    layer = np.empty(cells.shape[0], dtype=np.int64)
    for i in range(cells.shape[0]):
        k = cells[i, 2]
        if not inside[i]:
            layer[i] = 1 << 30
            continue
        while k > 0 and state[cells[i, 0], cells[i, 1], k - 1] != free:
            k -= 1
        layer[i] = k if k > 0 else -1
    return layer
