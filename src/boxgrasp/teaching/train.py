"""The eight SVMs of the thesis's four versions (figure 3-10, B-1): searched, trained, recorded."""

from __future__ import annotations

import base64
import hashlib
import json
import platform
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from boxgrasp.arrays import Array, Points
from boxgrasp.errors import BoxgraspError, ConfigError
from boxgrasp.execution import Store, Workers, finish
from boxgrasp.grasps.candidates import LINES
from boxgrasp.grasps.gripper import Gripper
from boxgrasp.ranking.features import line_features, single_features
from boxgrasp.ranking.model_set import HELP_FACE, SVMS, SampledScenes, Svm, help_label
from boxgrasp.ranking.onnx.record import Record
from boxgrasp.ranking.sampling import RESOLUTION_M, is_side
from boxgrasp.simulate.scenario import Recipe
from boxgrasp.strict import plain
from boxgrasp.teaching.export import to_onnx
from boxgrasp.teaching.samples import largest_edge_m, sampled_scenes
from boxgrasp.teaching.search import (
    SEARCH,
    Grid,
    Search,
    SearchParams,
    one_vs_rest_accuracy,
    search,
    train,
)
from boxgrasp.teaching.sets import Rows, SetConfig, claim
from boxgrasp.version import __version__

SCENE_KEY = "scene_key"  # column of rows whose scenes may come twice


@dataclass(frozen=True)
class Provenance:
    """Where a training set comes from, for the record.

    Attributes:
        object_set: objects and targets.
        seeds: of the set.
        label_source: who labeled.
        gripper: the hand.
        lines: l, lines a face.
    """

    object_set: str
    seeds: tuple[int, ...]
    label_source: str
    gripper: Gripper
    lines: int = LINES


@dataclass(frozen=True, eq=False)
class Taught:
    """Labeled rows, and where they come from.

    Attributes:
        rows: columns by name, every row labeled. Rows of one scene, as two operators label it, say
            so in a column `scene_key`, and stay in one fold.
        provenance: for the record.
        made: plain values that tell these rows from others, kept beside the models.
    """

    rows: Rows
    provenance: Provenance
    made: Mapping[str, Any]


def taught_by_set(made: SetConfig, rows: Rows) -> Taught:
    """What a set teaches: those of its rows that have an answer.

    Args:
        made: what the set is made of.
        rows: its rows.

    Returns:
        The labeled rows.
    """
    recipe, answered = made.rows.recipe, rows.answered
    provenance = Provenance(
        object_set=object_set_of(recipe),
        seeds=(made.rows.seed,),
        label_source=", ".join(sorted(set(answered["label_source"].tolist()))),
        gripper=Gripper(),
        lines=made.rows.lines,
    )
    said = np.ascontiguousarray(rows["label"], dtype="<i8").tobytes()
    kept = {"set": plain(made), "labels_sha256": hashlib.sha256(said).hexdigest()}
    return Taught(answered, provenance, kept)


def object_set_of(recipe: Recipe) -> str:
    """Objects and targets of a recipe, for the record.

    Args:
        recipe: any.

    Returns:
        `simulated: crisps_tube, ...`.
    """
    return f"{recipe.objects}: {', '.join(recipe.targets)}"


def examples(
    rows: Mapping[str, Array],
    svm: Svm,
    lines: int,
    edge_m: float | None,
    *,
    least_classes: int = 2,
) -> tuple[Points, Array]:
    """What one SVM learns from labeled rows, their target's points given.

    Args:
        rows: columns by name.
        svm: which one.
        lines: l, lines a face.
        edge_m: what box dimensions are divided by, m; None for each box's own.
        least_classes: how many classes there must be.

    Returns:
        (N, F) float32 features and (N,) int64 classes: of all rows, or of those whose labeled
        face is the part's. The request for help is class 5 l + 1, or face 6; lines never see it.

    Raises:
        ConfigError: fewer classes, rows without a label, or labels that there are not.
    """
    label = rows["label"]
    if len(label) == 0 or label.min() < 1:
        raise ConfigError("rows without a label; valid: a set whose every row is labeled")
    if label.max() > help_label(lines):
        raise ConfigError(f"a label is {label.max()}; valid: 1 to {help_label(lines)}")
    face, line = (label - 1) // lines + 1, (label - 1) % lines + 1
    which = _taught_by(svm, face)
    y = {"single": label, "face": face}.get(svm.part, line)[which]
    if len(np.unique(y)) < least_classes:
        raise ConfigError(
            f"{svm.name}: {len(y)} examples of {len(np.unique(y))} class; valid: at least two "
            "classes (more labels)"
        )
    scenes = sampled_scenes(rows, "given", svm.sampling)
    if svm.part in ("single", "face"):
        return single_features(scenes.whole, scenes.dimensions_m, edge_m), y
    return _line_examples(scenes, face, which, edge_m), y


def _taught_by(svm: Svm, face: Array) -> Array:
    """(N,) indices of the rows that an SVM learns from; face: of each row's label."""
    if svm.part in ("single", "face"):
        return np.arange(len(face))
    sides = [k != HELP_FACE and is_side(k) == (svm.part == "side") for k in face.tolist()]
    return np.flatnonzero(sides)


