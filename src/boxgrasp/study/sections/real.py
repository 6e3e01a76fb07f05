"""A stand-in for the thesis's robot tests (3-5-2, 4-3, 5-2-3, 5-2-4): noise and decisions."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Floats
from boxgrasp.execution import finish
from boxgrasp.grasps.candidates import FACES, LINES
from boxgrasp.study.evaluation import Evaluation, first_choice, model_order
from boxgrasp.study.intervals import difference, mean, share
from boxgrasp.study.report import Picture, Row, Section, Table
from boxgrasp.study.running import read_running, running_part
from boxgrasp.study.sections.baselines import WAYS, baseline_rows, categories_both_ways
from boxgrasp.study.sections.need import CASCADE
from boxgrasp.study.study import Study
from boxgrasp.teaching.sets import Rows

VARIANTS = {
    "real": "one frame, every second point",
    "real-every-point": "one frame, every point",
    "real-fused": "ten frames fused, every second point",
}
RUNNING = {
    "xtion": "one map that runs on, an Xtion's noise",
    "strong": "one map that runs on, strong noise",
}
SOURCES = {"given": "given", "found": "found by the package"}
WRONG_BOX_M = 0.015
_PART = 3


def real_section(study: Study) -> Section:
    """Scores under strong noise and without, and how often the decision changes.

    Args:
        study: whose scenes they are.

    Returns:
        The section.
    """
    return Section(
        key="real",
        title="The real world, by a stand-in",
        place="sections 3-5-2, 4-3, 5-2-3, 5-2-4; figure 4-10",
        words=(
            "No robot and no real table: simulated scenes of the thesis's five real objects with "
            "mug and wooden bar, seen by a sensor with strong noise. The models were trained on "
            "the simulated objects alone. Each scene is seen ten times with noise drawn anew.",
            "A decision here rests on one frame, or on ten frames of its own. The thesis's map ran "
            "on: each decision read what all frames before had left in it, which steadies it most. "
            "That is done too, the map begun five frames before the first decision.",
        ),
        rows=(
            *_score_rows(study),
            *_change_rows(study),
            *_running_rows(study),
            *(_once_rows(study) if study.scale.full else ()),
        ),
        tables=_change_tables(study),
        pictures=(_picture(study),),
    )


def _score_rows(study: Study) -> list[Row]:
    runs, real = study.scale.runs, study.evaluation("real")
    rows: list[Row] = []

    def by_scene(values: Floats) -> Floats:
        return np.asarray(values.reshape(-1, runs).mean(axis=1))

    for way, name in WAYS.items():
        noisy = by_scene(getattr(real.metrics(CASCADE), name))
        clean = getattr(study.evaluation("real-clean").metrics(CASCADE), name)
        simulated = getattr(study.evaluation("tested").metrics(CASCADE), name)
        rows += [
            Row(f"{way}, 42 scenes, strong noise", 0.86, mean(noisy)),
            *baseline_rows(real, way, averaged=by_scene),
            Row(f"{way}, the same scenes without noise", None, mean(clean)),
            Row(f"{way}, simulation tests", 0.84, mean(simulated)),
            Row(
                f"{way}, noisy less clean, same scenes",
                0.02,
                difference(noisy, clean),
                "the thesis compares different scenes",
            ),
        ]
    first = real.metrics(CASCADE).unobstructed[::runs]
    return [
        *rows,
        Row(
            "unobstructed, all runs",
            "more than 0.90",
            share(int(first.sum()), len(first)),
            "of each scene the first run",
        ),
    ]


def _change_rows(study: Study) -> list[Row]:
    rows, runs = [], study.scale.runs
    for name, words in VARIANTS.items():
        own = study.evaluation(name)
        for source, who in SOURCES.items():
            if f"{source}_passes" not in own.rows:
                continue
            changing = changed_scenes(own, runs, source)
            rows.append(
                Row(
                    f"scenes whose decision changes: {words}, target {who}",
                    "2 of 42" if (name, source) == ("real", "given") else None,
                    f"{len(changing)} of {own.rows.count // runs}",
                )
            )
    return rows


def _change_tables(study: Study) -> tuple[Table, ...]:
    runs = study.scale.runs
    evaluations = {words: study.evaluation(name) for name, words in VARIANTS.items()}
    return tuple(
        Table(
            f"Decisions that change: {words}",
            ("scene", "target", "decisions in ten runs", "cells that flip", "why"),
            tuple(why(own, runs, k) for k in changed_scenes(own, runs)),
        )
        for words, own in evaluations.items()
    )


def _running_rows(study: Study) -> list[Row]:
    rows = []
    for noise, words in RUNNING.items():
        unsteady, count = changed_running(study, noise)
        changes = f"{unsteady} of {count}"
        rows.append(Row(f"scenes whose decision changes: {words}", "2 of 42", changes))
    return rows


def _once_rows(study: Study) -> list[Row]:
    once = study.evaluation("real-once").metrics(CASCADE)
    count = len(once.score)
    clear = share(int(once.unobstructed.sum()), count)
    return [
        Row(f"score, {count} scenes once, strong noise", 0.86, mean(once.score)),
        Row(f"unobstructed, {count} scenes once", "more than 0.90", clear),
    ]


def _picture(study: Study) -> Picture:
    sets = {"simulation": "tested", "stand-in for real": "real"}

    def counts_of(name: str, any_width: bool) -> tuple[int, int, int]:
        return study.evaluation(sets[name]).category_counts(CASCADE, any_width=any_width)

    return Picture(
        "figure-4-10",
        "Cascade grid in the simulation tests and in the stand-in for real ones (4-10).",
        svg=categories_both_ways(tuple(sets), counts_of),
        alt="Shares of red, yellow and green picks",
    )


def changed_scenes(evaluation: Evaluation, runs: int, target_source: str = "given") -> list[int]:
    """Which scenarios get more than one decision of cascade grid over their runs.

    Args:
        evaluation: of a set whose scenarios are seen several times.
        runs: how often.
        target_source: `given` or `found`.

    Returns:
        Numbers of the scenarios.
    """
    picks = evaluation.picks(CASCADE, target_source).reshape(-1, runs)
    return [int(k) for k in np.flatnonzero((picks != picks[:, :1]).any(axis=1))]


def changed_running(study: Study, noise: str) -> tuple[int, int]:
    """How often decisions change that read a map that runs on.

    Args:
        study: whose scenes they are.
        noise: of the sensor.

    Returns:
        How many scenarios get more than one decision, and of how many.

    Raises:
        StoreError: the study's place cannot be read or written.
    """
    base = study.sets()["real"].rows
    config = replace(base, recipe=replace(base.recipe, noise=noise))
    count = study.scale.real
    tasks = {
        f"running/{noise}-{k // _PART:05d}.npz": (config, range(k, min(k + _PART, count)))
        for k in range(0, count, _PART)
    }
    finish(study.store, tasks, running_part, study.workers, f"running map, {noise}")
    rows = read_running([study.store.read(name) for name in tasks])
    ordered = model_order(study.model_sets[CASCADE], rows, "given")
    picks = first_choice(ordered).reshape(count, -1)
    return int((picks != picks[:, :1]).any(axis=1).sum()), count


def why(evaluation: Evaluation, runs: int, scene: int) -> tuple[int, str, str, int, str]:
    """One changing scene: what was decided how often, and what differed.

    Args:
        evaluation: of a set whose scenarios are seen several times.
        runs: how often.
        scene: number of the scenario.

    Returns:
        Its number, target, decisions, how many cells flipped, and why.
    """
    which = np.arange(scene * runs, (scene + 1) * runs)
    rows = evaluation.rows.take(which)
    picks = evaluation.picks(CASCADE)[which]
    common, _ = Counter(picks.tolist()).most_common(1)[0]
    odd = picks != common
    cells = rows["given_grid"]
    usual = cells[np.flatnonzero(~odd)[0]]
    flipped = int(np.median((cells[odd] != usual).sum(axis=1)))
    worst = _box_off_m(rows, odd)
    reason = (
        f"the box is off by {100 * worst:.1f} cm"
        if worst > WRONG_BOX_M
        else f"cells flipped, the box within {1000 * worst:.0f} mm"
    )
    said = Counter(f"{FACES[k // LINES]}, line {k % LINES + 1}" for k in picks.tolist())
    words = "; ".join(f"{name} ({count})" for name, count in said.most_common())
    return scene, str(rows["target"][0]), words, flipped, reason


def _box_off_m(rows: Rows, odd: NDArray[np.bool_]) -> float:
    """How far the boxes of odd decisions are off those of the others, in size or place."""
    boxes, places = rows["given_dimensions_m"], rows["given_box"][:, :3]
    jump = float(np.abs(boxes[odd] - np.median(boxes[~odd], axis=0)).max())
    moved = float(np.abs(places[odd] - np.median(places[~odd], axis=0)).max())
    return max(jump, moved)
