"""Sensor noise of a structured-light camera such as the Asus Xtion."""

from __future__ import annotations

from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from boxgrasp.errors import SceneError
from boxgrasp.sensing.sensor_model import XTION


@dataclass(frozen=True)
class NoiseModel:
    """Axial noise that grows with distance (Nguyen 2012), steps in depth, missing pixels, color.

    Attributes:
        sigma_m: least standard deviation along z, m, at `XTION.noise_least_at_m`.
        sigma_growth_per_m: what it grows by with the square of the distance from there, 1/m.
        step_m: depth comes in whole steps of this, m; 0 for none.
        edge_jump_m: a neighbor this much nearer or farther makes a pixel an edge's, m; at 1 m,
            growing with z^2.
        edge_dropout: share of edge pixels that are missing.
        dropout: share of other pixels that are missing.
        range_m: all beyond is missing, m.
        color_sigma: standard deviation of a color value, gray levels.

    Raises:
        SceneError: a value below 0 or not finite, or a share above 1.
    """

    sigma_m: float = XTION.noise_floor_m
    sigma_growth_per_m: float = XTION.noise_growth_per_m
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
    """Standard deviation along z at each depth.

    Args:
        depth: (H, W) float32, m.
        model: None for an Xtion's.

    Returns:
        (H, W) float32, m.
    """
    model = NoiseModel() if model is None else model
    off = depth - np.float32(XTION.noise_least_at_m)
    return np.float32(model.sigma_m) + np.float32(model.sigma_growth_per_m) * off * off


def edge_pixels(depth: NDArray[np.float32], jump_m: float) -> NDArray[np.bool_]:
    """Pixels with one of four neighbors across a jump in depth, or without depth.

    Args:
        depth: (H, W) float32, m, 0 missing.
        jump_m: as `NoiseModel.edge_jump_m`.

    Returns:
        (H, W) bool.
    """
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
    """A noisy copy of an exact depth image.

    Args:
        depth: (H, W) float32, m, 0 missing.
        rng: draws the noise.
        model: None for an Xtion's.

    Returns:
        (H, W) float32, m, 0 missing.
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
    """A noisy copy of colors.

    Args:
        rgb: (H, W, 3) uint8.
        rng: draws the noise.
        model: its `color_sigma` counts; None for an Xtion's.

    Returns:
        (H, W, 3) uint8.
    """
    model = NoiseModel() if model is None else model
    # A byte a value picks one of 256 equally likely steps: five times faster than normal draws.
    steps = [NormalDist().inv_cdf((k + 0.5) / 256) * model.color_sigma for k in range(256)]
    draws = np.rint(steps).astype(np.int16)[rng.integers(0, 256, rgb.shape, dtype=np.uint8)]
    return np.asarray(np.clip(rgb + draws, 0, 255), dtype=np.uint8)
