"""How labels spread over a depth image: as the plain rule, along surfaces, and no farther."""

from __future__ import annotations

from collections import deque

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from boxgrasp.kernels.flood import flood

LIMITS = np.array((0.004, 0.008, 0.016, 0.03))


def spread(
    depth: np.ndarray, labels: np.ndarray, open_mask: np.ndarray, limits: np.ndarray
) -> np.ndarray:
    """The rule, pixel by pixel."""
    labels = labels.copy()
    height, width = depth.shape
    for limit in limits:
        queue = deque(zip(*np.nonzero(labels >= 0), strict=True))
        while queue:
            v, u = queue.popleft()
            here = float(depth[v, u])
            most = float(limit) * max(1.0, here * here)
            for dv, du in ((0, -1), (0, 1), (-1, 0), (1, 0)):
                nv, nu, bv, bu = v + dv, u + du, v - dv, u - du
                inside = 0 <= nv < height and 0 <= nu < width
                if not inside or labels[nv, nu] >= 0 or not open_mask[nv, nu]:
                    continue
                there = float(depth[nv, nu])
                costs = [abs(there - here)]
                if 0 <= bv < height and 0 <= bu < width and labels[bv, bu] == labels[v, u]:
                    costs.append(abs(there - 2 * here + float(depth[bv, bu])))
                if costs[0] <= 4 * most and min(costs) <= most:
                    labels[nv, nu] = labels[v, u]
                    queue.append((nv, nu))
    return labels


@settings(deadline=None, max_examples=80)
@given(st.integers(0, 2**32 - 1), st.floats(0.3, 3.0))
def test_it_spreads_as_the_plain_rule(seed: int, middle: float) -> None:
    rng = np.random.default_rng(seed)
    shape = tuple(rng.integers(1, 12, 2))
    depth = ((round(middle * 128) + rng.integers(-3, 4, shape)) / 128).astype(np.float32)  # exact
    open_mask = rng.random(shape) < 0.85
    labels = np.where(rng.random(shape) < 0.15, rng.integers(0, 3, shape), -1)
    expected = spread(depth, labels, open_mask, LIMITS)
    flood(depth, labels, open_mask, LIMITS)
    np.testing.assert_array_equal(labels, expected)


@pytest.mark.parametrize("slant", [0.0, 0.005, 0.012])
def test_it_stops_at_an_outline_and_goes_on_along_a_slant(slant: float) -> None:
    rows, columns = np.mgrid[:40, :60]
    left = columns < 30
    depth = np.where(left, 0.7, 0.78) + slant * (rows - 20) * 0.5
    depth = (depth + np.random.default_rng(0).normal(0, 0.001, depth.shape)).astype(np.float32)
    labels = np.full(depth.shape, -1, dtype=np.int64)
    labels[::8, 3:29:8], labels[::8, 33::8] = 1, 2
    flood(depth, labels, np.ones_like(left), LIMITS)
    np.testing.assert_array_equal(labels, np.where(left, 1, 2))


def test_what_nothing_leads_to_stays_without_a_label() -> None:
    depth = np.full((20, 20), 0.8, dtype=np.float32)
    depth[5:9, 5:9] = 0.6  # an island
    labels = np.full(depth.shape, -1, dtype=np.int64)
    labels[0, 0] = 7
    flood(depth, labels, depth > 0, LIMITS)
    assert (labels[5:9, 5:9] == -1).all() and np.count_nonzero(labels == 7) == 400 - 16
