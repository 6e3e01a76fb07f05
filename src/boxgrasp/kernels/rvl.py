"""Unpacking of RVL, a lossless code of depth images (Wilson, ISS 2017), safe on any bytes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from boxgrasp.kernels._jit import jit

TRUNCATED, DAMAGED = -1, -2
LONGEST = 10  # nibbles of a number; 30 bits count any image's pixels


@jit
def _number(words: NDArray[np.uint32], at: int) -> tuple[int, int]:
    """A number of three bits a nibble, lowest first, and the next nibble; below 0 for none."""
    value = 0
    for k in range(LONGEST):
        if at >= 8 * len(words):
            return TRUNCATED, at
        nibble = int(np.int64(words[at >> 3]) >> (28 - 4 * (at & 7))) & 15
        at += 1
        value |= (nibble & 7) << (3 * k)
        if nibble < 8:
            return value, at
    return DAMAGED, at


@jit
def unpack(words: NDArray[np.uint32], pixels: NDArray[np.uint16]) -> int:
    """Pixels of a stream of runs: how many are 0, how many are not, and these as differences.

    Args:
        words: (n,) uint32, the stream, its first nibble the highest of the first word.
        pixels: (N,) uint16 to fill.

    Returns:
        Pixels filled, all of them; below 0 for a broken stream: `TRUNCATED` or `DAMAGED`.
    """
    filled, at, value = 0, 0, 0
    while filled < len(pixels):
        zeros, at = _number(words, at)
        if zeros < 0:
            return zeros
        if zeros > len(pixels) - filled:
            return DAMAGED
        pixels[filled : filled + zeros] = 0
        filled += zeros
        if filled == len(pixels):
            break
        others, at = _number(words, at)
        if others < 0:
            return others
        if others > len(pixels) - filled:
            return DAMAGED
        for _ in range(others):
            folded, at = _number(words, at)
            if folded < 0:
                return folded
            value += (folded >> 1) ^ -(folded & 1)
            if not 0 <= value <= 65535:
                return DAMAGED
            pixels[filled] = value
            filled += 1
    return filled
