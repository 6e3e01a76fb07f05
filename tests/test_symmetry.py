"""The same scene elsewhere, turned, mirrored, shuffled or asked twice gives the same grasp.

Moved scenes are compared within 0.1 mm: points are float32. Mirrored ones within 2 mm: the plane
is refitted on other pixels of the same table, the rays are every second column from the other
side, and voxels' and boxes' edges fall on the other side of a cell. An answer may differ where two
candidates are as good as each other, since then the lower label wins, and left is 1 and right 3;
scenes with such ties are left out by what the answer itself says (`tied`).
"""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor
from functools import cache

import numpy as np
import pytest
from helpers import answer_text, drawn, seen

from boxgrasp import Capture, GraspSelector, Selection, Target
from boxgrasp.geometry.transforms import make_transform, rotation_z, transform
from boxgrasp.result import Candidate

SEEDS = range(14)
SELECTOR = GraspSelector()


@cache
def view(seed: int, noisy: bool = True) -> Capture:
    return seen(drawn(seed, (1, 4)), seed if noisy else None)


@cache
def answer(seed: int, noisy: bool = True) -> Selection:
    return SELECTOR.select(view(seed, noisy))


def copy_of(capture: Capture, **changes: object) -> Capture:
    parts = {
        "depth": capture.depth,
        "intrinsics": capture.intrinsics,
        "T_base_camera": capture.T_base_camera,
        "rgb": capture.rgb,
        "target_pixel": capture.target_pixel,
        **changes,
    }
    return Capture(**parts)  # type: ignore[arg-type]


# The same bytes


@pytest.mark.parametrize("seed", SEEDS)
def test_same_input_same_bytes(seed: int) -> None:
    again = GraspSelector().select(copy_of(view(seed)))
    assert answer_text(again) == answer_text(answer(seed))
    lines = []
    for found in (again, answer(seed)):
        line = json.loads(found.to_json())
        line.pop("timings_ms")
        lines.append(json.dumps(line))
    assert lines[0] == lines[1]


def test_order_of_a_batch_is_irrelevant() -> None:
    selector = GraspSelector()
    backwards = {seed: answer_text(selector.select(view(seed))) for seed in reversed(SEEDS)}
    assert backwards == {seed: answer_text(answer(seed)) for seed in SEEDS}


def test_two_threads_at_once() -> None:
    """One selector, two threads, the same captures in different orders at the same time."""
    selector = GraspSelector()
    orders = [list(SEEDS), list(reversed(SEEDS))]

    def work(order: list[int]) -> dict[int, str]:
        return {seed: answer_text(selector.select(view(seed))) for seed in order}

    with ThreadPoolExecutor(2) as pool:
        found = list(pool.map(work, orders))
    expected = {seed: answer_text(answer(seed)) for seed in SEEDS}
    assert found == [expected, expected]


@pytest.mark.parametrize("cloud_frame", ["optical", "base"])
@pytest.mark.parametrize("seed", range(4))
def test_order_of_a_clouds_points_is_irrelevant(seed: int, cloud_frame: str) -> None:
    capture = view(seed)
    points, pixels = capture.valid_points()
    assert capture.rgb is not None and capture.T_base_camera is not None
    colors = capture.rgb.reshape(-1, 3)[pixels]
    T = np.array(capture.T_base_camera)
    base = transform(T, points)
    if cloud_frame == "base":
        points = base
    u, v = capture.target_pixel or (0, 0)
    target = Target(point=tuple(base[np.searchsorted(pixels, v * 640 + u)].tolist()))
    texts = []
    for k in range(3):
        order = np.random.default_rng(k).permutation(len(points)) if k else np.arange(len(points))
        cloud = Capture.from_cloud(
            points[order],
            cloud_frame=cloud_frame,  # type: ignore[arg-type]
            colors=colors[order],
            T_base_camera=T,
        )
        texts.append(answer_text(SELECTOR.select(cloud, target)))
    assert texts[0] == texts[1] == texts[2]


# The same scene in another place


def label_of(found: Selection) -> int | None:
    return None if found.grasp is None else found.grasp.label


def value(candidate: Candidate, check: str) -> float:
    return candidate.checks[check].value


def same_but_moved(before: Selection, after: Selection, M: np.ndarray) -> None:
    assert after.status == before.status
    np.testing.assert_allclose(after.box.dimensions_m, before.box.dimensions_m, atol=6e-4)
    np.testing.assert_allclose(after.T_base_camera, M @ np.array(before.T_base_camera), atol=1e-9)
    for a, b in zip(before.candidates, after.candidates, strict=True):
        np.testing.assert_allclose(b.T_base_gripper, M @ a.T_base_gripper, atol=1e-4)
        assert a.passed == b.passed
        for check in ("visible_clearance", "plane_clearance"):
            assert value(b, check) == pytest.approx(value(a, check), abs=1e-4)
    assert label_of(after) == label_of(before)
    if before.grasp is not None and after.grasp is not None:
        moved = M @ before.grasp.T_base_gripper
        np.testing.assert_allclose(after.grasp.T_base_gripper, moved, atol=1e-4)


