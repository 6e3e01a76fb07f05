"""The full study: cell size and number of labels (6-1), lines (3-2), mirroring, networks."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from boxgrasp.arrays import Array, Points
from boxgrasp.execution import finish
from boxgrasp.grasps.candidates import LINES
from boxgrasp.ranking.features import DIMENSIONS, single_features
from boxgrasp.ranking.sampling import RESOLUTION_M, grid
from boxgrasp.study.curves import (
    PART_ROWS,
    RESOLUTIONS_M,
    Kind,
    Variant,
    dense_part,
    dense_predictions,
    fit,
    read_dense,
)
from boxgrasp.study.evaluation import Evaluation
from boxgrasp.study.intervals import Estimate, mean, share
from boxgrasp.study.metrics import metrics_of
from boxgrasp.study.plots import curves
from boxgrasp.study.report import Picture, Row, Section, Table
from boxgrasp.study.sections.readings import KINDS, held, judged
from boxgrasp.study.study import Study
from boxgrasp.teaching.samples import largest_edge_m, occupancy_of
from boxgrasp.teaching.sets import Rows, joined

LINE_NUMBERS = (1, 3, 5, 7)
LABELS = (50, 100, 200, 400, 800, 1600, 3200)
NETWORKS = 5


@dataclass(frozen=True)
class _Point:
    """One point of a curve: what it was made with, and what it came to."""

    series: str
    at: int
    score: Estimate
    agreement: Estimate


def lines_section(study: Study) -> Section:
    """l = 1, 3, 5, 7 lines a face, C and gamma held.

    Args:
        study: whose labels and test scenarios they are.

    Returns:
        The section.
    """
    points = [_of_lines(study, kind, lines) for lines in LINE_NUMBERS for kind in KINDS]
    return Section(
        key="lines",
        title="Lines a face",
        place="section 3-2",
        words=(
            "The thesis chose l = 3 as a compromise and tried no other. Labels are the stand-in's, "
            "with C and gamma as found for l = 3.",
        ),
        rows=tuple(Row(f"score, {p.series}, l = {p.at}", None, p.score) for p in points),
        tables=(
            Table(
                "Score and agreement",
                ("l", "version", "score", "same candidate"),
                tuple((p.at, p.series, p.score, p.agreement) for p in points),
            ),
        ),
        pictures=(
            Picture(
                "curve-lines",
                "Score over lines a face.",
                svg=curves(LINE_NUMBERS, _scores(points), "lines a face", "score"),
                alt="Curves of score over lines a face",
            ),
        ),
    )


def _of_lines(study: Study, kind: Kind, lines: int) -> _Point:
    tail = "" if lines == LINES else f"-{lines}"
    labels, tested = study.rows(f"labels{tail}"), study.rows(f"tested{tail}")
    variant = Variant(kind, "grid", lines)
    model_set = fit(labels.answered, variant, held(study, "grid"))
    return _Point(variant.version, lines, *judged(_curve_tested(study, tested), model_set))


def network_section(study: Study) -> Section:
    """A small neural network in place of the SVM: table 2-1 in figures.

    Args:
        study: whose labels and test scenarios they are.

    Returns:
        The section.
    """
    return Section(
        key="network",
        title="A neural network in place of the SVM",
        place="section 2-3, table 2-1",
        words=(
            "One hidden layer of 64 (ours; the thesis trained none), the same features, labels and "
            f"test scenarios. {NETWORKS} runs from different starts show what `convergence not "
            "ensured` means for decisions.",
        ),
        rows=tuple(row for kind in KINDS for row in _network_rows(study, kind)),
    )


def _network_rows(study: Study, kind: Kind) -> list[Row]:
    evaluation = study.evaluation("tested")
    variants = [Variant(kind, "grid", network=seed) for seed in range(NETWORKS)]
    version = variants[0].version
    networks = [
        Evaluation(
            evaluation.rows, {"network": fit(study.rows("labels").answered, v, held(study, "grid"))}
        )
        for v in variants
    ]
    picks = [own.picks("network") for own in networks]
    unlike = np.mean([(p != picks[0]).mean() for p in picks[1:]])
    rows = []
    for name, score, chosen in (
        ("SVM", evaluation.metrics(version).score, evaluation.picks(version)),
        ("network", networks[0].metrics("network").score, picks[0]),
    ):
        agree = _agreement(chosen, evaluation.rows)
        rows += [
            Row(f"score, {version}, {name}", None, mean(score)),
            Row(f"same candidate as the operator, {version}, {name}", None, agree),
        ]
    rows.append(
        Row(
            f"decisions that differ between two training runs, {version}, network",
            "not ensured to converge",
            round(float(unlike), 3),
            "0 for the SVM",
        )
    )
    return rows


def mirror_section(study: Study) -> Section:
    """What mirrored training scenes add, beside as many new ones.

    Args:
        study: whose labels and test scenarios they are.

    Returns:
        The section.
    """
    base, more = _as_given(study.rows("labels")), study.rows("more-labels")
    count = base.count
    sets = {
        f"{count} labels": base,
        f"{count} and their mirror images": joined([base, study.rows("mirrored")]),
        f"{2 * count} labels": joined([base, more.take(np.arange(more.count) < count)]),
    }
    rows = []
    for name, used in sets.items():
        for kind in KINDS:
            model_set = fit(used.answered, Variant(kind, "grid"), held(study, "grid"))
            score, agree = judged(study.rows("tested"), model_set)
            rows += [
                Row(f"score, {kind}-grid, {name}", None, score),
                Row(f"same candidate as the operator, {kind}-grid, {name}", None, agree),
            ]
    return Section(
        key="mirror",
        title="Mirrored training scenes",
        place="beyond the thesis",
        words=("Left and right exchanged, cast and labeled again by the stand-in.",),
        rows=tuple(rows),
    )


def curves_section(study: Study) -> Section:
    """Score and agreement over cell size and number of labels (future work, 6-1).

    Args:
        study: whose labels and test scenarios they are.

    Returns:
        The section.
    """
    sizes = sorted((*RESOLUTIONS_M, RESOLUTION_M["grid"]))
    data = _CurveData.of(study)
    counts = [n for n in LABELS if n <= data.labels.count]
    points = {(size, n): _of_cells(study, data, size, n) for size in sizes for n in counts}
    return Section(
        key="curves",
        title="Cell size and number of labels",
        place="section 6-1",
        words=(
            "Single SVM, dense samples of every cell in the half sphere, C held and gamma scaled "
            "by the number of features; the first 50 to 3,200 labels.",
        ),
        rows=tuple(
            Row(f"score, {p.series} cells, {p.at} labels", None, p.score)
            for p in points.values()
            if p.at in (800, counts[-1])
        ),
        tables=(
            Table(
                "Score and agreement",
                ("cells", "labels", "features", "score", "same candidate as the operator"),
                tuple(
                    (p.series, p.at, feature_count(size), p.score, p.agreement)
                    for (size, _), p in points.items()
                ),
            ),
        ),
        pictures=_curve_pictures(counts, list(points.values())),
    )


def _curve_pictures(counts: Sequence[int], points: Sequence[_Point]) -> tuple[Picture, Picture]:
    agreements = {
        name: [p.agreement for p in points if p.series == name] for name in _scores(points)
    }
    return (
        Picture(
            "curve-score",
            "Score over the number of labels, by cell size.",
            svg=curves(counts, _scores(points), "labels", "score", log_x=True),
            alt="Curves of score",
        ),
        Picture(
            "curve-agreement",
            "Agreement with the operator over the number of labels, by cell size.",
            svg=curves(counts, agreements, "labels", "same candidate", log_x=True),
            alt="Curves of agreement",
        ),
    )


def _scores(points: Sequence[_Point]) -> Mapping[str, list[Estimate]]:
    names = dict.fromkeys(p.series for p in points)
    return {name: [p.score for p in points if p.series == name] for name in names}


@dataclass(frozen=True, eq=False)
class _CurveData:
    """What the curves over cells and labels are made of; states by cell size, m."""

    labels: Rows
    tested: Rows
    labels_states: Mapping[float, Array]
    tested_states: Mapping[float, Array]

    @staticmethod
    def of(study: Study) -> _CurveData:
        labels, tested = all_labels(study), _curve_tested(study, study.rows("tested"))
        first, more, asked = (_dense(study, name) for name in ("labels", "more-labels", "tested"))
        size = RESOLUTION_M["grid"]  # that every row has
        return _CurveData(
            labels,
            tested,
            {s: np.concatenate((first[s], more[s])) for s in first} | {size: labels["given_grid"]},
            {**asked, size: tested["given_grid"]},
        )


def _of_cells(study: Study, data: _CurveData, size_m: float, count: int) -> _Point:
    """The point of a cell size and the first `count` labels; what is predicted is kept."""
    name = f"curves/{round(1000 * size_m)}mm-{count}.json"
    if not study.store.exists(name):
        predicted = _predicted(study, data, size_m, count)
        study.store.write(name, json.dumps(predicted.tolist()).encode())
    picks = np.array(json.loads(study.store.read(name))) - 1
    score = mean(metrics_of(data.tested, "given", picks).score)
    return _Point(f"{100 * size_m:.0f} cm", count, score, _agreement(picks, data.tested))


def _predicted(study: Study, data: _CurveData, size_m: float, count: int) -> Array:
    C, gamma = held(study, "grid")["single"]
    # Distances grow with the number of features; so that a held gamma stays the same width, it is
    # scaled by it.
    gamma *= feature_count(RESOLUTION_M["grid"]) / feature_count(size_m)
    edge = largest_edge_m(data.labels)
    first = data.labels.take(np.arange(data.labels.count) < count)
    return dense_predictions(
        _features(data.labels_states[size_m][:count], first, edge),
        first["label"],
        _features(data.tested_states[size_m][: data.tested.count], data.tested, edge),
        (C, gamma),
    )


def _features(states: Array, rows: Rows, edge_m: float) -> Points:
    return single_features(occupancy_of(states), rows["given_dimensions_m"], edge_m)


def feature_count(size_m: float) -> int:
    """Features of a single model at a cell size.

    Args:
        size_m: of a cell, m.

    Returns:
        How many.
    """
    return len(grid(size_m)) + len(DIMENSIONS)


def all_labels(study: Study) -> Rows:
    """The labeled rows of the study and the further ones, as given.

    Args:
        study: whose they are.

    Returns:
        One after the other.
    """
    return joined([_as_given(study.rows("labels")), study.rows("more-labels")])


def _as_given(rows: Rows) -> Rows:
    return Rows({name: rows[name] for name in rows if not name.startswith("found")})


def _curve_tested(study: Study, tested: Rows) -> Rows:
    return tested.take(np.arange(tested.count) < study.scale.curve_tested)


def _agreement(picks: Array, rows: Rows) -> Estimate:
    same = picks == rows["label"] - 1
    return share(int(same.sum()), len(same))


def _dense(study: Study, name: str) -> dict[float, Array]:
    config = study.sets()[name]
    count = min(config.count, study.scale.curve_tested) if name == "tested" else config.count
    tasks = {
        f"dense/{name}/{first // PART_ROWS:05d}.npz": (
            config.rows, range(first, min(first + PART_ROWS, count)),
        )
        for first in range(0, count, PART_ROWS)
    }  # fmt: skip
    finish(study.store, tasks, dense_part, study.workers, f"dense {name}")
    return read_dense([study.store.read(part) for part in tasks])
