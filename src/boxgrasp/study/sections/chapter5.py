"""The discussion in figures: what spiral and grid miss, wide faces, coarse cells, bias (5-2)."""

from __future__ import annotations

import json

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Array, Bools, Floats
from boxgrasp.geometry import hand_distance
from boxgrasp.geometry.box import Box
from boxgrasp.geometry.transforms import transform
from boxgrasp.grasps.candidates import FACES, LINES, candidates_of
from boxgrasp.grasps.gripper import Gripper
from boxgrasp.grasps.scoring import RED_BELOW_M
from boxgrasp.mapping.local_map import OCCUPIED, MappingConfig
from boxgrasp.ranking.model_set import SAMPLINGS, VERSIONS
from boxgrasp.ranking.sampling import RADIUS_M, RESOLUTION_M, sampling
from boxgrasp.simulate.primitives import Box as SolidBox
from boxgrasp.simulate.primitives import Cylinder
from boxgrasp.simulate.scenes import build_scene
from boxgrasp.study.evaluation import Evaluation
from boxgrasp.study.intervals import Estimate, mean, share
from boxgrasp.study.report import Row, Section, Table
from boxgrasp.study.study import Study
from boxgrasp.teaching.rows import box_of
from boxgrasp.teaching.sets import Rows

_REACHES_IN_M = 0.02  # into the half sphere, or an obstacle does not count


def chapter5_section(study: Study) -> Section:
    """Section 5-2's explanations, each with a count.

    Args:
        study: whose test scenarios they are.

    Returns:
        The section.
    """
    evaluation = study.evaluation("tested")
    return Section(
        key="chapter-5",
        title="Why spiral and grid differ",
        place="section 5-2; figures 5-1, 5-2, 5-7, 5-8",
        words=(
            "An obstacle is missed by a sampling where it reaches into the half sphere but no "
            "sample that reads occupied lies within half a cell's diagonal of it; a few stand in "
            "another's shadow. Candidates are lost to coarse cells where their hand is clear by "
            "2 cm in truth and fits, but meets an occupied cell that does not touch the target's "
            "box.",
            "A version falls back on bias where its pick is unfeasible and lies on the face "
            "that the operator took most often for that target in training (known targets).",
        ),
        rows=(*_too_wide_rows(evaluation), _lost_row(evaluation), *_bias_rows(study, evaluation)),
        tables=(missed_table(evaluation),),
    )


def _too_wide_rows(evaluation: Evaluation) -> list[Row]:
    cereal = np.char.startswith(evaluation.rows["target"], "cereal")
    wide = {version: evaluation.metrics(version).too_wide for version in VERSIONS}
    every = [
        Row(
            f"{version}: faces wider than the opening",
            "often" if "spiral" in version else "never",
            share(int(w.sum()), len(w)),
        )
        for version, w in wide.items()
    ]
    boxes = [
        Row(
            f"{version}: the same on cereal boxes",
            None,
            share(int(w[cereal].sum()), int(cereal.sum())),
        )
        for version, w in wide.items()
    ]
    return every + boxes


def _lost_row(evaluation: Evaluation) -> Row:
    found = lost_candidates(evaluation)
    return Row("candidates feasible in truth but occupied by 7 cm cells", None, found)


def _bias_rows(study: Study, evaluation: Evaluation) -> list[Row]:
    rows = []
    for version in ("single-grid", "cascade-grid"):
        fallen, usual = fallbacks(study, evaluation, version)
        rows += [
            Row(f"{version}: unfeasible picks on the target's commonest face", None, fallen),
            Row(f"{version}: feasible picks on the target's commonest face", None, usual),
        ]
    return rows


def missed_table(evaluation: Evaluation) -> Table:
    """By obstacle: how many reach into the half sphere, and how many each sampling misses.

    Args:
        evaluation: of a set.

    Returns:
        A line an obstacle's name, and one of all.
    """
    counts: dict[str, NDArray[np.int64]] = {}
    for k in np.flatnonzero(evaluation.answered("given")).tolist():
        for name, missed in _missed(evaluation.rows, k):
            entry = counts.setdefault(name, np.zeros(3, dtype=np.int64))
            entry += (1, *missed)
    lines = [_missed_line(name, counts[name]) for name in sorted(counts)]
    total = sum(counts.values(), np.zeros(3, dtype=np.int64))
    return Table(
        "Obstacles that no sample hits",
        ("obstacle", "in the half sphere", "missed by spiral", "missed by grid"),
        (*lines, _missed_line("all", total)),
    )


def _missed(rows: Rows, k: int) -> list[tuple[str, list[bool]]]:
    """The obstacles of row k that reach into the half sphere, and whether each sampling misses."""
    scene = build_scene(json.loads(str(rows["scene"][k])))
    T_base_map = _box(rows, k).T_base_map()
    center = T_base_map[None, :3, 3]
    hits = {
        name: transform(T_base_map, sampling(name)[rows[f"given_{name}"][k] == OCCUPIED])
        for name in SAMPLINGS
    }
    found = []
    for number in scene.obstacle_ids:
        solids = scene.solids_of((number,))
        if _away(solids, center)[0] > RADIUS_M - _REACHES_IN_M:
            continue
        reach = {name: RESOLUTION_M[name] * np.sqrt(3) / 2 for name in SAMPLINGS}
        missed = [not (_away(solids, hits[n]) <= reach[n]).any() for n in SAMPLINGS]
        found.append((scene.names[number], missed))
    return found


