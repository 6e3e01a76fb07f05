"""A scene of a set, cast again so that it can be drawn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from boxgrasp.arrays import Floats, Points
from boxgrasp.draw.clouds import Cloud, base_cloud
from boxgrasp.forks import cached_property
from boxgrasp.geometry import hand_distance
from boxgrasp.geometry.box import Box
from boxgrasp.grasps.candidates import LINES, candidates_of, face_name
from boxgrasp.grasps.gripper import Gripper
from boxgrasp.mapping.local_map import LocalMap
from boxgrasp.perception.target import Target
from boxgrasp.result import Candidate, TargetBox
from boxgrasp.selector import SceneAnalysis
from boxgrasp.sensing.capture import Capture
from boxgrasp.simulate.scenario import NOISE, NOISES
from boxgrasp.simulate.scenes import to_capture
from boxgrasp.study.study import Study
from boxgrasp.teaching.rows import RowConfig, scenario_of_row, selector

_SHADING = 0.4  # of the picture's colors, so that edges are seen; depth is as in the set


@dataclass(frozen=True, eq=False)
class Seen:
    """A scene with what the code made of it.

    Attributes:
        capture: the view, its colors shaded and without noise.
        analysis: of it, target points and aligned box given.
    """

    capture: Capture
    analysis: SceneAnalysis

    @property
    def box(self) -> Box:
        """The target's box."""
        return self.analysis.context.box

    @property
    def target_box(self) -> TargetBox:
        """The same, as pictures take it."""
        box = self.box
        return TargetBox(box.T_base_box, box.dimensions_m, box.dimensions_m, box.dimensions_m)

    @property
    def floor_m(self) -> float:
        """Height of the support, base frame."""
        return float(self.box.base_center_m[2])

    @cached_property
    def cloud(self) -> Cloud:
        """The visible points, base frame."""
        return base_cloud(self.capture, self.analysis.scene.T_base_camera)

    @property
    def obstacle_points(self) -> Points:
        """(N, 3) float32, base frame, m, visible points of what is in the way."""
        kept = self.analysis.target_points.obstacle_mask
        return np.ascontiguousarray(self.analysis.scene.points[kept])

    def local_map(self, resolution_m: float) -> LocalMap:
        """The map round the target.

        Args:
            resolution_m: edge of its cells, one of the set's, m.

        Returns:
            The map.
        """
        return self.analysis.context.local_maps[resolution_m]

    def candidates(self, lines: int = LINES) -> tuple[Candidate, ...]:
        """The candidates of the box, without checks.

        Args:
            lines: l, lines a face.

        Returns:
            5 l of them, by label.
        """
        every = candidates_of(self.box, Gripper(), lines)
        columns = (every.label, every.face, every.line, every.width_m)
        found = zip(*(column.tolist() for column in columns), strict=True)
        return tuple(
            Candidate(label, face, line, label, every.T_base_gripper[k], width_m, {})
            for k, (label, face, line, width_m) in enumerate(found)
        )

    def nearest_obstacle(self, candidate: Candidate) -> tuple[float, Floats | None]:
        """What lies nearest to the hand's box at a candidate (thesis 3-4).

        Args:
            candidate: one of `candidates`.

        Returns:
            d to the nearest visible obstacle point, m, and the point, (3,) base frame, m; None
            where none is near.
        """
        hands = hand_distance.uprights(candidate.T_base_gripper[None], Gripper().half_m)
        distance_m, row = hand_distance.to_points(hands, self.obstacle_points)
        point = None if row[0] < 0 else np.asarray(self.obstacle_points[row[0]], np.float64)
        return float(distance_m[0]), point


def see(config: RowConfig, number: int, run: int = 0) -> Seen:
    """Cast a scene of a set again.

    Args:
        config: how the set's rows are made.
        number: of the scenario.
        run: which of its runs.

    Returns:
        The scene with the same depth and the same decision as the row's.

    Raises:
        SceneError: a target that the objects do not have, or no such scene.
    """
    scenario = scenario_of_row(config, number)
    model = NOISES[config.recipe.noise]
    first = run * config.frames
    noise = False if model is None else model
    capture, object_ids = to_capture(scenario.scene, scenario.rng(NOISE, first), noise)
    # Colors decide nothing; with their noise a picture would be ten times as large.
    capture = replace(capture, rgb=scenario.scene.view(shading=_SHADING).rgb)
    target = Target(mask=object_ids == scenario.scene.target_id)
    analysis = selector("given", config.lines, config.stride).analyze(capture, target)
    return Seen(capture, analysis)


def see_row(study: Study, name: str, row: int) -> Seen:
    """Cast a row of a study's set again.

    Args:
        study: whose set it is.
        name: of the set.
        row: its index.

    Returns:
        The scene.
    """
    rows = study.rows(name)
    return see(study.sets()[name].rows, int(rows["number"][row]), int(rows["run"][row]))


def pick_words(pick: int, lines: int = LINES) -> str:
    """A candidate in words.

    Args:
        pick: its index.
        lines: l, lines a face.

    Returns:
        As the thesis has it: `right face, line 3`.
    """
    return f"{face_name(pick // lines + 1)} face, line {pick % lines + 1}"


def counted(picks: Sequence[int]) -> list[tuple[int, int]]:
    """Decisions with how often each was taken.

    Args:
        picks: candidate indices.

    Returns:
        Index and count, the commonest first, then by index.
    """
    values, counts = np.unique(np.asarray(picks), return_counts=True)
    order = np.lexsort((values, -counts))
    return [(int(values[k]), int(counts[k])) for k in order]
