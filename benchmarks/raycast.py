"""Views a second of the ray caster: 640 x 480, 12 primitives, warm. `python benchmarks/raycast.py`.

Beside it the same view with noise, and a naive caster in numpy, in the same run.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable

import numpy as np

from boxgrasp.simulate import TableScene, cast, draw_scene, to_capture
from boxgrasp.simulate.camera import SHAPE


def milliseconds(work: Callable[[], object], repeats: int) -> float:
    """Median wall time of a call."""
    work()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return float(np.median(times)) * 1e3


def crowded(primitives: int) -> TableScene:
    """A drawn scene with just that many primitives, the floor and the table among them."""
    rng = np.random.default_rng(5)
    while True:
        scene = draw_scene(rng, obstacles=(4, 6), area_m=0.6)
        if len(scene.primitives) == primitives:
            return scene


def numpy_cast(scene: TableScene) -> np.ndarray:
    """Depth by slabs and quadrics over whole images, as one would write it first."""
    K, T = scene.intrinsics, scene.T_base_camera
    v, u = np.indices(SHAPE)
    rays = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones(u.shape)], -1)
    rays = rays @ T[:3, :3].T
    depth = np.full(u.shape, np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        for solid in scene.primitives:
            R, half = solid.T_base_solid[:3, :3], solid.half_size
            o = R.T @ (T[:3, 3] - solid.T_base_solid[:3, 3])
            d = rays @ R
            low, high = (-half - o) / d, (half - o) / d
            slabs = slice(0, 3)
            near = far = None
            if hasattr(solid, "radius_m"):
                a = d[..., 0] ** 2 + d[..., 1] ** 2
                b = d[..., 0] * o[0] + d[..., 1] * o[1]
                root = np.sqrt(b * b - a * (o[0] ** 2 + o[1] ** 2 - solid.radius_m**2))
                near, far = (-b - root) / a, (-b + root) / a
                slabs = slice(2, 3)
            enter = np.minimum(low, high)[..., slabs].max(-1)
            leave = np.maximum(low, high)[..., slabs].min(-1)
            if near is not None:
                enter, leave = np.maximum(enter, near), np.minimum(leave, far)
            hit = (enter <= leave) & (enter > 0) & (enter < depth)
            depth[hit] = enter[hit]
    return depth


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=60)
    parser.add_argument("--primitives", type=int, default=12)
    args = parser.parse_args()
    scene = crowded(args.primitives)
    rng = np.random.default_rng(0)
    view = [scene.primitives, scene.intrinsics, scene.T_base_camera]
    far = np.abs(numpy_cast(scene) - cast(*view).depth)
    rows = [
        ("cast: depth, color, object ids", milliseconds(lambda: cast(*view), args.repeats)),
        ("cast, shaded", milliseconds(lambda: cast(*view, shading=0.4), args.repeats)),
        ("cast with Xtion noise", milliseconds(lambda: to_capture(scene, rng), args.repeats)),
        ("numpy, depth only", milliseconds(lambda: numpy_cast(scene), max(3, args.repeats // 20))),
    ]
    print(f"{os.cpu_count()} cores, {len(scene.primitives)} primitives, 640 x 480")
    print(f"largest difference from numpy: {np.nanmax(far[np.isfinite(far)]) * 1e3:.4f} mm")
    for name, ms in rows:
        print(f"{name:30s} {ms:7.1f} ms  {1e3 / ms:7.1f} views/s")


if __name__ == "__main__":
    main()
