"""Where scenes to label come from, and captures that are kept by their content."""

from __future__ import annotations

import json
import logging
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from capture_files import view, write_npz

from boxgrasp.config import Config
from boxgrasp.errors import BoxgraspError, CaptureError, ConfigError, StoreError
from boxgrasp.execution import Store, local_workers
from boxgrasp.io import load_capture
from boxgrasp.io.npz import save_npz
from boxgrasp.labeling.captures import CaptureStore, capture_sha256
from boxgrasp.labeling.sources import capture_paths, load_scene, source_at, target_of
from boxgrasp.selector import GraspSelector
from boxgrasp.sensing.capture import Capture
from boxgrasp.simulate.scenario import Recipe, draw_scenario
from boxgrasp.strict import build, plain
from boxgrasp.teaching.rows import RowConfig
from boxgrasp.teaching.sets import SetConfig, make_set

RECIPE = Recipe(("beans_can",))


@pytest.fixture
def kept(tmp_path: Path) -> CaptureStore:
    return CaptureStore(Store(tmp_path / "kept"))


@pytest.fixture(scope="module")
def scene_capture() -> tuple[Capture, np.ndarray]:
    """A rendered scene without a target of its own, and the true object of each pixel."""
    capture, ids = draw_scenario(Recipe(("beans_can",), obstacles=(2, 2)), 5, 0).capture("none")
    return Capture(capture.depth, capture.intrinsics, capture.T_base_camera, capture.rgb), ids


def image(**changes: object) -> Capture:
    seen = view()
    given = {"rgb": seen.rgb, "mask": seen.mask, "target_pixel": seen.target_pixel}
    given["robot_mask"] = np.arange(24 * 32).reshape(24, 32) < 40
    return Capture(**{"depth": seen.depth, "intrinsics": seen.intrinsics,
                      "T_base_camera": seen.T_base_camera, **given, **changes})  # fmt: skip


def cloud(*, organized: bool, frame: str = "optical") -> Capture:
    seen = view()
    points = seen.points if organized else seen.points.reshape(-1, 3)
    colors = seen.rgb if organized else seen.rgb.reshape(-1, 3)
    return Capture.from_cloud(points, colors=colors, cloud_frame=frame, mask=None)


@pytest.mark.parametrize(
    "capture",
    [
        image(),
        image(rgb=None, mask=None, target_pixel=None, robot_mask=None, T_base_camera=None),
        cloud(organized=True),
        cloud(organized=False),
        cloud(organized=False, frame="base"),
    ],
)
def test_a_kept_capture_comes_back_array_for_array(kept: CaptureStore, capture: Capture) -> None:
    sha256 = kept.add(capture)
    again = kept.read(sha256)
    for name in ("depth", "intrinsics", "T_base_camera", "rgb", "mask", "robot_mask", "points"):
        one, other = getattr(capture, name), getattr(again, name)
        assert (one is None) == (other is None), name
        if one is not None:
            assert one.dtype == other.dtype and np.array_equal(
                one, other, equal_nan=one.dtype.kind == "f"
            )
    assert again.target_pixel == capture.target_pixel
    assert (again.cloud_frame, again.cloud_shape) == (capture.cloud_frame, capture.cloud_shape)
    assert again.warnings == capture.warnings
    assert capture_sha256(again) == sha256 == kept.add(again)


def test_a_hash_is_of_the_content_and_not_of_the_file(kept: CaptureStore, tmp_path: Path) -> None:
    packed, loose = tmp_path / "a.npz", tmp_path / "b.npz"
    save_npz(image(), packed)
    np.savez(loose, **{k: v for k, v in np.load(packed).items()})
    assert packed.read_bytes() != loose.read_bytes()
    assert capture_sha256(load_capture(packed)) == capture_sha256(load_capture(loose))


@pytest.mark.parametrize(
    "name", ["depth", "intrinsics", "T_base_camera", "rgb", "mask", "robot_mask"]
)
def test_any_change_of_content_changes_the_hash(name: str) -> None:
    base = image()
    value = np.array(getattr(base, name))
    place = {"T_base_camera": (0, 3), "intrinsics": (0, 2)}.get(name, (12, 12))
    value[place] = ~value[place] if value.dtype == bool else value[place] + 1
    assert capture_sha256(image(**{name: value})) != capture_sha256(base)
    assert capture_sha256(image(target_pixel=(12, 10))) != capture_sha256(base)


