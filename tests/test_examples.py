"""Every example runs as it stands, in a fresh interpreter and an empty folder."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Sequence
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from helpers import drawn, seen

from boxgrasp import Capture, GraspSelector, Target
from boxgrasp.geometry.transforms import quaternion_xyzw
from boxgrasp.io.frames import TransformBuffer
from boxgrasp.perception.segmentation import SEGMENTATIONS
from boxgrasp.selector import default_checks
from boxgrasp.simulate import demo_capture

DOCS = Path(__file__).resolve().parent.parent / "docs"
EXAMPLES = sorted((Path(__file__).resolve().parent.parent / "examples").glob("*.py"))


def test_examples_are_numbered_without_gaps() -> None:
    numbers = [int(path.name[:2]) for path in EXAMPLES]
    assert numbers == list(range(1, len(EXAMPLES) + 1))


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_example_runs(path: Path, tmp_path: Path) -> None:
    done = subprocess.run([sys.executable, path], capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout
    notice = "compiling kernels"  # the first process after installing says so
    assert all(line.startswith(notice) for line in done.stderr.splitlines()), done.stderr


def loaded(name: str) -> ModuleType:
    """An example as a module."""
    (path,) = (path for path in EXAMPLES if path.stem == name)
    spec = spec_from_file_location(f"example_{name}", path)
    assert spec is not None and spec.loader is not None
    module = module_from_spec(spec)
    sys.modules[module.__name__] = module
    spec.loader.exec_module(module)
    return module


def filled(sizes_m: Sequence[float]) -> np.ndarray:
    """(N, 3) points all over a box round the origin, its corners among them."""
    axes = [np.linspace(-size / 2, size / 2, int(size / 0.005) + 2) for size in sizes_m]
    return np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 3)


def meets(T_base_hand: np.ndarray, low_m: np.ndarray, high_m: np.ndarray) -> bool:
    """Whether the default hand and a box share a point, by points all over both."""
    sizes = np.array((0.22, 0.17, 0.07))
    hand = filled(sizes) @ T_base_hand[:3, :3].T + T_base_hand[:3, 3]
    box = filled(high_m - low_m) + (low_m + high_m) / 2
    of_hand = (box - T_base_hand[:3, 3]) @ T_base_hand[:3, :3]
    in_box = np.all((hand > low_m) & (hand < high_m), axis=1).any()
    return bool(in_box or np.all(np.abs(of_hand) < sizes / 2, axis=1).any())


@pytest.mark.parametrize("seed", range(4))
def test_own_check_rejects_exactly_the_hands_that_meet_the_box(seed: int) -> None:
    """The check of the example against points all over hand and box, in turned scenes."""
    example = loaded("14_own_check")
    view = seen(drawn(seed, yaw="random"), seed)
    without = GraspSelector().select(view)
    rng = np.random.default_rng(seed)
    met: list[bool] = []
    for _ in range(12):
        center = without.box.T_base_box[:3, 3] + rng.uniform(-0.3, 0.3, 3)
        half = rng.uniform(0.03, 0.15, 3)
        low, high = center - half, center + half
        keep_out = example.KeepOutBox(tuple(low.tolist()), tuple(high.tolist()))
        found = GraspSelector(checks=[*default_checks(), keep_out]).select(view)
        for candidate, before in zip(found.candidates, without.candidates, strict=True):
            said = candidate.checks["keep_out_box"]
            if abs(said.value) < 0.001:
                continue  # hand and box touch: points cannot tell
            met.append(meets(candidate.T_base_gripper, low, high))
            assert said.passed != met[-1]
            assert candidate.passed == (before.passed and not met[-1])
            reasons = [reason.check for reason in candidate.rejections]
            assert ("keep_out_box" in reasons) == met[-1]
            assert [name for name in reasons if name != "keep_out_box"] == [
                reason.check for reason in before.rejections
            ]
    assert len(met) > 170 and 20 < sum(met) < 150, "boxes near enough, and not too near"


def test_own_check_is_one_class(capsys: pytest.CaptureFixture[str]) -> None:
    """What the example prints is what its selection holds."""
    example = loaded("14_own_check")
    shown = capsys.readouterr().out.splitlines()
    reasons = [
        f"{candidate.name}: {reason.sentence}"
        for candidate in example.selection.candidates
        for reason in candidate.rejections
        if reason.check == "keep_out_box"
    ]
    assert len(reasons) >= 5 and shown == [repr(example.selection), *reasons]


def test_own_segmentation_parts_what_touches(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(SEGMENTATIONS, "by-color", "")  # its name is gone again after the test
    example = loaded("15_own_segmentation")
    counts = {
        name: len(GraspSelector({"scene": {"segmentation": name}}).objects(example.view))
        for name in ("euclidean", "by-color")
    }
    assert counts == {"euclidean": 1, "by-color": 2}


def test_ros_page_code_runs() -> None:
    (block,) = re.findall(r"```python\n(.*?)```", (DOCS / "ros.md").read_text("utf-8"), re.S)
    names: dict[str, object] = {}
    exec(block, names)
    view = demo_capture()
    assert view.depth is not None and view.intrinsics is not None
    height, width = view.depth.shape
    data = np.round(view.depth * 1000).astype(np.uint16).tobytes()
    stamp = SimpleNamespace(sec=7, nanosec=5)
    depth = SimpleNamespace(
        header=SimpleNamespace(frame_id="camera_optical_frame", stamp=stamp),
        height=height,
        width=width,
        encoding="16UC1",
        is_bigendian=0,
        step=2 * width,
        data=data,
    )
    k = view.intrinsics.reshape(-1).tolist()
    info = SimpleNamespace(height=height, width=width, d=[0.0] * 5, k=k)
    assert view.T_base_camera is not None
    x, y, z, w = quaternion_xyzw(view.T_base_camera[:3, :3]).tolist()
    place = dict(zip("xyz", view.T_base_camera[:3, 3].tolist(), strict=True))
    mounted = SimpleNamespace(
        header=SimpleNamespace(frame_id="base_link", stamp=stamp),
        child_frame_id="camera_optical_frame",
        transform=SimpleNamespace(
            translation=SimpleNamespace(**place), rotation=SimpleNamespace(x=x, y=y, z=z, w=w)
        ),
    )
    buffer = names["transforms"]
    assert isinstance(buffer, TransformBuffer)
    buffer.add(SimpleNamespace(transforms=[mounted]), True)
    T_base_camera = buffer.lookup("base_link", "camera_optical_frame", 0)
    np.testing.assert_allclose(T_base_camera, view.T_base_camera, atol=1e-12)
    pixel = view.target_pixel
    depth_m = (np.frombuffer(data, np.uint16).reshape(height, width) * 0.001).astype(np.float32)
    same = Capture(depth_m, view.intrinsics, T_base_camera)
    # The page's own faces are all in the way here, so it asks; with every face there is a grasp.
    for selector in (names["selector"], GraspSelector()):
        names["selector"] = selector
        assert isinstance(selector, GraspSelector)
        known = selector.select(same, Target(pixel=pixel))
        answer = names["on_request"](depth, info, None, pixel)  # type: ignore[operator]
        if known.refusal is not None:
            assert answer == known.refusal.message
        else:
            poses = [candidate.T_base_gripper for candidate in known.passing]
            np.testing.assert_array_equal(answer, poses)
    assert known.status == "grasp"
    refused = names["on_request"](depth, info, None, (9999, 5))  # type: ignore[operator]
    assert isinstance(refused, str) and "valid" in refused
