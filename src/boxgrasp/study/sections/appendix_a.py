"""Appendix A's own order on the study's scenes: what each stage keeps, and figure 5-6's failure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from boxgrasp.arrays import Array, Bools, Floats
from boxgrasp.draw.palette import HELD
from boxgrasp.execution import finish
from boxgrasp.geometry.transforms import transform
from boxgrasp.grasps.candidates import FACES, LINES, candidates_of
from boxgrasp.grasps.gripper import Gripper
from boxgrasp.study.appendix_a import AppendixParams
from boxgrasp.study.appendix_rows import (
    COUNTED,
    LEFT_AFTER,
    NOT_COUNTED,
    appendix_part,
    read_appendix,
    segmented_view,
)
from boxgrasp.study.evaluation import Evaluation, first_choice, model_order
from boxgrasp.study.intervals import Estimate, difference, mean
from boxgrasp.study.metrics import ASK
from boxgrasp.study.plots.stages import BoxPanel, Panel, boxes, clouds
from boxgrasp.study.report import Cell, Picture, Row, Section, Table
from boxgrasp.study.sections.need import CASCADE
from boxgrasp.study.sections.real import WRONG_BOX_M
from boxgrasp.study.study import Study
from boxgrasp.teaching.rows import box_of, scenario_of_row
from boxgrasp.teaching.sets import Rows

SETS: Final = {"tested": "simulation tests", "real": "stand-in for real, strong noise"}
FATES: Final = ("whole", "too short", "merged", "otherwise wrong", "lost")
FOREIGN_SHARE: Final = 0.05  # of a cluster's points, other things', from which it is a merged one
ROUND_TABLE_M: Final = 0.3  # that figure A-1 shows; the floor behind lies farther off
_PART_VIEWS = 30  # a task: some ten seconds
_WORDS = (
    "The package finds objects in a way of its own; this is appendix A's, in its order: the "
    "pass-through by distance on the points, centroids of voxels, the plane that holds most, "
    "outliers of table and rest trimmed, clusters, and the one chosen that has most of the "
    "target's points. The map is made of all points of the view, as the thesis's was, so the box "
    "alone differs from the other sections'. Each decision rests on one frame.",
)
_OURS = (
    "Ours, as the thesis does not print them: the plane's tolerance of {plane_m} m and its "
    "{plane_tries} tries, k = {neighbors} and n = {deviations:g} of the trimming (a point goes "
    "whose mean distance to its k nearest ones is over the mean of these by n standard "
    "deviations; the values of PCL's tutorial), clusters of {fewest} points and more. The box "
    "stands on the plane found."
)


@dataclass(frozen=True, eq=False)
class _Views:
    """A set's views, segmented; V of them, R a scene.

    Attributes:
        evaluation: its rows beside those of the sources `appendix` and `exact`.
        runs: R.
    """

    evaluation: Evaluation
    runs: int

    @property
    def rows(self) -> Rows:
        """Columns of the views."""
        return self.evaluation.rows

    def by_scene(self, flags: Array) -> Estimate:
        """The share of views for which something holds; a scene counts once.

        Args:
            flags: (V,) bool.

        Returns:
            The mean over the scenes.
        """
        return mean(np.asarray(flags, np.float64).reshape(-1, self.runs).mean(axis=1))

    def wrong(self, stage: int = -1) -> Bools:
        """(V,) whether the box is off by over 1.5 cm, in size or place, or missing.

        Args:
            stage: of `LEFT_AFTER`.

        Returns:
            Whether it is.
        """
        short, moved = (
            np.abs(self.rows[f"appendix_{n}"][:, stage]) for n in ("short_m", "moved_m")
        )
        return np.asarray(~(np.maximum(short, moved).max(axis=1) <= WRONG_BOX_M))  # NaN is wrong

    def short(self, stage: int = -1) -> Bools:
        """(V,) whether a side of the box is too short by over 1.5 cm.

        Args:
            stage: of `LEFT_AFTER`.

        Returns:
            Whether it is.
        """
        return np.asarray((self.rows["appendix_short_m"][:, stage] > WRONG_BOX_M).any(axis=1))


def appendix_section(study: Study) -> Section:
    """How often the thesis's own segmentation finds the target whole, and what follows.

    Args:
        study: whose scenes they are.

    Returns:
        The section.

    Raises:
        StoreError: the study's place cannot be read or written.
        WorkError: workers were lost.
        MissingExtraError: scipy or matplotlib is not installed.
    """
    views = {name: _views(study, name) for name in SETS}
    params = AppendixParams()
    return Section(
        key="appendix-a",
        title="Segmentation as in appendix A",
        place="appendix A, figures A-1 to A-3; section 5-2-4, figure 5-6",
        words=(*_WORDS, _OURS.format(**vars(params)), _fate_words()),
        rows=_decision_rows(views["real"]),
        tables=(
            _fate_table(views),
            _points_table(views),
            _short_table(views),
            _misled_table(views["real"]),
        ),
        pictures=(
            *_stage_pictures(study, views["real"]),
            *_figure_5_6(study, views["real"]),
        ),
    )


def _fate_words() -> str:
    return (
        f"A target is whole where its box is within {100 * WRONG_BOX_M:.1f} cm of the true one, in "
        "every side's length and in its middle's place; too short where it is not and a side is "
        f"shorter by more; merged where over {100 * FOREIGN_SHARE:.0f} % of the chosen cluster's "
        "points are another thing's; lost where no cluster has any of it. Scenes seen ten times "
        "count once."
    )


def _views(study: Study, name: str) -> _Views:
    config = study.sets()[name].rows
    count = min(study.scale.first, study.sets()[name].count // config.runs)
    step = max(1, _PART_VIEWS // config.runs)
    tasks = {
        f"appendix-a/{name}-{k:05d}.npz": (config, range(k, min(k + step, count)))
        for k in range(0, count, step)
    }
    finish(study.store, tasks, appendix_part, study.workers, f"appendix A, {name}")
    columns = read_appendix([study.store.read(part) for part in tasks])
    rows = study.rows(name).take(np.arange(count * config.runs))
    return _Views(Evaluation(Rows({**rows.columns, **columns}), study.model_sets), config.runs)


def fates(views: _Views) -> Array:
    """What became of the target in each view.

    Args:
        views: of a set.

    Returns:
        (V,) indices of `FATES`.
    """
    lost = views.rows["appendix_error"] != ""
    merged = views.rows["appendix_foreign"] > FOREIGN_SHARE
    wrong, short = views.wrong(), views.short()
    kinds = [lost, ~wrong, merged, short]
    numbers = [FATES.index(name) for name in ("lost", "whole", "merged", "too short")]
    return np.select(kinds, numbers, FATES.index("otherwise wrong"))


def _fate_table(views: Mapping[str, _Views]) -> Table:
    found = [(own, fates(own)) for own in views.values()]
    lines: list[tuple[Cell, ...]] = [
        (fate, *(own.by_scene(fate_of == k) for own, fate_of in found))
        for k, fate in enumerate(FATES)
    ]
    lines.append(
        ("whole by all its points in the view", *(own.by_scene(~own.wrong(0)) for own, _ in found))
    )
    return Table("What becomes of the target", ("target", *SETS.values()), tuple(lines))


def _decision_rows(own: _Views) -> tuple[Row, ...]:
    evaluation, runs = own.evaluation, own.runs
    score, usual = (
        evaluation.metrics(CASCADE, s).score.reshape(-1, runs) for s in ("appendix", "given")
    )
    scores = _scene_means(score), _scene_means(usual)
    misled = misled_views(own)
    scenes, of = misled.reshape(-1, runs).any(axis=1), len(score)
    return (
        Row("scenes whose decision changes, appendix A", "2 of 42", _changing(own, "appendix")),
        Row(
            "scenes whose decision changes, the true box in the same maps",
            None,
            _changing(own, "exact"),
        ),
        Row("scenes whose decision changes, points given", None, _changing(own, "given")),
        Row(
            "scenes whose decision changes as the box is too short in some runs (figure 5-6)",
            "1 of 42",
            f"{len(changed_by_the_box(own))} of {of}",
        ),
        Row(
            "scenes decided otherwise than in the true box, the box too short",
            None,
            f"{int(scenes.sum())} of {of}",
            "in any run",
        ),
        Row(
            "views decided otherwise than in the true box, the box too short",
            None,
            own.by_scene(misled),
        ),
        Row("score of cascade grid, appendix A", 0.86, mean(scores[0])),
        Row("score, appendix A less points given, same scenes", None, difference(*scores)),
    )


def _changing(views: _Views, source: str) -> str:
    """How many scenes get more than one decision over their runs."""
    picks = _picks(views, source).reshape(-1, views.runs)
    return f"{int((picks != picks[:, :1]).any(axis=1).sum())} of {len(picks)}"


def _scene_means(score: Floats) -> Floats:
    """(S,) over the runs that were answered; NaN where none was."""
    count = (~np.isnan(score)).sum(axis=1)
    total = np.nansum(score, axis=1)
    means: Floats = np.divide(total, count, out=np.full(len(score), np.nan), where=count > 0)
    return means


def _picks(views: _Views, source: str) -> Array:
    """(V,) what cascade grid picks in a source's box, in the same map."""
    if source != "exact":
        return views.evaluation.picks(CASCADE, source)
    # No set has this source, so no evaluation knows which of its rows are answered: all are.
    return first_choice(model_order(views.evaluation.model_sets[CASCADE], views.rows, source))


