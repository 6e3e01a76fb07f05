"""What the full study adds: dense maps of several cell sizes, models with C and gamma held."""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from boxgrasp.arrays import Array, Floats, Points
from boxgrasp.perception.target import Target
from boxgrasp.ranking.sampling import grid
from boxgrasp.study.evaluation import Decider, ModelSet
from boxgrasp.teaching.matrices import largest_edge_m
from boxgrasp.teaching.rows import RowConfig, scenario_of_row, selector, states_at
from boxgrasp.teaching.search import train
from boxgrasp.teaching.train import Part, Svm, examples

# Cell sizes of future work 6-1; 7 cm is the grid sampling that every row has.
CELLS_M = (0.02, 0.03, 0.05, 0.10)
PART_ROWS = 40
Kind = Literal["single", "cascade"]
PARTS: Mapping[Kind, tuple[Part, ...]] = {"single": ("single",), "cascade": ("face", "side", "top")}


@dataclass(frozen=True)
class Fitted:
    """A scikit-learn classifier as a decider."""

    model: Any
    classes: tuple[int, ...]

    def decide(self, X: Points) -> tuple[Array, Floats]:
        """Predictions and decision values."""
        ask = getattr(self.model, "decision_function", None) or self.model.predict_proba
        values = np.asarray(ask(X), dtype=np.float64)
        if values.ndim == 1:  # two classes
            values = np.column_stack((-values, values))
        return np.asarray(self.model.predict(X)), values


@dataclass(frozen=True)
class Always:
    """What is left to decide with one class: nothing."""

    classes: tuple[int, ...]

    def decide(self, X: Points) -> tuple[Array, Floats]:
        """The one class, always."""
        return np.full(len(X), self.classes[0]), np.zeros((len(X), 1))


def fit(
    rows: Mapping[str, Array],
    kind: Kind,
    sampling: str,
    held: Mapping[Part, tuple[float, float]],
    lines: int = 3,
    network: int | None = None,
    own_edge: bool = False,
) -> ModelSet:
    """A version fitted with C and gamma held.

    kind: `single` or `cascade`; held: C and gamma by part; network: seed of a small neural
    network in place of each SVM; own_edge: dimensions over each box's own longest edge.
    """
    edge = None if own_edge else largest_edge_m(rows)
    parts: dict[Part, Decider] = {}
    for part in PARTS[kind]:
        svm = Svm(0, sampling, part)
        if lines == 1 and part in ("side", "top"):
            parts[part] = Always((1,))
            continue
        X, y = examples(rows, svm, lines, edge)
        model = train(X, y, *held[part]) if network is None else _network(X, y, network)
        parts[part] = Fitted(model, tuple(int(c) for c in model.classes_))
    return ModelSet(sampling, edge, parts, lines)


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
    """Dense occupancy of each row at every cell size, as .npz: uint8 (n, P) a size, and no more.

    Scenes and noise are those of the rows of the same numbers.
    """
    config, numbers = task
    found: dict[str, list[Array]] = {_name(size): [] for size in CELLS_M}
    for number in numbers:
        scenario = scenario_of_row(config, number)
        capture, labels = scenario.capture(config.recipe.noise)
        mask = Target(mask=labels == scenario.scene.target_id)
        analysis = selector("given", config.lines).analyze(capture, mask, cells_m=CELLS_M)
        for size in CELLS_M:
            found[_name(size)].append(states_at(analysis.context.local_maps[size], grid(size)))
    out = io.BytesIO()
    np.savez_compressed(out, **{name: np.array(values) for name, values in found.items()})  # type: ignore[arg-type]
    return out.getvalue()


def read_dense(parts: list[bytes]) -> dict[float, Array]:
    """The parts put together, by cell size."""
    loaded = [np.load(io.BytesIO(data), allow_pickle=False) for data in parts]
    return {size: np.concatenate([part[_name(size)] for part in loaded]) for size in CELLS_M}


def _name(size_m: float) -> str:
    return f"cells_{round(1000 * size_m)}mm"


def dense_predictions(X: Points, y: Array, tested: Points, C: float, gamma: float) -> Array:
    """(T,) predictions of an RBF SVM, its kernel computed by one matrix product."""
    from sklearn.svm import SVC

    model = SVC(kernel="precomputed", C=C).fit(_kernel(X, X, gamma), y)
    return np.asarray(model.predict(_kernel(tested, X, gamma)))


def _kernel(A: Points, B: Points, gamma: float) -> Points:
    squares = (A**2).sum(axis=1)[:, None] + (B**2).sum(axis=1)[None] - 2.0 * (A @ B.T)
    return np.asarray(np.exp(-gamma * np.maximum(squares, 0.0)))
