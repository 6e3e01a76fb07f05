"""`boxgrasp warm-up` leaves nothing to compile for any command that comes after it."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from capture_files import View, pcd_bytes, ply_bytes, write_folder
from PIL import Image

from boxgrasp import Capture, GraspSelector
from boxgrasp.cli.warm_up import STEPS
from boxgrasp.geometry.transforms import quaternion_xyzw, transform
from boxgrasp.io.npz import save_npz
from boxgrasp.io.octomap import write_octomap
from boxgrasp.perception.segmentation import SEGMENTATIONS
from boxgrasp.simulate import build_scene, demo_capture, to_capture
from boxgrasp.simulate.demo import DEMO_SPEC

# In a process of its own: warms up, runs each command, and says which kernels were called with
# types that were new then. A kernel without types is fine where another that has some calls it.
RUN = """
import contextlib, importlib, io, json, pkgutil, sys
from boxgrasp import kernels
from boxgrasp.cli import main
from boxgrasp.kernels import _jit

def name_of(kernel):
    return f"{kernel.py_func.__module__}.{kernel.py_func.__name__}"

def called_by(kernel):
    there = [kernel.py_func.__globals__.get(word) for word in kernel.py_func.__code__.co_names]
    return [name_of(other) for other in there if other in _jit._made]

out, err = io.StringIO(), io.StringIO()
with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
    status = main(["warm-up"])
for module in pkgutil.iter_modules(kernels.__path__):
    importlib.import_module(f"boxgrasp.kernels.{module.name}")
first = before = _jit.signatures()
runs = []
for words in json.load(sys.stdin):
    ended, after = main(words), _jit.signatures()
    runs.append((words, ended, {name: k for name, k in after.items() if k != before[name]}))
    before = after
told = dict(status=status, printed=out.getvalue(), said=err.getvalue(), before=first, runs=runs)
told["calls"] = {name_of(kernel): called_by(kernel) for kernel in _jit._made}
open("told.json", "w").write(json.dumps(told))
"""


def write_captures(folder: Path) -> None:
    """The demo's table in every form in which a command reads one, and what goes with it."""
    view = demo_capture()
    assert view.depth is not None and view.intrinsics is not None and view.target_pixel is not None
    save_npz(view, folder / "table.npz")
    bare = {"depth": view.depth, "intrinsics": view.intrinsics}
    np.savez(folder / "bare.npz", **bare, target_pixel=view.target_pixel)
    wide = {name: np.asfortranarray(np.asarray(value, np.float64)) for name, value in bare.items()}
    np.savez(folder / "fortran.npz", **wide, T_base_camera=np.asfortranarray(view.T_base_camera))
    camera = {"position": [1.1, -0.75, 1.4], "gaze": [0.86, 0.0, 0.87]}
    other, _ = to_capture(build_scene(DEMO_SPEC | {"camera": camera}), np.random.default_rng(1))
    save_npz(other, folder / "other.npz")
    u, v = view.target_pixel
    hole = np.array(view.depth)
    hole[v - 9 : v + 9, u - 9 : u + 9] = np.nan
    np.savez(folder / "hole.npz", **{**bare, "depth": hole}, target_pixel=(u, v))
    numbers = GraspSelector().segment(view)
    own, arm = numbers == numbers[v, u], numbers == numbers.max()
    for name, mask in (("mask", own), ("arm", arm)):
        Image.fromarray(mask.astype(np.uint8) * 255).save(folder / f"{name}.png")
    seen = View(view.depth, view.intrinsics, view.T_base_camera, view.rgb, own, (u, v))
    write_folder(folder / "folder", seen)
    height, width = view.depth.shape
    told = json.loads((folder / "folder" / "intrinsics.json").read_text("utf-8"))
    told |= {"width": width, "height": height}
    (folder / "folder" / "intrinsics.json").write_text(json.dumps(told), "utf-8")
    write_clouds(folder, view)
    (folder / "gripper.yaml").write_text("max_opening_m: 0.1\n")
    (folder / "own.yaml").write_text(
        "scene: {voxel_m: 0.004, workspace_m: [[0, -1, 0], [2, 1, 2]]}"
    )
    for name in SEGMENTATIONS:
        (folder / f"{name}.yaml").write_text(f"scene: {{segmentation: {name}}}\n")