def misled_views(views: _Views) -> Bools:
    """Where the box is too short and the decision another than in the true box, in the same map.

    Args:
        views: of a set.

    Returns:
        (V,) bool.
    """
    picks = _picks(views, "appendix")
    return np.asarray(views.short() & (picks != ASK) & (picks != _picks(views, "exact")))


def changed_by_the_box(views: _Views) -> list[int]:
    """Scenes like figure 5-6's: misled in a run, and decided otherwise where the box is not short.

    Args:
        views: of scenes that are seen several times.

    Returns:
        Numbers of the scenes.
    """
    picks = _picks(views, "appendix").reshape(-1, views.runs)
    short = views.short().reshape(-1, views.runs)
    misled = misled_views(views).reshape(-1, views.runs)
    return [
        k
        for k in range(len(picks))
        if not short[k].all()
        and (misled[k] & (picks[k] != Counter(picks[k][~short[k]]).most_common(1)[0][0])).any()
    ]


def _points_table(views: Mapping[str, _Views]) -> Table:
    lines: list[tuple[Cell, ...]] = []
    for k, stage in enumerate(COUNTED):
        counts = [own.rows["appendix_points"][:, k] for own in views.values()]
        medians = [int(np.median(c[c != NOT_COUNTED])) for c in counts]
        lines.append((stage, *medians))
    clusters = [int(np.median(own.rows["appendix_clusters"])) for own in views.values()]
    lines.append(("clusters", *clusters))
    return Table(
        "Points that each stage keeps, median view", ("stage", *SETS.values()), tuple(lines)
    )


