"""Numbers and reasons for every option, the same for every chooser."""

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
from boxgrasp.grasps.candidates import FACES, Options
from boxgrasp.grasps.gripper import Gripper
from boxgrasp.kernels.uprights import filled_shares
from boxgrasp.mapping.local_map import FREE, LocalMap
from boxgrasp.mapping.unseen_space import columns_under, deepened, unseen_cells
from boxgrasp.perception.scene import Scene

Short = Annotated[float, Meta(ge=0.0, le=0.5)]


@dataclass(frozen=True)
class CheckConfig:
    """What an option must keep, meters.

    clearance_m: to seen obstacles (thesis: 2 cm is feasible), beside noise_m for sensor noise.
    body_m: to the hidden bodies under seen surfaces. unseen_m: to space that no ray crossed.
    unseen_share: how much of the gripper's space, grown by clearance_m, may be unseen.
    approach_back_m: how far back the way in is checked; approach_m: room along it to seen
    obstacles and hidden bodies. support_m: off the support plane. width_m: how much narrower
    than the opening the target must be.
    """

    clearance_m: Short = 0.02
    noise_m: Short = 0.003
    body_m: Short = 0.02
    unseen_m: Short = 0.0
    unseen_share: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.25
    approach_back_m: Short = 0.15
    approach_m: Short = 0.005
    support_m: Annotated[float, Meta(ge=-0.5, le=0.5)] = 0.003
    width_m: Short = 0.003


@dataclass(frozen=True, eq=False)
class Numbers:
    """(M,) arrays over the options, meters capped at 0.50; see `CheckConfig` for the words.

    nearest: row of the nearest obstacle point, -1 for none; fits: whether the target goes
    between the fingers; known: whether its width there is known.
    """

    seen_m: Floats
    body_m: Floats
    unseen_m: Floats
    unseen_share: Floats
    support_m: Floats
    approach_m: Floats
    fits: NDArray[np.bool_]
    known: NDArray[np.bool_]
    nearest: NDArray[np.int64]
    nearest_on_way: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Verdict:
    """rejected: a reason or None, an option each; short_m: how much each lacks in all, meters."""

    rejected: tuple[str | None, ...]
    short_m: Floats

    @property
    def passing(self) -> NDArray[np.bool_]:
        """(M,) whether nothing speaks against the option."""
        return np.array([reason is None for reason in self.rejected])


def measure(
    options: Options,
    gripper: Gripper,
    box: Box,
    scene: Scene,
    others: NDArray[np.bool_],
    extra_cells: tuple[Floats, Floats],
    local_map: LocalMap,
    width_known: tuple[bool, bool],
    config: CheckConfig,
) -> Numbers:
    """All distances of all options.

    others: (K,) which of the scene's points are obstacles. extra_cells:
    centers (K, 3) and edges (K,) of occupied cells that no point explains. width_known: whether
    the box's x and y dimensions are more than lower bounds.

    Raises:
        GripperError: the fingers cannot open wider than the margin.
    """
    if gripper.opening_m <= config.width_m:
        raise GripperError(
            f"gripper opening_m {gripper.opening_m} cannot hold anything: check.width_m is "
            f"{config.width_m}; valid: a wider opening"
        )
    T = options.T_base_gripper
    obstacles = np.ascontiguousarray(scene.points[others])
    boxes = hand_distance.uprights(T, gripper.half_m)
    swept = hand_distance.uprights(T, gripper.half_m, config.approach_back_m)
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
        seen_m=seen,
        body_m=body,
        unseen_m=np.minimum(body, hand_distance.to_cells(boxes, unseen, sizes, box.yaw_rad)),
        unseen_share=share,
        support_m=hand_distance.to_plane(boxes, scene.plane.normal, scene.plane.offset_m),
        approach_m=approach,
        fits=options.width_m <= gripper.opening_m - config.width_m,
        known=np.array(width_known)[options.width_axis],
        nearest=nearest,
        nearest_on_way=on_way,
    )


def judge(
    options: Options,
    numbers: Numbers,
    gripper: Gripper,
    scene: Scene,
    labels: NDArray[np.int64],
    faces: tuple[str, ...],
    config: CheckConfig,
) -> Verdict:
    """Each option's reason to fall out, or None. labels: (N,) object number of each obstacle."""
    reasons: list[str | None] = []
    need = config.clearance_m + config.noise_m
    limits = (
        (numbers.support_m, config.support_m),
        (numbers.seen_m, need),
        (numbers.approach_m, config.approach_m),
        (numbers.body_m, config.body_m),
        (numbers.unseen_m, config.unseen_m),
    )
    short = sum(
        (np.maximum(limit - value, 0.0) for value, limit in limits), np.zeros(len(options.label))
    )
    short = short + np.maximum(options.width_m - gripper.opening_m + config.width_m, 0.0)
    short = short + np.where(numbers.known, 0.0, 0.2)
    short = short + 0.1 * np.maximum(numbers.unseen_share - config.unseen_share, 0.0)
    for k in range(len(options.label)):
        found = []
        if FACES[options.face[k] - 1] not in faces:
            found.append("face not allowed")
            short[k] += 1.0
        if not numbers.fits[k]:
            found.append(
                f"target {_cm(options.width_m[k])} wide, opening {_cm(gripper.opening_m)}"
                f" less {_cm(config.width_m)}"
            )
        elif not numbers.known[k]:
            found.append("width unknown")
        if numbers.support_m[k] < config.support_m:
            found.append(f"support plane {_cm(numbers.support_m[k])}")
        if numbers.seen_m[k] < need:
            what = _what(labels, numbers.nearest[k])
            found.append(f"{what} {_cm(numbers.seen_m[k])}, needs {_cm(need)}")
        elif numbers.body_m[k] < config.body_m:
            found.append(
                f"hidden side of an obstacle {_cm(numbers.body_m[k])}, needs {_cm(config.body_m)}"
            )
        if numbers.approach_m[k] < config.approach_m:
            what = _what(labels, numbers.nearest_on_way[k])
            found.append(f"approach: {what} {_cm(numbers.approach_m[k])}")
        if numbers.unseen_m[k] < config.unseen_m:
            found.append(f"unseen space {_cm(numbers.unseen_m[k])}, needs {_cm(config.unseen_m)}")
        if numbers.unseen_share[k] > config.unseen_share:
            found.append(
                f"unseen space fills {numbers.unseen_share[k]:.0%} of the gripper's room, "
                f"at most {config.unseen_share:.0%}"
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
