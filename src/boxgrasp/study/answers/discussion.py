"""Sections 5-2-1 and 5-2-5: what spiral misses, faces too wide, bias, coarse cells."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np

from boxgrasp.arrays import Array, Bools, Floats
from boxgrasp.grasps.candidates import LINES, TOP_PARALLEL
from boxgrasp.ranking.sampling import RADIUS_M, RESOLUTION_M, sampling
from boxgrasp.study.answers.figures import (
    Answer,
    Answers,
    Figures,
    more_often,
    share_of,
)
from boxgrasp.study.answers.samplings import cells_of
from boxgrasp.study.intervals import NOTHING, Estimate, less, mean
from boxgrasp.study.report import Table
from boxgrasp.study.sections.chapter5 import (
    fallbacks,
    lost_candidates,
    lost_shares,
    missed_table,
    usual_faces,
)
from boxgrasp.study.sections.need import CASCADE, SINGLE

_CUBE_M = 0.06  # the green cube (3-1)
_CUBES = 4_000
_MOVED_M = 0.01


@lru_cache(maxsize=1)  # two results are read from it
def _table(figures: Figures) -> Table:
    return missed_table(figures.tested)


def _missed(figures: Figures, name: str) -> tuple[Estimate, Estimate]:
    """How often spiral and grid miss an obstacle; `all` for any."""
    for line in _table(figures).rows:
        if line[0] == name:
            _, _, spiral, grid = line
            assert isinstance(spiral, Estimate) and isinstance(grid, Estimate)
            return spiral, grid
    return NOTHING, NOTHING


def _cube_missed(figures: Figures) -> Answer:
    spiral, grid = _missed(figures, "green_cube")
    return Answer(
        less(spiral, grid),
        f"cubes in the half sphere that no sample meets, spiral less grid: {spiral.value or 0:.3f} "
        f"and {grid.value or 0:.3f}",
    )


def _grid_sees_all(figures: Figures) -> Answer:
    _, grid = _missed(figures, "all")
    return Answer(
        grid, "obstacles in the half sphere that no sample meets; some stand in another's shadow"
    )


def _touched(corners: Floats, name: str) -> Bools:
    """(N, cells) which sampled cells cubes touch, all of their volume taken as seen."""
    size_m = RESOLUTION_M[name]
    cells = cells_of(sampling(name), size_m)
    low = cells * size_m - np.array([0.0, 0.0, size_m / 2])
    over = np.minimum(corners[:, None] + _CUBE_M, low[None] + size_m)
    under = np.maximum(corners[:, None], low[None])
    found: Bools = (over > under).all(axis=2)
    return found


def _cubes() -> Floats:
    """(N, 3) lower corners of cubes that lie wholly in the half sphere, drawn evenly, m."""
    rng = np.random.default_rng(0)
    corners = rng.uniform(-RADIUS_M, RADIUS_M, (_CUBES, 3))
    corners[:, 2] = np.abs(corners[:, 2])
    far = np.maximum(np.abs(corners), np.abs(corners + _CUBE_M))
    return np.asarray(corners[np.linalg.norm(far, axis=1) <= RADIUS_M])


def _cube_between(_: Figures) -> Answer:
    corners = _cubes()
    spiral, grid = (np.asarray(~_touched(corners, name).any(axis=1)) for name in ("spiral", "grid"))
    return Answer(
        share_of(spiral),
        "of cubes of 6 cm drawn anywhere in the half sphere those that touch no sampled cell; "
        f"with grid {grid.mean():.3f}",
    )


def _same_information(_: Figures) -> Answer:
    corners = _cubes()
    moved = corners + np.array([_MOVED_M, 0.0, 0.0])
    same = {
        name: (_touched(corners, name) == _touched(moved, name)).all(axis=1)
        for name in ("spiral", "grid")
    }
    return Answer(
        share_of(same["spiral"]),
        "of such cubes those whose cells read the same after a move of 1 cm; with grid, whose "
        f"cells are coarser, {same['grid'].mean():.3f}",
    )


def _too_wide(version: str) -> Callable[[Figures], Answer]:
    def answer(figures: Figures) -> Answer:
        wide = figures.tested.metrics(version).too_wide
        novel = wide[~figures.tested.known]
        chance = ~figures.tested.rows["given_true_fits"]
        return Answer(
            share_of(wide),
            f"with novel objects {float(novel.mean()) if len(novel) else 0.0:.3f}; of all "
            f"candidates {float(chance.mean()):.3f} are too wide",
        )

    return answer


def _cereal_top(figures: Figures) -> Answer:
    rows = figures.tested.rows
    which = np.isin(rows["target"], ("cereal_y", "cereal_z"))
    picks = [figures.tested.picks(f"{kind}-spiral") // LINES for kind in ("single", "cascade")]
    top = np.mean([pick == TOP_PARALLEL - 1 for pick in picks], axis=0)
    parts = ", ".join(
        f"{name} {float(top[rows['target'] == name].mean()):.3f}"
        for name in ("cereal_y", "cereal_z")
        if (rows["target"] == name).any()
    )
    return Answer(
        mean(top[which]),
        "top-parallel picks of the two spiral versions on the boxes whose top is too wide that "
        f"way: {parts}",
    )


def _conservative(figures: Figures) -> Answer:
    grid, spiral = (figures.tested.metrics(f"cascade-{n}").unobstructed for n in ("grid", "spiral"))
    return Answer(more_often(grid, spiral), "unobstructed picks, cascade grid less cascade spiral")


def on_bias(figures: Figures, version: str) -> Array:
    """Which picks are unfeasible and on the face that training took most often for the target.

    Args:
        figures: of the study.
        version: of the thesis.

    Returns:
        (known scenes,) bool.
    """
    tested = figures.tested
    face = usual_faces(figures.study, tested.rows)
    fallen = (tested.picks(version) // LINES == face) & ~tested.metrics(version).unobstructed
    return np.asarray(fallen[tested.known])


def _bias_errors(figures: Figures) -> Answer:
    parts = {}
    for version in (CASCADE, SINGLE):
        fallen, usual = fallbacks(figures.study, figures.tested, version)
        parts[version] = less(fallen, usual)
    other = parts[SINGLE].value
    return Answer(
        parts[CASCADE],
        "picks on the target's commonest training face, unfeasible less feasible ones, cascade "
        f"grid, known targets; single grid {'none' if other is None else f'{other:+.3f}'}",
    )


def _bias_single_more(figures: Figures) -> Answer:
    flags = (on_bias(figures, version) for version in (SINGLE, CASCADE))
    return Answer(
        more_often(*flags),
        "unfeasible picks on the target's commonest training face, single less cascade grid",
    )


def _coarse_noise(figures: Figures) -> Answer:
    noisy, clean = (
        lost_shares(evaluation)
        for evaluation in (figures.real.take(figures.real.rows["run"] == 0), figures.real_clean)
    )
    return Answer(more_often(noisy, clean), "the same scenes, with strong noise less without")


ANSWERS: Answers = {
    "cube-missed": _cube_missed,
    "cube-between": _cube_between,
    "grid-sees-all": _grid_sees_all,
    "same-information": _same_information,
    "spiral-too-wide": _too_wide("single-spiral"),
    "spiral-too-wide-cascade": _too_wide("cascade-spiral"),
    "spiral-cereal-top": _cereal_top,
    "grid-never-wide-single": _too_wide(SINGLE),
    "grid-never-wide-cascade": _too_wide(CASCADE),
    "grid-conservative": _conservative,
    "bias-errors": _bias_errors,
    "bias-single-more": _bias_single_more,
    "bias-cascade-too": lambda f: Answer(share_of(on_bias(f, CASCADE)), "known targets"),
    "coarse-hides": lambda f: Answer(
        lost_candidates(f.tested),
        "of the candidates feasible in truth, those whose hand meets an occupied 7 cm cell",
    ),
    "coarse-hides-noise": _coarse_noise,
}
