"""Scenes by how clear their best candidate truly is, and how good an answer is in them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from boxgrasp.grasps.gripper import Gripper
from boxgrasp.grasps.scoring import GREEN_FROM_M, RED_BELOW_M
from boxgrasp.simulate import (
    CandidateTruth,
    Solids,
    TableScene,
    TrueCandidates,
    candidate_truth,
    draw_scene,
    hold_truth,
    true_candidates,
)

# Least and most true clearance of a scene's best valid candidate, m (issue bars).
BANDS = {"solvable": (0.025, np.inf), "between": (0.015, 0.025), "hopeless": (0.0, 0.015)}
SAFE_SLACK_M = 0.005


@dataclass(frozen=True, eq=False)
class JudgedScene:
    """A scene with the numbers of its true candidates; seed draws scene and noise again."""

    seed: tuple[int, int]
    scene: TableScene
    candidates: TrueCandidates
    truth: CandidateTruth

    @property
    def rng(self) -> np.random.Generator:
        """The generator for the scene's noise."""
        return np.random.default_rng((*self.seed, 1))


@dataclass(frozen=True)
class Verdict:
    """One answered pose against exact surfaces, hidden sides included."""

    clearance_m: float
    clear: bool
    safe: bool
    off_table: bool
    free_approach: bool
    fits: bool
    on_air: bool
    by_edge: bool
    touching: bool
    glancing: bool

    @property
    def good(self) -> bool:
        """Whether the grasp may be done: clear, off the table, free approach, fits."""
        return self.clear and self.off_table and self.free_approach and self.fits


def band_of(best_m: float) -> str:
    """Name of the band that a scene's best true clearance falls in."""
    return next(name for name, (least, most) in BANDS.items() if least <= best_m < most)


def judged(seed: int, number: int, **draw: object) -> JudgedScene:
    """Scene `number` of a seed: the same whatever other scenes were drawn."""
    scene = draw_scene(np.random.default_rng((seed, number, 0)), **draw)  # type: ignore[arg-type]
    candidates = true_candidates(scene)
    truth = candidate_truth(scene, candidates.T_base_gripper)
    return JudgedScene((seed, number), scene, candidates, truth)


def scenes(seed: int, count: int, band: str, **draw: object) -> Iterator[JudgedScene]:
    """The first `count` scenes of a seed whose best candidate is in the band."""
    number = 0
    while count:
        candidate = judged(seed, number, **draw)
        number += 1
        if band_of(candidate.truth.best_m) == band:
            count -= 1
            yield candidate


def verdict(
    judged_scene: JudgedScene, T_base_gripper: np.ndarray, gripper: Gripper | None = None
) -> Verdict:
    """How good an answered pose (4, 4) is; safe: within 5 mm of u or more (u: strict score)."""
    truth = candidate_truth(judged_scene.scene, np.asarray(T_base_gripper)[None], gripper=gripper)
    held = hold_truth(
        Solids.of(judged_scene.scene.target), np.asarray(T_base_gripper)[None], gripper=gripper
    )
    clearance = float(truth.clearance_m[0])
    u = min(GREEN_FROM_M, judged_scene.truth.best_m)
    return Verdict(
        clearance_m=clearance,
        clear=clearance >= RED_BELOW_M,
        safe=clearance >= u - SAFE_SLACK_M,
        off_table=bool(truth.plane_clearance_m[0] > 0),
        free_approach=bool(truth.approach_clearance_m[0] > 0),
        fits=bool(truth.fits[0]),
        on_air=bool(held.on_air[0]),
        by_edge=bool(held.by_edge[0]),
        touching=bool(held.touching[0]),
        glancing=bool(held.glancing[0]),
    )
