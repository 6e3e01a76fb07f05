"""The SVM rankers against a second, plainer reading of the thesis, and the baselines."""

from __future__ import annotations

import dataclasses
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import drawn, item, laid, seen
from test_imports import run
from tiny_models import parts_of, trained, write_models

from boxgrasp import GraspSelector
from boxgrasp.errors import BoxgraspError, ConfigError, ModelError
from boxgrasp.geometry.box import Box
from boxgrasp.geometry.transforms import make_transform
from boxgrasp.grasps.candidates import candidates_of
from boxgrasp.grasps.gripper import Gripper
from boxgrasp.ranking.features import line_features, single_features
from boxgrasp.ranking.model_set import VERSIONS
from boxgrasp.ranking.ranker import (
    SHIPPED,
    Ranker,
    RankerSetup,
    Ranking,
    RankingContext,
    ranker_named,
)
from boxgrasp.ranking.sampling import portion, sampling

SEEDS = range(4)
CELLS_M = (0.03, 0.07)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    for name in ("sklearn", "onnx", "onnxruntime"):
        pytest.importorskip(name)
    return write_models(tmp_path_factory.mktemp("models"))


def context_of(seed: int, lines: int = 3) -> RankingContext:
    selector = GraspSelector({"candidates": {"lines": lines}}, map_resolutions_m=CELLS_M)
    return selector.analyze(seen(drawn(seed), seed)).context


def a_box(x: float, y: float, z: float, at: float = 0.8, lines: int = 3) -> RankingContext:
    box = Box(make_transform(np.eye(3), (at, 0, z / 2)), np.array([x, y, z]))
    return RankingContext(box, candidates_of(box, Gripper(), lines), {}, {})


def expected_order(version: str, context: RankingContext) -> list[int]:
    """Labels by scikit-learn itself, candidate by candidate (thesis 2-3-2, 2-3-3)."""
    name = version.split("-")[1]
    local_map = context.local_maps[0.03 if name == "spiral" else 0.07]
    points, dimensions_m = sampling(name), context.box.dimensions_m[None]

    def ordered(part: str, X: Any, count: int) -> list[int]:
        svc, _ = trained(version, part)
        predicted = int(svc.predict(X[None])[0])
        values = np.atleast_1d(svc.decision_function(X[None])[0])
        if len(values) == 1:
            values = np.array([-values[0], values[0]])
        known = {int(c): float(v) for c, v in zip(svc.classes_, values, strict=True)}
        rest = sorted(
            (k for k in range(1, count + 1) if k != predicted),
            key=lambda k: (-round(known.get(k, -np.inf), 9), k),
        )
        return [predicted, *rest]

    (whole,) = single_features(local_map.values_at(points)[None], dimensions_m, 0.25)
    if version.startswith("single"):
        return ordered("single", whole, 15)
    found = []
    for face in ordered("face", whole, 5):
        occupancy = local_map.values_at(portion(points, face))[None]
        (X,) = line_features(occupancy, dimensions_m, face, 0.25)
        found += [(face - 1) * 3 + k for k in ordered("side" if face <= 3 else "top", X, 3)]
    return found


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("seed", SEEDS)
def test_the_order_is_the_thesis(version: str, seed: int, folder: Path) -> None:
    context = context_of(seed)
    found = ranker_named(version, RankerSetup(str(folder))).rank(context)
    assert (found.order + 1).tolist() == expected_order(version, context)


def test_versions_and_scenes_differ(folder: Path) -> None:
    """The test above would hold for a ranker that looks at nothing, were all orders the same."""
    orders = {
        tuple(ranker_named(version, RankerSetup(str(folder))).rank(context_of(seed)).order.tolist())
        for version in VERSIONS
        for seed in SEEDS
    }
    assert len(orders) > 8


@pytest.mark.parametrize("name", SHIPPED)
@pytest.mark.parametrize("seed", SEEDS)
def test_every_candidate_once_and_confidence_never_rises(
    name: str, seed: int, folder: Path
) -> None:
    context = context_of(seed)
    found = ranker_named(name, RankerSetup(str(folder))).rank(context)
    assert sorted(found.order.tolist()) == list(range(15))
    along = found.confidence[found.order]
    assert along.shape == (15,) and (along >= 0).all() and (along <= 1).all()
    assert (np.diff(along) <= 0).all() and found.confidence.sum() > 0
    again = ranker_named(name, RankerSetup(str(folder))).rank(context)
    np.testing.assert_array_equal(found.order, again.order)
    np.testing.assert_array_equal(found.confidence, again.confidence)


@pytest.mark.parametrize("version", VERSIONS)
def test_maps_of_the_right_cells_are_read(version: str, folder: Path) -> None:
    ranker = ranker_named(version, RankerSetup(str(folder)))
    assert ranker.map_resolutions_m == ((0.03,) if version.endswith("spiral") else (0.07,))
    assert ranker.warnings == ()


