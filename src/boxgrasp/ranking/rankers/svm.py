"""The thesis's four versions: one SVM for all candidates, or one for the face and one for the line.

Models are read from `<version>.onnx`, or `<version>-face.onnx`, `-side.onnx` and `-top.onnx`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Floats
from boxgrasp.errors import ConfigError, ModelError
from boxgrasp.grasps.candidates import LEFT, TOP_PARALLEL
from boxgrasp.grasps.gripper import Gripper
from boxgrasp.ranking import features
from boxgrasp.ranking.features import FeatureSchema
from boxgrasp.ranking.onnx.model import SHIPPED, Model, cascaded, load_model, ranked
from boxgrasp.ranking.onnx.record import check_fits, model_name
from boxgrasp.ranking.ranker import Ranker, RankerSetup, Ranking, RankingContext
from boxgrasp.ranking.sampling import is_side, sampling

FACES = range(1, 6)
Labels = NDArray[np.int64]


class Svm(Ranker):
    """Orders the candidates as trained SVMs prefer them.

    Confidence of a candidate is the share of one-against-one contests that it won, 0 for one never
    seen in training; a cascade's lines share the room between their face's confidence and the next
    face's. It never exceeds that of a candidate preferred to it. It is no probability.
    """

    version: ClassVar[str]
    parts: ClassVar[tuple[str, ...]]

    def __init__(self, models: Mapping[str, Model] | None = None, gripper: Gripper | None = None):
        """models: by part. gripper: the hand in use, if it may differ from the models'."""
        self._models = dict(models or {})
        records = [model.record for model in self._models.values()]
        self.resolutions_m = tuple(sorted({record.resolution_m for record in records}))
        self.notes = ()
        other = [r.gripper for r in records if gripper and _hand(r.gripper) != _hand(gripper)]
        if gripper and other:
            self.notes = (
                f"{self.version} was trained with another hand ({_difference(other[0], gripper)}): "
                "its preferences may be off, the check is not",
            )

    def prepared(self, setup: RankerSetup) -> Ranker:
        """The ranker with the models of the setup's folder."""
        folder = SHIPPED if setup.models is None else Path(setup.models)
        models = {part: _loaded(folder, self.version, part) for part in self.parts}
        for model in models.values():
            lines = model.record.lines
            if lines != setup.lines:
                raise ConfigError(
                    f"candidates.lines is {setup.lines}; {self.version} in {folder} was trained for "
                    f"{lines}; valid: {lines}, or models trained for {setup.lines} (--models DIR)"
                )
        return type(self)(models, setup.gripper)

    def rank(self, context: RankingContext) -> Ranking:
        """Every candidate: first the prediction, then by the decision values."""
        labels, confidence = self._ordered(context)
        order = labels - 1
        by_row = np.empty(len(order))
        by_row[order] = confidence
        return Ranking(order, by_row)

    def _ordered(self, context: RankingContext) -> tuple[Labels, Floats]:
        """(5 l,) labels, best first, and the confidence of each."""
        raise NotImplementedError

    def _whole(self, part: str, context: RankingContext) -> NDArray[np.float32]:
        record = self._models[part].record
        return features.single(
            context.local_maps[record.resolution_m],
            context.box.dimensions_m,
            sampling(record.sampling),
            record.largest_edge_m,
        )


class Single(Svm):
    """One SVM for all candidates (2-3-2)."""

    parts = ("single",)

    def _ordered(self, context: RankingContext) -> tuple[Labels, Floats]:
        model = self._models["single"]
        labels, shares = _asked(model, self._whole("single", context)[None], 5 * model.record.lines)
        return labels[0], shares[0]


class Cascade(Svm):
    """One SVM for the face, then one for the line on it (2-3-3): by face, then by line."""

    parts = ("face", "side", "top")

    def _ordered(self, context: RankingContext) -> tuple[Labels, Floats]:
        faces, face_shares = _asked(self._models["face"], self._whole("face", context)[None], 5)
        asked = [self._lines(context, [face for face in FACES if is_side(face) == side])
                 for side in (True, False)]  # fmt: skip
        lines, line_shares = (np.concatenate(pair) for pair in zip(*asked, strict=True))
        after = np.append(face_shares[0, 1:], 0.0)
        room = face_shares[0] - after
        confidence = after[:, None] + room[:, None] * line_shares[faces[0] - 1]
        return cascaded(faces, lines[None])[0], confidence.ravel()

    def _lines(self, context: RankingContext, faces: list[int]) -> tuple[Labels, Floats]:
        """(faces, l) lines of side or of top faces, best first, and their shares."""
        model = self._models["side" if is_side(faces[0]) else "top"]
        record = model.record
        points, local_map = sampling(record.sampling), context.local_maps[record.resolution_m]
        size = context.box.dimensions_m
        X = [features.line(local_map, size, points, face, record.largest_edge_m) for face in faces]
        return _asked(model, np.stack(X), record.lines)


class SingleSpiral(Single):
    """Spiral samples, 3 cm cells."""

    version = "single-spiral"


class SingleGrid(Single):
    """Grid samples, 7 cm cells."""

    version = "single-grid"


class CascadeSpiral(Cascade):
    """Spiral samples, 3 cm cells."""

    version = "cascade-spiral"


class CascadeGrid(Cascade):
    """Grid samples, 7 cm cells."""

    version = "cascade-grid"


def _asked(model: Model, X: NDArray[np.float32], count: int) -> tuple[Labels, Floats]:
    """(N, count) labels, best first, and the share of contests each won, never rising."""
    label, decision = model.decide(X)
    labels = ranked(label, decision, model.classes, range(1, count + 1))
    won = np.zeros((len(X), count))
    won[:, np.array(model.classes) - 1] = decision / (len(model.classes) - 1)
    shares = np.take_along_axis(np.clip(won, 0.0, 1.0), labels - 1, axis=1)
    return labels, np.minimum.accumulate(shares, axis=1)


def _loaded(folder: Path, version: str, part: str) -> Model:
    name = model_name(version, part)
    path = folder / f"{name}.onnx"
    if not path.is_file():
        raise ModelError(
            f"no model {path.name} in {folder}; valid: a folder that `boxgrasp train` wrote "
            "(--models DIR)"
        )
    model = load_model(path)
    record = model.record
    if record.name != name:
        raise ModelError(f"{path}: holds {record.name}; valid: {name}")
    try:
        check_fits(record, _schema(record.sampling, part))
    except (ConfigError, ModelError) as error:
        raise ModelError(f"{path}: {error}") from None
    return model


def _schema(name: str, part: str) -> FeatureSchema:
    points = sampling(name)
    if part in ("single", "face"):
        return features.single_schema(points)
    return features.line_schema(points, LEFT if part == "side" else TOP_PARALLEL)


def _hand(gripper: Gripper) -> dict[str, float]:
    """What of a hand decides where it fits."""
    names = [item.name for item in fields(gripper) if item.name != "T_gripper_tcp"]
    return {name: getattr(gripper, name) for name in names}


def _difference(trained: Gripper, used: Gripper) -> str:
    there, here = _hand(trained), _hand(used)
    return ", ".join(
        f"{name} {there[name]:g}, now {here[name]:g}" for name in there if there[name] != here[name]
    )
