"""Things told apart by a small network that sees the depth image alone.

It was trained on cast scenes and says for each cell of the image whether it shows a thing, and
whether cells some steps away show the same one. A mutex watershed groups the cells. What the
network takes for no thing stays an obstacle, but is no object.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Array
from boxgrasp.errors import ModelError, SceneError
from boxgrasp.kernels._threads import MOST_THREADS
from boxgrasp.kernels.flood import flood, nearest_labels
from boxgrasp.kernels.mutex import mutex_watershed
from boxgrasp.kernels.nearest import nearest
from boxgrasp.kernels.plan import grow
from boxgrasp.kernels.table_cells import regions
from boxgrasp.onnx.session import Session, load_file, open_session, record_of
from boxgrasp.perception.segmentation.clusters import Clusters
from boxgrasp.perception.segmentation.euclidean import clusters_without_specks
from boxgrasp.perception.segmentation.protocol import (
    DepthImage,
    SeenPoints,
    SegmentationConfig,
    Segments,
)

WEIGHTS = Path(__file__).parent / "weights" / "network.onnx"
_OPERATORS: Final = frozenset(("Conv", "Relu", "Concat", "Resize"))
FORMAT: Final = 1  # of the record
# What the channels of the network's input are, in the words of the record.
INPUT_NAMES: Final = (
    "height over the plane / 8 cm",
    "measured",
    "slope along u / 2",
    "slope along v / 2",
    "bend along u / 2",
    "bend along v / 2",
    "depth about a middle / 15 cm",
)

# As the network was trained.
_HEIGHT_SCALE_M: Final = 0.08
_DEPTH_SCALE_M: Final = 0.15
_BEND_SCALE_M: Final = 0.004
_SLOPE_PX: Final = 2  # slopes and bends are taken over so many pixels to each side
_LEAST_DEPTH_M: Final = 0.2  # nearer pixels would have unbounded slopes
_CLIP: Final = 4.0
_MULTIPLE_PX: Final = 16  # four levels, each half of the one before

_THING: Final = 0.5  # probability from which a cell shows a thing
_SAME: Final = 0.5  # probability from which two cells show the same thing
_LEAST_HEIGHT_M: Final = 0.004  # a cell of the table's own noise is no thing
_FAR_ATTRACTION: Final = 0.02  # less for cells three steps away: near ones are joined first
_ATTRACTING: Final = 4  # offsets along u and v by 1 and 3; farther ones only keep apart
_NEAREST: Final = 2  # offsets by 1, which never keep apart: a cut there would be noise
_LEAST_CELLS: Final = 40  # of a group; what is smaller goes to the group that a surface leads from
_FEWEST_CELLS: Final = 4  # of a sliver that no surface leads to
_FAR_M: Final = 1.25  # from where things are looked at more finely than the focal length asks
_MOST_CELLS: Final = 20_000  # that the network sees at once: a 640 x 480 image at every 2nd pixel
_MARGIN_CELLS: Final = 8  # round the points: what the network sees beside a thing
_RINGS: Final = 2  # of cells round a thing in which nothing is sure to be none
# Changes of depth from pixel to pixel along which answers spread, smooth ones first, at 1 m and
# nearer; a larger one is an outline.
_LIMITS_M: Final = (0.004, 0.008, 0.016, 0.03)
_NONE: Final = 1 << 30  # number of what is none while answers spread


@dataclass(frozen=True, eq=False)
class Network:
    """The network with what its record says of it.

    Attributes:
        focal_px: of the images that it was trained on, px.
        cell_px: edge of a cell in such an image, px.
        offsets: (v, u) steps in cells of each affinity.
    """

    focal_px: float
    cell_px: int
    offsets: tuple[tuple[int, int], ...]
    _session: Session

    def probabilities(self, inputs: NDArray[np.float32]) -> NDArray[np.float32]:
        """What the network says of an image.

        Args:
            inputs: (7, h, w) float32, h and w multiples of 16.

        Returns:
            (1 + offsets, h / cell_px, w / cell_px) float32: of being a thing, then of being the
            same thing as the cell at each offset.
        """
        logits = self._session.run(["y"], {"x": inputs[None]})[0][0]
        return np.asarray(1.0 / (1.0 + np.exp(-logits)), dtype=np.float32)


def read_network(data: bytes) -> Network:
    """The network of an ONNX file. Runs no code of it and opens no other file.

    Args:
        data: the file's bytes.

    Returns:
        The network.

    Raises:
        ModelError: damaged, no network of this kind, or more than plain arithmetic.
        MissingExtraError: onnxruntime is not installed.
    """
    text, whole = record_of(data)
    if not whole:
        raise ModelError("the file is damaged: graph and record do not match their digest")
    try:
        record = json.loads(text)
        if record["kind"] != "segmentation" or record["format"] != FORMAT:
            raise ModelError(f"the record is not of a segmentation network, format {FORMAT}")
        offsets = tuple((int(v), int(u)) for v, u in record["offsets"])
        focal_px, cell_px = float(record["focal_px"]), int(record["cell_px"])
    except (ValueError, KeyError, TypeError):
        raise ModelError("the record is not of a segmentation network") from None
    network = Network(focal_px, cell_px, offsets, open_session(data, _OPERATORS, MOST_THREADS))
    side = _MULTIPLE_PX * cell_px
    try:
        shape = network.probabilities(np.zeros((7, side, side), dtype=np.float32)).shape
    except Exception:  # onnxruntime's own errors share no other root
        raise ModelError("the graph does not run as its record says") from None
    if shape != (1 + len(offsets), side // cell_px, side // cell_px):
        raise ModelError("the graph does not answer as its record says")
    return network


@cache
def network_of(path: str | None) -> Network:
    """The network of a file, read once a process.

    Args:
        path: of an ONNX file, None for the one that ships.

    Returns:
        The network.

    Raises:
        ModelError: the file cannot be read, is damaged or no network.
        MissingExtraError: onnxruntime is not installed.
    """
    return load_file(WEIGHTS if path is None else path, read_network)


def network_segments(seen: SeenPoints, config: SegmentationConfig) -> Segments:
    """Things by the network; what is none by distance, as obstacles alone.

    Args:
        seen: K points with the image that shows them.
        config: the settings.

    Returns:
        Clusters of things, then those of the rest.

    Raises:
        SceneError: there is no image.
        ModelError: the network's file cannot be read, is damaged or no network.
        MissingExtraError: onnxruntime is not installed.
    """
    if seen.image is None:
        raise SceneError("segmentation by the network needs an image; valid: split, euclidean")
    network = network_of(config.network)
    clusters = _clusters_of(thing_image(network, seen.image), seen.image, len(seen.points))
    _join_unseen(clusters, seen, config.cluster_tolerance_m)
    found = int(clusters.max(initial=-1)) + 1
    rest = np.flatnonzero(clusters < 0)
    points = np.ascontiguousarray(seen.points[rest])
    others = clusters_without_specks(points, config.cluster_tolerance_m)
    clusters[rest] = np.where(others >= 0, found + others, -1)
    count = int(clusters.max(initial=-1)) + 1
    return Segments(clusters, np.arange(count) < found)


def _join_unseen(clusters: Clusters, seen: SeenPoints, tolerance_m: float) -> None:
    """Points that the image does not show, but a further scan, join the thing that they go on."""
    assert seen.image is not None
    unseen = np.bincount(seen.image.rows, minlength=len(clusters)) == 0
    edge = clusters >= 0
    while True:
        left = np.flatnonzero(unseen & (clusters < 0))
        things = np.flatnonzero(edge)
        if len(left) == 0 or len(things) == 0:
            return
        points = np.ascontiguousarray(seen.points[left])
        others = np.ascontiguousarray(seen.points[things])
        nearest_thing = nearest(points, others)
        off = points - others[nearest_thing]
        joined = np.einsum("ij,ij->i", off, off) < tolerance_m**2
        edge = np.zeros_like(edge)
        edge[left[joined]] = True
        clusters[left[joined]] = clusters[things[nearest_thing[joined]]]


@dataclass(frozen=True, eq=False)
class ThingImage:
    """Which thing each pixel of a part of an image, thinned, shows.

    Attributes:
        things: (h, w) int64, -1 for none.
        depth_m: (h, w) float32, 0 where it is missing.
        first_px: (v, u) of its first pixel in the image.
        step: every so many-th pixel of the image is there.
    """

    things: NDArray[np.int64]
    depth_m: NDArray[np.float32]
    first_px: tuple[int, int]
    step: int


def thing_image(network: Network, image: DepthImage) -> ThingImage:
    """Tell things apart in an image.

    The network sees only the part of the image in which points over the plane are shown, and a
    margin round it. It answers for one pixel of each cell; from there its answers spread along
    the surface.

    Args:
        network: what tells.
        image: of any size and focal length; at least one pixel shows a point.

    Returns:
        Things, numbered with gaps.
    """
    middle_m = float(np.median(image.depth_m.reshape(-1)[image.pixels]))
    cell = network.cell_px
    step, cells = _step_and_window(network, image, middle_m)
    pixels = tuple(slice(of.start * cell, of.stop * cell) for of in cells)
    depth, height = (of[::step, ::step][pixels] for of in (image.depth_m, image.height_m))
    inputs = network_inputs(depth, height, image.focal_px / step, middle_m)
    asked = np.s_[::cell, ::cell]
    rows, columns = depth[asked].shape
    said = network.probabilities(inputs)[:, :rows, :columns]
    measured = (depth > 0) & (height > _LEAST_HEIGHT_M)
    shows = measured[asked] & (said[0] > _THING)
    sure = _sure(depth)[asked]  # the network was never told what outlines show
    things = np.full(depth.shape, -1, dtype=np.int64)
    things[asked] = _grouped(said, shows & sure, network.offsets)
    limits_m = np.array(_LIMITS_M)
    showing = np.repeat(np.repeat(shows, cell, 0), cell, 1)[: depth.shape[0], : depth.shape[1]]
    flood(depth, things, showing & (depth > 0), limits_m)
    # What shows a thing, but no surface leads there: slivers behind a nearer thing.
    sliver, found = regions((things[asked] < 0) & shows & sure, False)
    sizes = np.bincount(sliver[sliver >= 0], minlength=found + 1)
    alone = (sliver >= 0) & (sizes[sliver] >= _FEWEST_CELLS)
    things[asked][alone] = int(things.max()) + 1 + sliver[alone]
    # Round a thing its rim is too mixed to tell; farther away what is none is sure to be none.
    none = grow(np.where(shows, 0, -1), np.ones_like(sure), _RINGS) < 0
    things[asked][none] = _NONE
    flood(depth, things, depth > 0, limits_m)
    things[things == _NONE] = -1
    return ThingImage(things, depth, (pixels[0].start * step, pixels[1].start * step), step)


def _sure(depth_m: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Pixels whose neighbors lie on one surface with them: no outline's."""
    sure = depth_m > 0
    limit = _LIMITS_M[-1] * np.maximum(depth_m, 1.0) ** 2
    for axis in (0, 1):
        for by in (1, -1):
            sure &= np.abs(np.roll(depth_m, by, axis) - depth_m) <= limit
    return sure


