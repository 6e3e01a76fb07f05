"""Unpacking of OctoMap's tree streams into leaves, safe on any bytes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from boxgrasp.kernels._jit import jit

DEPTH = 16  # levels of OctoMap's trees
TRUNCATED, TOO_DEEP, BAD_VALUE = -1, -2, -3


@jit
def unpack(
    data: NDArray[np.uint8],
    floats: NDArray[np.float32],
    binary: bool,
    record: int,
    free: float,
    occupied: float,
    fill: bool,
    keys: NDArray[np.int32],
    depths: NDArray[np.uint8],
    values: NDArray[np.float32],
) -> tuple[int, int, int]:
    """Leaves of a tree's stream in preorder: counted, and written where asked for.

    A binary stream holds two bits a child: free, occupied, or a node of its own.

    Args:
        data: (n,) uint8, the stream.
        floats: (m,) float32, its nodes' values; empty for a binary stream.
        binary: whether it holds two bits a child.
        record: bytes of a node.
        free: log-odds of a free child of a binary stream.
        occupied: of an occupied one.
        fill: whether leaves are written.
        keys: (K, 3) int32 to fill, the lowest cell of each leaf, from 0.
        depths: (K,) uint8 to fill.
        values: (K,) float32 to fill, log-odds.

    Returns:
        Leaves, nodes and bytes; leaves below 0 for a broken stream: `TRUNCATED`, `TOO_DEEP` or
        `BAD_VALUE`.
    """
    size = len(data)
    todo = np.zeros(DEPTH + 1, dtype=np.int64)  # children still to visit, a bit each, by depth
    base = np.zeros((DEPTH + 1, 3), dtype=np.int64)
    leaves, nodes, at, depth = 0, 1, 0, 0
    while True:
        if at + record > size:
            return TRUNCATED, nodes, at
        if binary:
            bits = int(data[at]) | (int(data[at + 1]) << 8)
            inner = 0
            for child in range(8):
                kind = (bits >> (2 * child)) & 3
                if kind == 3:
                    inner |= 1 << child
                elif kind:
                    if depth >= DEPTH:
                        return TOO_DEEP, nodes, at
                    if fill:
                        half = 1 << (DEPTH - depth - 1)
                        for a in range(3):
                            keys[leaves, a] = base[depth, a] + half * ((child >> a) & 1)
                        depths[leaves] = depth + 1
                        values[leaves] = free if kind == 1 else occupied
                    leaves += 1
                    nodes += 1
        else:
            inner = int(data[at + record - 1])
            value = floats[at // record]
            if not np.isfinite(value):
                return BAD_VALUE, nodes, at
            if inner == 0:
                if fill:
                    for a in range(3):
                        keys[leaves, a] = base[depth, a]
                    depths[leaves] = depth
                    values[leaves] = value
                leaves += 1
        at += record
        if inner and depth >= DEPTH:
            return TOO_DEEP, nodes, at
        todo[depth] = inner
        while todo[depth] == 0:
            if depth == 0:
                return leaves, nodes, at
            depth -= 1
        child = 0
        while not (todo[depth] >> child) & 1:
            child += 1
        todo[depth] &= ~(1 << child)
        half = 1 << (DEPTH - depth - 1)
        for a in range(3):
            base[depth + 1, a] = base[depth, a] + half * ((child >> a) & 1)
        depth += 1
        nodes += 1
