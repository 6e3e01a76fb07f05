"""Every benchmark runs as it stands at its least size, and judges as it says."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any

import label_browser
import numpy as np
import pytest

from boxgrasp import Capture, Gripper

FOLDER = Path(__file__).resolve().parent.parent / "benchmarks"
LEAST = {
    "captures": ["--only", "6dofgn_cheezit"],
    "cast_scenes": [
        "--solvable",
        "1",
        "--hopeless",
        "0",
        "--between",
        "0",
        "--wide",
        "2",
        "--processes",
        "1",
    ],
    "label_agreement": [],
    "label_page": ["2", "--timed", "2"],
    "label_record": ["--scenes", "40", "--rounds", "3"],
    "labelled_captures": ["--most", "2", "--scenes"],
    "ugly_scenes": ["--scenes", "2"],
    "local_map": ["--rounds", "1"],
    "process_start": ["--rounds", "1", "--warm"],
    "raycast": ["--repeats", "2"],
    "hands": ["--scenes", "2", "--rounds", "4", "--processes", "1"],
    "wrong_frames": ["--scenes", "1", "--most", "0"],
    "study": ["--count", "60", "--processes", "1"],
    "select_speed": ["--rounds", "1", "--scenes", "1"],
}


def module(name: str) -> ModuleType:
    """A benchmark, imported from its file as its siblings import each other."""
    if str(FOLDER) not in sys.path:
        sys.path.append(str(FOLDER))
    spec = spec_from_file_location(name, FOLDER / f"{name}.py")
    assert spec and spec.loader
    loaded = module_from_spec(spec)
    sys.modules[name] = loaded
    spec.loader.exec_module(loaded)
    return loaded


def printed(name: str, *more: str, **environment: str) -> str:
    done = subprocess.run(
        [sys.executable, str(FOLDER / f"{name}.py"), *LEAST[name], *more],
        capture_output=True,
        text=True,
        env={**os.environ, **environment},
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_every_benchmark_has_a_least_size() -> None:
    scripts = {path.stem for path in FOLDER.glob("[a-z]*.py")}
    assert scripts == set(LEAST)
    told = (FOLDER / "README.md").read_text("utf-8")
    assert all(f"`{name}.py`" in told for name in scripts)


def test_label_record_tells_every_time() -> None:
    pytest.importorskip("sqlalchemy", reason="the record needs the extra `label`")
    assert len(re.findall(r"(?:next_turn|save|progress) +[\d.]+ ms", printed("label_record"))) == 6


def test_label_page_tells_time_and_memory() -> None:
    pytest.importorskip("fastapi", reason="the page needs the extra `label`")
    pytest.importorskip("playwright", reason="Playwright is not installed")
    label_browser.chromium_path()
    out = printed("label_page")
    assert len(re.findall(r"median \d+ ms", out)) == 2
    assert re.search(r"2 scenes: server \d+ MB", out)


def test_label_agreement_counts(tmp_path: Path) -> None:
    """Two labels, what `clearance` takes and a question that it does not ask."""
    pytest.importorskip("sqlalchemy", reason="the record needs the extra `label`")
    from label_lessons import captures_in, database, said

    from boxgrasp import GraspSelector
    from boxgrasp.labeling.lessons import scene_config
    from boxgrasp.labeling.sources import DrawnSource, load_scene
    from boxgrasp.simulate.scenario import Recipe, targets_of
    from boxgrasp.teaching.rows import RowConfig
    from boxgrasp.teaching.sets import SetConfig

    scenes = DrawnSource(SetConfig(RowConfig(Recipe(targets_of("known")), 1), 2)).scenes()
    loaded = load_scene(scenes[0], captures_in(tmp_path))
    selector = GraspSelector(scene_config(scenes[0], GraspSelector().config))
    grasp = selector.select(loaded.capture, loaded.target).grasp
    assert grasp is not None
    labels = [said(scenes[0], grasp.label), said(scenes[1], None)]
    out = printed("label_agreement", str(database(tmp_path, scenes, labels)), str(tmp_path))
    assert "2 labels, 1 none; the commonest 1" in out
    (line,) = (row for row in out.splitlines() if row.startswith("clearance"))
    assert line.split()[-2:] == ["1", "2"]


def test_captures_answers_twice_alike(captures_dir: Path) -> None:
    out = printed("captures", BOXGRASP_CAPTURES=str(captures_dir))
    assert re.search(r"6dofgn_cheezit\s+0\s+(grasp|ask)\s+same", out), out
    assert re.search(r"6dofgn_cheezit\s+\d\.\d\d degrees .* held", out), out


def test_captures_without_captures_does_nothing(tmp_path: Path) -> None:
    assert "nothing done" in printed("captures", BOXGRASP_CAPTURES=str(tmp_path))


def test_labelled_captures_judges_two(labeled_dir: Path) -> None:
    out = printed("labelled_captures", BOXGRASP_LABELED=str(labeled_dir))
    lines = out.splitlines()
    assert lines[0] == "2 labeled captures" and len(lines) == 1 + 3 * 3
    for name in ("split", "euclidean", "network"):
        (line,) = (row for row in lines if row.startswith(name))
        figures = {key: float(value) for key, value in re.findall(r"(\b[PRF]) ([\d.]+)", line)}
        assert set(figures) >= {"P", "R", "F"} and figures["P"] > 0.5 and figures["R"] > 0.5


def test_labelled_captures_without_any_does_nothing(tmp_path: Path) -> None:
    assert "nothing done" in printed("labelled_captures", BOXGRASP_LABELED=str(tmp_path))


def numbers(*blocks: tuple[int, slice]) -> np.ndarray:
    """A (40, 100) image of numbers, each in a block of columns."""
    image = np.zeros((40, 100), dtype=np.int64)
    for number, columns in blocks:
        image[:, columns] = number
    return image


TRUTH = numbers((1, np.s_[:]), (2, np.s_[0:20]), (3, np.s_[20:40]), (4, np.s_[60:100]))
MEASURED = np.ones(TRUTH.shape, dtype=bool)


def test_labels_found_as_they_are_score_in_full() -> None:
    judged = module("labelled_captures").judged
    found = numbers((7, np.s_[0:20]), (1, np.s_[20:40]), (3, np.s_[60:100]))
    item = judged(TRUTH, found, MEASURED)
    assert (item.precision, item.recall, item.f, item.good) == (1.0, 1.0, pytest.approx(1.0), 1.0)
    assert item.iou == (1.0, 1.0, 1.0) and not any(item.merged + item.missed) and item.ghosts == 0


def test_labels_merged_cut_missed_and_ghosts() -> None:
    judged = module("labelled_captures").judged
    # 2 and 3 in one piece; of 4 a half in each of two pieces; one piece on the table alone.
    found = numbers((1, np.s_[0:40]), (2, np.s_[60:80]), (5, np.s_[80:100]), (9, np.s_[45:55]))
    item = judged(TRUTH, found, MEASURED)
    assert item.merged == (True, True, False) and item.missed == (False, False, False)
    assert item.iou == (0.5, 0.5, 0.5) and item.ghosts == 1 and item.good == 0.0
    matched = 20 + 20  # columns: one of the merged pair, half of the cut one
    assert item.precision == pytest.approx(matched / 90)
    assert item.recall == pytest.approx(matched / 80)
    nothing = judged(TRUTH, np.zeros_like(TRUTH), MEASURED)
    assert nothing.missed == (True, True, True) and nothing.f == 0.0 and nothing.iou == (0, 0, 0)


def test_labels_count_pixels_with_depth_alone() -> None:
    judged = module("labelled_captures").judged
    measured = MEASURED.copy()
    measured[:, 10:20] = False  # half of object 2 was not measured
    measured[:, 62:100] = False  # of object 4 are 80 pixels left: too few to be counted alone
    item = judged(TRUTH, numbers((1, np.s_[0:10]), (2, np.s_[20:40])), measured)
    assert item.iou == (1.0, 1.0) and item.good == pytest.approx(2 / 3)
    assert item.precision == 1.0 and item.recall == pytest.approx(1200 / 1280)


def test_ugly_scenes_judges_two() -> None:
    out = printed("ugly_scenes")
    assert out.count("at IoU 0.75") == 3 and "2 ugly tables" in out


def test_cast_scenes_judges_one_scene() -> None:
    out = printed("cast_scenes")
    told, wide = out.split("boxes 11.5 cm wide")
    assert told.count("answered by a grasp") == 3  # once a segmentation
    assert re.search(r"answered by a grasp +[12] of +2 ", wide) and "unhidden targets" in told
    assert "1 scenes" in out and "hopeless" not in out


def test_hands_compares_boxes_with_one() -> None:
    out = printed("hands")
    assert out.count("answered, of all") == 10 and out.count("boxes take") == 2


def test_wrong_frames_counts_what_is_caught() -> None:
    out = printed("wrong_frames", BOXGRASP_SHARED="/nowhere")
    right, wrong = out.split("wrong frames")
    assert right.count("doubted   0 of   1  held") == 5
    assert wrong.count("caught   1 of   1") == 9 and wrong.count("named   1") == 2
    assert "no real captures in /nowhere: nothing done" in wrong


def broken(folder: Path, module: str, library: str) -> str:
    """A PYTHONPATH on which a module lacks a system library."""
    text = f"raise OSError('{library}: cannot open shared object file: No such file or directory')"
    (folder / f"{module}.py").write_text(text)
    return os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")]).rstrip(os.pathsep)


def test_select_speed_times_itself_where_the_rival_lacks_a_library(tmp_path: Path) -> None:
    out = printed("select_speed", PYTHONPATH=broken(tmp_path, "open3d", "libX11.so.6"))
    (told,) = (line for line in out.splitlines() if line.startswith("no comparison"))
    assert told.count("libX11.so.6") == 1 and told.endswith("apt-get install libx11-6")
    off = re.search(r"off by ([\d.]+)%", out)
    assert off and float(off[1]) <= 5.0, out
    peak = re.search(r"peak memory under 400 MB: (\d+)", out)
    assert peak and 20 < int(peak[1]) < 400, out


def test_local_map_times_itself_without_octomap(tmp_path: Path) -> None:
    out = printed("local_map", PYTHONPATH=broken(tmp_path, "octomap", "libfoo.so.3"))
    assert "octomap cannot be loaded without the system library libfoo.so.3\n" in out
    rows = out.splitlines()[-2:]
    assert all(len(re.findall(r"\d+\.\d \( *\d+\.\d\)", row)) == 2 for row in rows), out


def test_what_a_rival_lacks_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    measure = module("_measure")
    monkeypatch.syspath_prepend(tmp_path)
    assert measure.lacking("json", "-") is None
    assert measure.lacking("no_such_rival", "pip install it") == "no no_such_rival: pip install it"
    (tmp_path / "odd_rival.py").write_text("raise ImportError('bad magic')")
    assert measure.lacking("odd_rival", "-") == "odd_rival cannot be loaded: bad magic"


def test_process_start_answers() -> None:
    assert re.search(r"after it: \d+\.\d\d s", printed("process_start"))


def test_local_map_equals_octomap() -> None:
    pytest.importorskip("octomap")
    rows = printed("local_map").splitlines()[-2:]
    assert all(row.endswith("100.00%") for row in rows), rows


def test_raycast_counts_views() -> None:
    assert "views/s" in printed("raycast")


def test_bands() -> None:
    truth = module("_truth")
    assert [truth.band_of(x) for x in (0.0, 0.0149, 0.015, 0.0249, 0.025, 0.3)] == [
        *("hopeless", "hopeless", "between", "between", "solvable", "solvable")
    ]


def test_a_scene_is_drawn_the_same_whatever_came_before() -> None:
    truth = module("_truth")
    first = next(truth.scenes(3, 1, "solvable"))
    again = truth.judged(*first.seed)
    assert again.truth.best_m == first.truth.best_m >= 0.025
    np.testing.assert_array_equal(again.scene.T_base_camera, first.scene.T_base_camera)


def test_the_true_candidate_that_is_best_is_good_and_safe() -> None:
    truth = module("_truth")
    scene = next(truth.scenes(3, 1, "solvable"))
    clear = np.where(scene.truth.valid, scene.truth.clearance_m, -1.0)
    verdict = truth.verdict(scene, scene.candidates.T_base_gripper[int(np.argmax(clear))])
    assert verdict.good and verdict.safe


def test_farthest_candidate_is_the_one_away_from_the_obstacle() -> None:
    speed = module("select_speed")
    box = speed.Box(np.eye(4), np.array([0.06, 0.06, 0.20]))
    wall = np.stack(np.meshgrid([-0.10], np.linspace(-0.2, 0.2, 9), np.linspace(0, 0.3, 7)), -1)
    right = speed.farthest(box, wall.reshape(-1, 3))
    assert right // 3 + 1 != 2  # the wall stands before the front face


def test_labelled_captures_asks_for_every_object(labeled_dir: Path) -> None:
    out = printed("labelled_captures", "--segmentation", "network", "--grasps",
                  BOXGRASP_LABELED=str(labeled_dir))  # fmt: skip
    for way in ("pixel", "mask", "grown", "shrunk", "shifted"):
        assert re.search(rf"by {way} +answered [\d.]+ of \d+ answerable; of \d+ grasps: good", out)


def test_ugly_scenes_asks_with_and_without_what_is_held() -> None:
    out = printed("ugly_scenes", "--grasps", "--scenes", "1")
    assert {"surface", "box", "unheld"} <= {line.split()[0] for line in out.splitlines()}


def block_seen(x: tuple[float, float], top_m: float = 0.10) -> tuple[np.ndarray, np.ndarray]:
    """(240, 320) depth of a camera 1 m over a table, looking down on a block, and its labels."""
    v, u = np.indices((240, 320))
    places = (u - 160) / 300.0 * (1.0 - top_m), (v - 120) / 300.0 * (1.0 - top_m)
    block = (x[0] <= places[0]) & (places[0] <= x[1]) & (np.abs(places[1]) <= 0.03)
    return np.where(block, 1.0 - top_m, 1.0).astype(np.float32), np.where(block, 2, 1)


def test_grasps_are_judged_by_what_lies_between_the_fingers() -> None:
    held = module("_held")
    depth, labels = block_seen((-0.04, 0.04))
    K = np.array([[300.0, 0.0, 160.0], [0.0, 300.0, 120.0], [0.0, 0.0, 1.0]])
    labeled = held.Labeled.of(Capture(depth, K), labels)
    np.testing.assert_allclose(labeled.up, (0.0, 0.0, -1.0), atol=1e-6)
    assert labeled.offset_m == pytest.approx(1.0, abs=1e-6)
    hand = Gripper()
    T = np.eye(4)
    T[:3, :3] = np.array(((0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)))  # down, across x
    T[:3, 3] = (0.0, 0.0, 0.91 - hand.length_m / 2)

    def moved(x: float, y: float, z: float) -> Any:
        pose = T.copy()
        pose[:3, 3] += (x, y, z)
        return labeled.judge(2, pose, hand)

    good = moved(0.0, 0.0, 0.0)
    assert good.good and good.outside == 0 and good.over_table_m == pytest.approx(0.09, abs=2e-3)
    assert moved(0.0, 0.0, -0.02).on_air and moved(0.0, 0.2, 0.0).on_air
    assert moved(0.0, 0.06, 0.0).by_an_edge
    assert moved(0.05, 0.0, 0.0).touching
    assert not moved(0.0, 0.0, 0.095).good  # into the table
    assert labeled.answerable(2, hand)
    wide, numbers = block_seen((-0.15, 0.15))
    numbers[:, 160:][numbers[:, 160:] == 2] = 3  # two blocks side by side
    both = held.Labeled.of(Capture(wide, K), numbers)
    assert not both.judge(2, T, hand).good and both.judge(2, T, hand).clear_m == 0.0


def test_a_ragged_mask_is_a_mask_moved_by_three_pixels() -> None:
    held = module("_held")
    mask = np.zeros((60, 80), dtype=np.bool_)
    mask[20:40, 30:50] = True
    ragged = held.ragged(mask)
    assert ragged["grown"].sum() > mask.sum() > ragged["shrunk"].sum()
    assert ragged["shrunk"].sum() == 14 * 14 and ragged["shifted"][23:43, 33:53].all()
    u, v = held.middle_pixel(mask)
    assert 37 <= u <= 42 and 27 <= v <= 32
