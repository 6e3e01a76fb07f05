"""What cannot be answered is refused with one line, whatever is thrown at it."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from helpers import item, laid, seen
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from boxgrasp import Capture, GraspSelector, Selection, Target
from boxgrasp.errors import BoxgraspError, ConfigError, GripperError, SceneError, TargetError
from boxgrasp.geometry.transforms import make_transform
from boxgrasp.simulate import cast
from boxgrasp.simulate.camera import intrinsics_matrix

K = intrinsics_matrix()
SELECTOR = GraspSelector()
SCENE = laid(item("green_cube", 0.85, 0.0), item("beans_can", 0.95, 0.2))
QUIET = settings(deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])


@cache
def view() -> Capture:
    return seen(SCENE, 0)


def refused(error: type[BoxgraspError], act: Callable[[], object], word: str = "") -> None:
    """The act fails with that error, in one line that says what is valid."""
    with pytest.raises(error, match=word or None) as caught:
        act()
    text = str(caught.value)
    assert text.strip() and "\n" not in text and "valid" in text
    assert len(text) < 400


def bare_table() -> Capture:
    solids = [p for p in SCENE.primitives if p.object_id <= 1]
    return Capture(
        cast(solids, SCENE.intrinsics, SCENE.T_base_camera).depth,
        SCENE.intrinsics,
        SCENE.T_base_camera,
        target_pixel=(320, 300),
    )


def random_depth() -> Capture:
    depth = np.random.default_rng(0).uniform(0.5, 3.0, (480, 640)).astype(np.float32)
    return Capture(depth, K, SCENE.T_base_camera, target_pixel=(320, 240))


def random_cloud(T: np.ndarray | None) -> Capture:
    points = np.random.default_rng(0).uniform((-1, -1, 0.5), (1, 1, 2.5), (20_000, 3))
    return Capture.from_cloud(points, T_base_camera=T)


def wall() -> Capture:
    """The camera looks level at a wall."""
    T = make_transform([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], (0.0, 0.0, 1.2))
    return Capture(np.full((480, 640), 1.5, np.float32), K, T, target_pixel=(320, 240))


def single_pixel() -> Capture:
    depth = np.zeros((480, 640), np.float32)
    depth[240, 320] = 1.0
    return Capture(depth, K, SCENE.T_base_camera, target_pixel=(320, 240))


SCENES = {
    "random points": random_depth,
    "a random cloud": lambda: random_cloud(None),
    "a random cloud with a camera": lambda: random_cloud(SCENE.T_base_camera),
    "a bare table": bare_table,
    "a wall": wall,
    "one pixel": single_pixel,
    "two points": lambda: Capture.from_cloud([[0, 0, 1.0], [0.1, 0, 1.0]]),
    "points on a line": lambda: Capture.from_cloud(
        np.column_stack((np.linspace(-1, 1, 5000), np.zeros(5000), np.ones(5000)))
    ),
    "equal points": lambda: Capture.from_cloud(np.ones((5000, 3))),
}


@pytest.mark.parametrize("case", SCENES)
def test_no_plane_or_nothing_on_it(case: str) -> None:
    refused(SceneError, lambda: SELECTOR.select(SCENES[case](), Target(object=1)))
    refused(SceneError, lambda: SELECTOR.objects(SCENES[case]()))


def test_the_two_words_for_an_empty_scene() -> None:
    refused(SceneError, lambda: SELECTOR.select(bare_table()), "nothing stands")
    refused(SceneError, lambda: SELECTOR.select(single_pixel()), "no support plane")


EMPTY = np.zeros((480, 640), bool)
TARGETS = {
    "right of the image": (Target(pixel=(640, 10)), "outside"),
    "left of the image": (Target(pixel=(-1, 10)), "outside"),
    "on the table": (Target(pixel=(320, 470)), "table"),
    "on nothing": (Target(pixel=(5, 5)), ""),
    "empty mask": (Target(mask=EMPTY), "empty"),
    "mask of the whole image": (Target(mask=~EMPTY), "100% of the image"),
    "misshapen mask": (Target(mask=EMPTY[:10]), "mask is"),
    "number too high": (Target(object=3), "no object 3; valid: 1 to 2"),
    "number nought": (Target(object=0), "no object 0"),
    "point in the air": (Target(point=(0.85, 0.0, 2.0)), "on no object"),
}


@pytest.mark.parametrize("case", TARGETS)
def test_targets_that_are_not_there(case: str) -> None:
    target, word = TARGETS[case]
    refused(TargetError, lambda: SELECTOR.select(view(), target), word)


def test_a_capture_without_a_target_needs_one() -> None:
    bare = Capture(view().depth, view().intrinsics, view().T_base_camera)
    refused(TargetError, lambda: SELECTOR.select(bare), "no target given")


def test_captures_with_wrong_targets_of_their_own() -> None:
    parts = (view().depth, view().intrinsics, view().T_base_camera)
    refused(BoxgraspError, lambda: Capture(*parts, mask=EMPTY), "empty")
    refused(BoxgraspError, lambda: Capture(*parts, mask=EMPTY[:9]), "shape")
    refused(BoxgraspError, lambda: Capture(*parts, target_pixel=(640, 3)), "outside")
    table = np.array(EMPTY)
    table[450:470, 300:340] = True
    on_table = Capture(*parts, mask=table)
    refused(TargetError, lambda: SELECTOR.select(on_table), "nothing above")


@pytest.mark.parametrize(
    "gripper",
    [
        {"max_opening_m": 0.0},
        {"max_opening_m": 0.001},
        {"max_opening_m": 0.003},
        {"max_opening_m": -1.0},
        {"max_opening_m": 0.2},
        {"insertion_depth_m": 0.0},
        {"insertion_depth_m": 0.3},
    ],
)
def test_a_gripper_that_cannot_hold_anything(gripper: dict[str, float]) -> None:
    def act() -> None:
        GraspSelector({"gripper": gripper}).select(view())

    with pytest.raises((GripperError, ConfigError)) as caught:
        act()
    assert "\n" not in str(caught.value) and "valid" in str(caught.value)


@pytest.mark.parametrize(
    "config",
    [
        {"ranker": "oracle"},
        {"scenes": {}},
        {"scene": {"voxel": 0.003}},
        {"scene": {"voxel_m": 0.0}},
        {"scene": {"segmentation": "none"}},
        {"scene": {"workspace_m": [[0, 0, 0]]}},
        {"checks": {"visible_clearance_m": -1}},
        {"candidates": {"lines": 0}},
        {"candidates": {"faces": []}},
        {"box": {"fit": "round"}},
        {"unchecked": "yes"},
    ],
)
def test_wrong_settings(config: dict[str, object]) -> None:
    refused(ConfigError, lambda: GraspSelector(config))


def test_a_thing_that_is_no_capture_fails_plainly() -> None:
    with pytest.raises((BoxgraspError, AttributeError, TypeError)):
        SELECTOR.select("view.npz")  # type: ignore[arg-type]


# Anything at all


def only_answers_or_refuses(make: Callable[[], Capture], target: Target | None) -> None:
    try:
        answer = SELECTOR.select(make(), target)
    except BoxgraspError as error:
        assert str(error).strip() and "\n" not in str(error)
        return
    assert isinstance(answer, Selection)
    assert Selection.from_json(answer.to_json()).status in ("grasp", "ask")


TARGET = st.one_of(
    st.just(Target(object=1)),
    st.builds(Target, object=st.integers(-1, 4)),
    st.builds(Target, pixel=st.tuples(st.integers(-2, 40), st.integers(-2, 40))),
    st.builds(Target, point=st.tuples(*(st.floats(-2, 2),) * 3)),
    st.none(),
)


@settings(parent=QUIET, max_examples=250)
@given(
    seed=st.integers(0, 2**32 - 1),
    shape=st.tuples(st.integers(1, 40), st.integers(1, 40)),
    scale=st.sampled_from([0.0, 0.002, 0.1, 1.0]),
    lost=st.sampled_from([0.0, 0.3, 0.99]),
    posed=st.booleans(),
    target=TARGET,
)
def test_random_depth_images(
    seed: int,
    shape: tuple[int, int],
    scale: float,
    lost: float,
    posed: bool,
    target: Target | None,
) -> None:
    rng = np.random.default_rng(seed)
    depth = (rng.uniform(0.3, 2.0) + scale * rng.random(shape)).astype(np.float32)
    depth[rng.random(shape) < lost] = rng.choice([0.0, np.nan])
    focal = float(rng.uniform(0.5, 2.0)) * max(shape)
    camera = intrinsics_matrix(focal, shape)
    T = SCENE.T_base_camera if posed else None
    only_answers_or_refuses(lambda: Capture(depth, camera, T), target)


@settings(parent=QUIET, max_examples=150)
@given(
    seed=st.integers(0, 2**32 - 1),
    count=st.sampled_from([1, 50, 3000, 12_000]),
    flat=st.booleans(),
    things=st.integers(0, 3),
    frame=st.sampled_from(["optical", "base"]),
    posed=st.booleans(),
    target=TARGET,
)
def test_random_clouds(
    seed: int,
    count: int,
    flat: bool,
    things: int,
    frame: str,
    posed: bool,
    target: Target | None,
) -> None:
    """Random points, or a random table with random heaps on it."""
    rng = np.random.default_rng(seed)
    points = rng.uniform((-0.4, -0.4, 0.0), (0.4, 0.4, 1.0 - 0.999 * flat), (count, 3))
    for _ in range(things):
        heap = rng.normal(0, rng.choice([0.0, 0.003, 0.015, 0.05], 3), (400, 3))
        points = np.vstack((points, np.abs(heap) + (*rng.uniform(-0.3, 0.3, 2), 0.01)))
    T = make_transform([[0, -0.6, 0.8], [-1, 0, 0], [0, -0.8, -0.6]], (-0.7, 0, 0.6))
    if frame == "optical":
        points = (points - T[:3, 3]) @ T[:3, :3]
    only_answers_or_refuses(
        lambda: Capture.from_cloud(
            points,
            cloud_frame=frame,  # type: ignore[arg-type]
            T_base_camera=T if posed else None,
        ),
        target,
    )


@settings(parent=QUIET, max_examples=80)
@given(
    seed=st.integers(0, 2**32 - 1),
    hole=st.sampled_from([0.0, 0.1, 0.5, 0.9]),
    blot=st.integers(0, 60),
    cut=st.tuples(st.integers(70, 120), st.integers(90, 160)),
    posed=st.booleans(),
    target=st.one_of(st.just(Target(object=1)), TARGET),
)
def test_damaged_views_of_a_table(
    seed: int,
    hole: float,
    blot: int,
    cut: tuple[int, int],
    posed: bool,
    target: Target | None,
) -> None:
    """A real scene at a quarter of its size: cut, with holes, a blot and single mad pixels."""
    rng = np.random.default_rng(seed)
    step = 4
    assert view().depth is not None
    depth = np.array(view().depth)[::step, ::step][: cut[0], : cut[1]]
    depth[rng.random(depth.shape) < hole] = 0
    v, u = rng.integers(0, depth.shape)
    depth[v : v + blot, u : u + blot] = rng.choice([0.0, 0.5, 0.9])
    mad = rng.integers(0, depth.size, 5)
    depth.reshape(-1)[mad] = rng.uniform(0.01, 60.0, 5)
    arm = rng.random(depth.shape) < 0.05 if seed % 2 else None
    camera = np.array(K)
    camera[:2] /= step
    T = SCENE.T_base_camera if posed else None
    only_answers_or_refuses(lambda: Capture(depth, camera, T, robot_mask=arm), target)


@pytest.mark.parametrize("max_range_m", [1e3, 5e3, 1e5])
def test_base_clouds_far_from_their_origin(max_range_m: float) -> None:
    """A map frame may lie kilometers off; whatever float32 leaves is answered or refused."""
    points, _ = view().valid_points()
    T = SCENE.T_base_camera
    base = points @ T[:3, :3].T.astype(np.float32) + T[:3, 3].astype(np.float32)
    moved = base.astype(np.float64) + (max_range_m, -max_range_m, 0.0)
    only_answers_or_refuses(lambda: Capture.from_cloud(moved, cloud_frame="base"), Target(object=1))


# Ten million points

MILLIONS = """
import resource, sys
import numpy as np
sys.path.insert(0, {tests!r})
from boxgrasp import BoxgraspError, Capture, GraspSelector, Target
from boxgrasp.simulate import cast
from boxgrasp.simulate.camera import intrinsics_matrix
from helpers import item, laid
scene = laid(item("green_cube", 0.85, 0.0), item("beans_can", 0.95, 0.2))
shape = (2700, 3720)
K = intrinsics_matrix(525.0 * 5.8, shape)
depth = cast(scene.primitives, K, scene.T_base_camera, shape).depth
if {kind!r} == "depth":
    capture = Capture(depth, K, scene.T_base_camera)
else:
    points, _ = Capture(depth, K).valid_points()
    points = points[np.random.default_rng(0).permutation(len(points))]
    assert len(points) > 9_900_000
    capture = Capture.from_cloud(points, T_base_camera=scene.T_base_camera)
try:
    print(GraspSelector().select(capture, Target(object=1)).status)
except BoxgraspError as error:
    print("refused", error)
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024)
"""


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["depth", "cloud"])
def test_ten_million_points_stay_under_three_gigabytes(kind: str) -> None:
    """Answered or refused; peak memory of the process that casts, holds and selects."""
    code = MILLIONS.format(tests=str(Path(__file__).parent), kind=kind)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=240)
    assert done.returncode == 0, done.stderr[-2000:]
    said, megabytes = done.stdout.splitlines()
    assert said in ("grasp", "ask")
    assert int(megabytes) < 3000
