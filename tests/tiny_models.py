"""Small SVMs on made-up labels with the right features, for tests of files and rankers."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from boxgrasp.grasps.gripper import Gripper
from boxgrasp.ranking.features import FeatureSchema
from boxgrasp.ranking.model_set import SVMS
from boxgrasp.ranking.onnx.record import Record
from boxgrasp.ranking.sampling import RESOLUTION_M


def record_of(svc: Any, schema: FeatureSchema, **other: Any) -> Record:
    """The record of a trained SVC; `other` wins."""
    told: dict[str, Any] = {
        "version": "single-grid",
        "part": "single",
        "sampling": "grid",
        "resolution_m": 0.07,
        "lines": 3,
        "largest_edge_m": 0.25,
        "features": schema.names,
        "schema_hash": schema.hash,
        "classes": tuple(int(c) for c in svc.classes_),
        "gripper": Gripper(),
        "object_set": "known",
        "seeds": (1,),
        "label_source": "chance",
        "versions": {"boxgrasp": "0"},
        "C": float(svc.C),
        "gamma": float(svc.gamma),
        "support_vectors": len(svc.support_),
        "training_examples": 1,
        "accuracy": 0.5,
    }
    return Record(**{**told, **other})


def rows(r: np.random.Generator, count: int, width: int) -> Any:
    """(count, width) float32: occupancy, then three dimensions."""
    occupancy = r.choice([0, 0.5, 1], (count, width - 3))
    return np.concatenate([occupancy, r.random((count, 3))], axis=1).astype(np.float32)


def schema_of(version: str, part: str) -> FeatureSchema:
    return next(svm.schema for svm in SVMS if (svm.version, svm.part) == (version, part))


@cache
def trained(version: str, part: str, lines: int = 3, seed: int = 0) -> tuple[Any, Record]:
    """An SVC and its record. The last class is never seen in training."""
    from boxgrasp.teaching.search import train

    r = np.random.default_rng([seed, len(version), len(part), lines])
    schema = schema_of(version, part)
    most = {"single": 5 * lines, "face": 5}.get(part, lines)
    X = rows(r, 80, len(schema))
    svc = train(X, 1 + np.arange(80) % (most - 1 if most > 2 else most), 4.0, 0.02)
    name = version.split("-")[1]
    place = {"sampling": name, "resolution_m": RESOLUTION_M[name]}
    return svc, record_of(svc, schema, version=version, part=part, lines=lines, **place)


def parts_of(version: str) -> tuple[str, ...]:
    return tuple(svm.part for svm in SVMS if svm.version == version)


def write_models(folder: Path, lines: int = 3, seed: int = 0) -> Path:
    """All eight in a folder."""
    from boxgrasp.teaching.export import to_onnx

    for svm in SVMS:
        svc, record = trained(svm.version, svm.part, lines, seed)
        (folder / f"{record.name}.onnx").write_bytes(to_onnx(svc, record))
    return folder
