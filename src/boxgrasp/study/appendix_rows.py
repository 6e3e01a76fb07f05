"""Views of a study's scenes segmented as in appendix A, and what follows for box and decision.

Of such a view the box alone differs from that of given points: the map is made of all points of the
view, as the thesis's OctoMap was, and the samples are read round the box's own base.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Array, Bools, Floats, Points
from boxgrasp.geometry import hand_distance
from boxgrasp.geometry.box import Box
from boxgrasp.geometry.plane import Plane
from boxgrasp.geometry.transforms import invert, transform
from boxgrasp.grasps.candidates import candidates_of
from boxgrasp.grasps.gripper import Gripper
from boxgrasp.mapping.local_map import MappingConfig
from boxgrasp.mapping.ray_insertion import build_local_map
from boxgrasp.perception.box_fit import BoxConfig, fit_box
from boxgrasp.ranking.sampling import RESOLUTION_M
from boxgrasp.simulate.scenario import Scenario
from boxgrasp.simulate.truth import candidate_truth, true_box
from boxgrasp.study.appendix_a import Stages, cluster_with, segmented
from boxgrasp.teaching.rows import TRUTHS, RowConfig, scenario_of_row
from boxgrasp.teaching.samples import sample_states

# What is left of the target after each; the first is all of it that the view shows.
LEFT_AFTER: Final = ("view", "pass-through and voxels", "plane", "trimming", "cluster")
# Points after each stage, of the whole view.
COUNTED: Final = (
    *("view", "pass-through", "voxels", "table", "table, trimmed", "nontable"),
    *("nontable, trimmed", "in clusters"),
)
NOT_COUNTED: Final = -1
FEWEST_ON_TARGET: Final = 3  # points of which a box can be made
_ALIGNED = BoxConfig(fit="aligned")
_LOST = np.full(3, np.nan)


@dataclass(frozen=True, eq=False)
class SegmentedView:
    """One view of a scenario, segmented.

    Attributes:
        points: (N, 3) float32, all points of the view, camera frame, m.
        stages: what each stage leaves.
        ids: (V,) int64, which true object most of each voxel's points show.
        seen: (N,) bool, the points that truly show the target.
        cluster: (V,) bool, the cluster that was selected.
        T_base_camera: (4, 4).
    """

    points: Points
    stages: Stages
    ids: NDArray[np.int64]
    seen: Bools
    cluster: Bools
    T_base_camera: Floats

    def box(self, points: Points) -> Box | None:
        """The aligned box round some points, standing on the main plane.

        Args:
            points: (N, 3) float32, camera frame, m.

        Returns:
            As for given points; None round fewer than three.
        """
        if len(points) < FEWEST_ON_TARGET:
            return None
        ahead = self.T_base_camera[:2, 2]
        heading_rad = float(np.arctan2(ahead[1], ahead[0]))
        plane: Plane = self.stages.plane.moved(self.T_base_camera)
        return fit_box(transform(self.T_base_camera, points), plane, heading_rad, _ALIGNED)

    def boxes(self, target_id: int) -> tuple[Box | None, ...]:
        """The box round what is left of the target, after each of `LEFT_AFTER`.

        Args:
            target_id: its number.

        Returns:
            A box each, None where too little is left; the last one is of the cluster, whatever
            else is in it.
        """
        own, stages = self.ids == target_id, self.stages
        parts = (own, own & ~stages.on_plane, own & stages.kept, self.cluster)
        return (self.box(self.points[self.seen]), *(self.box(stages.points[p]) for p in parts))


def segmented_view(scenario: Scenario, noise: str, run: int) -> SegmentedView:
    """A view of a scenario, segmented as in appendix A.

    Args:
        scenario: any.
        noise: of the sensor.
        run: which drawing of it.

    Returns:
        The view.

    Raises:
        SceneError: no points in range, or no plane.
    """
    capture, object_ids = scenario.capture(noise, run)
    points, pixels = capture.valid_points()
    shown = object_ids.reshape(-1)[pixels].astype(np.int64)
    stages = segmented(points)
    ids = _majority(stages.voxel_of, shown, len(stages.points))
    target_id = scenario.scene.target_id
    return SegmentedView(
        points=points,
        stages=stages,
        ids=ids,
        seen=np.asarray(shown == target_id),
        cluster=cluster_with(stages.clusters, ids == target_id),
        T_base_camera=np.asarray(capture.T_base_camera),
    )


def appendix_part(task: tuple[RowConfig, range]) -> bytes:
    """Some scenarios in all their runs, segmented as in appendix A; a task of its own.

    Args:
        task: how rows are made, and the scenarios' numbers.

    Returns:
        A .npz of columns, each (scenarios * runs, ...).
    """
    config, numbers = task
    rows = [
        _row(scenario_of_row(config, number), config, run, number == numbers[0] and run == 0)
        for number in numbers
        for run in range(config.runs)
    ]
    out = io.BytesIO()
    columns: dict[str, Any] = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    np.savez_compressed(out, **columns)
    return out.getvalue()


def read_appendix(parts: list[bytes]) -> Mapping[str, Array]:
    """The parts put together.

    Args:
        parts: of `appendix_part`.

    Returns:
        Columns as a set's rows have them, of the sources `appendix` (the cluster's box) and `exact`
        (the true box, in the same map of the same view).
    """
    loaded = [np.load(io.BytesIO(data), allow_pickle=False) for data in parts]
    return {name: np.concatenate([part[name] for part in loaded]) for name in loaded[0].files}


def _majority(voxel_of: NDArray[np.int64], shown: NDArray[np.int64], count: int) -> Array:
    """(V,) of each voxel the object that most of its points show."""
    within = voxel_of >= 0
    kinds = int(shown.max()) + 1
    table = np.bincount(voxel_of[within] * kinds + shown[within], minlength=count * kinds)
    return np.asarray(table.reshape(count, kinds).argmax(axis=1))


def _row(scenario: Scenario, config: RowConfig, run: int, with_table: bool) -> dict[str, Any]:
    view = segmented_view(scenario, config.recipe.noise, run)
    target_id, stages = scenario.scene.target_id, view.stages
    exact = Box(*true_box(scenario.scene, mode="aligned"))
    boxes = view.boxes(target_id)
    box = boxes[-1]
    sizes = np.array([_LOST if item is None else item.dimensions_m for item in boxes])
    others = np.isin(view.ids, scenario.scene.obstacle_ids)
    return {
        "appendix_points": _counts(stages, with_table),
        "appendix_clusters": stages.clusters.max() + 1,
        "appendix_short_m": exact.dimensions_m - sizes,
        "appendix_moved_m": np.array([_moved(item, exact) for item in boxes]),
        "appendix_foreign": int((others & view.cluster).sum()) / max(1, int(view.cluster.sum())),
        "appendix_error": "" if box is not None else "no cluster has the target",
        **_decided("appendix", exact if box is None else box, scenario, view, config),
        **_decided("exact", exact, scenario, view, config),
    }


def _moved(box: Box | None, exact: Box) -> Floats:
    """(3,) from the true middle to the box's, m."""
    if box is None:
        return _LOST
    return np.asarray(box.T_base_box[:3, 3] - exact.T_base_box[:3, 3])


