"""The eight SVMs of the thesis's four versions (figure 3-10, B-1): searched, trained, recorded."""

from __future__ import annotations

import base64
import hashlib
import json
import platform
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from boxgrasp.arrays import Array, Points
from boxgrasp.errors import ConfigError
from boxgrasp.execution import Store, Workers, finish
from boxgrasp.grasps.candidates import LEFT, TOP_PARALLEL
from boxgrasp.grasps.gripper import Gripper
from boxgrasp.ranking.features import FeatureSchema, line_schema, single_schema
from boxgrasp.ranking.onnx.record import Record, model_name
from boxgrasp.ranking.sampling import RESOLUTION_M, sampling
from boxgrasp.strict import plain
from boxgrasp.teaching.export import to_onnx
from boxgrasp.teaching.matrices import largest_edge_m, line_examples, single_matrix
from boxgrasp.teaching.search import Grid, Search, one_vs_rest_accuracy, search, train
from boxgrasp.teaching.sets import Rows, SetConfig, claim
from boxgrasp.version import __version__

SAMPLINGS = ("spiral", "grid")
Part = Literal["single", "face", "side", "top"]
PARTS: tuple[Part, ...] = ("single", "face", "side", "top")


@dataclass(frozen=True)
class Svm:
    """One of the eight: number as in figure B-4, what it samples, what it decides."""

    number: int
    sampling: str
    part: Part

    @property
    def version(self) -> str:
        """The algorithm version it belongs to (table 3-3)."""
        return f"{'single' if self.part == 'single' else 'cascade'}-{self.sampling}"

    @property
    def name(self) -> str:
        """Its file's name without the ending."""
        return model_name(self.version, self.part)

    @property
    def schema(self) -> FeatureSchema:
        """What its features are."""
        points = sampling(self.sampling)
        if self.part in ("single", "face"):
            return single_schema(points)
        return line_schema(points, LEFT if self.part == "side" else TOP_PARALLEL)


SVMS = tuple(
    Svm(2 * step + k + 1, name, part)
    for step, part in enumerate(PARTS)
    for k, name in enumerate(SAMPLINGS)
)


@dataclass(frozen=True)
class Provenance:
    """Where a training set comes from, for the record."""

    object_set: str
    seeds: tuple[int, ...]
    label_source: str
    gripper: Gripper
    lines: int = 3


def examples(
    rows: Mapping[str, Array], svm: Svm, lines: int, edge_m: float | None
) -> tuple[Points, Array]:
    """X (N, F) and y (N,) of one SVM from labeled rows, seen as given.

    Raises:
        ConfigError: fewer than two classes, or rows without a label.
    """
    label = rows["label"]
    if len(label) == 0 or label.min() < 1:
        raise ConfigError("rows without a label; valid: a set whose every row is labeled")
    face, line = (label - 1) // lines + 1, (label - 1) % lines + 1
    if svm.part in ("single", "face"):
        X = single_matrix(rows, "given", svm.sampling, edge_m)
        y = label if svm.part == "single" else face
    else:
        X, which = line_examples(rows, "given", svm.sampling, edge_m, face, svm.part)
        y = line[which]
    if len(np.unique(y)) < 2:
        raise ConfigError(
            f"{svm.name}: {len(y)} examples of {len(np.unique(y))} class; valid: at least two "
            "classes (more labels)"
        )
    return X, y


@dataclass(frozen=True)
class Trained:
    """One trained SVM: what the search found, and the file."""

    svm: Svm
    search: Search
    record: Record
    one_vs_rest: float
    onnx: bytes


