"""What rows keep of the local maps: a state a sample, and how models see it again."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Array, Floats, Points
from boxgrasp.mapping.local_map import LocalMap
from boxgrasp.ranking.model_set import FACE_NUMBERS, SampledScenes
from boxgrasp.ranking.sampling import portion, sampling

States = NDArray[np.uint8]


@cache
def sample_points(name: str) -> tuple[Floats, Floats]:
    """Where a sampling's states are read.

    Args:
        name: of the sampling.

    Returns:
        (P, 3) its points, and the portions of faces 1 to 5 one after the other (3-2-2), map
        frame, m.

    Raises:
        ConfigError: another name.
    """
    points = sampling(name)
    return points, np.concatenate([portion(points, face) for face in FACE_NUMBERS])


def sample_states(local_map: LocalMap, name: str) -> tuple[States, States]:
    """The states of a sampling's points and portions, as rows keep them.

    Args:
        local_map: round the target.
        name: of the sampling.

    Returns:
        For both arrays of `sample_points`, uint8: 0 free, 1 unseen, 2 occupied.

    Raises:
        ConfigError: another name.
    """
    whole, portions = sample_points(name)
    return states_at(local_map, whole), states_at(local_map, portions)


def states_at(local_map: LocalMap, points: Floats) -> States:
    """The states of some places.

    Args:
        local_map: round the target.
        points: (N, 3), map frame, m.

    Returns:
        (N,) uint8: 0 free, 1 unseen, 2 occupied.
    """
    return np.asarray((2 * local_map.values_at(points)).astype(np.uint8))


def occupancy_of(states: Array) -> Points:
    """States as features.

    Args:
        states: uint8: 0 free, 1 unseen, 2 occupied.

    Returns:
        float32 of the same shape: 0, 0.5, 1.
    """
    return np.asarray(states, dtype=np.float32) * np.float32(0.5)


def sampled_scenes(rows: Mapping[str, Array], target_source: str, name: str) -> SampledScenes:
    """What a model is shown of each row.

    Args:
        rows: columns by name.
        target_source: `given` or `found`.
        name: of the sampling.

    Returns:
        A scene a row.
    """
    sizes = [len(portion(sampling(name), face)) for face in FACE_NUMBERS]
    portions = np.split(rows[f"{target_source}_{name}_portions"], np.cumsum(sizes)[:-1], axis=1)
    return SampledScenes(
        occupancy_of(rows[f"{target_source}_{name}"]),
        {face: occupancy_of(part) for face, part in zip(FACE_NUMBERS, portions, strict=True)},
        rows[f"{target_source}_dimensions_m"],
    )


def largest_edge_m(rows: Mapping[str, Array], target_source: str = "given") -> float:
    """The longest box edge of a training set, by which dimensions are normalized (3-3-2).

    Args:
        rows: columns by name.
        target_source: `given` or `found`.

    Returns:
        m.
    """
    return float(np.max(rows[f"{target_source}_dimensions_m"]))
