"""The whole study, tiny: the same bytes however it was run and killed, and errors in one line."""

from __future__ import annotations

import importlib.util
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest

pytest.importorskip("sklearn", reason="extra train")
pytest.importorskip("onnx", reason="extra train")
pytest.importorskip("pyarrow", reason="extra train")
pytest.importorskip("matplotlib", reason="extra train")
pytest.importorskip("jinja2", reason="extra train")

import pyarrow
import pyarrow.parquet
import tiny_study
from cluster import cluster

import boxgrasp.study.study as study
import boxgrasp.teaching.sets as sets
import boxgrasp.teaching.train as train
from boxgrasp import __version__, load_capture
from boxgrasp.cli import main
from boxgrasp.execution import Store
from boxgrasp.ranking.model_set import SVMS
from boxgrasp.ranking.onnx.model import SHIPPED
from boxgrasp.simulate import demo_capture
from boxgrasp.simulate.physics import Settling
from boxgrasp.study.catalogue import catalogue
from boxgrasp.study.evaluation import Evaluation, model_sets_in
from boxgrasp.study.intervals import Estimate
from boxgrasp.study.sections.captures import captures_section
from boxgrasp.study.sections.need import only_faces
from boxgrasp.study.verdicts import Verdict, judge
from boxgrasp.teaching.rows import scenario_of_row
from boxgrasp.teaching.sets import read_set

ROOT = Path(__file__).resolve().parent.parent
VERDICTS = get_args(Verdict)
KNOWN = [
    "crisps_tube",
    "biscuits_pack",
    "cereal_x",
    "cereal_y",
]  # the targets of the training (3-3-1)
SEED = 1
REPRODUCE = [
    sys.executable, str(Path(tiny_study.__file__)), "reproduce", "--small", "--seed", str(SEED),
]  # fmt: skip


def start(out: Path, *words: str) -> subprocess.Popen[bytes]:
    """A study of its own process group, its standard error in a file beside its folder."""
    with out.with_suffix(".log").open("ab") as log:
        return subprocess.Popen(
            [*REPRODUCE, str(out), *words],
            stdout=subprocess.DEVNULL,
            stderr=log,
            start_new_session=True,
        )


def end(process: subprocess.Popen[bytes], out: Path) -> None:
    assert process.wait(timeout=300) == 0, out.with_suffix(".log").read_text("utf-8")


def wait_for(process: subprocess.Popen[bytes], out: Path, pattern: str, count: int) -> None:
    """Until so many finished files match, with the process still under way."""
    stop = time.monotonic() + 120
    while len(list(out.glob(pattern))) < count:
        assert process.poll() is None, out.with_suffix(".log").read_text("utf-8")
        assert time.monotonic() < stop, "waited in vain"
        time.sleep(0.01)
    assert process.poll() is None


def files(out: Path) -> dict[str, Path]:
    """Every file of a study by its name, but for what a kill left half written."""
    found = {path.relative_to(out).as_posix(): path for path in out.rglob("*") if path.is_file()}
    return {name: path for name, path in found.items() if ".unfinished-" not in name}


def assert_same(out: Path, base: Path) -> None:
    assert sorted(files(out)) == sorted(files(base))
    other = [n for n, path in files(out).items() if path.read_bytes() != (base / n).read_bytes()]
    assert other == []


