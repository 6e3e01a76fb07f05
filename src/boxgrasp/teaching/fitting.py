"""Versions fitted with C and gamma held: for curves and cross-validation, nothing is exported."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from boxgrasp.arrays import Array, Floats, Points
from boxgrasp.ranking.model_set import SVMS, Decider, ModelSet, Part, help_label
from boxgrasp.teaching.samples import largest_edge_m, sampled_scenes
from boxgrasp.teaching.search import train
from boxgrasp.teaching.train import examples

# C and gamma by part.
Held = Mapping[Part, tuple[float, float]]


@dataclass(frozen=True)
class Fitted:
    """A scikit-learn classifier as a decider.

    Attributes:
        model: the classifier.
        classes: as trained, rising.
    """

    model: Any
    classes: tuple[int, ...]

    def decide(self, X: Points) -> tuple[Array, Floats]:
        """What the classifier predicts.

        Args:
            X: (N, F) float32 rows of features.

        Returns:
            (N,) predictions, and (N, K) decision values or probabilities.
        """
        ask = getattr(self.model, "decision_function", None) or self.model.predict_proba
        values = np.asarray(ask(X), dtype=np.float64)
        if values.ndim == 1:  # two classes
            values = np.column_stack((-values, values))
        return np.asarray(self.model.predict(X)), values


@dataclass(frozen=True)
class Always:
    """What is left to decide with one class: nothing.

    Attributes:
        classes: the one.
    """

    classes: tuple[int, ...]

    def decide(self, X: Points) -> tuple[Array, Floats]:
        """The one class, always.

        Args:
            X: (N, F) rows of features.

        Returns:
            (N,) predictions, and (N, 1) zeros.
        """
        return np.full(len(X), self.classes[0]), np.zeros((len(X), 1))


def fit_version(rows: Mapping[str, Array], version: str, lines: int, held: Held) -> ModelSet:
    """A version fitted with C and gamma held; a part that saw one class always says that.

    Args:
        rows: columns by name, labeled.
        version: one of `VERSIONS`.
        lines: l, lines a face.
        held: C and gamma of each of its parts.

    Returns:
        The fitted classifiers.

    Raises:
        ConfigError: rows without a label.
        MissingExtraError: scikit-learn is not installed.
    """
    edge, parts = largest_edge_m(rows), dict[Part, Decider]()
    for svm in (svm for svm in SVMS if svm.version == version):
        X, y = examples(rows, svm, lines, edge, least_classes=0)
        known = np.unique(y).tolist()
        if len(known) < 2:  # a line of faces that nobody chose is the middle one
            parts[svm.part] = Always((int(known[0]) if known else (lines + 1) // 2,))
            continue
        model = train(X, y, *held[svm.part])
        parts[svm.part] = Fitted(model, tuple(int(c) for c in model.classes_))
    sampling = next(svm.sampling for svm in SVMS if svm.version == version)
    return ModelSet(sampling, edge, parts, lines)


def answers(models: ModelSet, rows: Mapping[str, Array]) -> Array:
    """What models would label rows as.

    Args:
        models: of one version.
        rows: columns by name.

    Returns:
        (N,) int64 labels: of the first choice, or 5 l + 1 where they ask for help.
    """
    found = models.order(sampled_scenes(rows, "given", models.sampling))
    return np.where(found.asks, help_label(models.lines), found.labels[:, 0])
