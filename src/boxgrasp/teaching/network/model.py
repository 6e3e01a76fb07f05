"""The network in JAX: a U-Net of four levels, what it is taught, and how far off it is.

Ronneberger et al., MICCAI 2015, with the affinities of Wolf et al., ECCV 2018 as its answer.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

OFFSETS = ((0, 1), (1, 0), (0, 3), (3, 0), (0, 9), (9, 0), (5, 5), (5, -5))  # v, u, cells
CHANNELS = (24, 40, 72, 112)
INPUTS = 7
_CUT_WEIGHT = 3.0  # cells of different things are rare

Parameters = list[tuple[Array, Array]]  # kernel (rows, columns, in, out) and bias of each layer


@dataclass(frozen=True)
class Layer:
    """A convolution.

    Attributes:
        edge: of its kernel.
        stride: of its steps.
        inputs: channels.
        outputs: channels.
        pad: cells of zeros round its input.
    """

    edge: int
    stride: int
    inputs: int
    outputs: int
    pad: int


def layers() -> Iterator[Layer]:
    """The convolutions in the order in which they are applied.

    Yields:
        One layer after the other: stem, down, up, and the answer.
    """
    first = CHANNELS[0]
    yield Layer(4, 2, INPUTS, first, 1)
    for level, channels in enumerate(CHANNELS):
        before = CHANNELS[max(level - 1, 0)]
        yield Layer(3, 2 if level else 1, before, channels, 1)
        yield Layer(3, 1, channels, channels, 1)
    for level in range(len(CHANNELS) - 1, 0, -1):
        below, here = CHANNELS[level], CHANNELS[level - 1]
        yield Layer(3, 1, below + here, here, 1)
        yield Layer(3, 1, here, here, 1)
    yield Layer(1, 1, first, 1 + len(OFFSETS), 0)


def drawn_parameters(rng: np.random.Generator) -> Parameters:
    """Where training begins: He's normal weights, no bias.

    Args:
        rng: draws them.

    Returns:
        Kernel and bias of each layer.
    """
    drawn = []
    for layer in layers():
        shape = (layer.edge, layer.edge, layer.inputs, layer.outputs)
        scale = np.sqrt(2.0 / (layer.edge**2 * layer.inputs))
        kernel = (rng.standard_normal(shape) * scale).astype(np.float32)
        drawn.append((jnp.asarray(kernel), jnp.zeros(layer.outputs, dtype=jnp.float32)))
    return drawn


def logits(parameters: Parameters, inputs: Array) -> Array:
    """What the network says.

    Args:
        parameters: of `layers`.
        inputs: (B, h, w, 7), h and w multiples of 16.

    Returns:
        (B, h / 2, w / 2, 9): of being a thing, then of being the same as the cell at each offset.
    """
    each = iter(zip(layers(), parameters, strict=True))

    def convolved(x: Array) -> Array:
        layer, (kernel, bias) = next(each)
        pads = ((layer.pad, layer.pad),) * 2
        order, strides = ("NHWC", "HWIO", "NHWC"), (layer.stride,) * 2
        y = jax.lax.conv_general_dilated(x, kernel, strides, pads, dimension_numbers=order)
        return y + bias

    def block(x: Array) -> Array:
        return jax.nn.relu(convolved(jax.nn.relu(convolved(x))))

    x = jax.nn.relu(convolved(inputs))
    kept = []
    for _ in CHANNELS:
        x = block(x)
        kept.append(x)
    for beside in kept[-2::-1]:
        twice = jnp.repeat(jnp.repeat(x, 2, axis=1), 2, axis=2)
        x = block(jnp.concatenate([twice, beside], axis=-1))
    return convolved(x)


def losses(said: Array, things: Array, told: Array) -> Array:
    """Weighted cross-entropy of each of the network's answers.

    Args:
        said: (B, rows, columns, 9) logits.
        things: (B, rows, columns) int, 0 for no thing.
        told: (B, rows, columns) bool, the cells that count.

    Returns:
        (9,) mean of the cells, or pairs of cells, that count; of pairs one must show a thing.
    """
    found = [_mean_loss(said[..., 0], things > 0, told.astype(jnp.float32))]
    rows, columns = things.shape[1:]
    for k, (dv, du) in enumerate(OFFSETS):
        here = np.s_[:, : rows - dv, max(0, -du) : columns - max(0, du)]
        there = np.s_[:, dv:, max(0, du) : columns - max(0, -du)]
        same = things[here] == things[there]
        counts = told[here] & told[there] & ((things[here] > 0) | (things[there] > 0))
        weights = counts * jnp.where(same, 1.0, _CUT_WEIGHT)
        found.append(_mean_loss(said[here][..., 1 + k], same, weights))
    return jnp.stack(found)


def _mean_loss(said: Array, true: Array, weights: Array) -> Array:
    each = jax.nn.softplus(said) - said * true
    return jnp.sum(each * weights) / jnp.maximum(jnp.sum(weights), 1.0)
