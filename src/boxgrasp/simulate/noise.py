"""Sensor noise of a structured-light camera such as the Asus Xtion."""

from __future__ import annotations

from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from boxgrasp.errors import SceneError


@dataclass(frozen=True)
class NoiseModel:
    """Axial noise sigma = floor + growth (z - 0.4 m)^2 (Nguyen 2012), steps, drop-outs, color.

    edge_jump_m is taken at 1 m and grows with z^2; a pixel beside a larger jump in depth is
    missing with edge_dropout, any other with dropout, all beyond range_m.
    color_sigma in gray levels.
    """

    sigma_m: float = 0.0012
    sigma_growth_per_m: float = 0.0019
    step_m: float = 0.001
    edge_jump_m: float = 0.02
    edge_dropout: float = 0.7
    dropout: float = 0.003
    range_m: float = 10.0
    color_sigma: float = 4.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not (np.isfinite(value) and value >= 0):
                raise SceneError(f"noise {name} is {value}; valid: a number of 0 or more")
            if "dropout" in name and value > 1:
                raise SceneError(f"noise {name} is {value}; valid: a share of 0 to 1")


def axial_sigma(depth: NDArray[np.float32], model: NoiseModel | None = None) -> NDArray[np.float32]:
    """(H, W) m, standard deviation along z at each depth."""
    model = NoiseModel() if model is None else model
    off = depth - np.float32(0.4)
    return np.float32(model.sigma_m) + np.float32(model.sigma_growth_per_m) * off * off


def edge_pixels(depth: NDArray[np.float32], jump_m: float) -> NDArray[np.bool_]:
    """(H, W) bool, pixels with a neighbor (of four) across a jump in depth, or without depth."""
    limit = np.float32(jump_m) * np.maximum(depth, np.float32(1.0)) ** 2
    edge = np.zeros(depth.shape, dtype=bool)
    for axis in (0, 1):
        low = (slice(None, -1), slice(None)) if axis == 0 else (slice(None), slice(None, -1))
        high = (slice(1, None), slice(None)) if axis == 0 else (slice(None), slice(1, None))
        jump = np.abs(depth[high] - depth[low]) > np.minimum(limit[high], limit[low])
        edge[low] |= jump
        edge[high] |= jump
    return edge


def add_noise(
    depth: NDArray[np.float32], rng: np.random.Generator, model: NoiseModel | None = None
) -> NDArray[np.float32]:
    """A noisy copy of an exact depth image (H, W) float32 m, 0 missing.

    Raises:
        SceneError: the model has a value out of range.
    """
    model = NoiseModel() if model is None else model
    draws = rng.standard_normal(depth.shape, dtype=np.float32)
    chance = rng.random(depth.shape, dtype=np.float32)
    noisy = depth + draws * axial_sigma(depth, model)
    if model.step_m > 0:
        noisy = np.rint(noisy / np.float32(model.step_m)) * np.float32(model.step_m)
    edge = edge_pixels(depth, model.edge_jump_m)
    lost = chance < np.where(edge, model.edge_dropout, model.dropout)
    noisy[lost | (depth <= 0) | (depth > model.range_m) | (noisy <= 0)] = 0.0
    return noisy


def color_noise(
    rgb: NDArray[np.uint8], rng: np.random.Generator, model: NoiseModel | None = None
) -> NDArray[np.uint8]:
    """A copy of (H, W, 3) colors, each value off by color_sigma gray levels."""
    model = NoiseModel() if model is None else model
    # A byte a value picks one of 256 equally likely steps: five times faster than normal draws.
    steps = [NormalDist().inv_cdf((k + 0.5) / 256) * model.color_sigma for k in range(256)]
    draws = np.rint(steps).astype(np.int16)[rng.integers(0, 256, rgb.shape, dtype=np.uint8)]
    return np.asarray(np.clip(rgb + draws, 0, 255), dtype=np.uint8)
