"""Trained models: ONNX files with their records, asked through onnxruntime."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Floats
from boxgrasp.errors import ModelError
from boxgrasp.grasps.candidates import label_of
from boxgrasp.onnx.session import Session, load_file, open_session, record_of
from boxgrasp.ranking.onnx.record import Record, from_json

Classes = NDArray[np.int64]

# Operators of the standard set that the exported graphs are made of.
OPERATORS = frozenset(
    (
        *("Cast", "MatMul", "Mul", "Add", "Sub", "Div", "Abs", "Relu", "Exp", "ReduceSum"),
        *("Split", "Concat", "Gather", "Greater", "Less", "Where", "ArgMax", "Neg"),
    )
)
SHIPPED = Path(__file__).parent / "weights"

_ROWS = 1024  # asked at once; bounds the memory
_DECIMALS = 9  # of a decision value that count in an order: the rest differs between machines


@dataclass(frozen=True, eq=False)
class Model:
    """A loaded model; safe from several threads.

    Attributes:
        record: how it was made and what it needs.
    """

    record: Record
    _session: Session

    @property
    def classes(self) -> tuple[int, ...]:
        """Classes as trained, rising."""
        return self.record.classes

    def decide(self, X: NDArray[np.float32]) -> tuple[Classes, Floats]:
        """What the model predicts.

        The prediction is LIBSVM's vote. Decision values are scikit-learn's: how many of the
        one-against-one contests a class won, moved by less than half a vote by its margins.

        Args:
            X: (N, F) float32 rows of features.

        Returns:
            (N,) int64 predictions, and (N, K) float64 decision values in the order of `classes`.

        Raises:
            ModelError: rows of another length than the model's features.
        """
        X = np.ascontiguousarray(X, dtype=np.float32)
        if X.ndim != 2 or X.shape[1] != len(self.record.features):
            raise ModelError(
                f"features have shape {X.shape}; {self.record.name} takes "
                f"(N, {len(self.record.features)})"
            )
        predicted = np.empty(len(X), dtype=np.int64)
        decision = np.empty((len(X), len(self.classes)))
        for k in range(0, len(X), _ROWS):
            rows = slice(k, k + _ROWS)
            predicted[rows], decision[rows] = self._session.run(
                ["label", "decision"], {"features": X[rows]}
            )
        return predicted, decision


def load_model(source: bytes | str | PathLike[str]) -> Model:
    """A trained model. Runs no code of the file and opens no other one.

    Args:
        source: an ONNX file's path, or its bytes.

    Returns:
        The model.

    Raises:
        ModelError: unreadable, damaged, no record, another format, more than plain arithmetic.
        MissingExtraError: onnxruntime is not installed.
    """
    return _load(source) if isinstance(source, bytes) else load_file(source, _load)


def _load(data: bytes) -> Model:
    text, whole = record_of(data)
    record = from_json(text)
    if not whole:
        raise ModelError("the file is damaged: graph and record do not match their digest")
    model = Model(record, open_session(data, OPERATORS))
    try:
        predicted, decision = model._session.run(
            ["label", "decision"],
            {"features": np.zeros((2, len(record.features)), dtype=np.float32)},
        )
    except Exception:  # onnxruntime's own errors share no other root
        raise ModelError("the graph does not run as its record says") from None
    known = np.isin(predicted, record.classes).all()
    fine = predicted.dtype == np.int64 and predicted.shape == (2,) and known
    if not fine or decision.dtype != np.float64 or decision.shape != (2, len(record.classes)):
        raise ModelError("the graph does not answer as its record says")
    return model


def ranked(
    predicted: Classes, decision: Floats, classes: Sequence[int], wanted: Sequence[int]
) -> Classes:
    """Every wanted class, best first.

    First the prediction, then by decision value, ties by the lower class; classes never seen in
    training last, in their order.

    Args:
        predicted: (N,) int64.
        decision: (N, K) float64 decision values of `classes`.
        classes: the K classes seen in training.
        wanted: the M classes that there are.

    Returns:
        (N, M) int64.
    """
    every = np.array(sorted(wanted), dtype=np.int64)
    scores = np.full((len(predicted), len(every)), -np.inf)
    for k, known in enumerate(classes):
        scores[:, every == known] = np.round(decision[:, k : k + 1], _DECIMALS)
    scores[every == np.asarray(predicted)[:, None]] = np.inf
    return np.asarray(every[np.argsort(-scores, axis=1, kind="stable")])


def cascaded(faces: Classes, lines: Classes) -> Classes:
    """Labels in the order of their faces, then of the lines on each.

    Args:
        faces: (N, 5) int64, best first.
        lines: (N, 5, l) int64, lines of faces 1 to 5, best first.

    Returns:
        (N, 5 l) int64 labels, best first.
    """
    chosen = np.take_along_axis(lines, (faces - 1)[:, :, None], axis=1)
    count = lines.shape[2]
    return np.asarray(label_of(faces[:, :, None], chosen, count).reshape(len(faces), -1))
