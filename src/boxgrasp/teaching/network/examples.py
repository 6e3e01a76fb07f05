"""What the network learns from: ugly tables as a random sensor measures them, and what is true."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boxgrasp.perception.segmentation.network import network_inputs
from boxgrasp.simulate.sensors import Image, Rng, sensed
from boxgrasp.simulate.ugly import UNTOLD, View, draw_view

SHAPE = (144, 192)  # px, of an example: multiples of 16
CELL_PX = 2

_TILT = 0.012  # rad, standard deviation of a plane's fit on real captures, and its height, m
_LIFT_M = 0.002
_MIDDLE_M = 0.15  # standard deviation of the depth that the network's is told about


@dataclass(frozen=True, eq=False)
class Batch:
    """Examples for one step of training.

    Attributes:
        inputs: (B, h, w, 7) float16, as `network_inputs` makes them.
        things: (B, h / 2, w / 2) int16, what each cell shows, 0 for no thing.
        told: (B, h / 2, w / 2) bool, where that can be told and was measured.
    """

    inputs: NDArray[np.float16]
    things: NDArray[np.int16]
    told: NDArray[np.bool_]


@dataclass(frozen=True)
class BatchTask:
    """Which batch: every number gives another, the same seed and number the same.

    Attributes:
        seed: of the training.
        number: of the batch.
        size: examples in it.
    """

    seed: int
    number: int
    size: int


def draw_batch(task: BatchTask) -> Batch:
    """Cast and measure a batch.

    Args:
        task: which.

    Returns:
        The batch.
    """
    rng = np.random.default_rng((task.seed, task.number))
    drawn = [_example(rng) for _ in range(task.size)]
    inputs, things, told = (np.stack(of) for of in zip(*drawn, strict=True))
    return Batch(inputs, things, told)


def _example(rng: Rng) -> tuple[NDArray[np.float16], NDArray[np.int16], NDArray[np.bool_]]:
    view = draw_view(rng, SHAPE)
    depth, edge = sensed(view.depth_m, view.things, view.focal_px, rng)
    height = _heights(depth, view, rng)
    shown = depth[(view.things > 0) & (depth > 0)]
    middle = float(np.median(shown if len(shown) else depth)) + rng.normal(0.0, _MIDDLE_M)
    inputs = network_inputs(depth, height, view.focal_px, middle)
    cells = np.s_[::CELL_PX, ::CELL_PX]
    things, told = view.things[cells], ((depth > 0) & ~edge)[cells]
    told = told & (things != UNTOLD)
    inputs, things, told = _mirrored(inputs, things, told, rng)
    return inputs.transpose(1, 2, 0).astype(np.float16), things.astype(np.int16), told


def _heights(depth: Image, view: View, rng: Rng) -> Image:
    """Over a plane that was fitted as well as planes are."""
    v, u = np.mgrid[: depth.shape[0], : depth.shape[1]].astype(np.float32)
    x = (u - np.float32(view.center_px[0])) / np.float32(view.focal_px)
    y = (v - np.float32(view.center_px[1])) / np.float32(view.focal_px)
    T = view.T_table_camera.astype(np.float32)
    up = T[2, :3] + T[:2, :3].T @ rng.normal(0.0, _TILT, 2).astype(np.float32)
    lift = T[2, 3] + np.float32(rng.normal(0.0, _LIFT_M))
    height = (up[0] * x + up[1] * y + up[2]) * depth + lift
    return np.where(depth > 0, height, np.float32(0)).astype(np.float32)


def _mirrored(
    inputs: NDArray[np.float32], things: NDArray[np.int32], told: NDArray[np.bool_], rng: Rng
) -> tuple[NDArray[np.float32], NDArray[np.int32], NDArray[np.bool_]]:
    """Half of the examples left to right; the slope along u turns its sign."""
    if rng.random() < 0.5:
        return inputs, things, told
    inputs = inputs[:, :, ::-1].copy()
    inputs[2] = -inputs[2]
    return inputs, things[:, ::-1], told[:, ::-1]