def _short_table(views: Mapping[str, _Views]) -> Table:
    """By the first stage after which the target's own points make too short a box."""
    names = (
        "not seen in the view",
        "beyond 1.6 m, or by the voxels",
        "taken for the table",
        "trimmed",
        "in another cluster",
    )
    lines = []
    for own in views.values():
        short = np.array([own.short(k) for k in range(len(LEFT_AFTER))])
        first = Counter(short[:, short[-1]].argmax(axis=0).tolist())
        lines.append([first[k] for k in range(len(LEFT_AFTER))])
    counts: list[tuple[Cell, ...]] = list(zip(names, *lines, strict=True))
    counts.append(("any", *(sum(line) for line in lines)))
    return Table(
        "Views whose box is too short, by the stage that made it so",
        ("why", *SETS.values()),
        tuple(counts),
    )


def _misled_table(views: _Views) -> Table:
    misled = misled_views(views).reshape(-1, views.runs)
    own, exact = (_picks(views, s).reshape(misled.shape) for s in ("appendix", "exact"))
    lines = []
    for scene in np.flatnonzero(misled.any(axis=1)).tolist():
        k = scene * views.runs + int(misled[scene].argmax())
        short_m = views.rows["appendix_short_m"][k, -1]
        lines.append(
            (
                scene,
                str(views.rows["target"][k]),
                int(misled[scene].sum()),
                _said(own[scene]),
                _said(exact[scene]),
                f"{100 * short_m.max():.1f} cm along {'xyz'[int(short_m.argmax())]}",
            )
        )
    columns = ("scene", "target", "runs misled", "decisions", "in the true box", "too short by")
    return Table("Decisions that a box too short misled", columns, tuple(lines))


def _said(picks: Array) -> str:
    counts = Counter(_named(pick) for pick in picks.tolist())
    return "; ".join(f"{name} ({count})" for name, count in counts.most_common())


def _named(pick: int) -> str:
    return "no target" if pick < 0 else f"{FACES[pick // LINES]}, line {pick % LINES + 1}"