@pytest.mark.parametrize("quarters", [0, 1, 2, 3])
@pytest.mark.parametrize("seed", SEEDS)
def test_a_moved_and_quarter_turned_scene_moves_the_grasp(seed: int, quarters: int) -> None:
    M = make_transform(rotation_z(quarters * np.pi / 2), (0.37 * quarters - 0.2, -1.13, 0.41))
    moved = copy_of(view(seed), T_base_camera=M @ np.array(view(seed).T_base_camera))
    same_but_moved(answer(seed), SELECTOR.select(moved), M)


def test_a_base_frame_far_away() -> None:
    """A base 200 m off, as in a map frame: float32 keeps 15 micrometers."""
    M = make_transform(np.eye(3), (180.0, -95.0, 12.0))
    for seed in (0, 1, 3):
        moved = copy_of(view(seed), T_base_camera=M @ np.array(view(seed).T_base_camera))
        found = SELECTOR.select(moved)
        assert label_of(found) == label_of(answer(seed))
        before = answer(seed).grasp
        if before is not None and found.grasp is not None:
            expected = M[:3, 3] + before.position_m
            np.testing.assert_allclose(found.grasp.position_m, expected, atol=1e-3)


# The mirrored scene

_OTHER_FACE = {1: 3, 2: 2, 3: 1, 4: 4, 5: 5}


def mirrored(capture: Capture) -> Capture:
    """Left for right: image flipped, and the base's y turned round."""
    assert capture.depth is not None and capture.rgb is not None
    assert capture.target_pixel is not None
    width = capture.depth.shape[1]
    K = np.array(capture.intrinsics)
    K[0, 2] = width - 1 - K[0, 2]
    T = np.diag([1.0, -1, 1, 1]) @ np.array(capture.T_base_camera) @ np.diag([-1.0, 1, 1, 1])
    u, v = capture.target_pixel
    return Capture(
        capture.depth[:, ::-1],
        K,
        T,
        capture.rgb[:, ::-1],
        target_pixel=(width - 1 - u, v),
    )


def mirrored_label(label: int) -> int:
    face, line = (label - 1) // 3 + 1, (label - 1) % 3 + 1
    return (_OTHER_FACE[face] - 1) * 3 + (4 - line if face == 5 else line)


def tied(found: Selection) -> bool:
    """Whether another candidate is as good as the chosen one, by what `clearance` ranks by."""
    if found.grasp is None:
        return False
    chosen = found.candidate(found.grasp.label)
    other = found.candidate(mirrored_label(chosen.label))
    rivals = [
        rival
        for rival in found.passing
        if rival.label != chosen.label
        and abs(counted_m(rival) - counted_m(chosen)) < 0.002
        and habit(rival) == habit(chosen)
    ]
    return bool(rivals) or (other.label != chosen.label and other.passed)


def counted_m(candidate: Candidate) -> float:
    return min(value(candidate, "visible_clearance"), 0.06)


def habit(candidate: Candidate) -> tuple[bool, int]:
    return candidate.face in (2, 4), abs(candidate.line - 2)


def untied(noisy: bool) -> list[int]:
    return [seed for seed in SEEDS if not tied(answer(seed, noisy))]


def test_enough_scenes_are_untied() -> None:
    assert len(untied(True)) >= 4


@pytest.mark.parametrize("seed", SEEDS)
def test_a_mirrored_scene_mirrors_the_candidates(seed: int) -> None:
    """Poses and distances, ties or not."""
    before, after = answer(seed), SELECTOR.select(mirrored(view(seed)))
    np.testing.assert_allclose(after.box.dimensions_m, before.box.dimensions_m, atol=0.002)
    for candidate in before.candidates:
        other = after.candidate(mirrored_label(candidate.label))
        flipped = other.T_base_gripper[:3, 3] * (1, -1, 1)
        # Voxels are not mirrored, and a pose moves to the ninth nearest.
        np.testing.assert_allclose(flipped, candidate.T_base_gripper[:3, 3], atol=0.003)
        # Approach and finger opening mirrored, the latter as an axis without a sign.
        x, y = (other.T_base_gripper[:3, k] * (1, -1, 1) for k in (0, 1))
        np.testing.assert_allclose(x, candidate.T_base_gripper[:3, 0], atol=0.02)
        assert abs(y @ candidate.T_base_gripper[:3, 1]) > 0.999
        for check, within_m in (("visible_clearance", 0.004), ("plane_clearance", 0.002)):
            assert value(other, check) == pytest.approx(value(candidate, check), abs=within_m)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_mirrored_scene_mirrors_the_grasp(seed: int) -> None:
    before, after = answer(seed), SELECTOR.select(mirrored(view(seed)))
    if tied(before):
        pytest.skip("two candidates are as good as each other; the lower label wins")
    assert after.status == before.status
    if before.grasp is not None and after.grasp is not None:
        assert after.grasp.label == mirrored_label(before.grasp.label)
        flipped = after.grasp.position_m * (1, -1, 1)
        np.testing.assert_allclose(flipped, before.grasp.position_m, atol=0.002)
