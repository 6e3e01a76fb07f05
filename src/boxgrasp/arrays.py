"""Names of the arrays that everything shares, and how they are closed to writing."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]
Points = NDArray[np.float32]


def readonly(array: Array) -> Array:
    """Close an array to writing, so that a frozen value stays what it is.

    Args:
        array: (...,) any shape and dtype.

    Returns:
        (...,) the same array.
    """
    array.setflags(write=False)
    return array
