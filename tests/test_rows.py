"""Rows of a set: what the selector sees, kept and read back, the same on every way there."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pyarrow", reason="extra train")
pytest.importorskip("onnx", reason="extra train")

from boxgrasp import load_capture
from boxgrasp.errors import ConfigError
from boxgrasp.execution import Store, local_workers
from boxgrasp.perception.target import Target
from boxgrasp.ranking.model_set import FACE_NUMBERS, SAMPLINGS, SampledScenes
from boxgrasp.ranking.sampling import RESOLUTION_M
from boxgrasp.simulate.scenario import Recipe, targets_of
from boxgrasp.teaching.operators import Label
from boxgrasp.teaching.rows import (
    CHECK_FLAGS,
    CHECK_VALUES,
    RowConfig,
    row_of,
    scenario_of_row,
    selector,
)
from boxgrasp.teaching.samples import sampled_scenes
from boxgrasp.teaching.sets import (
    SetConfig,
    capture_bytes,
    from_parquet,
    joined,
    make_set,
    part,
    read_set,
    to_parquet,
)

CONFIG = RowConfig(Recipe(targets_of("all"), noise="xtion"), 11)


@pytest.fixture(scope="module")
def rows():
    return from_parquet(part((CONFIG, range(6))))


def test_a_row_is_what_the_selector_sees(rows) -> None:
    scenario = scenario_of_row(CONFIG, 3)
    capture, object_ids = scenario.capture("xtion")
    mask = Target(mask=object_ids == scenario.scene.target_id)
    for name, target in (("given", mask), ("found", None)):
        analysis = selector(name, 3).analyze(capture, target)
        results = analysis.context.check_results
        for column, check in CHECK_VALUES.items():
            kept = rows[f"{name}_{column}"][3]
            assert np.array_equal(kept, results[check].value), column
        for column, check in CHECK_FLAGS.items():
            kept = rows[f"{name}_{column}"][3]
            assert np.array_equal(kept, results[check].passed), column
        assert np.array_equal(rows[f"{name}_passes"][3], analysis.passing)


def test_models_see_in_rows_what_they_see_in_the_maps(rows) -> None:
    scenario = scenario_of_row(CONFIG, 2)
    capture, object_ids = scenario.capture("xtion")
    mask = Target(mask=object_ids == scenario.scene.target_id)
    chosen = selector("given", 3)
    context = chosen.analyze(capture, mask).context
    for name in SAMPLINGS:
        local_map = context.local_maps[RESOLUTION_M[name]]
        alone = SampledScenes.of_map(local_map, context.box.dimensions_m, name)
        every = sampled_scenes(rows, "given", name)
        assert every.whole.dtype == alone.whole.dtype == np.float32
        assert np.array_equal(every.whole[2], alone.whole[0])
        assert np.array_equal(every.dimensions_m[2], alone.dimensions_m[0])
        assert set(every.portions) == set(FACE_NUMBERS)
        for face in FACE_NUMBERS:
            assert np.array_equal(every.portions[face][2], alone.portions[face][0])


def test_thesis_distance_is_the_check_s_when_the_target_is_given(rows) -> None:
    assert np.array_equal(rows["given_thesis_clearance_m"], rows["given_visible_clearance_m"])


def test_parquet_gives_back_what_it_got(rows) -> None:
    made = [row_of(CONFIG, number) for number in range(6)]
    again = from_parquet(to_parquet(made, CONFIG))
    assert set(again) == set(rows)
    for name in rows:
        assert np.array_equal(again[name], rows[name], equal_nan=rows[name].dtype.kind == "f")
    assert part((CONFIG, range(6))) == to_parquet(made, CONFIG)


def test_what_was_not_found_says_so_and_counts_nothing() -> None:
    made = [row_of(CONFIG, number) for number in range(2)]
    for name in [name for name in made[1] if name.startswith("found_")]:
        del made[1][name]
    made[1]["found_error"] = "no target"
    read = from_parquet(to_parquet(made, CONFIG))
    assert read["found_error"].tolist() == ["", "no target"]
    assert np.isnan(read["found_visible_clearance_m"][1]).all()
    assert not read["found_passes"][1].any()


def test_runs_of_a_scenario_share_the_scene_and_not_the_noise() -> None:
    config = replace(CONFIG, runs=3, stride=2)
    made = [row_of(config, number) for number in range(6)]
    assert [row["number"] for row in made] == [0, 0, 0, 1, 1, 1]
    assert [row["run"] for row in made] == [0, 1, 2, 0, 1, 2]
    assert made[0]["scene"] == made[2]["scene"]
    assert not np.array_equal(made[0]["given_dimensions_m"], made[1]["given_dimensions_m"])


def test_fused_frames_leave_fewer_cells_unknown() -> None:
    alone = row_of(replace(CONFIG, stride=2, target_sources=("given",)), 0)
    fused = row_of(replace(CONFIG, stride=2, frames=4, target_sources=("given",)), 0)
    column = "given_visible_clearance_m"
    assert np.array_equal(alone[column], fused[column])
    assert (fused["given_spiral"] == 1).sum() <= (alone["given_spiral"] == 1).sum()


def test_a_set_goes_on_where_it_stopped_and_refuses_other_settings(tmp_path: Path) -> None:
    store = Store(tmp_path / "set")
    config = SetConfig(CONFIG, 50)
    with local_workers(1) as workers:
        make_set(store, "", config, workers, "")
        _, first = read_set(store)
        (tmp_path / "set" / "part-00001.parquet").unlink()
        with pytest.raises(ConfigError, match="lacks 1 of 2 parts"):
            read_set(store)
        before = (tmp_path / "set" / "part-00000.parquet").stat().st_mtime_ns
        make_set(store, "", config, workers, "")
        assert (tmp_path / "set" / "part-00000.parquet").stat().st_mtime_ns == before
        _, again = read_set(store)
        assert np.array_equal(first["label"], again["label"])
        assert again.count == 50
        other = SetConfig(replace(CONFIG, seed=12), 50)
        with pytest.raises(ConfigError, match="seed is 11 there, 12 now"):
            make_set(store, "", other, workers, "")


def test_a_set_grows_to_the_bytes_of_one_made_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("boxgrasp.teaching.sets.PART_ROWS", 3)

    def grown(*counts: int) -> dict[str, bytes]:
        folder = tmp_path / "-".join(map(str, counts))
        with local_workers(1) as workers:
            for count in counts:
                make_set(Store(folder), "", SetConfig(CONFIG, count), workers, "")
        return {path.name: path.read_bytes() for path in folder.iterdir()}

    whole = grown(7)
    assert set(whole) == {"set.json", *(f"part-0000{k}.parquet" for k in range(3))}
    assert grown(1, 3, 4, 5, 7) == whole
    store, small = Store(tmp_path / "7"), SetConfig(CONFIG, 6)
    with local_workers(1) as workers:
        with pytest.raises(ConfigError, match="a set of 7, 6 are asked for; valid: 7 or more"):
            make_set(store, "", small, workers, "")
        other = SetConfig(replace(CONFIG, seed=12), 8)
        with pytest.raises(ConfigError, match="seed is 11 there, 12 now"):
            make_set(store, "", other, workers, "")
    assert {name: store.read(name) for name in whole} == whole
    # A growth to 8 that was killed before set.json told of it: seen to be unfinished, and mended.
    store, name = Store(tmp_path / "1-3-4-5-7"), "part-00002.parquet"
    store.write(name, part((CONFIG, range(6, 8))))
    with pytest.raises(ConfigError, match="holds 8 rows; valid: 7 as in its set.json"):
        read_set(store)
    with local_workers(1) as workers:
        make_set(store, "", SetConfig(CONFIG, 7), workers, "")
    assert {name: store.read(name) for name in whole} == whole


def test_joined_rows_follow_each_other(rows) -> None:
    both = joined([rows.take(np.arange(2)), rows.take(np.arange(2, 6))])
    assert np.array_equal(both["number"], rows["number"])


def test_a_set_of_former_names_is_refused_with_the_names_of_now(tmp_path: Path) -> None:
    store = Store(tmp_path)
    with local_workers(1) as workers:
        make_set(store, "", SetConfig(replace(CONFIG, target_sources=("given",)), 1), workers, "")
    made = tmp_path / "set.json"
    for former, now in (("sights", "target_sources"), ("thin", "stride")):
        text = made.read_text()
        made.write_text(text.replace(f'"{now}"', f'"{former}"'))
        with pytest.raises(ConfigError, match=f"'{former}' in rows is now '{now}'"):
            read_set(store)
        made.write_text(text)


def test_nothing_there_is_said(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="boxgrasp simulate"):
        read_set(Store(tmp_path))
    with pytest.raises(ConfigError, match="not a part of a set"):
        from_parquet(b"nothing of the kind")


def test_a_kept_capture_is_the_one_that_was_seen(tmp_path: Path) -> None:
    path = tmp_path / "capture.npz"
    path.write_bytes(capture_bytes((CONFIG, 4)))
    kept = load_capture(path)
    fresh, object_ids = scenario_of_row(CONFIG, 4).capture("xtion")
    assert np.array_equal(kept.depth, fresh.depth)
    assert kept.target_pixel == fresh.target_pixel
    assert np.array_equal(np.load(path, allow_pickle=False)["object_ids"], object_ids)


def test_the_true_box_holds_the_target_s_surfaces(rows) -> None:
    for k in range(rows.count):
        scene = scenario_of_row(CONFIG, k).scene
        middle, size = rows["true_box"][k][:3], rows["true_dimensions_m"][k]
        assert middle[2] - size[2] / 2 == pytest.approx(scene.table_height_m)
        for solid in scene.target:
            away = np.abs(solid.T_base_solid[:3, 3] - middle) + solid.half_size
            assert (away <= size / 2 + 1e-9).all()


def test_an_object_file_that_changed_is_another_set(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    block = "objects:\n  block:\n    set: known\n    color: [9, 9, 9]\n    parts:\n"
    file.write_text(block + "      - {shape: box, dimensions_m: [0.06, 0.06, 0.12]}\n")
    rows = RowConfig(Recipe(("block",), objects=str(file), obstacles=(0, 0)), 1)
    store = Store(tmp_path / "set")
    with local_workers(1) as workers:
        make_set(store, "", SetConfig(rows, 1), workers, "")
        file.write_text(block + "      - {shape: box, dimensions_m: [0.06, 0.06, 0.13]}\n")
        with pytest.raises(ConfigError, match="objects_sha256"):
            make_set(store, "", SetConfig(rows, 1), workers, "")


def test_whoever_labels_comes_through_the_same_door() -> None:
    class Person:
        def label(self, shown, rng) -> Label:
            assert shown.candidates.width_m.shape == (15,)
            return Label(7, "a person")

    row = row_of(CONFIG, 0, Person())
    assert (row["label"], row["label_source"]) == (7, "a person")