def _missed_line(name: str, counts: NDArray[np.int64]) -> tuple[str, int, Estimate, Estimate]:
    of, spiral, grid = counts.tolist()
    return name, of, share(spiral, of), share(grid, of)


def lost_candidates(evaluation: Evaluation) -> Estimate:
    """How many feasible candidates coarse cells hide.

    Args:
        evaluation: of a set.

    Returns:
        Average share, a scene, of its feasible candidates whose hand meets an occupied 7 cm cell.
    """
    return mean(lost_shares(evaluation))


def lost_shares(evaluation: Evaluation) -> Floats:
    """Of each scene's feasible candidates, the share that coarse cells hide.

    Args:
        evaluation: of a set.

    Returns:
        (N,); NaN for a scene without any.
    """
    shares = [_lost_share(evaluation.rows, k) for k in range(evaluation.rows.count)]
    return np.array([np.nan if found is None else found for found in shares])


def _lost_share(rows: Rows, k: int) -> float | None:
    """Of the feasible candidates of row k, those that coarse cells hide; None without any."""
    free = (rows["given_true_clearance_m"][k] >= RED_BELOW_M) & rows["given_true_fits"][k]
    return float(hidden_by_cells(rows, k)[free].mean()) if free.any() else None


def hidden_by_cells(rows: Rows, k: int) -> Bools:
    """Which candidates of a row meet an occupied 7 cm cell that the target does not fill.

    Args:
        rows: of a set.
        k: the row.

    Returns:
        (5 l,) bool, by label.
    """
    hand, size_m, box = Gripper(), RESOLUTION_M["grid"], _box(rows, k)
    cells = sampling("grid")[rows["given_grid"][k] == OCCUPIED]
    # Cells that the target itself may fill speak of no obstacle.
    reach = box.dimensions_m / 2 + size_m / 2
    over_m = MappingConfig.center_above_support_m
    middle = np.array([0.0, 0.0, box.dimensions_m[2] / 2 - over_m])
    cells = cells[(np.abs(cells - middle) > reach).any(axis=1)]
    lines = rows["given_passes"].shape[1] // len(FACES)
    T = candidates_of(box, hand, lines).T_base_gripper
    hands = hand_distance.uprights(T, hand.half_m)
    centers = transform(box.T_base_map(), cells)
    edges = np.full(len(cells), size_m)
    met, _ = hand_distance.to_cells(hands, centers, edges, box.yaw_rad)
    return np.asarray(met <= 0.0)


def fallbacks(study: Study, evaluation: Evaluation, version: str) -> tuple[Estimate, Estimate]:
    """How often picks lie on the target's commonest training face (known targets).

    Args:
        study: whose labels count.
        evaluation: of a set.
        version: of the thesis.

    Returns:
        Shares of the unfeasible picks, and of the feasible ones.
    """
    known, usual = evaluation.known, usual_faces(study, evaluation.rows)
    on_usual = evaluation.picks(version) // LINES == usual
    clear = evaluation.metrics(version).unobstructed
    bad, good = known & ~clear, known & clear
    return (
        share(int(on_usual[bad].sum()), int(bad.sum())),
        share(int(on_usual[good].sum()), int(good.sum())),
    )


def usual_faces(study: Study, rows: Rows) -> Array:
    """The face that the operator took most often in training for each row's target.

    Args:
        study: whose labels count.
        rows: of a set.

    Returns:
        (N,) index of the face, -1 for a target that was not in training.
    """
    labels = study.rows("labels")
    face = (labels["label"] - 1) // LINES
    common = {
        str(name): int(np.bincount(face[labels["target"] == name], minlength=len(FACES)).argmax())
        for name in np.unique(labels["target"])
    }
    return np.array([common.get(str(name), -1) for name in rows["target"]])


def _box(rows: Rows, k: int) -> Box:
    return box_of(rows["given_box"][k], rows["given_dimensions_m"][k])


def _away(solids: tuple[SolidBox | Cylinder, ...], points: Array) -> Floats:
    """(N,) m, distance of points from the nearest of some solids, 0 inside."""
    away = np.full(len(points), np.inf)
    for solid in solids:
        local = (points - solid.T_base_solid[:3, 3]) @ solid.T_base_solid[:3, :3]
        if isinstance(solid, Cylinder):
            flat = np.maximum(np.hypot(local[:, 0], local[:, 1]) - solid.half_size[0], 0.0)
            tall = np.maximum(np.abs(local[:, 2]) - solid.half_size[2], 0.0)
            away = np.minimum(away, np.hypot(flat, tall))
        else:
            beyond = np.maximum(np.abs(local) - solid.half_size, 0.0)
            away = np.minimum(away, np.linalg.norm(beyond, axis=1))
    return away
