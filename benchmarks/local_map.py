"""The local map beside OctoMap on the same points. `python benchmarks/local_map.py`.

One cast 640 x 480 frame with noise, 0.4 to 1.6 m away, thinned to 3 mm voxels. OctoMap inserts into
an empty tree, its most favorable case; ours is the whole call, frame change included. Rounds take
turns, so that other work on the machine weighs on all alike: trust the ratios.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable

import numpy as np
import octomap

from boxgrasp.geometry.transforms import make_transform, rotation_z, transform
from boxgrasp.mapping.local_map import MappingConfig
from boxgrasp.mapping.ray_insertion import build_local_map, lattice_transform
from boxgrasp.simulate import draw_scene, to_capture


def seconds(work: Callable[[], object]) -> float:
    """Wall time of one call."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def thinned(points: np.ndarray, edge_m: float = 0.003) -> np.ndarray:
    """One point for each voxel."""
    keys = np.floor(points / edge_m).astype(np.int64)
    _, first = np.unique((keys[:, 0] << 42) + (keys[:, 1] << 21) + keys[:, 2], return_index=True)
    return points[np.sort(first)]


def frame(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points (N, 3) and eye (3,) in the base frame, and T_base_map at the target."""
    scene = draw_scene(np.random.default_rng(seed))
    capture, _ = to_capture(scene, np.random.default_rng(seed))
    points, pixels = capture.valid_points()
    near = (points[:, 2] > 0.4) & (points[:, 2] < 1.6)  # long rays would cost OctoMap seconds
    points, pixels = points[near], pixels[near]
    T = scene.T_base_camera
    u, v = capture.target_pixel
    at = int(np.argmin(np.abs(pixels - (v * capture.shape[1] + u))))
    base = transform(T, points)
    center = np.array([*base[at, :2], np.median(base[:, 2]) + 0.05])
    return thinned(base), T[:3, 3], make_transform(rotation_z(0.3), center)


def cells(tree: octomap.OcTree, config: MappingConfig) -> tuple[np.ndarray, np.ndarray]:
    """Log-odds and known flags of OctoMap's cells on our lattice."""
    lowest, shape = config.lattice()
    values, known = np.zeros(shape, np.float32), np.zeros(shape, bool)
    for index in np.ndindex(shape):
        node = tree.search((np.array(index) + lowest + 0.5) * config.resolution_m)
        try:
            values[index], known[index] = node.getLogOdds(), True
        except octomap.NullPointerException:
            pass
    return values, known


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--seed", type=int, default=5)
    args = parser.parse_args()
    points, eye, T_base_map = frame(args.seed)
    print(f"{os.cpu_count()} cores, {len(points)} points of one frame; medians, ms (least)")
    print("cell   cells   ours         one thread   exact         discretized   ratios      equal")
    for resolution in (0.03, 0.07):
        config = MappingConfig(resolution_m=resolution)
        L = lattice_transform(T_base_map, resolution)
        x = points.astype(np.float64)
        rows = [
            L[a, 0] * x[:, 0] + L[a, 1] * x[:, 1] + L[a, 2] * x[:, 2] + L[a, 3] for a in (0, 1, 2)
        ]
        cloud = np.stack(rows, axis=1).astype(np.float32).astype(np.float64)
        origin = (L[:3, :3] @ eye + L[:3, 3]).astype(np.float32).astype(np.float64)

        def insert(
            discretize: bool,
            config: MappingConfig = config,
            cloud: np.ndarray = cloud,
            origin: np.ndarray = origin,
        ) -> octomap.OcTree:
            tree = octomap.OcTree(config.resolution_m)
            tree.setProbMiss(config.prob_miss)
            tree.insertPointCloud(cloud, origin, maxrange=-1.0, discretize=discretize)
            return tree

        def ours(threads: int = 2, config: MappingConfig = config) -> object:
            return build_local_map([(points, eye)], T_base_map, config, threads=threads)

        local = build_local_map([(points, eye)], T_base_map, config)
        values, known = cells(insert(False), config)
        equal = np.mean((values == local.log_odds) & (known == local.known))
        times = np.array(
            [
                [
                    seconds(ours),
                    seconds(lambda: ours(1)),
                    seconds(lambda: insert(False)),
                    seconds(lambda: insert(True)),
                ]
                for _ in range(args.rounds)
            ]
        )
        m, least = np.median(times, axis=0) * 1e3, times.min(axis=0) * 1e3
        columns = "  ".join(f"{a:5.1f} ({b:5.1f})" for a, b in zip(m, least, strict=True))
        print(
            f"{resolution * 100:.0f} cm  {values.size:6d}  {columns}  "
            f"{m[2] / m[0]:4.1f} {m[3] / m[0]:4.1f}  {equal:.2%}"
        )


if __name__ == "__main__":
    main()
