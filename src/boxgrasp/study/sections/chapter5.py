"""The discussion in figures: what spiral and grid miss, wide faces, coarse cells, bias (5-2)."""

from __future__ import annotations

import json

import numpy as np

from boxgrasp.arrays import Array, Floats
from boxgrasp.geometry import hand_distance
from boxgrasp.geometry.transforms import transform
from boxgrasp.grasps.candidates import FACES, candidates_of
from boxgrasp.grasps.gripper import Gripper
from boxgrasp.ranking.sampling import RADIUS_M, RESOLUTION_M, sampling
from boxgrasp.simulate.primitives import Box, Cylinder
from boxgrasp.simulate.scenes import TableScene, build_scene
from boxgrasp.study.evaluation import VERSIONS, Evaluation
from boxgrasp.study.intervals import Estimate, mean, share
from boxgrasp.study.report import Row, Section, Table
from boxgrasp.study.study import Study
from boxgrasp.teaching.rows import box_of

OCCUPIED = 2
_SMALL = ("green_cube", "cigarettes")


def chapter5_section(study: Study) -> Section:
    """Section 5-2's explanations, each with a count."""
    evaluation = study.evaluation("tested")
    table = missed_table(evaluation)
    wide = [evaluation.metrics(version).too_wide for version in VERSIONS]
    cereal = np.char.startswith(evaluation.rows["target"], "cereal")
    rows = [
        *(
            Row(
                f"{version}: faces wider than the opening",
                "often" if "spiral" in version else "never",
                share(int(w.sum()), len(w)),
            )
            for version, w in zip(VERSIONS, wide, strict=True)
        ),
        *(
            Row(
                f"{version}: the same on cereal boxes",
                None,
                share(int(w[cereal].sum()), int(cereal.sum())),
            )
            for version, w in zip(VERSIONS, wide, strict=True)
        ),
        Row(
            "candidates feasible in truth but occupied by 7 cm cells",
            None,
            lost_candidates(evaluation),
        ),
    ]
    for version in ("single-grid", "cascade-grid"):
        fallen, usual = fallbacks(study, evaluation, version)
        rows += [
            Row(f"{version}: unfeasible picks on the target's commonest face", None, fallen),
            Row(f"{version}: feasible picks on the target's commonest face", None, usual),
        ]
    return Section(
        key="chapter-5",
        title="Why spiral and grid differ",
        place="section 5-2; figures 5-1, 5-2, 5-7, 5-8",
        words=(
            "An obstacle is missed by a sampling where it reaches into the half sphere but no "
            "sample that reads occupied lies within half a cell's diagonal of it; a few stand in "
            "another's shadow. Candidates are lost to coarse cells where their hand is clear by 2 cm "
            "in truth and fits, but meets an occupied cell that does not touch the target's box.",
            "A version falls back on bias where its pick is unfeasible and lies on the face "
            "that the operator took most often for that target in training (known targets).",
        ),
        rows=tuple(rows),
        tables=(table,),
    )


def missed_table(evaluation: Evaluation) -> Table:
    """By obstacle: how many reach into the half sphere, and how many each sampling misses."""
    counts: dict[str, np.ndarray] = {}
    for k in range(evaluation.rows.count):
        scene = build_scene(json.loads(str(evaluation.rows["scene"][k])))
        box = box_of(evaluation.rows["given_box"][k], evaluation.rows["given_dimensions_m"][k])
        T_base_map = box.T_base_map()
        hits = {}
        for name in ("spiral", "grid"):
            occupied = evaluation.rows[f"given_{name}"][k] == OCCUPIED
            hits[name] = transform(T_base_map, sampling(name)[occupied])
        center = T_base_map[:3, 3]
        for label in scene.obstacle_ids:
            solids = _solids(scene, label)
            if _away(solids, center[None])[0] > RADIUS_M - 0.02:
                continue
            met = [
                bool((_away(solids, hits[n]) <= RESOLUTION_M[n] * np.sqrt(3) / 2).any())
                for n in ("spiral", "grid")
            ]
            entry = counts.setdefault(scene.names[label], np.zeros(3, dtype=int))
            entry += (1, not met[0], not met[1])
    lines = [
        (name, int(n[0]), share(int(n[1]), int(n[0])), share(int(n[2]), int(n[0])))
        for name, n in sorted(counts.items())
    ]
    total = sum(counts.values(), np.zeros(3, dtype=int))
    lines.append(
        (
            "all",
            int(total[0]),
            share(int(total[1]), int(total[0])),
            share(int(total[2]), int(total[0])),
        )
    )
    return Table(
        "Obstacles that no sample hits",
        ("obstacle", "in the half sphere", "missed by spiral", "missed by grid"),
        tuple(lines),
    )


def lost_candidates(evaluation: Evaluation) -> Estimate:
    """Average share, a scene, of its feasible candidates whose hand meets an occupied 7 cm cell."""
    rows, hand, size_m = evaluation.rows, Gripper(), RESOLUTION_M["grid"]
    points = sampling("grid")
    shares = []
    for k in range(rows.count):
        box = box_of(rows["given_box"][k], rows["given_dimensions_m"][k])
        candidates = candidates_of(box, hand)
        free = (rows["given_true_clearance_m"][k] >= 0.02) & rows["given_true_fits"][k]
        cells = points[rows["given_grid"][k] == OCCUPIED]
        # Cells that the target itself may fill speak of no obstacle.
        reach = box.dimensions_m / 2 + size_m / 2
        middle = np.array([0.0, 0.0, box.dimensions_m[2] / 2 - 0.05])
        cells = cells[(np.abs(cells - middle) > reach).any(axis=1)]
        if not free.any():
            continue
        hands = hand_distance.uprights(candidates.T_base_gripper, hand.half_m)
        sizes = np.full(len(cells), size_m)
        met = hand_distance.to_cells(hands, transform(box.T_base_map(), cells), sizes, box.yaw_rad)
        shares.append(float((met[free] <= 0.0).mean()))
    return mean(shares)


def fallbacks(study: Study, evaluation: Evaluation, version: str) -> tuple[Estimate, Estimate]:
    """Share of picks on the target's commonest training face, unfeasible ones and feasible ones."""
    labels = study.rows("labels")
    face = (labels["label"] - 1) // 3
    common = {
        str(name): int(np.bincount(face[labels["target"] == name], minlength=len(FACES)).argmax())
        for name in np.unique(labels["target"])
    }
    known = evaluation.known
    usual = np.array([common.get(str(name), -1) for name in evaluation.rows["target"]])
    on_usual = evaluation.picks(version) // 3 == usual
    clear = evaluation.metrics(version).unobstructed
    bad, good = known & ~clear, known & clear
    return (
        share(int(on_usual[bad].sum()), int(bad.sum())),
        share(int(on_usual[good].sum()), int(good.sum())),
    )


def _solids(scene: TableScene, label: int) -> tuple[Box | Cylinder, ...]:
    return tuple(solid for solid in scene.obstacles if solid.label == label)


def _away(solids: tuple[Box | Cylinder, ...], points: Array) -> Floats:
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
