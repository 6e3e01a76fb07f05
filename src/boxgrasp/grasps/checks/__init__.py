"""Numbers and reasons for every candidate, the same for every ranker."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from boxgrasp.arrays import Floats
from boxgrasp.errors import GripperError
from boxgrasp.geometry import hand_distance
from boxgrasp.geometry.box import Box
from boxgrasp.grasps.candidates import FACES, Candidates
from boxgrasp.grasps.gripper import Gripper
from boxgrasp.kernels.uprights import filled_shares
from boxgrasp.mapping.local_map import FREE, LocalMap
from boxgrasp.mapping.unseen_space import columns_under, deepened, unseen_cells
from boxgrasp.perception.scene import Scene

Short = Annotated[float, Meta(ge=0.0, le=0.5)]


@dataclass(frozen=True)
class ChecksConfig:
    """What a candidate must keep, meters.

    clearance_m: to seen obstacles (thesis: 2 cm is feasible), beside noise_m for sensor noise.
    occluded_clearance_m: to the hidden bodies under seen surfaces. unseen_distance_m: to space that no ray crossed.
    unseen_fraction: how much of the gripper's space, grown by clearance_m, may be unseen.
    pregrasp_distance_m: how far back the way in is checked; approach_clearance_m: room along it to seen
    obstacles and hidden bodies. plane_clearance_m: off the support plane. width_m: how much narrower
    than the opening the target must be.
    """

    clearance_m: Short = 0.02
    noise_m: Short = 0.003
    occluded_clearance_m: Short = 0.02
    unseen_distance_m: Short = 0.0
    unseen_fraction: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.25
    pregrasp_distance_m: Short = 0.15
    approach_clearance_m: Short = 0.005
    plane_clearance_m: Annotated[float, Meta(ge=-0.5, le=0.5)] = 0.003
    width_m: Short = 0.003


@dataclass(frozen=True, eq=False)
class Numbers:
    """(M,) arrays over the candidates, meters capped at 0.50; see `ChecksConfig` for the words.

    nearest: row of the nearest obstacle point, -1 for none; fits: whether the target goes
    between the fingers; known: whether its width there is known.
    """

    visible_clearance_m: Floats
    occluded_clearance_m: Floats
    unseen_distance_m: Floats
    unseen_fraction: Floats
    plane_clearance_m: Floats
    approach_clearance_m: Floats
    fits: NDArray[np.bool_]
    known: NDArray[np.bool_]
    nearest: NDArray[np.int64]
    nearest_on_way: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Verdict:
    """rejected: a reason or None, a candidate each; short_m: how much each lacks in all, meters."""

    rejected: tuple[str | None, ...]
    short_m: Floats

    @property
    def passing(self) -> NDArray[np.bool_]:
        """(M,) whether nothing speaks against the candidate."""
        return np.array([reason is None for reason in self.rejected])


def measure(
    candidates: Candidates,
    gripper: Gripper,
    box: Box,
    scene: Scene,
    others: NDArray[np.bool_],
    extra_cells: tuple[Floats, Floats],
    local_map: LocalMap,
    width_known: tuple[bool, bool],
    config: ChecksConfig,
) -> Numbers:
    """All distances of all candidates.

    others: (K,) which of the scene's points are obstacles. extra_cells:
    centers (K, 3) and edges (K,) of occupied cells that no point explains. width_known: whether
    the box's x and y dimensions are more than lower bounds.

    Raises:
        GripperError: the fingers cannot open wider than the margin.
    """
    if gripper.max_opening_m <= config.width_m:
        raise GripperError(
            f"gripper max_opening_m {gripper.max_opening_m} cannot hold anything: check.width_m is "
            f"{config.width_m}; valid: a wider opening"
        )
    T = candidates.T_base_gripper
    obstacles = np.ascontiguousarray(scene.points[others])
    boxes = hand_distance.uprights(T, gripper.half_m)
    swept = hand_distance.uprights(T, gripper.half_m, config.pregrasp_distance_m)
    columns = np.vstack(
        (
            columns_under(obstacles, local_map, scene.plane),
            deepened(scene, others, box, local_map),
        )
    )
    seen, nearest = hand_distance.to_points(boxes, obstacles)
    body, _ = hand_distance.to_columns(boxes, columns)
    approach, on_way = hand_distance.to_columns(swept, columns)
    if len(extra_cells[0]):
        seen = np.minimum(seen, hand_distance.to_cells(boxes, *extra_cells, 0.0))
        approach = np.minimum(approach, hand_distance.to_cells(swept, *extra_cells, 0.0))
    body = np.minimum(body, seen)
    unseen = unseen_cells(local_map, box)
    sizes = np.full(len(unseen), local_map.resolution_m)
    share = filled_shares(boxes, unseen, local_map.resolution_m, config.clearance_m)
    if not np.any(local_map.state == FREE):  # no camera is known: the answer warns instead
        share = np.zeros(len(boxes))
    return Numbers(
        visible_clearance_m=seen,
        occluded_clearance_m=body,
        unseen_distance_m=np.minimum(
            body, hand_distance.to_cells(boxes, unseen, sizes, box.yaw_rad)
        ),
        unseen_fraction=share,
        plane_clearance_m=hand_distance.to_plane(boxes, scene.plane.normal, scene.plane.offset_m),
        approach_clearance_m=approach,
        fits=candidates.width_m <= gripper.max_opening_m - config.width_m,
        known=np.array(width_known)[candidates.width_axis],
        nearest=nearest,
        nearest_on_way=on_way,
    )


def judge(
    candidates: Candidates,
    numbers: Numbers,
    gripper: Gripper,
    scene: Scene,
    labels: NDArray[np.int64],
    faces: tuple[str, ...],
    config: ChecksConfig,
) -> Verdict:
    """Each candidate's reason to fall out, or None. labels: (N,) object number of each obstacle."""
    reasons: list[str | None] = []
    need = config.clearance_m + config.noise_m
    limits = (
        (numbers.plane_clearance_m, config.plane_clearance_m),
        (numbers.visible_clearance_m, need),
        (numbers.approach_clearance_m, config.approach_clearance_m),
        (numbers.occluded_clearance_m, config.occluded_clearance_m),
        (numbers.unseen_distance_m, config.unseen_distance_m),
    )
    short = sum(
        (np.maximum(limit - value, 0.0) for value, limit in limits), np.zeros(len(candidates.label))
    )
    short = short + np.maximum(candidates.width_m - gripper.max_opening_m + config.width_m, 0.0)
    short = short + np.where(numbers.known, 0.0, 0.2)
    short = short + 0.1 * np.maximum(numbers.unseen_fraction - config.unseen_fraction, 0.0)
    for k in range(len(candidates.label)):
        found = []
        if FACES[candidates.face[k] - 1] not in faces:
            found.append("face not allowed")
            short[k] += 1.0
        if not numbers.fits[k]:
            found.append(
                f"target {_cm(candidates.width_m[k])} wide, opening {_cm(gripper.max_opening_m)}"
                f" less {_cm(config.width_m)}"
            )
        elif not numbers.known[k]:
            found.append("width unknown")
        if numbers.plane_clearance_m[k] < config.plane_clearance_m:
            found.append(f"support plane {_cm(numbers.plane_clearance_m[k])}")
        if numbers.visible_clearance_m[k] < need:
            what = _what(labels, numbers.nearest[k])
            found.append(f"{what} {_cm(numbers.visible_clearance_m[k])}, needs {_cm(need)}")
        elif numbers.occluded_clearance_m[k] < config.occluded_clearance_m:
            found.append(
                f"hidden side of an obstacle {_cm(numbers.occluded_clearance_m[k])}, needs {_cm(config.occluded_clearance_m)}"
            )
        if numbers.approach_clearance_m[k] < config.approach_clearance_m:
            what = _what(labels, numbers.nearest_on_way[k])
            found.append(f"approach: {what} {_cm(numbers.approach_clearance_m[k])}")
        if numbers.unseen_distance_m[k] < config.unseen_distance_m:
            found.append(
                f"unseen space {_cm(numbers.unseen_distance_m[k])}, needs {_cm(config.unseen_distance_m)}"
            )
        if numbers.unseen_fraction[k] > config.unseen_fraction:
            found.append(
                f"unseen space fills {numbers.unseen_fraction[k]:.0%} of the gripper's room, "
                f"at most {config.unseen_fraction:.0%}"
            )
        reasons.append("; ".join(found) or None)
    return Verdict(tuple(reasons), short)


def _what(labels: NDArray[np.int64], row: int) -> str:
    if row < 0:
        return "occupied cell of the map"
    if row >= len(labels):
        return "hidden side of an obstacle"
    return f"object {labels[row]}" if labels[row] > 0 else "obstacle"


def _cm(meters: float) -> str:
    return f"{meters * 100:.1f} cm"