def _counts(stages: Stages, with_table: bool) -> NDArray[np.int64]:
    """(8,) points after each stage of `COUNTED`; to trim the table costs most, so few views do."""
    return np.array(
        [
            len(stages.voxel_of),
            int((stages.voxel_of >= 0).sum()),
            len(stages.points),
            int(stages.on_plane.sum()),
            int(stages.table_kept.sum()) if with_table else NOT_COUNTED,
            int((~stages.on_plane).sum()),
            int(stages.kept.sum()),
            int((stages.clusters >= 0).sum()),
        ]
    )


def _decided(
    source: str, box: Box, scenario: Scenario, view: SegmentedView, config: RowConfig
) -> dict[str, Any]:
    """What a box comes to: the columns that models and metrics read."""
    hand = Gripper()
    cells = replace(MappingConfig(), resolution_m=RESOLUTION_M["grid"])
    T_camera_map = invert(view.T_base_camera) @ box.T_base_map()
    rays = [(view.points[:: config.stride], np.zeros(3))]
    states = sample_states(build_local_map(rays, T_camera_map, cells), "grid")
    poses = candidates_of(box, hand, config.lines).T_base_gripper
    truth = candidate_truth(scenario.scene, poses)
    stages = view.stages
    obstacles = ~stages.on_plane & np.isin(view.ids, scenario.scene.obstacle_ids)
    visible = transform(view.T_base_camera, stages.points[obstacles])
    hands = hand_distance.uprights(poses, hand.half_m)
    columns = {
        "box": np.array([*box.T_base_box[:3, 3], box.yaw_rad]),
        "dimensions_m": box.dimensions_m,
        "grid": states[0],
        "grid_portions": states[1],
        "passes": np.zeros(len(poses), dtype=np.bool_),  # no check is asked here
        "thesis_clearance_m": hand_distance.to_points(hands, visible)[0],
        **{f"true_{name}": getattr(truth, name) for name in TRUTHS},
    }
    return {f"{source}_{name}": value for name, value in columns.items()}
