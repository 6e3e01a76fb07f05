"""`select` beside the pipeline one would write first. `python benchmarks/select_speed.py`.

From a 640 x 480 depth array to an answer, wall time around the call, warm, on several cast scenes.
The obvious pipeline: back-projection, pass-through, Open3D's 3 mm voxels, plane, outliers and
clusters over all that is seen; OctoMap's exact insertion of the whole cloud at 3 cm; 184 searches;
numpy distances of the 15 candidates to the obstacle points. The cropped one does the same to what
lies in a cube of 60 cm round the target, and inserts discretized. Both are spared the checks: they
find no reasons, no unseen space, no free approach. All take turns call by call, so that other work
on the machine weighs on all alike: trust the ratios.

Open3D is wanted for nothing but this (`pip install -r benchmarks/requirements.txt`); without it, or
without a system library that it links to, that is said and only our own figures are printed. Peak
memory is that of a fresh process that reads one capture and selects.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from _measure import cast_captures, lacking, quartiles, run

from boxgrasp import Capture, GraspSelector, Selection
from boxgrasp.arrays import Floats, Points
from boxgrasp.geometry.box import Box
from boxgrasp.geometry.transforms import invert, transform
from boxgrasp.grasps.candidates import candidates_of
from boxgrasp.grasps.gripper import Gripper
from boxgrasp.io.npz import save_npz
from boxgrasp.mapping.local_map import MappingConfig
from boxgrasp.perception.scene_config import SceneConfig
from boxgrasp.ranking.sampling import grid

Contender = Callable[[Capture], Any]

BAR_MS, BAR_OBVIOUS, BAR_CROPPED, BAR_MB = 33.0, 10.0, 5.0, 400.0
SCENE = SceneConfig()
CELL_M, CROP_M = MappingConfig().resolution_m, 0.60
# VmHWM and not ru_maxrss: a child's ru_maxrss counts what its parent held.
PEAK = """
import sys
from boxgrasp import GraspSelector, load_capture
GraspSelector().select(load_capture(sys.argv[1]))
peak = next(line for line in open("/proc/self/status") if line.startswith("VmHWM"))
print(int(peak.split()[1]) / 1024)
"""


def ours(selector: GraspSelector, capture: Capture) -> Selection:
    """The call that is timed, from arrays."""
    fresh = Capture(
        capture.depth,
        capture.intrinsics,
        capture.T_base_camera,
        capture.rgb,
        target_pixel=capture.target_pixel,
    )
    return selector.select(fresh)


def obvious(capture: Capture, crop: bool) -> int:
    """The pipeline of the libraries; the row of the candidate with most clearance."""
    import open3d

    T = capture.T_base_camera
    points, on_target = back_projected(capture)
    if crop:
        points = points[np.all(np.abs(points - on_target) < CROP_M / 2, axis=1)]
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
    cloud = cloud.voxel_down_sample(SCENE.voxel_m)
    plane, _ = cloud.segment_plane(0.01, 3, 1000)
    x = np.asarray(cloud.points)
    plane = np.array(plane) * np.sign(T[2, :3] @ plane[:3])
    high = np.flatnonzero(x @ plane[:3] + plane[3] > 0.01)
    over, _ = cloud.select_by_index(high).remove_statistical_outlier(20, 2.0)
    clusters = np.array(over.cluster_dbscan(SCENE.cluster_tolerance_m, 10))
    stands = np.asarray(over.points)
    own = clusters == clusters[np.argmin(((stands - on_target) ** 2).sum(axis=1))]
    box = aligned_box(transform(T, stands[own]), transform(T, x))
    searched(x, T, box, exact=not crop)
    return farthest(box, transform(T, stands[~own]))


def back_projected(capture: Capture) -> tuple[Floats, Floats]:
    """(N, 3) points in the camera frame and the target pixel's point (3,)."""
    depth, K = capture.depth, capture.intrinsics
    v, u = np.nonzero((depth > SCENE.min_range_m) & (depth < SCENE.max_range_m))
    z = depth[v, u].astype(np.float64)
    points = np.column_stack([(u - K[0, 2]) / K[0, 0] * z, (v - K[1, 2]) / K[1, 1] * z, z])
    a, b = capture.target_pixel
    return points, points[np.argmin((u - a) ** 2 + (v - b) ** 2)]


def aligned_box(own: Floats, everything: Floats) -> Box:
    """Plain minimum and maximum, down to the table."""
    low, high = own.min(axis=0), own.max(axis=0)
    low[2] = np.median(everything[:, 2])
    T = np.eye(4)
    T[:3, 3] = (low + high) / 2
    return Box(T, high - low)


def searched(points: Floats, T: Floats, box: Box, exact: bool) -> Points:
    """(184,) occupancy of the half sphere out of OctoMap, in the map's frame."""
    import octomap

    config = MappingConfig()

    T_map_camera = invert(box.T_base_map()) @ T
    tree = octomap.OcTree(CELL_M)
    tree.setProbMiss(config.prob_miss)
    tree.insertPointCloud(
        transform(T_map_camera, points), T_map_camera[:3, 3], maxrange=-1.0, discretize=not exact
    )
    values = np.full(184, 0.5, np.float32)
    for k, place in enumerate(grid()):
        try:
            p = tree.search(place).getOccupancy()
        except octomap.NullPointerException:
            continue
        values[k] = 1.0 if p > config.occupied_above else 0.0 if p < config.free_below else 0.5
    return values


