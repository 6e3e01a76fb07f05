"""A stand-in for the thesis's robot tests (3-5-2, 4-3, 5-2-3, 5-2-4): noise and decisions."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np

from boxgrasp.execution import finish
from boxgrasp.grasps.candidates import FACES
from boxgrasp.study.evaluation import Evaluation, order
from boxgrasp.study.intervals import difference, mean, share
from boxgrasp.study.plots import category_shares
from boxgrasp.study.report import Picture, Row, Section, Table
from boxgrasp.study.running import read_running, running_part
from boxgrasp.study.sections.need import CASCADE
from boxgrasp.study.study import Study

VARIANTS = {
    "real": "one frame, every second point",
    "real-every-point": "one frame, every point",
    "real-fused": "ten frames fused, every second point",
}
RUNNING = {
    "xtion": "one map that runs on, an Xtion's noise",
    "strong": "one map that runs on, strong noise",
}
WRONG_BOX_M = 0.015
_PART = 3


def real_section(study: Study) -> Section:
    """Scores under strong noise and without, and how often the decision changes."""
    evaluation, clean = study.evaluation("real"), study.evaluation("real-clean")
    runs = study.scale.runs
    score = evaluation.metrics(CASCADE).score
    by_scene = score.reshape(-1, runs).mean(axis=1)
    simulated = study.evaluation("tested").metrics(CASCADE).score
    rows = [
        Row("score, 42 scenes, strong noise", 0.86, mean(by_scene)),
        Row("score, the same scenes without noise", None, mean(clean.metrics(CASCADE).score)),
        Row("score, simulation tests", 0.84, mean(simulated)),
        Row(
            "score, noisy less clean, same scenes",
            0.02,
            difference(by_scene, clean.metrics(CASCADE).score),
            "the thesis compares different scenes",
        ),
        Row(
            "unobstructed, all runs",
            "more than 0.90",
            share(
                int(evaluation.metrics(CASCADE).unobstructed[::runs].sum()),
                evaluation.rows.count // runs,
            ),
            "of each scene the first run",
        ),
    ]
    tables = []
    for name, words in VARIANTS.items():
        own = study.evaluation(name)
        for target_source, who in (("given", "given"), ("found", "found by the package")):
            if f"{target_source}_passes" not in own.rows:
                continue
            changing = changed_scenes(own, runs, target_source)
            theirs = "2 of 42" if (name, target_source) == ("real", "given") else None
            rows.append(
                Row(
                    f"scenes whose decision changes: {words}, target {who}",
                    theirs,
                    f"{len(changing)} of {own.rows.count // runs}",
                )
            )
            if target_source == "given":
                tables.append(
                    Table(
                        f"Decisions that change: {words}",
                        ("scene", "target", "decisions in ten runs", "cells that flip", "why"),
                        tuple(why(own, runs, k) for k in changing),
                    )
                )
    for noise, words in RUNNING.items():
        unsteady, count = changed_running(study, noise)
        rows.append(
            Row(f"scenes whose decision changes: {words}", "2 of 42", f"{unsteady} of {count}")
        )
    if study.scale.full:
        once = study.evaluation("real-once").metrics(CASCADE)
        rows += [
            Row(f"score, {len(once.score)} scenes once, strong noise", 0.86, mean(once.score)),
            Row(
                f"unobstructed, {len(once.score)} scenes once",
                "more than 0.90",
                share(int(once.unobstructed.sum()), len(once.score)),
            ),
        ]
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
        rows=tuple(rows),
        tables=tuple(tables),
        pictures=(
            Picture(
                "figure-4-10",
                "Cascade grid in the simulation tests and in the stand-in for real ones (4-10).",
                svg=category_shares(
                    ("simulation", "stand-in for real"),
                    (
                        study.evaluation("tested").categories(CASCADE),
                        evaluation.categories(CASCADE),
                    ),
                ),
                alt="Shares of red, yellow and green picks",
            ),
        ),
    )


def changed_scenes(evaluation: Evaluation, runs: int, target_source: str = "given") -> list[int]:
    """Which scenarios get more than one decision of cascade grid over their runs."""
    picks = evaluation.picks(CASCADE, target_source).reshape(-1, runs)
    return [int(k) for k in np.flatnonzero((picks != picks[:, :1]).any(axis=1))]


def changed_running(study: Study, noise: str) -> tuple[int, int]:
    """How many scenarios get more than one decision from a map that runs on, and of how many."""
    base = study.sets()["real"].rows
    config = replace(base, recipe=replace(base.recipe, noise=noise))
    count = study.scale.real
    tasks = {
        f"running/{noise}-{k // _PART:05d}.npz": (config, range(k, min(k + _PART, count)))
        for k in range(0, count, _PART)
    }
    finish(study.store, tasks, running_part, study.workers, f"running map, {noise}")
    rows = read_running([study.store.read(name) for name in tasks])
    picks = order(study.model_sets[CASCADE], rows, "given")[:, 0].reshape(count, -1)
    return int((picks != picks[:, :1]).any(axis=1).sum()), count


def why(evaluation: Evaluation, runs: int, scene: int) -> tuple[int, str, str, int, str]:
    """One changing scene: what was decided how often, and what differed."""
    which = slice(scene * runs, (scene + 1) * runs)
    rows = evaluation.rows
    picks = evaluation.picks(CASCADE)[which]
    common, _ = Counter(picks.tolist()).most_common(1)[0]
    odd = picks != common
    cells = rows["given_grid"][which]
    usual = cells[np.flatnonzero(~odd)[0]]
    flipped = int(np.median((cells[odd] != usual).sum(axis=1)))
    boxes = rows["given_dimensions_m"][which]
    jump = float(np.abs(boxes[odd] - np.median(boxes[~odd], axis=0)).max())
    moved = float(
        np.abs(
            rows["given_box"][which][odd][:, :3]
            - np.median(rows["given_box"][which][~odd][:, :3], axis=0)
        ).max()
    )
    worst = max(jump, moved)
    reason = (
        f"the box is off by {100 * worst:.1f} cm"
        if worst > WRONG_BOX_M
        else f"cells flipped, the box within {1000 * worst:.0f} mm"
    )
    said = Counter(f"{FACES[k // 3]}, line {k % 3 + 1}" for k in picks.tolist())
    words = "; ".join(f"{name} ({count})" for name, count in said.most_common())
    return scene, str(rows["target"][which][0]), words, flipped, reason