@pytest.mark.parametrize("version", VERSIONS)
def test_selecting_with_models(version: str, folder: Path) -> None:
    view = seen(drawn(1), 1)
    config = {"ranker": version, "models": str(folder)}
    found = GraspSelector(config).select(view)
    assert found.ranker == version
    order = sorted(found.candidates, key=lambda candidate: candidate.rank)
    assert [candidate.rank for candidate in order] == list(range(1, 16))
    assert [candidate.label for candidate in order] == expected_order(version, context_of(1))
    passing = [candidate.label for candidate in order if candidate.passed]
    assert [candidate.label for candidate in found.passing] == passing
    label = None if found.grasp is None else found.grasp.label
    assert label == (passing[0] if passing else None)
    bare = GraspSelector({**config, "unchecked": True}).select(view)
    assert bare.grasp is not None and bare.grasp.label == order[0].label


def test_another_number_of_lines(tmp_path: Path, folder: Path) -> None:
    with pytest.raises(ConfigError) as error:
        GraspSelector({"ranker": "cascade-grid", "models": str(folder), "candidates": {"lines": 5}})
    text = str(error.value)
    assert "candidates.lines is 5" in text and "trained for 3" in text and "\n" not in text
    models = write_models(tmp_path, lines=5)
    for version in VERSIONS:
        found = ranker_named(version, RankerSetup(str(models), lines=5)).rank(context_of(0, 5))
        assert sorted(found.order.tolist()) == list(range(25))


@pytest.mark.parametrize("version", ["single-grid", "cascade-spiral"])
def test_another_hand_is_said(version: str, folder: Path) -> None:
    gripper = Gripper(max_opening_m=0.1, length_m=0.2)
    (warning,) = ranker_named(version, RankerSetup(str(folder), gripper)).warnings
    said = warning.message
    assert warning.code == "trained_with_another_gripper"
    assert "max_opening_m 0.12, now 0.1" in said and "length_m 0.22, now 0.2" in said
    assert "width" not in said and "\n" not in said
    config = {"ranker": version, "models": str(folder), "gripper": {"max_opening_m": 0.1}}
    told = GraspSelector(config).select(seen(drawn(0))).warnings
    assert "trained_with_another_gripper" in [warning.code for warning in told]
    tool = dataclasses.replace(Gripper(), T_gripper_tcp=tuple(map(tuple, np.eye(4).tolist())))
    assert ranker_named(version, RankerSetup(str(folder), tool)).warnings == ()


@pytest.mark.parametrize("version", VERSIONS)
def test_a_missing_file(version: str, tmp_path: Path, folder: Path) -> None:
    for part in parts_of(version):
        models = tmp_path / part
        shutil.copytree(folder, models)
        name = version if part == "single" else f"{version}-{part}"
        (models / f"{name}.onnx").unlink()
        with pytest.raises(ModelError) as error:
            ranker_named(version, RankerSetup(str(models)))
        text = str(error.value)
        assert f"{name}.onnx" in text and str(models) in text and "boxgrasp train" in text
    with pytest.raises(ModelError):
        ranker_named(version, RankerSetup(str(tmp_path / "nowhere")))


def test_a_file_under_another_name(tmp_path: Path, folder: Path) -> None:
    shutil.copy(folder / "single-spiral.onnx", tmp_path / "single-grid.onnx")
    with pytest.raises(ModelError, match="holds single-spiral; valid: single-grid"):
        ranker_named("single-grid", RankerSetup(str(tmp_path)))


def test_other_features_are_refused(tmp_path: Path) -> None:
    """A model that names itself right but was trained on spiral samples."""
    pytest.importorskip("onnxruntime")
    from boxgrasp.teaching.export import to_onnx

    svc, record = trained("single-spiral", "single")
    lying = dataclasses.replace(record, version="single-grid", sampling="grid")
    (tmp_path / "single-grid.onnx").write_bytes(to_onnx(svc, lying))
    with pytest.raises(ModelError) as error:
        ranker_named("single-grid", RankerSetup(str(tmp_path)))
    text = str(error.value)
    assert "single-grid.onnx: " in text and "first difference: feature 0" in text
    assert text.count(" of schema ") == 2 and "\n" not in text
    lying = dataclasses.replace(lying, sampling="cube")
    (tmp_path / "single-grid.onnx").write_bytes(to_onnx(svc, lying))
    with pytest.raises(ModelError, match="sampling is 'cube'"):
        ranker_named("single-grid", RankerSetup(str(tmp_path)))


class Reversed(Ranker):
    """A user's own: the last label first, the most confident first."""

    name = "reversed"

    def rank(self, context: RankingContext) -> Ranking:
        count = len(context.candidates.label)
        return Ranking(np.arange(count)[::-1], np.linspace(0.0, 1.0, count))


