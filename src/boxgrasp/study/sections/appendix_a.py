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
from boxgrasp.study.plots.stages import BoxPanel, Panel, boxes, clouds
from boxgrasp.study.report import Picture, Row, Section, Table
from boxgrasp.study.sections.need import CASCADE
from boxgrasp.study.sections.real import WRONG_BOX_M
from boxgrasp.study.study import Study
from boxgrasp.teaching.rows import box_of, scenario_of_row
from boxgrasp.teaching.sets import Rows

SETS: Final = {"tested": "simulation tests", "real": "stand-in for real, strong noise"}
FATES: Final = ("whole", "too short", "merged", "otherwise wrong", "lost")
FOREIGN_SHARE: Final = 0.05  # of a cluster's points, other things', from which it is a merged one
_PART_VIEWS = 30  # a task: some ten seconds
_WORDS = (
    "The package finds objects in a way of its own; this is appendix A's, in its order: the "
    "pass-through by distance on the points, centroids of voxels, the plane that holds most, "
    "outliers of table and rest trimmed, clusters, and the one chosen that has most of the "
    "target's points. The map is made of all points of the view, as the thesis's was, so the box "
    "alone differs from the other sections'.",
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
        return ~(np.maximum(short, moved).max(axis=1) <= WRONG_BOX_M)

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
    found = figure_5_6_scenes(views["real"])
    return Section(
        key="appendix-a",
        title="Segmentation as in appendix A",
        place="appendix A, figures A-1 to A-3; section 5-2-4, figure 5-6",
        words=(*_WORDS, _OURS.format(**vars(params)), _fate_words()),
        rows=(*_fate_rows(views), *_decision_rows(views, found)),
        tables=(_points_table(views), _short_table(views), _changes_table(views["real"], found)),
        pictures=(
            *_stage_pictures(study, views["real"]),
            *_figure_5_6(study, views["real"], found),
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


def _fate_rows(views: Mapping[str, _Views]) -> list[Row]:
    rows = []
    for name, words in SETS.items():
        own = views[name]
        found = fates(own)
        rows += [
            Row(f"target {fate}, {words}", None, own.by_scene(found == k))
            for k, fate in enumerate(FATES)
        ]
        given = own.by_scene(~own.wrong(0))
        rows.append(Row(f"box of all the target's seen points whole, {words}", None, given))
    return rows


def _decision_rows(views: Mapping[str, _Views], found: list[int]) -> list[Row]:
    own = views["real"]
    evaluation, runs = own.evaluation, own.runs
    picks = {s: evaluation.picks(CASCADE, s).reshape(-1, runs) for s in ("given", "appendix")}
    changes = {s: int((p != p[:, :1]).any(axis=1).sum()) for s, p in picks.items()}
    score, usual = (
        evaluation.metrics(CASCADE, s).score.reshape(-1, runs) for s in ("appendix", "given")
    )
    of = len(score)
    misled = own.short() & (_exact_picks(own) != evaluation.picks(CASCADE, "appendix"))
    scores = _scene_means(score), _scene_means(usual)
    return [
        Row(
            "scenes whose decision changes, appendix A", "2 of 42", f"{changes['appendix']} of {of}"
        ),
        Row("the same scenes, points given", None, f"{changes['given']} of {of}"),
        Row("of them by a box too short (figure 5-6)", "1 of 42", f"{len(found)} of {of}"),
        Row(
            "views decided otherwise than in the true box, the box too short",
            None,
            own.by_scene(misled),
        ),
        Row("score of cascade grid, appendix A", 0.86, mean(scores[0])),
        Row("score, appendix A less points given, same scenes", None, difference(*scores)),
    ]


def _scene_means(score: Floats) -> Floats:
    """(S,) over the runs that were answered; NaN where none was."""
    count = (~np.isnan(score)).sum(axis=1)
    total = np.nansum(score, axis=1)
    return np.divide(total, count, out=np.full(len(score), np.nan), where=count > 0)


def _exact_picks(views: _Views) -> Array:
    """(V,) what cascade grid picks in the true box, in the same map."""
    model_set = views.evaluation.model_sets[CASCADE]
    return first_choice(model_order(model_set, views.rows, "exact"))


def _points_table(views: Mapping[str, _Views]) -> Table:
    lines = []
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
    names = ("not seen in the view", "", "taken for the table", "trimmed", "in another cluster")
    lines = []
    for own in views.values():
        short = np.array([own.short(k) for k in range(len(LEFT_AFTER))])
        first = Counter(short[:, short[-1]].argmax(axis=0).tolist())
        lines.append([first[k] for k in range(len(LEFT_AFTER))])
    names = (names[0], "beyond 1.6 m or by the voxels", *names[2:])
    counts = zip(names, *lines, strict=True)
    every = ("any", *(sum(line) for line in lines))
    return Table(
        "Views whose box is too short, by the stage that made it so",
        ("why", *SETS.values()),
        (*counts, every),
    )


def figure_5_6_scenes(views: _Views) -> list[int]:
    """Scenes where the decision changes because the box is too short, as in figure 5-6.

    In some run the box is too short and the decision is another than the commonest one of the runs
    whose box is not; in the true box, in the same map, it is that one.

    Args:
        views: of scenes that are seen several times.

    Returns:
        Numbers of the scenes.
    """
    return [k for k in range(views.rows.count // views.runs) if len(_misled_runs(views, k))]


def _misled_runs(views: _Views, scene: int) -> Array:
    """Rows of a scene that are as in figure 5-6."""
    which = np.arange(scene * views.runs, (scene + 1) * views.runs)
    picks = views.evaluation.picks(CASCADE, "appendix")[which]
    short = views.short()[which]
    if short.all():
        return which[:0]
    usual = Counter(picks[~short].tolist()).most_common(1)[0][0]
    misled = short & (picks != usual) & (_exact_picks(views)[which] == usual)
    return which[misled]


def _changes_table(views: _Views, found: list[int]) -> Table:
    picks = views.evaluation.picks(CASCADE, "appendix").reshape(-1, views.runs)
    lines = []
    for scene in found:
        said = Counter(_named(pick) for pick in picks[scene].tolist())
        words = "; ".join(f"{name} ({count})" for name, count in said.most_common())
        k = int(_misled_runs(views, scene)[0])
        short_m = views.rows["appendix_short_m"][k, -1]
        side = "xyz"[int(short_m.argmax())]
        too_short = f"{100 * short_m.max():.1f} cm along {side}"
        lines.append((scene, str(views.rows["target"][k]), words, too_short))
    columns = ("scene", "target", "decisions in all runs", "too short by")
    return Table("Decisions that change because the box is too short", columns, tuple(lines))


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
    lit = np.where(view.cluster[:, None], np.uint8(HELD), colors)
    table, things = points[stages.on_plane], points[stages.clusters >= 0]
    wide = [(float(table[:, k].min()) - 0.05, float(table[:, k].max()) + 0.05) for k in (0, 1)]
    near = [(float(things[:, k].min()) - 0.03, float(things[:, k].max()) + 0.03) for k in range(3)]
    high = (near[2][0] - 0.25, near[2][1])
    rest = stages.kept
    target, words = scenario.target, f"scene {scene} of the stand-in, first view"
    return (
        Picture(
            "figure-a-1",
            f"Pass-through and downsampling (A-1): {len(every):,} points become {len(points):,}; "
            f"{words}.",
            svg=clouds(
                (Panel("all points", every, rgb), Panel("filtered", points, colors)),
                (*wide, high),
            ),
            alt="A table with things on it as a cloud of points, before and after filtering",
        ),
        Picture(
            "figure-a-2",
            f"The rest without the table and without outliers (A-2): {int(rest.sum()):,} points.",
            svg=clouds((Panel("nontable, trimmed", points[rest], colors[rest], 4.0),), near),
            alt="The things alone",
        ),
        Picture(
            "figure-a-3",
            f"The target's cluster ({target}) selected, in light blue (A-3).",
            svg=clouds((Panel("cluster selected", points[rest], lit[rest], 4.0),), near),
            alt="The things alone, one of them in light blue",
        ),
    )


def _figure_5_6(study: Study, views: _Views, found: list[int]) -> tuple[Picture, ...]:
    """The scene whose misled box is shortest of all, usual and misled run below each other."""
    if not found:
        return ()
    misled = [int(k) for scene in found for k in _misled_runs(views, scene)]
    short_m = views.rows["appendix_short_m"][:, -1].max(axis=1)
    odd = max(misled, key=lambda k: float(short_m[k]))
    scene = odd // views.runs
    which = np.arange(scene * views.runs, (scene + 1) * views.runs)
    picks = views.evaluation.picks(CASCADE, "appendix")
    usual = Counter(picks[which][~views.short()[which]].tolist()).most_common(1)[0][0]
    fair = int(which[(picks[which] == usual) & ~views.short()[which]][0])
    counts = Counter(picks[which].tolist())
    panels = [
        _box_panel(
            study, views, k, f"{_named(int(picks[k]))} ({counts[int(picks[k])]} of {views.runs})"
        )
        for k in (fair, odd)
    ]
    from_above = int(views.rows["appendix_short_m"][odd, -1].argmax()) < 2
    return (
        Picture(
            "figure-5-6",
            "A decision of cascade grid that changes because the box is too short (5-6), seen from "
            f"{'above' if from_above else 'the side'}: scene {scene} of the stand-in, the one of "
            f"{len(found)} whose box is shortest. Such a scene has a run whose box lacks over "
            f"{100 * WRONG_BOX_M:.1f} cm and whose decision is not the usual one of the other "
            "runs, but is in the true box.",
            svg=boxes(panels, from_above),
            alt="The target's points, its box and the hand, in a usual run and in a misled one",
        ),
    )


def _box_panel(study: Study, views: _Views, k: int, title: str) -> BoxPanel:
    config = study.sets()["real"].rows
    scenario = scenario_of_row(config, k // views.runs)
    view = segmented_view(scenario, config.recipe.noise, k % views.runs)
    points, own = (
        transform(view.T_base_camera, view.stages.points),
        view.ids == scenario.scene.target_id,
    )
    rows, hand = views.rows, Gripper()
    box = box_of(rows["appendix_box"][k], rows["appendix_dimensions_m"][k])
    pick = int(views.evaluation.picks(CASCADE, "appendix")[k])
    others = ~view.stages.on_plane & np.isin(view.ids, scenario.scene.obstacle_ids)
    return BoxPanel(
        title=title,
        cluster=points[view.cluster],
        dropped=points[own & ~view.cluster & ~view.stages.on_plane],
        others=points[others],
        box=box,
        exact=box_of(rows["exact_box"][k], rows["exact_dimensions_m"][k]),
        T_base_hand=candidates_of(box, hand, config.lines).T_base_gripper[pick],
        half_m=hand.half_m,
    )
