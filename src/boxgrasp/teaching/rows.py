"""One scenario as a row: its scene, its truth, what the code saw of it, and the operator's label.

Each scenario is seen twice. `given`: the target's points as they truly are (thesis 1-6 takes the
segmentation as given) and the aligned box: the thesis. `found`: the package as it ships, which
finds the object under a pixel by itself and may turn the box.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Any

import numpy as np

from boxgrasp.arrays import Array, readonly
from boxgrasp.errors import BoxgraspError, ConfigError
from boxgrasp.geometry import hand_distance
from boxgrasp.geometry.box import Box
from boxgrasp.geometry.transforms import make_transform, rotation_z
from boxgrasp.mapping.local_map import LocalMap
from boxgrasp.perception.scene import Scene
from boxgrasp.perception.target import Target
from boxgrasp.ranking.sampling import RESOLUTION_M, portion, sampling
from boxgrasp.selector import GraspSelector, SceneAnalysis
from boxgrasp.sensing.capture import Capture
from boxgrasp.simulate.scenario import OPERATOR, Recipe, Scenario, draw_scenario
from boxgrasp.simulate.truth import candidate_truth, true_box
from boxgrasp.teaching.operators import Operator, Shown
from boxgrasp.teaching.stand_in import StandIn

TARGET_SOURCES = ("given", "found")
SAMPLINGS = ("grid", "spiral")
FITS = {"given": "aligned", "found": "yaw"}
CELLS_M = tuple(sorted({RESOLUTION_M[name] for name in SAMPLINGS}))
# Of each candidate, measured by the check.
NUMBERS = (
    "visible_clearance_m", "occluded_clearance_m", "unseen_distance_m", "unseen_fraction", "plane_clearance_m", "approach_clearance_m", "fits", "known",
)  # fmt: skip
# Of each candidate, exact truth of its pose.
TRUTHS = ("clearance_m", "plane_clearance_m", "approach_clearance_m", "fits")

Row = dict[str, Any]
STAND_IN = StandIn()


@dataclass(frozen=True)
class RowConfig:
    """How rows are made: the recipe of their scenes, the seed, lines a face, the target_sources.

    runs: how often each scenario is seen, its noise drawn anew; frames: how many frames are fused
    in the map of each; stride: as `MappingConfig.stride`.

    Raises:
        ConfigError: a seed or a number of lines that cannot be.
    """

    recipe: Recipe
    seed: int
    lines: int = 3
    target_sources: tuple[str, ...] = TARGET_SOURCES
    runs: int = 1
    frames: int = 1
    stride: int | None = None

    def __post_init__(self) -> None:
        if not 0 <= self.seed < 2**63:  # the seed's column is int64
            raise ConfigError(f"seed is {self.seed}; valid: 0 to 2^63 - 1")
        if not 1 <= self.lines <= 99:
            raise ConfigError(f"lines is {self.lines}; valid: 1 to 99")


def row_of(config: RowConfig, number: int, operator: Operator = STAND_IN) -> Row:
    """Row `number` of a set: its scenario drawn, cast, seen and labeled by the operator."""
    number, run = divmod(number, config.runs)
    scenario = scenario_of_row(config, number)
    seen = [
        scenario.capture(config.recipe.noise, run * config.frames + k) for k in range(config.frames)
    ]
    capture, labels = seen[0]
    scans = [view for view, _ in seen[1:]]
    return scenario_row(scenario, capture, labels, config, run, scans, operator)


@lru_cache(maxsize=2)
def scenario_of_row(config: RowConfig, number: int) -> Scenario:
    """The scenario of a number; rows of its runs follow each other."""
    return draw_scenario(config.recipe, config.seed, number, lines=config.lines)


def scenario_row(
    scenario: Scenario,
    capture: Capture,
    labels: Array,
    config: RowConfig,
    run: int = 0,
    scans: Sequence[Capture] = (),
    operator: Operator = STAND_IN,
) -> Row:
    """The row of one view of a scenario.

    labels: (H, W) true object of each pixel; scans: further frames, for the map alone.
    """
    row = {**_truth_columns(scenario), "run": run}
    scene: Scene | None = None
    blocked: Array | None = None
    for name in config.target_sources:
        chosen = selector(name, config.lines, config.stride)
        mask = labels == scenario.scene.target_id
        target = Target(mask=mask) if name == "given" else None
        try:
            scene = scene or chosen.scene(capture)
            analysis = chosen.analyze(capture, target, scans, scene=scene, cells_m=CELLS_M)
        except BoxgraspError as error:
            row[f"{name}_error"] = str(error)
            continue
        if name == "given":
            blocked = np.ascontiguousarray(
                analysis.scene.points[analysis.target_points.obstacle_mask]
            )
            label = operator.label(shown(analysis, chosen), scenario.rng(OPERATOR))
            row |= {"label": label.label, "label_source": label.source}
        row |= {f"{name}_{key}": value for key, value in _sight_columns(analysis, scenario).items()}
        if blocked is not None:
            hands = hand_distance.uprights(
                analysis.context.candidates.T_base_gripper, chosen.config.gripper.half_m
            )
            row[f"{name}_visible_m"] = hand_distance.to_points(hands, blocked)[0]
    return row


def shown(analysis: SceneAnalysis, selector: GraspSelector) -> Shown:
    """What the operator is shown of a analysis."""
    return Shown(
        analysis.context.box,
        analysis.context.candidates,
        np.ascontiguousarray(analysis.scene.points[analysis.target_points.obstacle_mask]),
        float(analysis.context.box.base_center_m[2]),
        selector.config.gripper,
    )


@cache
def selector(analysis: str, lines: int, stride: int | None = None) -> GraspSelector:
    """The configuration of a analysis."""
    return GraspSelector(
        {
            "box": {"fit": FITS[analysis]},
            "candidates": {"lines": lines},
            "mapping": {"stride": stride},
        }
    )


@cache
def sample_points(name: str) -> tuple[Array, Array]:
    """A sampling's P points, and the portions of the five faces one after the other (3-2-2)."""
    points = sampling(name)
    return points, np.concatenate([portion(points, face) for face in range(1, 6)])


