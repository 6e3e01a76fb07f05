"""Segmentation by the network: its grouping, its file, what it finds, what it falls back on."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import drawn, item, laid, seen
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from boxgrasp import Capture, GraspSelector, Target, load_capture
from boxgrasp.errors import ModelError
from boxgrasp.kernels.mutex import mutex_watershed, mutex_watershed_naive
from boxgrasp.kernels.plan import grow
from boxgrasp.onnx.session import DIGEST_KEY, RECORD_KEY, digest
from boxgrasp.perception.segmentation.network import WEIGHTS, network_inputs, read_network

onnx = pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")

NETWORK = {"scene": {"segmentation": "network"}}
SPLIT = {"scene": {"segmentation": "split"}}


@settings(deadline=None, max_examples=300)
@given(st.integers(2, 14), st.data())
def test_groups_equal_those_of_the_plain_rule(count: int, data: st.DataObject) -> None:
    cell = st.integers(0, count - 1)
    edges = data.draw(st.lists(st.tuples(cell, cell, st.booleans()), max_size=60))
    first, second, attract = (
        np.array([edge[k] for edge in edges], dtype=kind)
        for k, kind in enumerate((np.int64, np.int64, np.bool_))
    )
    found = mutex_watershed(first, second, attract, count)
    groups = {frozenset(np.flatnonzero(found == name).tolist()) for name in set(found.tolist())}
    expected = {frozenset(group) for group in mutex_watershed_naive(first, second, attract, count)}
    assert groups == expected


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 2**32 - 1), st.integers(0, 4))
def test_growing_takes_as_many_rings_as_told(seed: int, rings: int) -> None:
    rng = np.random.default_rng(seed)
    inside = rng.random((9, 12)) < 0.7
    seeds = np.where(
        inside & (rng.random(inside.shape) < 0.1), rng.integers(0, 3, inside.shape), -1
    )
    grown = grow(seeds, inside, rings)
    assert (grown[seeds >= 0] == seeds[seeds >= 0]).all() and (grown[~inside] == -1).all()
    plain = np.where(seeds >= 0, seeds, 99)
    for _ in range(rings):  # the lowest seed round each inside cell that has none yet
        padded = np.pad(plain, 1, constant_values=99)
        near = np.min([padded[v : v + 9, u : u + 12] for v in range(3) for u in range(3)], axis=0)
        plain = np.where((plain == 99) & inside, near, plain)
    np.testing.assert_array_equal(grown, np.where(plain == 99, -1, plain))


def changed(**changes: Any) -> bytes:
    """The shipped file with its record or graph changed; its digest made right where told."""
    model = onnx.load_from_string(WEIGHTS.read_bytes())
    stored = {entry.key: entry for entry in model.metadata_props}
    if "operator" in changes:
        model.graph.node[1].op_type = changes["operator"]
    if "record" in changes:
        stored[RECORD_KEY].value = changes["record"]
    if "weight" in changes:
        raw = bytearray(model.graph.initializer[1].raw_data)
        raw[5] ^= 0x40
        model.graph.initializer[1].raw_data = bytes(raw)
    if changes.get("mended"):
        from boxgrasp.onnx import guard

        graph = guard.parse(model.SerializeToString()).graph
        stored[DIGEST_KEY].value = digest(graph, stored[RECORD_KEY].value.encode())
    return bytes(model.SerializeToString())


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"", "not an ONNX file"),
        (b"\x00" * 400, "not an ONNX file"),
        (WEIGHTS.read_bytes()[:-200], "not an ONNX file"),
        (changed(weight=1), "damaged"),
        (changed(record="{}"), "damaged"),
        (changed(record="{}", mended=True), "record is not of a segmentation network"),
        (changed(record="nonsense", mended=True), "record is not of a segmentation network"),
        (changed(operator="Loop", mended=True), "operator 'Loop'"),
        (changed(operator="Softmax", mended=True), "operator 'Softmax'"),
    ],
    ids=["empty", "zeros", "cut", "weight", "record", "bare", "text", "loop", "softmax"],
)
def test_a_wrong_or_damaged_file_gives_one_line(data: bytes, said: str) -> None:
    with pytest.raises(ModelError, match=said) as caught:
        read_network(data)
    assert "\n" not in str(caught.value)


def test_an_svm_s_file_is_no_network() -> None:
    from boxgrasp.ranking.onnx.model import SHIPPED

    with pytest.raises(ModelError, match="not of a segmentation network"):
        read_network((SHIPPED / "single-grid.onnx").read_bytes())


def test_the_shipped_file_is_small_and_says_how_it_was_made() -> None:
    data = WEIGHTS.read_bytes()
    assert len(data) < 4_000_000
    network = read_network(data)
    assert network.offsets[:2] == ((0, 1), (1, 0)) and len(network.offsets) == 8


@pytest.mark.parametrize("shape", [(1, 1), (17, 31), (240, 320), (123, 457)])
def test_images_of_any_size_are_taken(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(0)
    depth = np.where(rng.random(shape) < 0.9, 0.8, 0.0).astype(np.float32)
    inputs = network_inputs(depth, depth * 0, 262.5, 0.8)
    assert inputs.shape[0] == 7 and all(size % 16 == 0 for size in inputs.shape[1:])
    assert np.isfinite(inputs).all() and np.abs(inputs).max() <= 4.0
    said = read_network(WEIGHTS.read_bytes()).probabilities(inputs)
    assert said.shape == (9, inputs.shape[1] // 2, inputs.shape[2] // 2)
    assert ((said >= 0) & (said <= 1)).all()


def test_the_number_of_threads_changes_no_bit() -> None:
    from boxgrasp.onnx.session import open_session

    data = WEIGHTS.read_bytes()
    x = np.random.default_rng(0).normal(size=(1, 7, 208, 256)).astype(np.float32)
    said = [open_session(data, {"Conv", "Relu", "Concat", "Resize"}, n).run(["y"], {"x": x})[0]
            for n in (1, 2, 3)]  # fmt: skip
    np.testing.assert_array_equal(said[0], said[1])
    np.testing.assert_array_equal(said[0], said[2])


def overlap(truth: np.ndarray, found: np.ndarray, number: int) -> float:
    """Intersection over union of a true object and the piece that shares most with it."""
    own = truth == number
    pieces = found[own & (found > 0)]
    if len(pieces) == 0:
        return 0.0
    piece = np.bincount(pieces).argmax()
    return float(
        np.count_nonzero(own & (found == piece)) / np.count_nonzero(own | (found == piece))
    )


def test_real_labeled_scenes_are_parted(labeled_dir: Path) -> None:
    """Stacked and touching things of the learning half, the harder end of it."""
    selector, ious = GraspSelector(NETWORK), []
    for number in (17, 20, 22, 23, 28, 33, 40, 42):
        folder = labeled_dir / f"learn{number}"
        truth = np.asarray(Image.open(folder / "labels.png")).astype(np.int64)
        capture = load_capture(folder)
        found = selector.segment(capture)
        truth = np.where(np.asarray(capture.depth) > 0, truth, 0)
        ious += [overlap(truth, found, k) for k in np.unique(truth[truth >= 2]).tolist()]
    assert np.mean(np.array(ious) >= 0.75) > 0.85


@pytest.mark.parametrize("seed", range(6))
def test_cast_things_apart_are_found_one_each(seed: int) -> None:
    things = [item("green_cube", 0.75, -0.18), item("beans_can", 0.85, 0.0), item("mug", 0.8, 0.2)]
    scene = laid(things[0], *things[1:])
    view = scene.view()
    found = GraspSelector(NETWORK).segment(seen(scene, seed))
    truth = np.asarray(view.object_ids)
    numbers = [scene.target_id, *scene.obstacle_ids]
    assert [overlap(truth, found, number) > 0.75 for number in numbers] == [True] * 3


@pytest.mark.parametrize("seed", range(4))
def test_what_is_no_thing_stays_an_obstacle(seed: int) -> None:
    capture = seen(drawn(seed, (2, 4)), seed)
    split, network = GraspSelector(SPLIT).scene(capture), GraspSelector(NETWORK).scene(capture)
    # Every point that is an obstacle or an object by the one is one by the other, but for specks.
    assert abs(len(split.points) - len(network.points)) < 0.02 * len(split.points) + 40
    answer = GraspSelector(NETWORK).select(capture)
    known = {warning.code for warning in GraspSelector(SPLIT).select(capture).warnings}
    assert len(answer.candidates) == 15 and {w.code for w in answer.warnings} <= known


def test_the_same_view_gives_the_same_bytes() -> None:
    capture = seen(drawn(3, (2, 4)), 3)
    first, second = (GraspSelector(NETWORK).select(capture).to_dict() for _ in range(2))
    assert first.pop("timings_ms") and second.pop("timings_ms") and first == second


def test_the_robot_s_arm_is_not_shown_to_the_network() -> None:
    capture = seen(laid(item("green_cube", 0.85, 0.0), item("beans_can", 0.9, 0.2)), 0)
    arm = np.zeros(capture.shape, dtype=bool)
    arm[:, :60] = True
    masked = Capture(capture.depth, capture.intrinsics, capture.T_base_camera, robot_mask=arm)
    blank = np.where(arm, 0, np.asarray(capture.depth)).astype(np.float32)
    cut = Capture(blank, capture.intrinsics, capture.T_base_camera)
    found = [GraspSelector(NETWORK).segment(view) for view in (masked, cut)]
    np.testing.assert_array_equal(*found)


def test_a_cloud_is_split_and_the_answer_says_so() -> None:
    capture = seen(laid(item("green_cube", 0.85, 0.0)), 0)
    cloud = Capture.from_cloud(capture.valid_points()[0], T_base_camera=capture.T_base_camera)
    network = GraspSelector(NETWORK).select(cloud, Target(object=1))
    split = GraspSelector(SPLIT).select(cloud, Target(object=1))
    assert [w.code for w in network.warnings] == ["segmentation_without_image"]
    assert network.box.dimensions_m.tolist() == split.box.dimensions_m.tolist()


def test_without_onnxruntime_it_is_named() -> None:
    code = (
        "import sys; sys.modules['onnxruntime'] = None\n"
        "from boxgrasp import GraspSelector\n"
        "from boxgrasp.errors import MissingExtraError\n"
        "from boxgrasp.simulate import demo_capture\n"
        "try: GraspSelector().select(demo_capture())\n"
        "except MissingExtraError as error: print(error)\n"
        "split = {'scene': {'segmentation': 'split'}}\n"
        "print(GraspSelector(split).select(demo_capture()).status)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    said, status = done.stdout.splitlines()
    assert "pip install onnxruntime" in said and status in ("grasp", "ask")