@pytest.fixture(scope="session")
def base(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The study by one process; made once where xdist keeps a file together (`loadfile`)."""
    out = tmp_path_factory.mktemp("base") / "out"
    end(start(out, "--processes", "1"), out)
    return out


@pytest.fixture(autouse=True)
def tiny(monkeypatch: pytest.MonkeyPatch) -> None:
    """In this process, too, `--small` is the tiny scale."""
    monkeypatch.setattr(study, "SMALL", tiny_study.TINY)
    monkeypatch.setattr(sets, "PART_ROWS", tiny_study.PART_ROWS)
    monkeypatch.setattr(train, "SEARCH", tiny_study.SEARCH)
    monkeypatch.setattr("boxgrasp.execution._dask._REACH_S", 1)


def one_line(capsys: pytest.CaptureFixture[str]) -> str:
    """The one line on standard error, nothing on the other."""
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.startswith("boxgrasp: ") and said.err.count("\n") == 1, said.err
    return said.err


# ---- the whole


def test_base_is_whole(base: Path) -> None:
    report = json.loads((base / "report.json").read_bytes())
    assert report["made_with"]["boxgrasp"] == __version__
    assert report["made_with"]["seed"] == str(SEED)
    assert report["claims"] and report["sections"]
    (causes,) = (section for section in report["sections"] if section["key"] == "causes")
    assert [len(table["rows"]) for table in causes["tables"]] == [27, 27, 8, 8, 23]
    names = files(base)
    assert {"report.html", "report.md"} <= set(names)
    assert re.search(r"\bnan\b", (base / "report.md").read_text("utf-8")) is None
    assert sum(name.endswith(".onnx") for name in names) == 8
    assert len(list((base / "sets" / "labels").glob("part-*"))) == 8
    for name, count in (("labels", 64), ("tested", 12), ("real", 4)):
        assert read_set(Store(base), f"sets/{name}/")[1].count == count


@pytest.mark.slow
def test_killed_twice_and_resumed(base: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    first = start(out, "--processes", "2")
    wait_for(first, out, "sets/labels/part-*", 2)
    first.kill()
    first.wait()
    finished = {name: path.stat().st_mtime_ns for name, path in files(out).items()}
    second = start(out, "--processes", "2")
    wait_for(second, out, "models/training/*-*.json", 2)
    os.killpg(second.pid, signal.SIGKILL)  # its workers, too
    second.wait()
    finished |= {name: path.stat().st_mtime_ns for name, path in files(out).items()}
    assert not (out / "report.json").exists()
    end(start(out, "--processes", "2"), out)
    assert_same(out, base)
    for name, written in finished.items():
        assert files(out)[name].stat().st_mtime_ns == written, f"{name} was made again"


@pytest.mark.slow
def test_dask_cluster_that_loses_a_worker(base: Path, tmp_path: Path) -> None:
    pytest.importorskip("distributed", reason="extra cluster")
    out = tmp_path / "out"
    with cluster(workers=2) as running:
        process = start(out, "--cluster", running.address)
        try:
            wait_for(process, out, "sets/labels/part-*", 2)  # all are handed out
            running.kill_worker()
            end(process, out)
        finally:
            process.kill()
    assert_same(out, base)


# ---- what it made


def test_train_gives_the_study_s_models(base: Path, tmp_path: Path, capsys) -> None:
    out = tmp_path / "models"
    labels = str(base / "sets" / "labels")
    assert main(["train", labels, str(out), "--seed", str(SEED), "--processes", "2"]) == 0
    assert len(capsys.readouterr().out.splitlines()) == 9
    assert_same(out, base / "models")
    assert main(["train", labels, str(out), "--seed", "2"]) == 2
    assert "seed is 1 there, 2 now" in one_line(capsys)
    tested = str(base / "sets" / "tested")
    assert main(["train", tested, str(out), "--seed", str(SEED)]) == 2
    assert "valid: another place" in one_line(capsys)


def test_evaluate_says_what_the_report_says(base: Path, capsys) -> None:
    words = [str(base / "sets" / "tested"), "--models", str(base / "models"), "--json"]
    assert main(["evaluate", *words]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert {line["checked"] for line in lines} == {False, True}
    assert len(lines) == 2 * len({line["ranker"] for line in lines}) >= 14
    assert main(["evaluate", *words[:-1], "--target", "given"]) == 0
    assert "12 scenarios" in capsys.readouterr().out


def claims_of(out: Path) -> dict[str, dict[str, Any]]:
    report = json.loads((out / "report.json").read_bytes())
    return {claim["key"]: claim for claim in report["claims"]}


def test_every_result_of_the_thesis_has_a_verdict(base: Path) -> None:
    claims = claims_of(base)
    assert list(claims) == [item.key for item in catalogue()]
    for item in catalogue():
        claim = claims[item.key]
        assert claim["verdict"] in VERDICTS and claim["theirs"], item.key
        if claim["verdict"] == "cannot be judged here":
            assert claim["reason"], item.key
        else:
            assert claim["ours"] is not None, item.key


def test_scenes_cast_for_the_need_are_those_that_the_answers_count(base: Path) -> None:
    needed, _, line = only_faces(read_set(Store(base), "sets/need/")[1])
    assert needed.all() and (line != 1).all()


def column(table: Any, name: str) -> np.ndarray:
    return np.array(table[name].to_pylist())


def scores_by_hand(
    clearances_m: np.ndarray, fits: np.ndarray, picks: np.ndarray, *, any_width: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """The thesis's words (3-4), a scene at a time: score, and 0, 1, 2 for red, yellow, green."""
    scores, categories = [], []
    for d, fit, pick in zip(clearances_m, fits, picks, strict=True):
        open_ = np.ones_like(fit) if any_width else fit
        largest = d[open_].max() if open_.any() else 0.0
        safe = min(0.06, largest)
        if not open_[pick] or d[pick] < 0.02:
            found = 0.0, 0
        elif d[pick] >= safe:
            found = 1.0, 2
        else:
            found = ((d[pick] - 0.02) / (safe - 0.02)) ** 2, 1
        scores.append(found[0])
        categories.append(found[1])
    return np.array(scores), np.array(categories)


def test_table_4_1_comes_out_of_the_stored_rows_by_numpy_alone(base: Path) -> None:
    """No code of the study but for the models' picks; to the third digit."""
    parts = sorted((base / "sets" / "tested").glob("part-*.parquet"))
    table = pyarrow.concat_tables([pyarrow.parquet.read_table(part) for part in parts])
    clearances_m = column(table, "given_thesis_clearance_m")
    fits = column(table, "given_true_fits").astype(bool)
    known = np.isin(column(table, "target"), KNOWN)
    assert clearances_m.shape == fits.shape == (12, 15) and known.sum() == 8
    store, claims = Store(base), claims_of(base)
    evaluation = Evaluation(read_set(store, "sets/tested/")[1], model_sets_in(store, "models/"))
    groups = {"known": known, "novel": ~known, "total": np.ones_like(known)}
    every = {}
    for version in ("single-spiral", "cascade-spiral", "single-grid", "cascade-grid"):
        every[version] = picks = evaluation.picks(version)
        scores, categories = scores_by_hand(clearances_m, fits, picks)
        alone, _ = scores_by_hand(clearances_m, fits, picks, any_width=True)
        for name, group in groups.items():
            claim = claims[f"score-{version}-{name}"]
            assert claim["ours"]["value"] == pytest.approx(scores[group].mean(), abs=5e-4)
            assert f"however wide: {alone[group].mean():.3f}" in claim["reason"]
    for key, flags in {
        "clear-simulation": categories > 0,
        "clear-novel": (categories > 0)[~known],
        "safe-simulation": categories == 2,
        "grid-never-wide-cascade": ~fits[np.arange(12), picks],
        "differ-grid-total": every["single-grid"] != every["cascade-grid"],
        "differ-spiral-known": (every["single-spiral"] != every["cascade-spiral"])[known],
    }.items():
        assert claims[key]["ours"]["value"] == pytest.approx(flags.mean(), abs=5e-4), key


def test_the_docs_quote_what_stands_in_the_report(base: Path) -> None:
    """The page is written from the kept figures, and each of them is one of the report's."""
    spec = importlib.util.spec_from_file_location("quote_study", ROOT / "tools" / "quote_study.py")
    assert spec is not None and spec.loader is not None
    tool = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(tool)
    kept = json.loads(tool.FIGURES.read_text("utf-8"))
    assert tool.text_of(kept) in tool.PAGE.read_text("utf-8")
    now = tool.figures_of(json.loads((base / "report.json").read_bytes()))
    for part, name in (("claims", "key"), ("rows", "name")):
        assert [item[name] for item in kept[part]] == [item[name] for item in now[part]]
    judged = {item.key: item.said for item in catalogue()}
    for claim in kept["claims"]:
        assert claim["theirs"] == str(judged[claim["key"]])
        assert claim["verdict"] == judge(judged[claim["key"]], Estimate(**claim["ours"]))
    assert sum(kept["verdicts"].values()) == len(judged)
    assert tool.replaced(f"a{tool.BEGIN}b{tool.END}c", "X") == "aXc"


def test_other_settings_at_the_same_place(base: Path, capsys) -> None:
    before = {name: path.stat().st_mtime_ns for name, path in files(base).items()}
    assert main(["reproduce", str(base), "--small", "--seed", "2"]) == 2
    assert "rows.seed is 1001 there, 2001 now" in one_line(capsys)
    assert main(["reproduce", str(base), "--seed", str(SEED)]) == 2
    assert "count is 64 there, 800 now" in one_line(capsys)
    labels = str(base / "sets" / "labels")
    assert main(["simulate", labels, "--count", "64", "--seed", "1001", "--noise", "xtion"]) == 2
    assert "noise is none there, xtion now" in one_line(capsys)
    assert before == {name: path.stat().st_mtime_ns for name, path in files(base).items()}


# ---- errors

AT = "simulate {tmp}/new --count 2"


@pytest.mark.parametrize(
    ("line", "said"),
    [
        (f"{AT} --processes 0", "0 processes; valid: 1 or more"),
        (f"{AT} --processes 2 --cluster tcp://127.0.0.1:1", "not allowed with"),
        (f"{AT} --cluster tcp://127.0.0.1:1", "no Dask scheduler at tcp://127.0.0.1:1"),
        (f"{AT} --cluster here", "no Dask scheduler at here"),
        ("simulate {tmp}/new --count 0", "count is 0; valid: 1 to 4000000"),
        ("simulate {tmp}/new --count -4", "count is -4; valid: 1 to 4000000"),
        ("simulate {tmp}/new --count many", "invalid int value"),
        (f"{AT} --seed -1", "seed is -1; valid: 0 to"),
        (f"{AT} --seed 9999999999999999999", "seed is 9999999999999999999; valid: 0 to"),
        (f"{AT} --lines 0", "lines is 0; valid: 1 to 99"),
        (f"{AT} --set none", "invalid choice: 'none'"),
        (f"{AT} --wish none", "invalid choice: 'none'"),
        (f"{AT} --objects {{tmp}}/none.yaml", "none.yaml' cannot be read"),
        (f"{AT} --obstacles 3 1 --processes 1", "valid: 0 to 200, the least first"),
        (f"{AT} --obstacles 0 9223372036854775807 --processes 1", "valid: 0 to 200, the least"),
        ("simulate {tmp}/file --count 2", "file/set.json: File exists"),
        ("simulate {tmp}/file/under --count 2", "Not a directory"),
        ("simulate /proc/none --count 2", "/proc/none/set.json: "),
        ("simulate nope://x --count 2", "Protocol not known: nope"),
        ("train {tmp}/none {tmp}/new", "no set at {tmp}/none"),
        ("train {tmp}/damaged {tmp}/new", "damaged/set.json is damaged"),
        ("train {tmp}/list {tmp}/new", "list/set.json is damaged"),
        ("train {base}/sets/labels {tmp}/new --seed -1", "seed is -1; valid: 0 or more"),
        ("train {base}/sets/labels {tmp}/file", "Not a directory"),
        ("train {base}/sets/labels {tmp}/new --processes 0", "valid: 1 or more"),
        ("evaluate {tmp}/none", "no set at {tmp}/none"),
        ("evaluate {tmp}/damaged", "damaged/set.json is damaged"),
        ("evaluate {tmp}/torn", "not a part of a set"),
        ("evaluate {tmp}/lacking", "set lacks 1 of 2 parts"),
        ("evaluate {tmp}/mixed", "mixed/ holds 4 rows; valid: 5 as in its set.json"),
        ("evaluate {base}/sets/tested --models {tmp}/none", "single-spiral.onnx: No such file"),
        ("evaluate {base}/sets/tested --models {tmp}/swapped", "holds single-spiral; valid: "),
        ("evaluate {base}/sets/tested --models {tmp}/cut", "single-grid.onnx: not an ONNX file"),
        ("reproduce {tmp}/new --small --seed -1", "seed is -1; valid: 0 or more"),
        ("reproduce {tmp}/file --small", "Not a directory"),
        ("reproduce {tmp}/new --small --processes 0", "0 processes; valid: 1 or more"),
        ("reproduce {tmp}/new --small --cluster tcp://127.0.0.1:1", "no Dask scheduler"),
        ("reproduce {tmp}/new --small --captures {tmp}/none", "no folder {tmp}/none"),
    ],
)
def test_errors(line: str, said: str, base: Path, tmp_path: Path, capsys) -> None:
    (tmp_path / "file").touch()
    for name, text in (("damaged", '{"rows": '), ("list", "[]")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "set.json").write_text(text)
    for name in ("torn", "lacking"):
        shutil.copytree(base / "sets" / "tested", tmp_path / name)
    (tmp_path / "torn" / "part-00000.parquet").write_bytes(b"PAR1")
    (tmp_path / "lacking" / "part-00000.parquet").unlink()
    shutil.copytree(base / "sets" / "real", tmp_path / "mixed")
    made = tmp_path / "mixed" / "set.json"
    made.write_text(made.read_text().replace('"count": 4', '"count": 5'))
    for name in ("swapped", "cut"):
        shutil.copytree(base / "models", tmp_path / name)
    models = base / "models"
    shutil.copy(models / "single-spiral.onnx", tmp_path / "swapped" / "single-grid.onnx")
    (tmp_path / "cut" / "single-grid.onnx").write_bytes(
        (models / "single-grid.onnx").read_bytes()[:900]
    )
    places = {"tmp": str(tmp_path), "base": str(base)}
    assert main([word.format(**places) for word in line.split()]) == 2
    assert said.format(**places) in one_line(capsys)
    assert not (tmp_path / "new").exists() or not list((tmp_path / "new").glob("part-*"))


def test_models_for_other_lines(base: Path, tmp_path: Path, capsys) -> None:
    out = str(tmp_path / "five")
    assert main(["simulate", out, "--count", "1", "--lines", "5", "--processes", "1"]) == 0
    capsys.readouterr()
    assert main(["evaluate", out, "--models", str(base / "models")]) == 2
    assert "was trained for 3 lines a face, the set has 5" in one_line(capsys)


# ---- simulate


def test_simulate_to_a_url_and_again(tmp_path: Path, capsys) -> None:
    words = ["--count", "3", "--seed", "5", "--keep-captures"]
    url = f"memory://{tmp_path.name}/set"
    assert main(["simulate", url, *words, "--processes", "1"]) == 0
    assert capsys.readouterr().out.startswith(f"{url}: 3 scenarios, ")
    scenario_of_row.cache_clear()
    folder = tmp_path / "set"
    assert main(["simulate", str(folder), *words, "--processes", "2"]) == 0
    names = ["set.json", "part-00000.parquet", *(f"capture-{k:06d}.npz" for k in range(3))]
    assert sorted(files(folder)) == sorted(names)
    for name in names:
        assert Store(url).read(name) == (folder / name).read_bytes(), name
    config, rows = read_set(Store(url))
    assert (config.rows.seed, rows.count) == (5, 3)
    for number in range(3):
        kept = load_capture(folder / f"capture-{number:06d}.npz")
        fresh, _ = scenario_of_row(config.rows, number).capture(config.rows.recipe.noise)
        assert np.array_equal(kept.depth, fresh.depth)
        assert np.array_equal(kept.T_base_camera, fresh.T_base_camera)


def test_physics_keeps_what_stands(tmp_path: Path, monkeypatch, capsys) -> None:
    pytest.importorskip("mujoco", reason="extra sim")

    def scene(name: str, *words: str) -> str:
        scenario_of_row.cache_clear()
        out = str(tmp_path / name)
        words = (out, "--count", "1", "--seed", "3", "--processes", "1", *words)
        assert main(["simulate", *words]) == 0
        return str(read_set(Store(out))[1]["scene"][0])

    drawn = scene("drawn")
    assert scene("settled", "--physics") == drawn  # the scenes are made to stand
    fallen = iter([Settling(0.1, 0.0), Settling(0.0, 0.5), Settling(0.0, 0.0)])
    monkeypatch.setattr("boxgrasp.simulate.scenario.settles", lambda _: next(fallen))
    assert scene("again", "--physics") != drawn
    assert next(fallen, None) is None
    scenario_of_row.cache_clear()


def test_physics_without_mujoco(tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    scenario_of_row.cache_clear()
    out = str(tmp_path / "out")
    assert main(["simulate", out, "--count", "1", "--physics", "--processes", "1"]) == 2
    assert "pip install 'boxgrasp[sim]'" in one_line(capsys)


def test_captures_are_decided_again_and_bad_ones_left_out(tmp_path: Path) -> None:
    folder = tmp_path / "captures"
    folder.mkdir()
    view = demo_capture()
    for name in ("a table", "b"):
        np.savez(
            folder / f"{name}.npz",
            depth=view.depth,
            intrinsics=view.intrinsics,
            T_base_camera=view.T_base_camera,
            target_pixel=view.target_pixel,
        )
    (folder / "broken.npz").write_bytes(b"no archive")
    (folder / "empty").mkdir()
    store = Store(tmp_path / "out")
    for svm in SVMS:
        store.write(f"models/{svm.name}.onnx", (SHIPPED / f"{svm.name}.onnx").read_bytes())
    small = study.Study(store, None, SEED, study.Scale(runs=2))  # type: ignore[arg-type]
    section = captures_section(small, folder)
    assert [row[0] for row in section.tables[0].rows] == ["a table", "b"]
    assert all("(2)" in row[2] or "(1)" in row[2] for row in section.tables[0].rows)
    assert "broken" in section.words[-1]
    assert "empty" in section.words[-1]
    assert len({picture.name for picture in section.pictures}) == 2
    assert captures_section(small, folder) == section  # kept, and read back the same