def occupied_at(local_map: LocalMap, name: str) -> tuple[Array, Array]:
    """uint8 occupancy (0 free, 1 unseen, 2 occupied) of a sampling's points and portions."""
    whole, parts = sample_points(name)
    return states_at(local_map, whole), states_at(local_map, parts)


def states_at(local_map: LocalMap, points: Array) -> Array:
    """(N,) uint8 occupancy of points (map frame): 0 free, 1 unseen, 2 occupied."""
    return np.asarray((2 * local_map.values_at(points)).astype(np.uint8))


def _truth_columns(scenario: Scenario) -> Row:
    T_base_box, dimensions_m = true_box(scenario.scene, mode="aligned")
    return {
        "seed": scenario.seed,
        "number": scenario.number,
        "target": scenario.target,
        "scene": json.dumps(scenario.scene.spec, sort_keys=True),
        "feasible": scenario.feasible,
        "best_m": scenario.truth.best_m,
        "true_box": np.array([*T_base_box[:3, 3], 0.0]),
        "true_dimensions_m": dimensions_m,
        **{f"true_{name}": getattr(scenario.truth, name) for name in TRUTHS},
    }


def _sight_columns(analysis: SceneAnalysis, scenario: Scenario) -> Row:
    box, numbers = analysis.context.box, analysis.context.numbers
    truth = candidate_truth(scenario.scene, analysis.context.candidates.T_base_gripper)
    row: Row = {
        "box": np.array([*box.T_base_box[:3, 3], box.yaw_rad]),
        "dimensions_m": box.dimensions_m,
        "passes": analysis.verdict.passing,
        **{name: getattr(numbers, name) for name in NUMBERS},
        **{f"true_{name}": getattr(truth, name) for name in TRUTHS},
    }
    for name in SAMPLINGS:
        local_map = analysis.context.local_maps[RESOLUTION_M[name]]
        row[name], row[f"{name}_portions"] = occupied_at(local_map, name)
    return row


def box_of(place: Array, dimensions_m: Array) -> Box:
    """The box of a row's columns."""
    return Box(readonly(make_transform(rotation_z(place[3]), place[:3])), readonly(dimensions_m))
