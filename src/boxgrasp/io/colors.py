"""Colors as clouds pack them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def unpack_rgb(packed: NDArray[Any]) -> NDArray[np.uint8] | None:
    """Colors of packed values.

    Args:
        packed: (N,) of four bytes each, 0x..RRGGBB, float or integer.

    Returns:
        (N, 3) uint8 red, green, blue; None for values of another size.
    """
    if packed.dtype.itemsize != 4:
        return None
    bits = np.ascontiguousarray(packed, packed.dtype.newbyteorder("=")).view(np.uint32)
    return np.stack([bits >> 16, bits >> 8, bits], axis=1).astype(np.uint8)
