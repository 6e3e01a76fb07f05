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
from dataclasses import dataclass
from typing import Any

import numpy as np
from _measure import lacking

from boxgrasp.geometry.transforms import make_transform, rotation_z, transform
from boxgrasp.mapping.local_map import LocalMap, MappingConfig
from boxgrasp.mapping.ray_insertion import build_local_map, lattice_transform
from boxgrasp.perception.scene_config import SceneConfig
from boxgrasp.ranking.sampling import RESOLUTION_M
from boxgrasp.simulate import draw_scene, to_capture

CELLS_M = sorted(set(RESOLUTION_M.values()))


def seconds(work: Callable[[], object]) -> float:
    """Wall time of one call."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def thinned(points: np.ndarray, edge_m: float = SceneConfig().voxel_m) -> np.ndarray:
    """One point for each voxel."""
    keys = np.floor(points / edge_m).astype(np.int64)
    _, first = np.unique((keys[:, 0] << 42) + (keys[:, 1] << 21) + keys[:, 2], return_index=True)
    return points[np.sort(first)]


def frame(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points (N, 3) and camera position (3,) in the base frame, and T_base_map at the target."""
    scene = draw_scene(np.random.default_rng(seed))
    capture, _ = to_capture(scene, np.random.default_rng(seed))
    points, pixels = capture.valid_points()
    scene_config = SceneConfig()
    depth_m = points[:, 2]  # long rays would cost OctoMap seconds
    near = (depth_m > scene_config.min_range_m) & (depth_m < scene_config.max_range_m)
    points, pixels = points[near], pixels[near]
    T = scene.T_base_camera
    u, v = capture.target_pixel
    at = int(np.argmin(np.abs(pixels - (v * capture.shape[1] + u))))
    base = transform(T, points)
    height_m = float(np.median(base[:, 2])) + MappingConfig().center_above_support_m
    center = np.array([*base[at, :2], height_m])
    return thinned(base), T[:3, 3], make_transform(rotation_z(0.3), center)


def cells(tree: Any, config: MappingConfig) -> tuple[np.ndarray, np.ndarray]:
    """Log-odds and known flags of OctoMap's cells on our lattice."""
    import octomap

    lowest, shape = config.lattice()
    values, known = np.zeros(shape, np.float32), np.zeros(shape, bool)
    for index in np.ndindex(shape):
        node = tree.search((np.array(index) + lowest + 0.5) * config.resolution_m)
        try:
            values[index], known[index] = node.getLogOdds(), True
        except octomap.NullPointerException:
            pass
    return values, known


@dataclass(frozen=True, eq=False)
class Contest:
    """One frame for ours, and the same points in the map frame for OctoMap.

    Attributes:
        points: (N, 3) float32, base frame, m.
        camera_m: (3,) camera position, base frame.
        T_base_map: (4, 4).
        config: cell size and sensor model.
        cloud: (N, 3) float64 of float32 values, lattice frame, m.
        origin: (3,) camera position, likewise.
    """

    points: np.ndarray
    camera_m: np.ndarray
    T_base_map: np.ndarray
    config: MappingConfig
    cloud: np.ndarray
    origin: np.ndarray

    def ours(self, threads: int = 2) -> LocalMap:
        """The whole call."""
        view = (self.points, self.camera_m)
        return build_local_map([view], self.T_base_map, self.config, threads=threads)

    def octomap(self, discretize: bool) -> Any:
        """Insertion into an empty tree."""
        import octomap

        tree = octomap.OcTree(self.config.resolution_m)
        tree.setProbMiss(self.config.prob_miss)
        tree.insertPointCloud(self.cloud, self.origin, maxrange=-1.0, discretize=discretize)
        return tree

    def equal(self) -> float:
        """The share of our cells in which OctoMap holds the same number."""
        local_map = self.ours()
        values, known = cells(self.octomap(False), self.config)
        same = (values == local_map.log_odds) & (known == local_map.known)
        return float(np.mean(same))

    def seconds(self, alone: bool = False) -> tuple[float, ...]:
        """Ours, ours on one thread, OctoMap's exact insertion, and its discretized one."""
        own = (seconds(self.ours), seconds(lambda: self.ours(1)))
        if alone:
            return own
        others = (seconds(lambda: self.octomap(False)), seconds(lambda: self.octomap(True)))
        return (*own, *others)


def contest(resolution_m: float, seed: int) -> Contest:
    """The points in both frames, to the bit as our own map rounds them."""
    points, camera_m, T_base_map = frame(seed)
    L = lattice_transform(T_base_map, resolution_m)
    x = points.astype(np.float64)
    axes = [L[a, 0] * x[:, 0] + L[a, 1] * x[:, 1] + L[a, 2] * x[:, 2] + L[a, 3] for a in (0, 1, 2)]
    cloud = np.stack(axes, axis=1).astype(np.float32).astype(np.float64)
    origin = (L[:3, :3] @ camera_m + L[:3, 3]).astype(np.float32).astype(np.float64)
    config = MappingConfig(resolution_m=resolution_m)
    return Contest(points, camera_m, T_base_map, config, cloud, origin)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--seed", type=int, default=5)
    args = parser.parse_args()
    contests = [contest(resolution_m, args.seed) for resolution_m in CELLS_M]
    count = len(contests[0].points)
    print(f"{os.cpu_count()} cores, {count} points of one frame; medians, ms (least)")
    if reason := lacking("octomap", "pip install '.[io]'"):
        print(f"no comparison, our own part alone; {reason}")
    print("cell   cells   ours         one thread   exact         discretized   ratios      equal")
    for one in contests:
        times = np.array([one.seconds(alone=bool(reason)) for _ in range(args.rounds)])
        m, least = np.median(times, axis=0) * 1e3, times.min(axis=0) * 1e3
        columns = "  ".join(f"{a:5.1f} ({b:5.1f})" for a, b in zip(m, least, strict=True))
        line = f"{one.config.resolution_m * 100:.0f} cm  {one.ours().log_odds.size:6d}  {columns}"
        if not reason:
            line += f"  {m[2] / m[0]:4.1f} {m[3] / m[0]:4.1f}  {one.equal():.2%}"
        print(line)


if __name__ == "__main__":
    main()