def _shown_cells(image: DepthImage, cell_px: int) -> NDArray[np.bool_]:
    """(rows, columns) whether a point over the plane is shown there."""
    shape = tuple(-(-side // cell_px) for side in image.depth_m.shape)
    shown = np.zeros(shape, dtype=np.bool_)
    shown[_cells_of_pixels(image, cell_px, shape)] = True
    return shown


def _window(shown: NDArray[np.bool_]) -> tuple[slice, slice]:
    """The rows and columns round the shown cells, with a margin."""
    held = [np.flatnonzero(shown.any(axis=1 - axis)) for axis in (0, 1)]
    first, last = zip(*((int(of[0]), int(of[-1]) + 1) for of in held), strict=True)
    rows, columns = (
        slice(max(a - _MARGIN_CELLS, 0), min(b + _MARGIN_CELLS, side))
        for a, b, side in zip(first, last, shown.shape, strict=True)
    )
    return rows, columns


def _step_and_window(
    network: Network, image: DepthImage, middle_m: float
) -> tuple[int, tuple[slice, slice]]:
    """Every so many-th pixel is looked at, in so many cells: as fine as in training, within bounds.

    An image of about the network's focal length, a finer one where things are far; a coarser one
    where they are all over a large image, so that the time is bounded.
    """
    wanted = image.focal_px / (network.focal_px * max(1.0, middle_m / _FAR_M))
    step = max(1, round(wanted))
    while True:
        window = _window(_shown_cells(image, step * network.cell_px))
        if np.prod([side.stop - side.start for side in window]) <= _MOST_CELLS:
            return step, window
        step += 1


def network_inputs(
    depth_m: NDArray[np.float32],
    height_m: NDArray[np.float32],
    focal_px: float,
    middle_m: float,
) -> NDArray[np.float32]:
    """An image as the network takes it, filled up to multiples of 16 pixels.

    Args:
        depth_m: (h, w) float32, 0 where it is missing.
        height_m: (h, w) float32 over the support plane.
        focal_px: px.
        middle_m: a depth among the things', m.

    Returns:
        (7, ...) float32: height, measured, slopes and bends along u and v, depth about the middle.
    """
    measured = depth_m > 0
    slope_u, bend_u = _slope_and_bend(depth_m, 1, focal_px)
    slope_v, bend_v = _slope_and_bend(depth_m, 0, focal_px)
    channels = (
        np.clip(height_m / _HEIGHT_SCALE_M, -_CLIP / 2, _CLIP) * measured,
        measured,
        slope_u / 2,
        slope_v / 2,
        bend_u / 2,
        bend_v / 2,
        np.clip((depth_m - middle_m) / _DEPTH_SCALE_M, -_CLIP, _CLIP) * measured,
    )
    height, width = depth_m.shape
    filled = np.zeros((7, height + -height % _MULTIPLE_PX, width + -width % _MULTIPLE_PX))
    filled[:, :height, :width] = channels
    return filled.astype(np.float32)


def _slope_and_bend(
    depth_m: NDArray[np.float32], axis: int, focal_px: float
) -> tuple[Array, Array]:
    """Change of depth over change of place, and its change; 0 where a neighbor is missing."""
    after, before = (np.roll(depth_m, by, axis) for by in (-_SLOPE_PX, _SLOPE_PX))
    whole = (after > 0) & (before > 0) & (depth_m > 0)
    scale = focal_px / (2 * _SLOPE_PX * np.maximum(depth_m, _LEAST_DEPTH_M))
    slope = np.clip((after - before) * scale, -_CLIP, _CLIP)
    bend = np.clip((after + before - 2 * depth_m) / _BEND_SCALE_M, -_CLIP, _CLIP)
    return np.where(whole, slope, 0), np.where(whole, bend, 0)


def _grouped(
    said: NDArray[np.float32], inside: NDArray[np.bool_], offsets: tuple[tuple[int, int], ...]
) -> NDArray[np.int64]:
    """(rows, columns) thing of each inside cell, -1 outside and in small groups."""
    things = np.full(inside.shape, -1, dtype=np.int64)
    count = int(np.count_nonzero(inside))
    if count == 0:
        return things
    number = things.copy()
    number[inside] = np.arange(count)
    parts = [
        _edges(number, said[1 + k], offset, k < _ATTRACTING, k >= _NEAREST)
        for k, offset in enumerate(offsets)
    ]
    first, second, weight, attract = (np.concatenate(part) for part in zip(*parts, strict=True))
    order = np.argsort(-weight, kind="stable")
    groups = mutex_watershed(first[order], second[order], attract[order], count)
    _, group, sizes = np.unique(groups, return_inverse=True, return_counts=True)
    group = group.reshape(-1)
    things[inside] = np.where(sizes[group] >= _LEAST_CELLS, group, -1)
    return things


def _edges(
    number: NDArray[np.int64],
    same: NDArray[np.float32],
    offset: tuple[int, int],
    attracts: bool,
    repels: bool,
) -> tuple[Array, Array, Array, Array]:
    """Cells, their partners at an offset, weights, and whether each pair attracts."""
    rows, columns = number.shape
    dv, du = offset
    here = np.s_[: rows - dv, max(0, -du) : columns - max(0, du)]
    there = np.s_[dv:, max(0, du) : columns - max(0, -du)]
    pairs = (number[here] >= 0) & (number[there] >= 0)
    first, second, probability = number[here][pairs], number[there][pairs], same[here][pairs]
    if not repels:
        return first, second, probability, np.ones(len(first), dtype=np.bool_)
    attract = probability >= _SAME
    weight = np.where(attract, probability - np.float32(_FAR_ATTRACTION), 1 - probability)
    kept = ~attract if not attracts else np.ones(len(first), dtype=np.bool_)
    return first[kept], second[kept], weight[kept], attract[kept]


def _cells_of_pixels(
    image: DepthImage, cell_px: int, shape: tuple[int, ...]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(S,) row and (S,) column of the cell that each pixel of a point lies in."""
    v, u = np.divmod(image.pixels.astype(np.int64), image.depth_m.shape[1])
    return np.minimum(v // cell_px, shape[0] - 1), np.minimum(u // cell_px, shape[1] - 1)


def _shown_things(found: ThingImage, image: DepthImage) -> NDArray[np.int64]:
    """(S,) the thing that each pixel of a point shows, -1 for none."""
    things = np.empty(len(image.pixels), dtype=np.int64)
    nearest_labels(
        image.pixels, image.depth_m.shape[1], image.depth_m.reshape(-1), np.array(found.first_px),
        found.step, found.depth_m, found.things, _LIMITS_M[-1], things,
    )  # fmt: skip
    return things


def _clusters_of(found: ThingImage, image: DepthImage, count: int) -> Clusters:
    """(K,) the thing that most of a point's pixels show, ids without gaps; -1 for none."""
    shown = _without_gaps(_shown_things(found, image)) + 1
    kinds = int(shown.max(initial=0)) + 1
    votes = np.bincount(image.rows * kinds + shown, minlength=count * kinds).reshape(count, kinds)
    best = np.argmax(votes, axis=1) - 1
    best[votes.sum(axis=1) == 0] = -1
    return _without_gaps(best)


def _without_gaps(names: NDArray[np.int64]) -> NDArray[np.int64]:
    """(N,) the same names from 0 on, in their order; -1 stays."""
    present = np.bincount(names[names >= 0], minlength=1) > 0
    ids = np.append(np.cumsum(present) - 1, -1)
    return np.asarray(ids[names])