def test_an_own_ranker_is_handed_over() -> None:
    """In place of the configuration's; the checks are the same; confidence goes by the row."""
    view = seen(drawn(1), 1)
    shipped, own = GraspSelector().select(view), GraspSelector(ranker=Reversed()).select(view)
    assert own.ranker == "reversed"
    assert [candidate.rank for candidate in own.candidates] == list(range(15, 0, -1))
    assert [candidate.checks for candidate in own.candidates] == [
        candidate.checks for candidate in shipped.candidates
    ]
    passing = [candidate.label for candidate in shipped.candidates if candidate.passed]
    assert [candidate.label for candidate in own.passing] == passing[::-1]
    assert own.grasp is not None and own.grasp.label == passing[-1]
    assert own.grasp.confidence == (own.grasp.label - 1) / 14


@pytest.mark.parametrize(
    ("order", "confidence", "said"),
    [
        (range(14), [0.5] * 15, "order is no permutation; valid: each row of 0 to 14"),
        ([0] * 15, [0.5] * 15, "order is no permutation"),
        (range(1, 16), [0.5] * 15, "order is no permutation"),
        (range(15), [0.5] * 14, "confidence is not 15 numbers from 0 to 1"),
        (range(15), [1.5] * 15, "confidence is not 15 numbers from 0 to 1"),
        (range(15), [np.nan] * 15, "confidence is not 15 numbers from 0 to 1"),
    ],
)
def test_an_own_ranking_that_does_not_fit(
    order: Sequence[int], confidence: list[float], said: str
) -> None:
    class Wrong(Reversed):
        def rank(self, context: RankingContext) -> Ranking:
            return Ranking(np.array(order), np.array(confidence))

    with pytest.raises(BoxgraspError, match="ranker reversed: " + said):
        GraspSelector(ranker=Wrong()).select(seen(drawn(1), 1))


@pytest.mark.parametrize(
    "ranker", [Reversed, "clearance", object()], ids=["a class", "a name", "no ranker"]
)
def test_what_is_no_ranker(ranker: Any) -> None:
    with pytest.raises(ConfigError, match=r"is a class; valid: an object|is no ranker; valid:"):
        GraspSelector(ranker=ranker)


def test_a_ranker_that_reads_a_check_that_is_not_made() -> None:
    with pytest.raises(ConfigError, match="reads the check visible_clearance, which is not in"):
        GraspSelector(checks=[]).select(seen(drawn(1), 1))


def test_top_down_by_example() -> None:
    """Parallel closes over y, perpendicular over x; the narrower first, then the other."""
    ranker = ranker_named("top-down")
    rest = [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 12, 13, 15]
    assert (ranker.rank(a_box(0.2, 0.05, 0.1)).order + 1).tolist() == [11, 14, *rest]
    assert (ranker.rank(a_box(0.05, 0.2, 0.1)).order + 1).tolist() == [14, 11, *rest]
    assert (ranker.rank(a_box(0.06, 0.06, 0.06)).order + 1).tolist() == [11, 14, *rest]
    assert (ranker.rank(a_box(0.2, 0.05, 0.1, lines=1)).order + 1).tolist() == [4, 5, 1, 2, 3]
    assert (ranker.rank(a_box(0.2, 0.05, 0.1, lines=4)).order[:2] + 1).tolist() == [14, 18]


def test_top_down_in_a_scene() -> None:
    found = GraspSelector({"ranker": "top-down"}).select(seen(laid(item("green_cube", 0.85, 0.0))))
    assert found.grasp is not None and found.grasp.label in (11, 14)


def test_random_is_even_over_scenes() -> None:
    ranker = ranker_named("random")
    orders = np.array(
        [ranker.rank(a_box(0.05, 0.06, 0.07, at=0.6 + k * 1e-3)).order for k in range(600)]
    )
    firsts = np.bincount(orders[:, 0], minlength=15)
    assert firsts.min() > 15 and firsts.max() < 75  # 40 expected, five standard deviations
    near = [ranker.rank(a_box(0.05, 0.06, 0.07, at=at)).order for at in (0.8, 0.8 + 1e-7)]
    np.testing.assert_array_equal(*near)


def test_an_unknown_name() -> None:
    with pytest.raises(ConfigError, match="unknown ranker: oracle; valid: clearance, single-"):
        ranker_named("oracle")


def test_onnxruntime_is_asked_for_by_name_and_only_when_needed(folder: Path) -> None:
    code = f"""
    import sys
    from boxgrasp import GraspSelector
    from boxgrasp.errors import MissingExtraError
    from boxgrasp.simulate import demo_capture
    for name in ("clearance", "top-down", "random"):
        split = {{"ranker": name, "scene": {{"segmentation": "split"}}}}
        GraspSelector(split).select(demo_capture())
    try:
        GraspSelector({{"ranker": "cascade-grid", "models": {str(folder)!r}}})
    except MissingExtraError as error:
        print(error)
    """
    blocked = ("onnxruntime", "onnx", "sklearn")
    assert run(code, blocked) == (
        "trained models need onnxruntime; install with: pip install onnxruntime\n"
    )