def test_warnings_are_kept(kept: CaptureStore) -> None:
    depth = np.array(view().depth)
    depth[0, 0] = 70.0
    capture = image(depth=depth)
    assert [w.code for w in capture.warnings] == ["depth_beyond_range"]
    assert kept.read(kept.add(capture)).warnings == capture.warnings


def test_a_damaged_or_missing_capture_is_told(kept: CaptureStore) -> None:
    sha256 = kept.add(image())
    file = Path(kept.store.place) / "captures" / sha256[:2] / f"{sha256}.npz"
    other = kept.add(image(target_pixel=(12, 10)))
    shutil.copy(file.parent.parent / other[:2] / f"{other}.npz", file)
    with pytest.raises(CaptureError, match="content is not what its name says"):
        kept.read(sha256)
    file.write_bytes(b"no archive")
    with pytest.raises(CaptureError, match="content is not what its name says"):
        kept.read(sha256)
    np.savez(file, depth=np.array([{}], dtype=object))
    with pytest.raises(CaptureError, match="content is not what its name says"):
        kept.read(sha256)
    file.unlink()
    with pytest.raises(StoreError, match="keeps no capture"):
        kept.read(sha256)
    for name in ("../../etc/passwd", "AB" * 32, ""):
        with pytest.raises(CaptureError, match="no capture's hash"):
            kept.read(name)


def test_objects_of_a_capture_are_scenes_whose_pixels_lead_back(
    kept: CaptureStore, tmp_path: Path, scene_capture: tuple[Capture, np.ndarray]
) -> None:
    capture, ids = scene_capture
    folder = tmp_path / "in"
    (folder / "nested").mkdir(parents=True)
    save_npz(capture, folder / "nested" / "a.npz")
    save_npz(capture, folder / "b.npz")  # the same content again: no scene of its own
    scenes = source_at(str(folder), kept).scenes()
    shown_things = {int(k) for k in np.unique(ids) if k > 0 and (ids == k).sum() > 500}
    assert len(scenes) == len({scene.key for scene in scenes}) >= 2
    hit = set()
    for scene in scenes:
        loaded = load_scene(scene, kept)
        assert scene.box_kind == "yaw" and len(scene.key) <= 120
        assert loaded.target is not None and loaded.target.pixel is not None
        u, v = loaded.target.pixel
        around = ids[v - 2 : v + 3, u - 2 : u + 3]  # truth: well inside one thing
        assert len(np.unique(around)) == 1
        hit.add(int(ids[v, u]))
    assert len(hit) == len(scenes) and hit <= shown_things
    assert source_at(str(folder), kept).scenes() == scenes  # as found before, from what was kept


def test_keys_know_content_box_and_lines_alone(
    kept: CaptureStore, tmp_path: Path, scene_capture: tuple[Capture, np.ndarray]
) -> None:
    for name in ("here", "there"):
        (tmp_path / name).mkdir()
        save_npz(scene_capture[0], tmp_path / name / f"{name}.npz")
    keys = [
        {scene.key for scene in source_at(str(tmp_path / name), kept, config=config).scenes()}
        for name, config in (
            ("here", None), ("there", None),
            ("here", build(Config, {"box": {"fit": "aligned"}}, "", ConfigError)),
            ("here", build(Config, {"candidates": {"lines": 5}}, "", ConfigError)),
        )
    ]  # fmt: skip
    assert keys[0] == keys[1]
    assert not (keys[0] & keys[2] or keys[0] & keys[3] or keys[2] & keys[3])


def test_a_captures_own_target_is_its_only_scene(kept: CaptureStore, tmp_path: Path) -> None:
    save_npz(image(), tmp_path / "masked.npz")
    (one,) = source_at(str(tmp_path / "masked.npz"), kept).scenes()
    assert one.target == {"mask": True} and load_scene(one, kept).target is None
    save_npz(image(mask=None), tmp_path / "pointed.npz")
    (one,) = source_at(str(tmp_path / "pointed.npz"), kept).scenes()
    assert one.target == {"pixel": list(view().target_pixel)}