def _stage_pictures(study: Study, views: _Views) -> tuple[Picture, ...]:
    """Figures A-1 to A-3: the scene with most clusters whose target is whole in its first view."""
    config = study.sets()["real"].rows
    clusters = views.rows["appendix_clusters"] * (fates(views) == FATES.index("whole"))
    scene = int(clusters[:: views.runs].argmax())
    scenario = scenario_of_row(config, scene)
    view = segmented_view(scenario, config.recipe.noise, 0)
    capture, _ = scenario.capture(config.recipe.noise, 0)
    rgb = np.asarray(capture.rgb).reshape(-1, 3)[capture.valid_points()[1]]
    stages = view.stages
    _, first = np.unique(stages.voxel_of, return_index=True)
    colors = rgb[first[-len(stages.points) :]]
    points = transform(view.T_base_camera, stages.points)
    every = transform(view.T_base_camera, view.points)
    lit = np.where(view.cluster[:, None], np.array(HELD, np.uint8), colors)
    table = points[stages.on_plane, :2]
    low, high = table.min(axis=0) - ROUND_TABLE_M, table.max(axis=0) + ROUND_TABLE_M
    near = ((every[:, :2] >= low) & (every[:, :2] <= high)).all(axis=1)
    rest = stages.kept
    target, words = scenario.target, f"scene {scene} of the stand-in, first view"
    return (
        Picture(
            "figure-a-1",
            f"Pass-through and downsampling (A-1): of {len(every):,} points, the far floor's among "
            f"them (not drawn), {int((stages.voxel_of >= 0).sum()):,} lie in range and become "
            f"{len(points):,}; {words}.",
            svg=clouds(
                (Panel("all points", every[near], rgb[near]), Panel("filtered", points, colors))
            ),
            alt="A table with things on it as a cloud of points, before and after filtering",
        ),
        Picture(
            "figure-a-2",
            f"The rest without the table and without outliers (A-2): {int(rest.sum()):,} points.",
            svg=clouds((Panel("nontable, trimmed", points[rest], colors[rest], 4.0),)),
            alt="The things alone",
        ),
        Picture(
            "figure-a-3",
            f"The target's cluster ({target}) selected, in light blue (A-3).",
            svg=clouds((Panel("cluster selected", points[rest], lit[rest], 4.0),)),
            alt="The things alone, one of them in light blue",
        ),
    )


def _figure_5_6(study: Study, views: _Views) -> tuple[Picture, ...]:
    """The misled view whose box is shortest of all: in its own box, and in the true one."""
    misled = misled_views(views)
    if not misled.any():
        return ()
    short_m = views.rows["appendix_short_m"][:, -1].max(axis=1)
    k = int(np.where(misled, short_m, -np.inf).argmax())
    scene, run = divmod(k, views.runs)
    from_above = int(views.rows["appendix_short_m"][k, -1].argmax()) < 2
    count, of = int(misled.reshape(-1, views.runs).any(axis=1).sum()), len(misled) // views.runs
    return (
        Picture(
            "figure-5-6",
            "A decision of cascade grid that a box too short misled (5-6), seen from "
            f"{'above' if from_above else 'the side'}: scene {scene} of the stand-in, run {run}. "
            f"Such a scene has a run whose box lacks over {100 * WRONG_BOX_M:.1f} cm along a side "
            "and whose decision is another than in the true box with the same map; of the "
            f"{count} of {of} that are so, this box is the shortest.",
            svg=boxes([_box_panel(study, views, k, s) for s in ("appendix", "exact")], from_above),
            alt="The target's points and the hand, in the cluster's box and in the true one",
        ),
    )


def _box_panel(study: Study, views: _Views, k: int, source: str) -> BoxPanel:
    config = study.sets()["real"].rows
    scenario = scenario_of_row(config, k // views.runs)
    view = segmented_view(scenario, config.recipe.noise, k % views.runs)
    points = transform(view.T_base_camera, view.stages.points)
    things = ~view.stages.on_plane
    own = things & (view.ids == scenario.scene.target_id)
    box, exact = (
        box_of(views.rows[f"{s}_box"][k], views.rows[f"{s}_dimensions_m"][k])
        for s in (source, "exact")
    )
    pick, hand = int(_picks(views, source)[k]), Gripper()
    place = "in the true box" if source == "exact" else "in the cluster's box"
    return BoxPanel(
        title=f"{place}: {_named(pick)}",
        cluster=points[view.cluster],
        dropped=points[own & ~view.cluster],
        others=points[things & np.isin(view.ids, scenario.scene.obstacle_ids)],
        box=box,
        exact=exact,
        T_base_hand=candidates_of(box, hand, config.lines).T_base_gripper[pick],
        half_m=hand.half_m,
    )