def train_svm(
    rows: Mapping[str, Array],
    svm: Svm,
    provenance: Provenance,
    seed: int = 0,
) -> Trained:
    """Search, train and export one of the eight."""
    edge = largest_edge_m(rows)
    X, y = examples(rows, svm, provenance.lines, edge)
    found = search(X, y, seed=seed)
    model = train(X, y, found.C, found.gamma)
    schema = svm.schema
    record = Record(
        version=svm.version,
        part=svm.part,
        sampling=svm.sampling,
        resolution_m=RESOLUTION_M[svm.sampling],
        lines=provenance.lines,
        largest_edge_m=edge,
        features=schema.names,
        schema_hash=schema.hash,
        classes=tuple(int(c) for c in model.classes_),
        gripper=provenance.gripper,
        object_set=provenance.object_set,
        seeds=provenance.seeds,
        label_source=provenance.label_source,
        versions=versions(),
        C=found.C,
        gamma=found.gamma,
        support_vectors=int(len(model.support_)),
        training_examples=len(y),
        accuracy=found.accuracy,
    )
    other = one_vs_rest_accuracy(X, y, found.C, found.gamma, seed=seed)
    return Trained(svm, found, record, other, to_onnx(model, record))


def training_tasks(
    made: SetConfig, rows: Mapping[str, Array], prefix: str, seed: int
) -> dict[str, tuple[dict[str, Array], Svm, Provenance, int]]:
    """The task of each of the eight by the name of its result."""
    recipe = made.rows.recipe
    provenance = Provenance(
        object_set=f"{recipe.objects}: {', '.join(recipe.targets)}",
        seeds=(made.rows.seed,),
        label_source=", ".join(sorted(set(rows["label_source"].tolist()))),
        gripper=Gripper(),
        lines=made.rows.lines,
    )
    used = ("label", "given_dimensions_m")
    return {
        f"{prefix}{svm.name}.json": (
            {
                name: np.asarray(rows[name])
                for name in (*used, f"given_{svm.sampling}", f"given_{svm.sampling}_portions")
            },
            svm,
            provenance,
            seed,
        )
        for svm in SVMS
    }


def trained_json(task: tuple[dict[str, Array], Svm, Provenance, int]) -> bytes:
    """One SVM trained, with its search's heat map and its file, as JSON."""
    done = train_svm(*task)
    kept = {
        "record": plain(done.record),
        "one_vs_rest": done.one_vs_rest,
        "search": {
            "C": done.search.C,
            "gamma": done.search.gamma,
            "accuracy": done.search.accuracy,
            "coarse": _grid(done.search.coarse),
            "fine": _grid(done.search.fine),
        },
        "onnx": base64.b64encode(done.onnx).decode(),
    }
    return (json.dumps(kept, sort_keys=True) + "\n").encode()


def _grid(grid: Grid) -> dict[str, Any]:
    return {name: np.asarray(value).tolist() for name, value in vars(grid).items()}


def train_svms(
    store: Store, prefix: str, labeled: tuple[SetConfig, Rows], workers: Workers, seed: int = 0
) -> list[dict[str, Any]]:
    """Train what is not there yet of the eight, write their files, give what is kept of each.

    Raises:
        ConfigError: rows that cannot teach, a negative seed, or a place with models made otherwise.
    """
    if seed < 0:
        raise ConfigError(f"seed is {seed}; valid: 0 or more")
    labels = np.ascontiguousarray(labeled[1]["label"], dtype="<i8").tobytes()
    said = hashlib.sha256(labels).hexdigest()  # a set may have been labeled anew
    made = {"set": plain(labeled[0]), "labels_sha256": said, "seed": seed}
    claim(store, f"{prefix}training/", "made.json", made, "models")
    finish(
        store, training_tasks(*labeled, f"{prefix}training/", seed), trained_json, workers, "train"
    )
    kept = []
    for svm in SVMS:
        kept.append(json.loads(store.read(f"{prefix}training/{svm.name}.json")))
        name = f"{prefix}{svm.name}.onnx"
        if not store.exists(name):
            store.write(name, base64.b64decode(kept[-1]["onnx"]))
    return kept


def versions() -> dict[str, str]:
    """Versions of what a model was made with."""
    from importlib.metadata import version

    names = ("numpy", "scikit-learn", "onnx")
    return {
        "boxgrasp": __version__,
        "python": platform.python_version(),
        **{name: version(name) for name in names},
    }
