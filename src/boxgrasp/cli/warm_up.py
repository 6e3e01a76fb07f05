"""Compile every kernel once, so that no command and no node waits for it later.

Kernels are compiled for this machine's processor and kept beside the package, or in the user's
cache where that cannot be written; NUMBA_CACHE_DIR names another folder.
"""

from __future__ import annotations

import argparse
import importlib
import logging
import time
from collections.abc import Callable, Sequence
from functools import cache
from typing import TYPE_CHECKING, Any

from boxgrasp.errors import BoxgraspError

if TYPE_CHECKING:
    from boxgrasp.mapping.octomap_leaves import MapCells
    from boxgrasp.perception.target import Target
    from boxgrasp.sensing.capture import Capture

# The least OctoMap files: a root without children.
_MAPS = (
    b"# Octomap OcTree binary file\nid OcTree\nsize 1\nres 0.03\ndata\n\x00\x00",
    b"# Octomap OcTree file\nid OcTree\nsize 1\nres 0.03\ndata\n\x00\x00\x00\x00\x00",
)
_ON_TARGET_M = (0.82, -0.01, 0.90)  # of the demo's table
_HOLE_PX = 8  # more than the 5 within which a pixel without depth takes the nearest with depth
_UGLY_SEEDS = (1, 2, 3, 5)  # of tables with flat, hollow and stacked things on them
_UGLY_SHAPE, _UGLY_FOCAL_PX = (240, 320), 262.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command: none of its own.

    Args:
        parser: of the command.
    """


def run(_args: argparse.Namespace) -> int:
    """Do what the commands do on cast tables, and say how far it is.

    Returns:
        0.

    Raises:
        BoxgraspError: what is compiled can be kept nowhere.
    """
    log = logging.getLogger("boxgrasp.kernels")
    level = log.level
    log.setLevel(logging.ERROR)  # that it compiles is said here in other words
    try:
        _compile()
    finally:
        log.setLevel(level)
    return 0


def _compile() -> None:
    from boxgrasp.execution.progress import progress
    from boxgrasp.kernels import _jit

    importlib.import_module("boxgrasp.kernels.rvl")  # a kernel knows where it is kept
    folder = _jit.cache_folder()
    if folder is None:
        raise BoxgraspError(
            "compiled kernels can be kept nowhere: neither the package's folder nor the user's "
            "cache can be written; valid: NUMBA_CACHE_DIR set to a folder that can"
        )
    start = time.perf_counter()
    with progress("warm-up", len(STEPS), 0) as one_done:
        for step in STEPS:
            step()
            one_done()
    spent = time.perf_counter() - start
    print(f"{_jit.compiled_count()} kernels compiled in {spent:.0f} s, kept in {folder}")


@cache
def _table() -> Capture:
    from boxgrasp.simulate import demo_capture

    return demo_capture()


def _select(
    capture: Capture,
    target: Target | None = None,
    scans: Sequence[Capture] = (),
    octomap: MapCells | None = None,
    **config: Any,
) -> None:
    """Answer once; `config` holds sections of a configuration."""
    from boxgrasp.selector import GraspSelector

    GraspSelector(config).select(capture, target, scans, octomap)


def _images() -> None:
    """By every segmentation, and as the thesis has it; with and without pose and color."""
    from boxgrasp.perception.segmentation import SEGMENTATIONS
    from boxgrasp.selector import GraspSelector
    from boxgrasp.sensing.capture import Capture

    table = _table()
    for name in SEGMENTATIONS:
        GraspSelector({"scene": {"segmentation": name}}).warm_up()
        _select(table, scene={"segmentation": name})
    _select(table, box={"fit": "aligned"}, candidates={"refine": "none"}, ranker="cascade-grid")
    bare = Capture(table.depth, table.intrinsics, target_pixel=table.target_pixel)
    _select(bare)
    _select(bare, scene={"segmentation": "split"})


def _targets() -> None:
    """By a mask, a number, a point, and a pixel in a hole; with a second view and an arm."""
    import numpy as np

    from boxgrasp.perception.target import Target
    from boxgrasp.selector import GraspSelector
    from boxgrasp.sensing.capture import Capture

    table = _table()
    u, v = table.target_pixel or (0, 0)
    image = GraspSelector().segment(table)
    number = int(image[v, u])
    _select(table, Target(mask=image == number))
    depth = np.array(table.depth)
    depth[v - _HOLE_PX : v + _HOLE_PX, u - _HOLE_PX : u + _HOLE_PX] = 0.0
    _select(Capture(depth, table.intrinsics, table.T_base_camera), Target(pixel=(u, v)))
    _select(table, Target(object=number), scans=[table])
    own_arm = Capture(
        table.depth, table.intrinsics, table.T_base_camera, robot_mask=image == number + 1
    )
    _select(own_arm, Target(point=_ON_TARGET_M))


def _clouds() -> None:
    """Organized and not, with colors and without, in either frame."""
    import numpy as np

    from boxgrasp.geometry.transforms import transform
    from boxgrasp.perception.target import Target
    from boxgrasp.sensing.capture import Capture

    table, target = _table(), Target(point=_ON_TARGET_M)
    points, pixels = table.valid_points()
    height, width = table.shape or (0, 0)
    grid = np.full((height * width, 3), np.nan, dtype=np.float32)
    grid[pixels] = points
    T = np.array(table.T_base_camera)
    organized = grid.reshape(height, width, 3)
    _select(Capture.from_cloud(organized, colors=table.rgb, T_base_camera=T), target)
    _select(Capture.from_cloud(points, T_base_camera=T), target)
    _select(Capture.from_cloud(transform(T, points), cloud_frame="base"), target)


def _files() -> None:
    """Depth packed as RVL, and maps of either kind, one with a cell that stands in the way."""
    import numpy as np

    from boxgrasp.io.octomap import parse_octomap
    from boxgrasp.kernels import rvl
    from boxgrasp.mapping.octomap_leaves import MapCells

    rvl.unpack(np.zeros(1, np.uint32), np.zeros(1, np.uint16))
    for data in _MAPS:
        parse_octomap(data)
    keys = np.array([[27, 10, 40], [27, 0, 40]], dtype=np.int32)
    log_odds = np.array([2.0, -2.0], dtype=np.float32)
    _select(_table(), octomap=MapCells(0.03, keys, np.ones(2, np.int64), log_odds))


def _pictures() -> None:
    from boxgrasp.draw import draw_objects, draw_selection
    from boxgrasp.selector import GraspSelector

    table, selector = _table(), GraspSelector()
    draw_selection(table, selector.select(table))
    draw_objects(table, selector.scene(table))


def _ugly_tables() -> None:
    """Flat, hollow and stacked things, as the network learns from them."""
    import numpy as np

    from boxgrasp.perception.segmentation import SEGMENTATIONS
    from boxgrasp.selector import GraspSelector
    from boxgrasp.sensing.capture import Capture
    from boxgrasp.simulate.ugly import draw_view

    for seed in _UGLY_SEEDS:
        view = draw_view(np.random.default_rng(seed), _UGLY_SHAPE, _UGLY_FOCAL_PX)
        (u, v), f = view.center_px, view.focal_px
        K = np.array([[f, 0.0, u], [0.0, f, v], [0.0, 0.0, 1.0]])
        capture = Capture(view.depth_m, K, view.T_table_camera)
        for name in SEGMENTATIONS:
            GraspSelector({"scene": {"segmentation": name}}).scene(capture)


def _truth() -> None:
    """A row of a labeled set with its exact truth."""
    from boxgrasp.simulate.scenario import Recipe, targets_of
    from boxgrasp.teaching.rows import RowConfig, row_of

    row_of(RowConfig(Recipe(targets_of("known")), 1), 0)


STEPS: tuple[Callable[[], object], ...] = (
    _table,
    _images,
    _targets,
    _clouds,
    _files,
    _pictures,
    _ugly_tables,
    _truth,
)