def test_what_is_no_capture_is_passed_over_with_a_line(
    kept: CaptureStore, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    place = tmp_path / "in"
    (place / "empty").mkdir(parents=True)
    (place / "notes.txt").write_text("x")
    (place / "bad.npz").write_bytes(b"x")
    write_npz(place / "good.npz", view())
    with caplog.at_level(logging.WARNING, logger="boxgrasp.labeling"):
        assert len(source_at(str(place), kept).scenes()) == 1
    said = [r.getMessage() for r in caplog.records if r.name == "boxgrasp.labeling"]
    assert [line.split("/in/")[1].split(":")[0] for line in said] == [
        "empty",
        "notes.txt",
        "bad.npz",
    ]
    assert all("(no_capture)" in line and "\n" not in line for line in said)


@pytest.mark.skipif(os.name == "nt", reason="symbolic links need a right on Windows")
def test_links_never_lead_out(kept: CaptureStore, tmp_path: Path) -> None:
    outside, place = tmp_path / "outside", tmp_path / "in"
    outside.mkdir()
    (place / "sub").mkdir(parents=True)
    write_npz(outside / "secret.npz", view())
    write_npz(place / "good.npz", view())
    (place / "link.npz").symlink_to(outside / "secret.npz")
    (place / "link").symlink_to(outside)
    (place / "sub" / "link.npz").symlink_to(outside / "secret.npz")
    (place / "deep").mkdir()
    (place / "deep" / "depth.png").symlink_to(outside / "secret.npz")
    (place / "ring").symlink_to(place / "ring")
    (place / "inner.npz").symlink_to(place / "good.npz")
    assert [path.name for path in capture_paths(place)] == ["good.npz", "inner.npz"]


def test_numbers_in_names_are_in_their_order(tmp_path: Path) -> None:
    for name in ("view_10.npz", "view_9.npz", "view_1.npz"):
        write_npz(tmp_path / name, view())
    assert [p.name for p in capture_paths(tmp_path)] == ["view_1.npz", "view_9.npz", "view_10.npz"]


@pytest.mark.parametrize("make", ["nothing", "empty", "file", "faulty", "url"])
def test_no_source_is_told_with_what_is_valid(
    kept: CaptureStore, tmp_path: Path, make: str
) -> None:
    place = tmp_path / "in"
    if make == "file":
        place.write_text("x")
    elif make != "nothing":
        place.mkdir()
    if make == "faulty":
        (place / "bad.npz").write_bytes(b"x")
    where = "memory://label-sources" if make == "url" else str(place)
    with pytest.raises(BoxgraspError, match="valid: a set that") as told:
        source_at(where, kept).scenes()
    assert "\n" not in str(told.value)


@pytest.fixture(scope="module")
def made() -> SetConfig:
    return SetConfig(RowConfig(RECIPE, 3), 2)


def test_a_set_and_the_same_set_drawn_on_the_fly_have_the_same_scenes(
    kept: CaptureStore, tmp_path: Path, made: SetConfig
) -> None:
    pytest.importorskip("pyarrow")
    with local_workers(1) as workers:
        make_set(Store(tmp_path), "", made, workers, "")
    scenes = source_at(str(tmp_path), kept).scenes()
    assert list(scenes) == list(source_at("simulate", kept, simulate=made).scenes())
    assert [scene.number for scene in scenes] == [0, 1]
    assert {scene.box_kind for scene in scenes} == {"aligned"}


def test_a_scenario_is_cast_again_from_its_key_data_alone(
    kept: CaptureStore, made: SetConfig
) -> None:
    scene = source_at("simulate", kept, simulate=made).scenes()[1]
    told = json.loads(json.dumps(plain(scene)))
    loaded = load_scene(type(scene)(**told), kept)
    truth = draw_scenario(RECIPE, 3, 1)
    capture, ids = truth.capture("none")
    assert np.array_equal(loaded.capture.depth, capture.depth)
    assert loaded.target is not None
    assert np.array_equal(loaded.target.mask, ids == truth.scene.target_id)
    answer = GraspSelector({"box": {"fit": "aligned"}}).select(loaded.capture, loaded.target)
    assert len(answer.candidates) == 15


def test_a_scenario_of_other_settings_is_refused(kept: CaptureStore, made: SetConfig) -> None:
    scene = source_at("simulate", kept, simulate=made).scenes()[0]
    assert scene.row_config is not None
    with pytest.raises(ConfigError, match="other settings or objects"):
        load_scene(type(scene)(**{**vars(scene), "number": 1}), kept)


@pytest.mark.parametrize(
    "target", [{}, {"pixel": [1]}, {"pixel": ["a", 1]}, {"mask": False}, {"x": 1}]
)
def test_odd_targets_are_refused(target: dict[str, object]) -> None:
    with pytest.raises(ConfigError, match="valid: a pixel, point or mask"):
        target_of(target)
