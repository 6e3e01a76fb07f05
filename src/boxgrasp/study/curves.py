"""What the full study adds: dense maps of several cell sizes, models with C and gamma held."""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from boxgrasp.arrays import Array, Points
from boxgrasp.grasps.candidates import LINES
from boxgrasp.perception.target import Target
from boxgrasp.ranking.model_set import SVMS, Decider, ModelSet, Part
from boxgrasp.ranking.sampling import grid
from boxgrasp.teaching.fitting import Always, Fitted
from boxgrasp.teaching.rows import RowConfig, scenario_of_row, selector
from boxgrasp.teaching.samples import largest_edge_m, states_at
from boxgrasp.teaching.search import train
from boxgrasp.teaching.train import examples

# Cell sizes of future work 6-1; 7 cm is the grid sampling that every row has.
RESOLUTIONS_M = (0.02, 0.03, 0.05, 0.10)
PART_ROWS = 40
Kind = Literal["single", "cascade"]


@dataclass(frozen=True)
class Variant:
    """A version of the algorithm, fitted otherwise than the thesis did.

    Attributes:
        kind: `single` or `cascade`.
        sampling: `spiral` or `grid`.
        lines: l, lines a face.
        network: seed of a small neural network in place of each SVM; None for SVMs.
        own_edge: dimensions over each box's own longest edge.
    """

    kind: Kind
    sampling: str
    lines: int = LINES
    network: int | None = None
    own_edge: bool = False

    @property
    def version(self) -> str:
        """The thesis's version."""
        return f"{self.kind}-{self.sampling}"


def fit(
    rows: Mapping[str, Array], variant: Variant, held: Mapping[Part, tuple[float, float]]
) -> ModelSet:
    """A version fitted with C and gamma held.

    Args:
        rows: columns by name, labeled.
        variant: which version, and how.
        held: C and gamma by part.

    Returns:
        The fitted classifiers.

    Raises:
        ConfigError: fewer than two classes, or rows without a label.
        MissingExtraError: scikit-learn is not installed.
    """
    edge = None if variant.own_edge else largest_edge_m(rows)
    parts: dict[Part, Decider] = {}
    for svm in (svm for svm in SVMS if svm.version == variant.version):
        if variant.lines == 1 and svm.part in ("side", "top"):
            parts[svm.part] = Always((1,))
            continue
        X, y = examples(rows, svm, variant.lines, edge)
        if variant.network is None:
            model = train(X, y, *held[svm.part])
        else:
            model = _network(X, y, variant.network)
        parts[svm.part] = Fitted(model, tuple(int(c) for c in model.classes_))
    return ModelSet(variant.sampling, edge, parts, variant.lines)


def _network(X: Points, y: Array, seed: int) -> Any:
    """One hidden layer of 64, early stopping off: small enough for 800 examples (ours)."""
    import warnings

    from sklearn.exceptions import ConvergenceWarning
    from sklearn.neural_network import MLPClassifier

    model = MLPClassifier((64,), alpha=1e-2, max_iter=600, random_state=seed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        return model.fit(X, y)


def dense_part(task: tuple[RowConfig, range]) -> bytes:
    """Dense states of some rows at every cell size; a task of its own.

    Scenes and noise are those of the rows of the same numbers.

    Args:
        task: how rows are made, and the rows' numbers.

    Returns:
        A .npz: uint8 (n, P) a cell size.
    """
    config, numbers = task
    found: dict[str, list[Array]] = {_name(size): [] for size in RESOLUTIONS_M}
    for number in numbers:
        scenario = scenario_of_row(config, number)
        capture, object_ids = scenario.capture(config.recipe.noise)
        target = Target(mask=object_ids == scenario.scene.target_id)
        analysis = selector("given", config.lines, None, RESOLUTIONS_M).analyze(capture, target)
        for size in RESOLUTIONS_M:
            found[_name(size)].append(states_at(analysis.context.local_maps[size], grid(size)))
    out = io.BytesIO()
    np.savez_compressed(out, **{name: np.array(values) for name, values in found.items()})  # type: ignore[arg-type]
    return out.getvalue()


def read_dense(parts: list[bytes]) -> dict[float, Array]:
    """The parts put together.

    Args:
        parts: of `dense_part`.

    Returns:
        (N, P) uint8 by cell size, m.
    """
    loaded = [np.load(io.BytesIO(data), allow_pickle=False) for data in parts]
    return {size: np.concatenate([part[_name(size)] for part in loaded]) for size in RESOLUTIONS_M}


def _name(size_m: float) -> str:
    return f"cells_{round(1000 * size_m)}mm"


def dense_predictions(
    X: Points, y: Array, tested: Points, parameters: tuple[float, float]
) -> Array:
    """Predictions of an RBF SVM, its kernel computed by one matrix product.

    Args:
        X: (N, F) features to learn from.
        y: (N,) classes.
        tested: (T, F) features to predict from.
        parameters: C and gamma.

    Returns:
        (T,) classes.
    """
    from sklearn.svm import SVC

    C, gamma = parameters
    model = SVC(kernel="precomputed", C=C).fit(_kernel(X, X, gamma), y)
    return np.asarray(model.predict(_kernel(tested, X, gamma)))


def _kernel(A: Points, B: Points, gamma: float) -> Points:
    squares = (A**2).sum(axis=1)[:, None] + (B**2).sum(axis=1)[None] - 2.0 * (A @ B.T)
    return np.asarray(np.exp(-gamma * np.maximum(squares, 0.0)))
