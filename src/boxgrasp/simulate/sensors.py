"""What depth cameras make of a view: structured light, active stereo and time of flight.

`noise` is the study's Xtion, pixel by pixel. Here are the coarser faults that a network must see
through: shadows, veils behind outlines, waves, fattened and rounded edges, holes, coarse steps.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from boxgrasp.sensing.sensor_model import XTION

Image = NDArray[np.float32]
Rng = np.random.Generator

_FAR_M = 9.0  # in place of a missing pixel, where the nearest is looked for
_JUMP_M = 0.015  # between neighbors, from which they are an outline's
_SEEN_M = 4.0  # farther things have no depth
_SHADOW_PX = 14  # widest


def sensed(
    depth_m: Image, things: NDArray[np.int32], focal_px: float, rng: Rng
) -> tuple[Image, NDArray[np.bool_]]:
    """A view as a random camera of a random kind measures it.

    Args:
        depth_m: (H, W) float32, exact, 0 where nothing is, m.
        things: (H, W) int32, what each pixel shows: some things are dark, or shine.
        focal_px: px.
        rng: draws kind and strength of every fault.

    Returns:
        (H, W) float32, m, 0 where it is missing; and (H, W) bool, where what a pixel shows
        cannot be told: at outlines.
    """
    kind = rng.choice(("light", "stereo", "flight"), p=(0.4, 0.35, 0.25))
    exact = np.where(depth_m > _SEEN_M, np.float32(0), depth_m)
    nearest, farthest = _around(exact)
    edge = (farthest - nearest > _JUMP_M) & (exact > 0)
    depth = _veiled(exact, nearest, farthest, edge, rng)
    if kind == "stereo":
        fat = (rng.random(depth.shape, dtype=np.float32) < rng.uniform(0, 0.8)) & (depth > 0)
        depth = np.where(fat & (nearest < _FAR_M), nearest, depth)
        depth = depth + _waves(depth, rng)
    elif kind == "flight":
        depth = _rounded(depth, rng)
        depth = depth + _grains(depth, 0.6, rng)
    else:
        depth = depth + _grains(depth, 1.0, rng)
    if kind != "flight" and rng.random() < 0.7:
        steps = np.float32(rng.uniform(250, 900))  # a metre's share of disparity, halved and so on
        inverse = np.rint(steps / np.maximum(depth, np.float32(0.1)))
        depth = np.asarray(steps / np.maximum(inverse, 1), dtype=np.float32)
    missing = (exact <= 0) | _holes(depth.shape, edge, rng) | _dark(things, rng)
    if kind != "flight":
        missing |= _shadow(exact, focal_px, rng)
    depth = np.where(missing, np.float32(0), depth).astype(np.float32)
    return depth, edge


def _around(depth: Image) -> tuple[Image, Image]:
    """Nearest and farthest depth of the 3 x 3 pixels round each."""
    low = np.where(depth > 0, depth, np.float32(_FAR_M))
    nearest, farthest = low.copy(), depth.copy()
    for axis in (0, 1):
        near, far = nearest.copy(), farthest.copy()
        for by in (-1, 1):
            a, b = (np.s_[:-1], np.s_[1:]) if by > 0 else (np.s_[1:], np.s_[:-1])
            if axis:
                a, b = (np.s_[:], a), (np.s_[:], b)  # type: ignore[assignment]
            near[a] = np.minimum(near[a], nearest[b])
            far[a] = np.maximum(far[a], farthest[b])
        nearest, farthest = near, far
    return nearest, farthest


def _veiled(
    depth: Image, nearest: Image, farthest: Image, edge: NDArray[np.bool_], rng: Rng
) -> Image:
    """Flying pixels at outlines, some of them moved by a pixel."""
    mix = rng.random(depth.shape, dtype=np.float32)
    flying = edge & (rng.random(depth.shape, dtype=np.float32) < rng.uniform(0.05, 0.6))
    other = np.where(rng.random(depth.shape, dtype=np.float32) < 0.5, nearest, farthest)
    depth = np.where(flying & (other < _FAR_M), mix * depth + (1 - mix) * other, depth)
    moved = np.roll(depth, tuple(rng.integers(-1, 2, 2)), (0, 1))
    swapped = edge & (rng.random(depth.shape, dtype=np.float32) < 0.3) & (moved > 0)
    return np.where(swapped, moved, depth).astype(np.float32)


def _smooth(shape: tuple[int, ...], cell_px: float, rng: Rng) -> Image:
    """(H, W) normal noise, bilinear between knots so many pixels apart."""
    knots = [int(np.ceil(n / cell_px)) + 1 for n in shape]
    noise = rng.standard_normal(knots, dtype=np.float32)
    for axis in (0, 1):
        at = np.arange(shape[axis]) / cell_px
        first = at.astype(np.int64)
        share = (at - first).astype(np.float32)
        share = share[:, None] if axis == 0 else share
        before, after = (np.take(noise, first + k, axis) for k in (0, 1))
        noise = before + share * (after - before)
    return np.asarray(noise, dtype=np.float32)


def _grains(depth: Image, share: float, rng: Rng) -> Image:
    """Noise of pixels and of patches of some pixels."""
    low = _smooth(depth.shape, 16, rng) + np.float32(0.6) * _smooth(depth.shape, 4, rng)
    fine = rng.standard_normal(depth.shape, dtype=np.float32)
    strength = np.float32(share * rng.uniform(0.3, 1.6) * 0.7)
    return np.asarray(strength * XTION.axial_noise_m(depth) * (fine + low), dtype=np.float32)


def _waves(depth: Image, rng: Rng) -> Image:
    """Stereo's smooth waves, which grow with the square of the depth."""
    strengths = rng.uniform(0, 1, 3)
    waves = sum(
        np.float32(s) * _smooth(depth.shape, px, rng)
        for s, px in zip(strengths, (20, 10, 5), strict=True)
    )
    grown = np.float32(rng.uniform(0.0008, 0.005)) * np.square(depth / np.float32(0.8))
    return np.asarray(grown * waves + 0.2 * _grains(depth, 1.0, rng), dtype=np.float32)


