"""Rows to feature matrices, exactly the features of `boxgrasp.ranking.features`, many at once."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise

import numpy as np

from boxgrasp.arrays import Array, Floats, Points
from boxgrasp.ranking.features import FACE_FEATURE
from boxgrasp.ranking.sampling import is_side, portion, sampling

FACES = range(1, 6)


def largest_edge_m(rows: Mapping[str, Array], target_source: str = "given") -> float:
    """The longest box edge of a training set, by which dimensions are normalized (3-3-2)."""
    return float(np.max(rows[f"{target_source}_dimensions_m"]))


def single_matrix(
    rows: Mapping[str, Array], target_source: str, name: str, edge_m: float | None
) -> Points:
    """(N, P + 3) float32, features of the single model and of the cascade's first."""
    return np.hstack(
        (_occupancy(rows[f"{target_source}_{name}"]), _dimensions(rows, target_source, edge_m))
    )


def line_matrix(
    rows: Mapping[str, Array], target_source: str, name: str, edge_m: float | None, face: int
) -> Points:
    """(N, p + 4) float32, features of the cascade's second models on one face."""
    ends = np.cumsum([0, *(len(portion(sampling(name), k)) for k in FACES)])
    first, last = list(pairwise(ends.tolist()))[face - 1]
    part = _occupancy(rows[f"{target_source}_{name}_portions"][:, first:last])
    kind = np.full((len(part), 1), FACE_FEATURE[face], dtype=np.float32)
    return np.hstack((part, _dimensions(rows, target_source, edge_m), kind))


def line_examples(
    rows: Mapping[str, Array],
    target_source: str,
    name: str,
    edge_m: float | None,
    faces: Array,
    part: str,
) -> tuple[Points, Array]:
    """Features of each row on its own face, of the rows whose face is of the part; and which rows.

    faces: (N,) the face of each row; part: `side` or `top`.
    """
    rows_of = np.flatnonzero([is_side(face) == (part == "side") for face in faces.tolist()])
    found = {
        face: line_matrix(rows, target_source, name, edge_m, face) for face in set(faces[rows_of])
    }
    if not found:
        return np.empty((0, 0), dtype=np.float32), rows_of
    return np.array([found[faces[k]][k] for k in rows_of]), rows_of


def _occupancy(states: Array) -> Points:
    return np.asarray(states, dtype=np.float32) * np.float32(0.5)


def _dimensions(rows: Mapping[str, Array], target_source: str, edge_m: float | None) -> Points:
    size: Floats = rows[f"{target_source}_dimensions_m"]
    edge = size.max(axis=1, keepdims=True) if edge_m is None else edge_m
    return np.minimum(size / edge, 1.0).astype(np.float32)
