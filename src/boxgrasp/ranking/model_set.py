"""The thesis's versions: which SVMs each has, and the order of candidates that they give.

One path for `select`, training and the study: scenes come as what their maps say at the samples,
one or many at once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal, NamedTuple, Protocol

import numpy as np

from boxgrasp.arrays import Bools, Floats, Points
from boxgrasp.errors import BoxgraspError, MissingExtraError, ModelError
from boxgrasp.grasps.candidates import LEFT, TOP_PARALLEL
from boxgrasp.mapping.local_map import LocalMap
from boxgrasp.ranking.features import (
    FeatureSchema,
    line_features,
    line_schema,
    single_features,
    single_schema,
)
from boxgrasp.ranking.onnx.model import Classes, Model, cascaded, load_model, ranked
from boxgrasp.ranking.onnx.record import model_name, validate_fits
from boxgrasp.ranking.sampling import is_side, portion, sampling

Part = Literal["single", "face", "side", "top"]
PARTS: tuple[Part, ...] = ("single", "face", "side", "top")
SAMPLINGS = ("spiral", "grid")
FACE_NUMBERS = range(1, 6)
HELP_FACE = 6  # the thesis's sixth face: the operator would help


def help_label(lines: int) -> int:
    """The label of a request for help, as of the first line on the sixth face.

    Args:
        lines: l, lines a face.

    Returns:
        5 l + 1.
    """
    return 5 * lines + 1


@dataclass(frozen=True)
class Svm:
    """One of the thesis's eight SVMs.

    Attributes:
        number: as in figure B-4.
        sampling: `spiral` or `grid`.
        part: what it decides: all at once, or the cascade's face, side line or top line.
    """

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
VERSIONS = ("single-spiral", "cascade-spiral", "single-grid", "cascade-grid")


@dataclass(frozen=True, eq=False)
class SampledScenes:
    """What the local maps of N scenes say at the points of one sampling.

    Attributes:
        whole: (N, P) float32, 0 free, 1 occupied, 0.5 else, of every sample.
        portions: by face, 1 to 5, (N, p) float32 of the samples before that face.
        dimensions_m: (N, 3) of the targets' boxes, m.
    """

    whole: Points
    portions: Mapping[int, Points]
    dimensions_m: Floats

    @staticmethod
    def of_map(local_map: LocalMap, dimensions_m: Floats, name: str) -> SampledScenes:
        """One scene, from its local map.

        Args:
            local_map: round the target.
            dimensions_m: (3,) of its box, m.
            name: of the sampling.

        Returns:
            N = 1.
        """
        points = sampling(name)
        return SampledScenes(
            local_map.values_at(points)[None],
            {face: local_map.values_at(portion(points, face))[None] for face in FACE_NUMBERS},
            dimensions_m[None],
        )


class Order(NamedTuple):
    """Every candidate of N scenes, best first, and whether the operator would help.

    Attributes:
        labels: (N, 5 l) int64.
        confidence: (N, 5 l) float64 in [0, 1], in the same order.
        asks: (N,) bool, whether the prediction is to ask for help (6-1).
    """

    labels: Classes
    confidence: Floats
    asks: Bools


class Decider(Protocol):
    """A trained classifier."""

    @property
    def classes(self) -> tuple[int, ...]:
        """Classes as trained, rising."""

    def decide(self, X: Points) -> tuple[Classes, Floats]:
        """What the classifier predicts.

        Args:
            X: (N, F) float32 rows of features.

        Returns:
            (N,) int64 predictions, and (N, K) float64 decision values in the order of `classes`.
        """


@dataclass(frozen=True, eq=False)
class ModelSet:
    """The deciders of one version.

    Attributes:
        sampling: `spiral` or `grid`.
        largest_edge_m: what box dimensions are divided by, m; None for each box's own.
        parts: deciders by part: `single`, or `face`, `side` and `top`.
        lines: l, lines a face.
    """

    sampling: str
    largest_edge_m: float | None
    parts: Mapping[Part, Decider]
    lines: int

    def order(self, scenes: SampledScenes) -> Order:
        """Every candidate of N scenes, best first.

        First the prediction, then by the decision values. Confidence is the share of
        one-against-one contests that a candidate won, 0 for one never seen in training; a
        cascade's lines share what lies between their face's confidence and the next face's. It
        never rises along the order, and is no probability. Models that learned when the operator
        would help may predict that; the candidates are ordered all the same.

        Args:
            scenes: N of them.

        Returns:
            The order.
        """
        whole = single_features(scenes.whole, scenes.dimensions_m, self.largest_edge_m)
        if "single" in self.parts:
            return _decided(self.parts["single"], whole, 5 * self.lines)
        faces, face_shares, asks = _decided(self.parts["face"], whole, 5)
        decided = [self._lines(scenes, face) for face in FACE_NUMBERS]
        lines, line_shares = (np.stack(pair, axis=1) for pair in zip(*decided, strict=True))
        after = np.append(face_shares[:, 1:], np.zeros((len(faces), 1)), axis=1)
        between = face_shares - after
        chosen = np.take_along_axis(line_shares, (faces - 1)[:, :, None], axis=1)
        confidence = after[:, :, None] + between[:, :, None] * chosen
        return Order(cascaded(faces, lines), confidence.reshape(len(faces), -1), asks)

    def _lines(self, scenes: SampledScenes, face: int) -> tuple[Classes, Floats]:
        """(N, l) lines of one face, best first, and their shares."""
        X = line_features(scenes.portions[face], scenes.dimensions_m, face, self.largest_edge_m)
        lines = _decided(self.parts["side" if is_side(face) else "top"], X, self.lines)
        return lines.labels, lines.confidence


def _decided(decider: Decider, X: Points, count: int) -> Order:
    """(N, count) classes, best first, and the share of contests each won, never rising.

    The class after them is the request for help.
    """
    predicted, decision = decider.decide(X)
    classes = ranked(predicted, decision, decider.classes, range(1, count + 1))
    won = np.zeros((len(X), count + 1))
    won[:, np.array(decider.classes) - 1] = decision / max(len(decider.classes) - 1, 1)
    shares = np.take_along_axis(np.clip(won, 0.0, 1.0), classes - 1, axis=1)
    return Order(classes, np.minimum.accumulate(shares, axis=1), predicted > count)


def read_models(version: str, read: Callable[[str], bytes]) -> dict[Part, Model]:
    """The trained models of a version by part.

    Args:
        version: one of `VERSIONS`.
        read: gives a file's bytes by its name.

    Returns:
        `single`, or `face`, `side` and `top`.

    Raises:
        ModelError: a file that is no such model, or does not fit the features or the other parts.
        MissingExtraError: onnxruntime is not installed.
        BoxgraspError: as `read` raises it.
    """
    models: dict[Part, Model] = {}
    for svm in SVMS:
        if svm.version != version:
            continue
        data = read(f"{svm.name}.onnx")
        try:
            model = load_model(data)
            if model.record.name != svm.name:
                raise ModelError(f"holds {model.record.name}; valid: {svm.name}")
            if model.record.sampling != svm.sampling:
                raise ModelError(f"sampling is {model.record.sampling!r}; valid: {svm.sampling}")
            validate_fits(model.record, svm.schema)
        except MissingExtraError:
            raise
        except BoxgraspError as error:
            raise type(error)(f"{svm.name}.onnx: {error}") from None
        models[svm.part] = model
    made = {(model.record.lines, model.record.largest_edge_m or 0.0) for model in models.values()}
    if len(made) > 1:
        raise ModelError(
            f"parts of {version} were trained apart (lines and longest edge: {sorted(made)}); "
            "valid: parts of one training"
        )
    return models


def model_set_of(models: Mapping[Part, Model]) -> ModelSet:
    """The set that a version's models make.

    Args:
        models: by part, of one training, as `read_models` gives them.

    Returns:
        The set.
    """
    record = next(iter(models.values())).record
    return ModelSet(record.sampling, record.largest_edge_m, dict(models), record.lines)
