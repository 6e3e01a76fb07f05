"""The thesis's four versions: one SVM for all candidates, or one for the face and one for the line.

Models are read from `<version>.onnx`, or `<version>-face.onnx`, `-side.onnx` and `-top.onnx`.
"""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from boxgrasp.errors import CodedWarning, ConfigError, MissingExtraError, ModelError
from boxgrasp.grasps.gripper import Gripper
from boxgrasp.ranking.model_set import ModelSet, SampledScenes, model_set_of, read_models
from boxgrasp.ranking.onnx.model import SHIPPED
from boxgrasp.ranking.ranker import Ranker, RankerSetup, Ranking, RankingContext


class SvmRanker(Ranker):
    """Orders the candidates as trained SVMs prefer them; `ModelSet.order` says how."""

    _models: ModelSet

    def prepared(self, setup: RankerSetup) -> Ranker:
        """The ranker with the models of the setup's folder.

        Raises:
            ConfigError: they are for another number of lines.
            ModelError: they are missing, damaged, or do not fit the code's features.
            MissingExtraError: onnxruntime is not installed.
        """
        folder = SHIPPED if setup.models is None else Path(setup.models)

        def read(name: str) -> bytes:
            if not (folder / name).is_file():
                raise ModelError(
                    f"no model {name} in {folder}; valid: a folder that `boxgrasp train` wrote "
                    "(--models DIR)"
                )
            try:
                return (folder / name).read_bytes()
            except OSError as error:
                raise ModelError(f"{folder / name}: {error.strerror or error}") from None

        try:
            models = read_models(self.name, read)
        except MissingExtraError:
            raise
        except ModelError as error:
            said = str(error)
            raise ModelError(said if str(folder) in said else f"{folder}/{said}") from None
        ready = type(self)()
        ready._models = model_set_of(models)
        records = [model.record for model in models.values()]
        if ready._models.lines != setup.lines:
            raise ConfigError(
                f"candidates.lines is {setup.lines}; {self.name} in {folder} was trained for "
                f"{ready._models.lines}; valid: {ready._models.lines}, or models trained for "
                f"{setup.lines} (--models DIR)"
            )
        ready.map_resolutions_m = tuple(sorted({record.resolution_m for record in records}))
        other = [r.gripper for r in records if _hand(r.gripper) != _hand(setup.gripper)]
        if other:
            ready.warnings = (
                CodedWarning(
                    "trained_with_another_gripper",
                    f"{self.name} was trained with another gripper "
                    f"({_difference(other[0], setup.gripper)}): its order may be off, the checks "
                    "are not",
                ),
            )
        return ready

    def rank(self, context: RankingContext) -> Ranking:
        """Every candidate: first the prediction, then by the decision values.

        It asks where the models predict that their operator would help.
        """
        local_map = context.local_maps[self.map_resolutions_m[0]]
        scene = SampledScenes.of_map(local_map, context.box.dimensions_m, self._models.sampling)
        labels, confidence, asks = self._models.order(scene)
        order = labels[0] - 1
        by_row = np.empty(len(order))
        by_row[order] = confidence[0]
        return Ranking(order, by_row, bool(asks[0]))


class SingleSpiral(SvmRanker):
    """Spiral samples, 3 cm cells, one SVM (2-3-2)."""

    name = "single-spiral"


class SingleGrid(SvmRanker):
    """Grid samples, 7 cm cells, one SVM (2-3-2)."""

    name = "single-grid"


class CascadeSpiral(SvmRanker):
    """Spiral samples, 3 cm cells, one SVM for the face and one for the line on it (2-3-3)."""

    name = "cascade-spiral"


class CascadeGrid(SvmRanker):
    """Grid samples, 7 cm cells, one SVM for the face and one for the line on it (2-3-3)."""

    name = "cascade-grid"


_APART = (
    "name",
    "T_gripper_tcp",
    "T_flange_gripper",
)  # where a hand fits is alike whatever they are


def _hand(gripper: Gripper) -> dict[str, Any]:
    """What of a hand decides where it fits."""
    names = [item.name for item in fields(gripper) if item.name not in _APART]
    return {name: getattr(gripper, name) for name in names}


def _difference(trained: Gripper, used: Gripper) -> str:
    there, here = _hand(trained), _hand(used)
    return ", ".join(
        f"{name} {_told(there[name])}, now {_told(here[name])}"
        for name in there
        if there[name] != here[name]
    )


def _told(value: Any) -> str:
    if isinstance(value, tuple):
        return f"{len(value)} boxes"
    return "none" if value is None else f"{value:g}"
