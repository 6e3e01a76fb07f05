"""One scenario as a row: its scene, its truth, what the code saw of it, and the operator's label.

Each scenario is answered twice. `given`: the target's points as they truly are (thesis 1-6 takes
the segmentation as given) and the aligned box: the thesis. `found`: the package as it ships, which
finds the object under a pixel by itself and may turn the box.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Any, ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Array, Points, readonly
from boxgrasp.errors import BoxgraspError, ConfigError
from boxgrasp.geometry import hand_distance
from boxgrasp.geometry.box import Box
from boxgrasp.geometry.transforms import make_transform, rotation_z
from boxgrasp.grasps.candidates import LINES
from boxgrasp.grasps.gripper import Gripper
from boxgrasp.perception.scene import Scene
from boxgrasp.perception.target import Target
from boxgrasp.ranking.model_set import SAMPLINGS, help_label
from boxgrasp.ranking.sampling import RESOLUTION_M
from boxgrasp.selector import GraspSelector, SceneAnalysis
from boxgrasp.sensing.capture import Capture
from boxgrasp.simulate.scenario import OPERATOR, Recipe, Scenario, draw_scenario
from boxgrasp.simulate.truth import candidate_truth, true_box
from boxgrasp.teaching.operators import Operator, Shown
from boxgrasp.teaching.samples import sample_states
from boxgrasp.teaching.stand_in import StandIn

TARGET_SOURCES = ("given", "found")
FITS = {"given": "aligned", "found": "yaw"}
MAP_RESOLUTIONS_M = tuple(sorted({RESOLUTION_M[name] for name in SAMPLINGS}))
# Columns of each candidate, and the checks whose values they hold.
CHECK_VALUES: Final = {
    "visible_clearance_m": "visible_clearance",
    "occluded_clearance_m": "occluded_clearance",
    "unseen_distance_m": "unseen_distance",
    "unseen_fraction": "unseen_fraction",
    "approach_clearance_m": "approach_clearance",
    "plane_clearance_m": "plane_clearance",
}
# Columns of each candidate, and the checks that say yes or no.
CHECK_FLAGS: Final = {"fits": "width", "width_known": "width_known"}
# Of each candidate, exact truth of its pose.
TRUTHS = ("clearance_m", "plane_clearance_m", "approach_clearance_m", "fits")

Row = dict[str, Any]
STAND_IN = StandIn()


@dataclass(frozen=True)
class RowConfig:
    """How rows are made.

    Attributes:
        recipe: of their scenes.
        seed: of the set.
        lines: l, lines a face.
        target_sources: where the target's points come from, `given`, `found` or both.
        runs: how often each scenario is seen, its noise drawn anew.
        frames: how many frames are fused in the map of each.
        stride: as `MappingConfig.stride`.

    Raises:
        ConfigError: a seed or a number of lines that cannot be.
    """

    recipe: Recipe
    seed: int
    lines: int = LINES
    target_sources: tuple[str, ...] = TARGET_SOURCES
    runs: int = 1
    frames: int = 1
    stride: int | None = None

    RENAMED: ClassVar[dict[str, str]] = {"sights": "target_sources", "thin": "stride"}

    def __post_init__(self) -> None:
        if not 0 <= self.seed < 2**63:  # the seed's column is int64
            raise ConfigError(f"seed is {self.seed}; valid: 0 to 2^63 - 1")
        if not 1 <= self.lines <= 99:
            raise ConfigError(f"lines is {self.lines}; valid: 1 to 99")


@dataclass(frozen=True, eq=False)
class ScenarioView:
    """One look at a scenario.

    Attributes:
        capture: the view.
        object_ids: (H, W) int32, the true object of each pixel.
        run: which drawing of the noise.
        scans: further frames, for the map alone.
    """

    capture: Capture
    object_ids: NDArray[np.int32]
    run: int = 0
    scans: Sequence[Capture] = ()


def row_of(config: RowConfig, number: int, operator: Operator = STAND_IN) -> Row:
    """A row of a set: its scenario drawn, cast, answered and labeled.

    Args:
        config: of the set.
        number: of the row.
        operator: who labels.

    Returns:
        Values by column.

    Raises:
        SceneError: a target that the objects do not have, or no such scene.
    """
    scenario = scenario_of_row(config, number // config.runs)
    return scenario_row(scenario, view_of_row(config, number), config, operator)


def view_of_row(config: RowConfig, number: int) -> ScenarioView:
    """What the camera sees of a row's scenario.

    Args:
        config: of the set.
        number: of the row.

    Returns:
        The view, with its further frames.

    Raises:
        SceneError: a target that the objects do not have, or no such scene.
    """
    number, run = divmod(number, config.runs)
    scenario = scenario_of_row(config, number)
    first = run * config.frames
    (capture, object_ids), *others = [
        scenario.capture(config.recipe.noise, first + k) for k in range(config.frames)
    ]
    return ScenarioView(capture, object_ids, run, [scan for scan, _ in others])


@lru_cache(maxsize=2)
def scenario_of_row(config: RowConfig, number: int) -> Scenario:
    """A scenario of a set; the last two are kept, as rows of its runs follow each other.

    Args:
        config: of the set.
        number: of the scenario.

    Returns:
        The scenario.

    Raises:
        SceneError: a target that the objects do not have, or no such scene.
    """
    return draw_scenario(config.recipe, config.seed, number, lines=config.lines)


def scenario_row(
    scenario: Scenario, view: ScenarioView, config: RowConfig, operator: Operator = STAND_IN
) -> Row:
    """The row of one view of a scenario.

    Args:
        scenario: scene and truth.
        view: of it.
        config: of the set.
        operator: who labels.

    Returns:
        Values by column.
    """
    row = {**_truth_columns(scenario), "run": view.run}
    scene: Scene | None = None
    given_obstacles: Points | None = None
    for source in config.target_sources:
        chosen = selector(source, config.lines, config.stride)
        mask = view.object_ids == scenario.scene.target_id
        target = Target(mask=mask) if source == "given" else None
        try:
            scene = scene or chosen.scene(view.capture)
            analysis = chosen.analyze(view.capture, target, view.scans, scene=scene)
        except BoxgraspError as error:
            row[f"{source}_error"] = str(error)
            continue
        if source == "given":
            given_obstacles = obstacle_points(analysis)
            label = operator.label(shown(analysis, chosen), scenario.rng(OPERATOR))
            said = help_label(config.lines) if label.label is None else label.label
            row |= {"label": said, "label_source": label.source}
        columns = analysis_columns(analysis, chosen.config.gripper, given_obstacles)
        truth = candidate_truth(scenario.scene, analysis.context.candidates.T_base_gripper)
        columns |= {f"true_{name}": getattr(truth, name) for name in TRUTHS}
        row |= {f"{source}_{name}": value for name, value in columns.items()}
    return row


def shown(analysis: SceneAnalysis, selector: GraspSelector) -> Shown:
    """What the operator is shown of a scene.

    Args:
        analysis: of it.
        selector: whose hand it is.

    Returns:
        Visible points, box and candidates.
    """
    return Shown(
        analysis.context.box,
        analysis.context.candidates,
        obstacle_points(analysis),
        float(analysis.context.box.base_center_m[2]),
        selector.config.gripper,
    )


@cache
def selector(
    target_source: str,
    lines: int,
    stride: int | None = None,
    map_resolutions_m: tuple[float, ...] = MAP_RESOLUTIONS_M,
) -> GraspSelector:
    """The selector that answers rows.

    Args:
        target_source: `given` or `found`.
        lines: l, lines a face.
        stride: as `MappingConfig.stride`.
        map_resolutions_m: cell sizes of the local maps, m.

    Returns:
        One a process for the same arguments.
    """
    return GraspSelector(
        {
            "box": {"fit": FITS[target_source]},
            "candidates": {"lines": lines, "refine": "none"},  # the thesis's poses
            "mapping": {"stride": stride},
        },
        map_resolutions_m=map_resolutions_m,
    )


def box_of(place: Array, dimensions_m: Array) -> Box:
    """The box of a row's columns.

    Args:
        place: (4,) x, y, z of its center, base frame, m, and its yaw, radians.
        dimensions_m: (3,) along its x, y, z, m.

    Returns:
        The box.
    """
    return Box(readonly(make_transform(rotation_z(place[3]), place[:3])), readonly(dimensions_m))


def obstacle_points(analysis: SceneAnalysis) -> Points:
    """What is in the way.

    Args:
        analysis: of a scene.

    Returns:
        (N, 3) float32, base frame, m.
    """
    return np.ascontiguousarray(analysis.scene.points[analysis.target_points.obstacle_mask])


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


def analysis_columns(
    analysis: SceneAnalysis, gripper: Gripper, obstacles: Points | None = None
) -> Row:
    """What the code saw of a scene, a scenario's or a capture's: truth apart.

    Args:
        analysis: of it.
        gripper: the hand.
        obstacles: (N, 3) float32, base frame, m, by which the thesis's clearance is measured; None
            leaves that out.

    Returns:
        Values by column, whose names lack the source of the target's points.
    """
    context = analysis.context
    row: Row = {
        "box": np.array([*context.box.T_base_box[:3, 3], context.box.yaw_rad]),
        "dimensions_m": context.box.dimensions_m,
        "passes": analysis.passing,
        **{column: context.result(check).value for column, check in CHECK_VALUES.items()},
        **{column: context.result(check).passed for column, check in CHECK_FLAGS.items()},
    }
    if obstacles is not None:
        hands = hand_distance.uprights(context.candidates.T_base_gripper, gripper.half_m)
        row["thesis_clearance_m"] = hand_distance.to_points(hands, obstacles)[0]
    for name in SAMPLINGS:
        local_map = context.local_maps[RESOLUTION_M[name]]
        row[name], row[f"{name}_portions"] = sample_states(local_map, name)
    return row