def farthest(box: Box, obstacles: Floats) -> int:
    """The candidate whose gripper box is farthest from the obstacle points."""
    hand = Gripper()
    candidates = candidates_of(box, hand)
    clear = []
    for T in candidates.T_base_gripper:
        away = np.abs(transform(invert(T), obstacles)) - hand.half_m
        clear.append(np.linalg.norm(np.maximum(away, 0.0), axis=1).min(initial=0.5))
    return int(np.argmax(clear))


def milliseconds(work: Callable[[], Any]) -> tuple[float, Any]:
    """Wall time of one call, and what it gave."""
    start = time.perf_counter()
    result = work()
    return (time.perf_counter() - start) * 1e3, result


def peak_memory_mb(capture: Capture) -> float:
    """Most memory that a fresh process held while it read and selected."""
    with tempfile.TemporaryDirectory() as place:
        path = Path(place) / "capture.npz"
        save_npz(capture, path)
        done = run(["-c", PEAK, str(path)])
    if done.status:
        raise RuntimeError(done.err)
    return float(done.out)


def word(held: bool) -> str:
    """How a bar stands."""
    return "held" if held else "MISSED"


@dataclass
class Times:
    """What calls took, ms.

    Attributes:
        calls: by contender, one a call.
        off: by how much `timings_ms.total` differs from the call's wall time, as a share of it.
        stages: `timings_ms` of each call of `select`.
    """

    calls: dict[str, list[float]]
    off: list[float] = field(default_factory=list)
    stages: list[dict[str, float]] = field(default_factory=list)

    def median(self, name: str) -> float:
        """Of one contender, ms."""
        return float(np.median(self.calls[name]))


def contenders_of(selector: GraspSelector, alone: bool) -> dict[str, Contender]:
    """By name, what takes turns; the libraries' pipelines where Open3D is there."""
    own: dict[str, Contender] = {
        "select": selector.select,
        "Capture + select": lambda capture: ours(selector, capture),
    }
    if alone:
        return own
    reasons = [
        lacking("open3d", "pip install -r benchmarks/requirements.txt"),
        lacking("octomap", "pip install '.[io]'"),
    ]
    if any(reasons):
        print(f"no comparison, our own part alone; {'; '.join(filter(None, reasons))}")
        return own
    own["obvious"] = lambda capture: obvious(capture, crop=False)
    own["cropped, discretized"] = lambda capture: obvious(capture, crop=True)
    return own


def timed(contenders: dict[str, Contender], captures: list[Capture], rounds: int) -> Times:
    """All in turn, `rounds` times every capture."""
    for work in contenders.values():
        work(captures[0])
    times = Times({name: [] for name in contenders})
    for _ in range(rounds):
        for capture in captures:
            for name, work in contenders.items():
                ms, result = milliseconds(lambda work=work, capture=capture: work(capture))
                times.calls[name].append(ms)
                if name == "select":
                    times.off.append(abs(ms - result.timings_ms["total"]) / ms)
                    times.stages.append(result.timings_ms)
    return times


def print_table(times: Times) -> None:
    """Quartiles of every contender, and the stages of `select`."""
    print(f"{'':22s}  {'median':>8s}  {'quartiles':>18s}  {'least':>8s}   over ours")
    for name, values in times.calls.items():
        ratio = times.median(name) / times.median("Capture + select")
        print(f"{name:22s}  {quartiles(values)}   {ratio:5.1f}")
    stages = {key: np.median([lap[key] for lap in times.stages]) for key in times.stages[0]}
    print("stages: " + ", ".join(f"{key} {ms:.1f}" for key, ms in stages.items()))


def print_bars(times: Times, peak_mb: float) -> None:
    """How each bar stands."""
    own = times.median("Capture + select")
    print(f"\nmedian at most {BAR_MS:.0f} ms: {own:.1f}, {word(own <= BAR_MS)}")
    print(
        f"timings_ms.total within 5 %: off by {np.median(times.off):.2%} (median), "
        f"{max(times.off):.2%} (most), {word(float(np.median(times.off)) <= 0.05)}"
    )
    for name, bar in (("obvious", BAR_OBVIOUS), ("cropped, discretized", BAR_CROPPED)):
        if name in times.calls:
            ratio = times.median(name) / own
            print(f"{bar:.0f} times faster than {name}: {ratio:.1f}, {word(ratio >= bar)}")
    print(f"peak memory under {BAR_MB:.0f} MB: {peak_mb:.0f}, {word(peak_mb < BAR_MB)}")


def main(argv: list[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=12, help="calls a contender and scene")
    parser.add_argument("--scenes", type=int, default=6)
    parser.add_argument("--seed", type=int, default=31)
    parser.add_argument("--alone", action="store_true", help="without the libraries' pipelines")
    args = parser.parse_args(argv)
    captures = cast_captures(args.scenes, args.seed)
    linux = Path("/proc/self/status").exists()
    peak_mb = peak_memory_mb(captures[0]) if linux else float("nan")
    times = timed(contenders_of(GraspSelector(), args.alone), captures, args.rounds)
    print(
        f"{os.cpu_count()} cores, {args.scenes} cast scenes of 640 x 480, "
        f"{len(times.off)} calls each, warm; ms"
    )
    print_table(times)
    print_bars(times, peak_mb)


if __name__ == "__main__":
    main()