def groups_of(rows: Mapping[str, Array], svm: Svm, lines: int) -> Array | None:
    """Which of an SVM's examples are of one scene.

    Args:
        rows: columns by name.
        svm: which one.
        lines: l, lines a face.

    Returns:
        (N,) keys of the scenes of its examples; None where rows do not tell.
    """
    if SCENE_KEY not in rows:
        return None
    face = (rows["label"] - 1) // lines + 1
    return np.asarray(rows[SCENE_KEY][_taught_by(svm, face)])


def _line_examples(
    scenes: SampledScenes, face: Array, which: Array, edge_m: float | None
) -> Points:
    """(N, F) features of some scenes, each on its own face."""
    seen = {
        k: line_features(scenes.portions[k], scenes.dimensions_m, k, edge_m)
        for k in np.unique(face[which]).tolist()
    }
    return np.array([seen[face[k]][k] for k in which])


@dataclass(frozen=True)
class Trained:
    """One trained SVM.

    Attributes:
        svm: which one.
        search: what the search found.
        record: how it was made.
        one_vs_rest: cross-validated accuracy of one class against the rest.
        onnx: the file.
    """

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
    params: SearchParams = SEARCH,
) -> Trained:
    """Search, train and export one of the eight.

    Args:
        rows: columns by name, (N, ...) each, labeled.
        svm: which one.
        provenance: for the record.
        seed: of the folds.
        params: what C and gamma are tried.

    Returns:
        The SVM and its file.

    Raises:
        ConfigError: fewer than two classes, rows without a label, or labels from which every C
            and gamma learns to say the same class always.
        MissingExtraError: scikit-learn or onnx is not installed.
    """
    edge = largest_edge_m(rows)
    X, y = examples(rows, svm, provenance.lines, edge)
    groups = groups_of(rows, svm, provenance.lines)
    try:
        found = search(X, y, seed=seed, params=params, groups=groups)
    except BoxgraspError as error:
        raise ConfigError(f"{svm.name}, {len(y)} examples: {error}") from None
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
    other = one_vs_rest_accuracy(X, y, found.C, found.gamma, seed=seed, groups=groups)
    return Trained(svm, found, record, other, to_onnx(model, record))


Task = tuple[dict[str, Array], Svm, Provenance, int, SearchParams]


def training_task(taught: Taught, svm: Svm, seed: int, params: SearchParams) -> Task:
    """The task of training one of the eight.

    Args:
        taught: labeled rows.
        svm: which one.
        seed: of the folds.
        params: what C and gamma are tried.

    Returns:
        Arguments of `train_svm`, with the columns that it reads.
    """
    used = (
        "label",
        "given_dimensions_m",
        f"given_{svm.sampling}",
        f"given_{svm.sampling}_portions",
    )
    rows = {name: np.asarray(taught.rows[name]) for name in used}
    if SCENE_KEY in taught.rows:
        rows[SCENE_KEY] = np.asarray(taught.rows[SCENE_KEY])
    return rows, svm, taught.provenance, seed, params


def trained_json(task: Task) -> bytes:
    """One SVM trained; a task of its own.

    Args:
        task: arguments of `train_svm`.

    Returns:
        Record, the search's heat map and the file, as JSON.
    """
    done = train_svm(*task)
    kept = {
        "record": plain(done.record),
        "one_vs_rest": done.one_vs_rest,
        "search": {
            "C": done.search.C,
            "gamma": done.search.gamma,
            "accuracy": done.search.accuracy,
            "balanced": done.search.balanced,
            "commonest": done.search.commonest,
            "coarse": _grid(done.search.coarse),
            "fine": _grid(done.search.fine),
        },
        "onnx": base64.b64encode(done.onnx).decode(),
    }
    return (json.dumps(kept, sort_keys=True) + "\n").encode()


def _grid(grid: Grid) -> dict[str, Any]:
    return {name: np.asarray(value).tolist() for name, value in vars(grid).items()}


def train_svms(
    store: Store, prefix: str, taught: Taught, workers: Workers, seed: int = 0
) -> list[dict[str, Any]]:
    """Train what is not there yet of the eight, and write their files.

    Args:
        store: where to.
        prefix: of the names there.
        taught: labeled rows.
        workers: who trains.
        seed: of the folds.

    Returns:
        What `trained_json` made of each, in the order of `SVMS`.

    Raises:
        ConfigError: rows that cannot teach, a negative seed, or a place with models made otherwise.
        StoreError: the place cannot be read or written.
        WorkError: workers were lost.
        MissingExtraError: scikit-learn or onnx is not installed.
    """
    if seed < 0:
        raise ConfigError(f"seed is {seed}; valid: 0 or more")
    claim(store, f"{prefix}training/", "made.json", {**taught.made, "seed": seed}, "models")
    tasks = {
        f"{prefix}training/{svm.name}.json": training_task(taught, svm, seed, SEARCH)
        for svm in SVMS
    }
    finish(store, tasks, trained_json, workers, "train")
    kept = []
    for svm in SVMS:
        kept.append(json.loads(store.read(f"{prefix}training/{svm.name}.json")))
        name = f"{prefix}{svm.name}.onnx"
        if not store.exists(name):
            store.write(name, base64.b64decode(kept[-1]["onnx"]))
    return kept


def versions() -> dict[str, str]:
    """Versions of what a model is made with.

    Returns:
        By name.
    """
    from importlib.metadata import version

    names = ("numpy", "scikit-learn", "onnx")
    return {
        "boxgrasp": __version__,
        "python": platform.python_version(),
        **{name: version(name) for name in names},
    }