def write_clouds(folder: Path, view: Capture) -> None:
    points, pixels = view.valid_points()
    T = view.T_base_camera
    assert T is not None and view.rgb is not None and view.depth is not None
    grid = np.full((view.depth.size, 3), np.nan, dtype=np.float32)
    grid[pixels] = points
    organized = grid.reshape(*view.depth.shape, 3)[::3, ::3]
    thinned = points[::9]
    in_base = transform(T, thinned)
    x, y, z, w = quaternion_xyzw(T[:3, :3])
    pose = " ".join(map(str, (*T[:3, 3], w, x, y, z)))
    colors = np.full((len(thinned), 3), 90, dtype=np.uint8)
    (folder / "cloud.pcd").write_bytes(pcd_bytes(thinned, "binary", rgb=colors))
    (folder / "posed.pcd").write_bytes(pcd_bytes(in_base, "binary", viewpoint=pose))
    (folder / "organized.pcd").write_bytes(
        pcd_bytes(organized, "binary", rgb=view.rgb[::3, ::3], organized=True)
    )
    (folder / "base.ply").write_bytes(ply_bytes(in_base, "binary_little_endian"))


def write_with_extras(folder: Path) -> None:
    """Maps and bags, which take packages of the extras to write."""
    from bag_files import BagMaker
    from test_messages import rvl_of

    view = demo_capture()
    assert view.depth is not None and view.intrinsics is not None
    local_map = next(iter(GraspSelector().analyze(view).context.local_maps.values()))
    for kind in ("bt", "ot"):
        write_octomap(folder / f"map.{kind}", local_map)
    millimeters = np.round(view.depth * 1000).astype(np.uint16)
    size = (view.depth.shape[1], view.depth.shape[0])
    for name in ("plain", "rvl"):
        bag = BagMaker("mcap").info("/camera/depth/camera_info", 1.0, view.intrinsics, size=size)
        if name == "plain":
            bag.image("/camera/depth/image_raw", 1.0, millimeters, "16UC1")
        else:
            bag.compressed_depth(
                "/camera/depth/compressedDepth", 1.0, millimeters, rvl_of(millimeters)
            )
        (folder / name).mkdir()
        bag.write(folder / name)


def commands() -> list[list[str]]:
    """Each command that meets a kernel, on each form, by each setting that takes another way."""
    lines = [
        "objects table.npz --json --masks numbers.png --picture objects.png",
        "select table.npz --mask mask.png --picture answer.png --robot-mask arm.png",
        "select table.npz --object 2 --scan other.npz",
        "select table.npz --point 0.82 -0.01 0.9 --octomap map.bt",
        "select table.npz --box 280 180 360 300 --octomap map.ot",
        "select table.npz --config own.yaml --gripper gripper.yaml",
        "explain fortran.npz --pixel 322 247",
        "explain bare.npz",
        "select hole.npz",
        "select folder",
        "select cloud.pcd --object 1",
        "select base.ply --cloud-frame base --object 1",
        "select organized.pcd --pixel 107 82",
        "select posed.pcd --object 1",
        "select plain/bag_mcap --pixel 322 247",
        "select rvl/bag_mcap --pixel 322 247",
        "demo --seed 3 --save again.npz",
        "simulate set --count 1 --noise strong --set real --processes 1 --keep-captures",
        "simulate physics --count 1 --wish any --physics --lines 5 --processes 1",
    ]
    lines += [f"select other.npz --config {name}.yaml" for name in SEGMENTATIONS]
    lines += [f"select table.npz --gripper {name}" for name in ("robotiq-2f-85", "thesis")]
    lines += [f"select other.npz --ranker {name}" for name in ("single-spiral", "top-down")]
    return [line.split() for line in lines]


@pytest.fixture(scope="module")
def told(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What the process says."""
    folder = tmp_path_factory.mktemp("warm")
    write_captures(folder)
    write_with_extras(folder)
    done = subprocess.run(
        [sys.executable, "-c", RUN], cwd=folder, input=json.dumps(commands()), text=True,
        capture_output=True, timeout=500,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return dict(json.loads((folder / "told.json").read_text("utf-8")))


def test_after_it_no_command_meets_a_kernel_for_new_types(told: dict[str, Any]) -> None:
    assert told["status"] == 0
    new = {" ".join(words): found for words, _, found in told["runs"] if found}
    assert not new
    failed = [" ".join(words) for words, ended, _ in told["runs"] if ended]
    assert not failed, "each command must get as far as an answer"


def test_it_reaches_every_kernel(told: dict[str, Any]) -> None:
    """Itself, or as a part of another one that it reaches."""
    reached = {name for name, types in told["before"].items() if types}
    waiting = list(reached)
    while waiting:
        within = set(told["calls"][waiting.pop()]) - reached
        reached |= within
        waiting += within
    assert len(reached) > 70
    assert sorted(set(told["before"]) - reached) == []


def test_it_says_how_far_it_is_and_at_last_how_many_and_where(told: dict[str, Any]) -> None:
    line = told["printed"]
    assert re.fullmatch(r"\d+ kernels compiled in \d+ s, kept in /\S+\n", line), line
    lines = told["said"].splitlines()
    assert all(re.match(rf"warm-up: \d of {len(STEPS)}, \d+ s", line) for line in lines), lines
    assert lines[-1].startswith(f"warm-up: {len(STEPS)} of {len(STEPS)}")