def _rounded(depth: Image, rng: Rng) -> Image:
    """Time of flight: light from all of a spot is averaged, so edges and corners are round."""
    for _ in range(int(rng.integers(1, 3))):
        for axis in (0, 1):
            before, after = np.roll(depth, 1, axis), np.roll(depth, -1, axis)
            whole = (before > 0) & (after > 0) & (depth > 0)
            depth = np.where(whole, (before + 2 * depth + after) / 4, depth)
    return np.asarray(depth, dtype=np.float32)


def _holes(shape: tuple[int, ...], edge: NDArray[np.bool_], rng: Rng) -> NDArray[np.bool_]:
    """Lost at outlines, pixel by pixel, and in patches where a surface shines or is dark."""
    lost = edge & (rng.random(shape, dtype=np.float32) < rng.uniform(0, 0.7))
    lost |= rng.random(shape, dtype=np.float32) < rng.uniform(0, 0.008)
    if rng.random() < 0.4:
        lost |= _smooth(shape, rng.uniform(5, 14), rng) > rng.uniform(1.6, 2.6)
    return lost


def _dark(things: NDArray[np.int32], rng: Rng) -> NDArray[np.bool_]:
    """Large parts of a dark, clear or shining thing."""
    lost = np.zeros(things.shape, dtype=np.bool_)
    shown = np.unique(things[things > 0])
    if len(shown) == 0 or rng.random() > 0.3:
        return lost
    for thing in rng.choice(shown, min(len(shown), int(rng.integers(1, 3))), replace=False):
        patches = _smooth(things.shape, rng.uniform(8, 30), rng) > rng.uniform(-0.3, 1.2)
        lost |= patches & (things == thing)
    return lost


def _shadow(depth: Image, focal_px: float, rng: Rng) -> NDArray[np.bool_]:
    """What the projector, or the second camera, does not reach: beside nearer things."""
    side = 1 if rng.random() < 0.5 else -1
    baseline_px = np.float32(focal_px * rng.uniform(0.03, 0.08))
    inverse = np.where(depth > 0, 1 / np.maximum(depth, np.float32(0.1)), 0).astype(np.float32)
    inverse = inverse[:, ::side]  # as if it fell to the right
    hidden = np.zeros(depth.shape, dtype=np.bool_)
    for by in range(1, _SHADOW_PX):
        hidden[:, by:] |= (inverse[:, :-by] - inverse[:, by:]) * baseline_px > by + 0.3
    hidden = hidden[:, ::side]
    return hidden & (rng.random() < 0.8)
