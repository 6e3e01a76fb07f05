"""Sections 3-5-2, 4-3, 5-2-3, 5-2-4, chapter 6: the stand-in for the robot's tests, its noise."""

from __future__ import annotations

import warnings

import numpy as np

from boxgrasp.arrays import Array, Bools, Floats
from boxgrasp.ranking.sampling import RESOLUTION_M, sampling
from boxgrasp.study.answers.figures import (
    Answer,
    Answers,
    Figures,
    green,
    mean_like,
    more_often,
    share_of,
)
from boxgrasp.study.evaluation import obstacle_counts
from boxgrasp.study.intervals import less, mean, share
from boxgrasp.study.sections.need import CASCADE
from boxgrasp.study.sections.real import WRONG_BOX_M, changed_running, changed_scenes

_TALL = "crisps"


def _changes(figures: Figures, name: str = "real", target_source: str = "given") -> Bools:
    """(scenes,) whether the decision changes over the runs."""
    evaluation, runs = figures.study.evaluation(name), figures.study.scale.runs
    found = np.zeros(evaluation.rows.count // runs, dtype=bool)
    found[changed_scenes(evaluation, runs, target_source)] = True
    return found


def _half_cloud(figures: Figures) -> Answer:
    every, half = _changes(figures, "real-every-point"), _changes(figures)
    return Answer(
        more_often(every, half),
        "scenes whose decision changes with every point, less with every second; one frame each",
    )


def _scores(figures: Figures) -> Floats:
    if figures.study.scale.full:
        return figures.real_once.metrics(CASCADE).score
    return figures.by_scene(figures.real.metrics(CASCADE).score)


def _alike(figures: Figures) -> Answer:
    """Real less simulation, the simulated scenes weighted to the real ones' obstacle counts."""
    wanted, scores = obstacle_counts(figures.real_once.rows), _scores(figures)
    simulated = figures.tested.metrics(CASCADE).score
    like = mean_like(simulated, obstacle_counts(figures.tested.rows), wanted)
    return Answer(
        less(mean(scores), like),
        f"stand-in {np.nanmean(scores):.3f}, simulation {like.value or 0.0:.3f} weighted to the "
        f"same numbers of obstacles (on average {wanted.mean():.1f}), "
        f"{np.nanmean(simulated):.3f} as it is. The objects differ too, as the thesis's did.",
    )


def _running_changes(figures: Figures) -> Answer:
    found = {noise: changed_running(figures.study, noise) for noise in ("strong", "xtion")}
    alone = _changes(figures)
    return Answer(
        share(*found["strong"]),
        "one map that runs on, as the thesis's did, under strong noise; under an Xtion's "
        f"{found['xtion'][0]} of {found['xtion'][1]}; each decision from one frame alone "
        f"{int(alone.sum())} of {len(alone)}",
    )


def _grids(figures: Figures) -> tuple[Array, Array]:
    """(scenes, runs, 184) cells under noise, and (scenes, 184) without."""
    runs, clean = figures.study.scale.runs, figures.real_clean.rows["given_grid"]
    return figures.real.rows["given_grid"].reshape(len(clean), runs, -1), clean


def _map_alike(figures: Figures) -> Answer:
    noisy, clean = _grids(figures)
    same = (noisy == clean[:, None]).mean(axis=(1, 2))
    return Answer(
        mean(same), "cells of 7 cm that read the same with strong noise and without, same scenes"
    )


def _flips_at_borders(figures: Figures) -> Answer:
    """Cells with a neighbor of another state flip more often than the others."""
    noisy, clean = _grids(figures)
    points = sampling("grid")
    away = np.linalg.norm(points[:, None] - points[None], axis=2)
    beside = (away > 0) & (away < 1.01 * RESOLUTION_M["grid"])
    flips = (noisy != noisy[:, :1]).any(axis=1)
    border = np.array([(beside & (cells[:, None] != cells[None])).any(axis=1) for cells in clean])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a scene without a border is NaN
        at, others = (np.where(which, flips, np.nan) for which in (border, ~border))
        rates = np.nanmean(at, axis=1), np.nanmean(others, axis=1)
    return Answer(
        more_often(*rates),
        "share of cells that flip between runs, beside another state less elsewhere",
    )


def _flips_cluttered(figures: Figures) -> Answer:
    changing, counts = _changes(figures), obstacle_counts(figures.real_clean.rows)
    bounds = (0.0, float(counts.max()))
    return Answer(
        less(mean(counts[changing], bounds), mean(counts[~changing], bounds)),
        "obstacles of the scenes whose decision changes, less of the others; one frame each",
    )


def _flips_harmless(figures: Figures) -> Answer:
    noisy, clean = _grids(figures)
    other = (noisy != clean[:, None]).any(axis=2)
    runs = figures.study.scale.runs
    same = (
        figures.real.picks(CASCADE).reshape(-1, runs) == figures.real_clean.picks(CASCADE)[:, None]
    )
    shares = [float(s[o].mean()) for s, o in zip(same, other, strict=True) if o.any()]
    return Answer(
        mean(shares), "decisions as without noise, of the runs whose cells differ from it"
    )


def _one_voxel(figures: Figures) -> Answer:
    noisy, _ = _grids(figures)
    picks = figures.real.picks(CASCADE).reshape(noisy.shape[:2])
    fewest: list[int] = []
    for cells, own in zip(noisy, picks, strict=True):
        a, b = np.nonzero(own[:, None] != own[None])
        flipped = (cells[a] != cells[b]).sum(axis=1)
        fewest += flipped[flipped > 0].tolist()
    return Answer(
        min(fewest) if fewest else None,
        "fewest cells between two runs of a scene with different decisions"
        if fewest
        else "no decision changed here",
    )


def _tall_steady(figures: Figures) -> Answer:
    tall = np.char.startswith(figures.real_clean.rows["target"].astype(str), _TALL)
    changing = _changes(figures)
    return Answer(
        less(share_of(changing, ~tall), share_of(changing, tall)),
        "scenes whose decision changes, other targets less the crisps tube; one frame each",
    )


def _changes_box(figures: Figures) -> Answer:
    runs = figures.study.scale.runs
    boxes = figures.real.rows["found_dimensions_m"].reshape(-1, runs, 3)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a target that is never found is NaN
        jump = (np.nanmax(boxes, axis=1) - np.nanmin(boxes, axis=1)).max(axis=1)
    wrong = _changes(figures, target_source="found") & (jump > WRONG_BOX_M)
    return Answer(
        share_of(wrong),
        "scenes whose decision changes and whose box varies by more than 1.5 cm, target found by "
        "the package. The thesis's own segmentation is in the section on appendix A.",
    )


def _changes_cells(figures: Figures) -> Answer:
    ours, _ = _running_changes(figures)
    return Answer(ours, "target points given, so that cells alone vary; one map that runs on")


ANSWERS: Answers = {
    "half-cloud": _half_cloud,
    "real-score": lambda f: Answer(mean(_scores(f))),
    "real-alike": _alike,
    "real-changes": _running_changes,
    "map-alike": _map_alike,
    "flips-at-borders": _flips_at_borders,
    "flips-cluttered": _flips_cluttered,
    "flips-harmless": _flips_harmless,
    "one-voxel": _one_voxel,
    "tall-steady": _tall_steady,
    "real-changes-cells": _changes_cells,
    "real-changes-box": _changes_box,
    "clear-real": lambda f: Answer(
        share_of(f.real_once.metrics(CASCADE).unobstructed), "cascade grid in the stand-in"
    ),
    "safe-real": lambda f: Answer(
        share_of(green(f.real_once, CASCADE)), "cascade grid in the stand-in, green"
    ),
}
