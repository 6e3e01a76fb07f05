"""What is known of a trained model, kept inside its ONNX file."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from msgspec import Meta

from boxgrasp.errors import ModelError
from boxgrasp.grasps.gripper import Gripper
from boxgrasp.ranking.features import FeatureSchema
from boxgrasp.strict import build, plain

FORMAT = 2

Positive = Annotated[float, Meta(gt=0.0)]
Count = Annotated[int, Meta(ge=1)]


@dataclass(frozen=True)
class Record:
    """How a model was made and what it needs.

    Attributes:
        version: the thesis's algorithm version, as `cascade-grid`.
        part: what it decides.
        sampling: `spiral` or `grid`.
        resolution_m: cell size of the local map that it reads, m.
        lines: l, lines a face.
        largest_edge_m: what box dimensions are divided by, m; None for each box's own.
        features: names of its features in order.
        schema_hash: theirs.
        classes: candidates 1 to 5 l, faces 1 to 5 or lines 1 to l, those seen in training; one
            more, 5 l + 1 or 6, is the request for help (6-1), which lines do not have.
        gripper: the hand of its training.
        object_set: objects and targets of its training.
        seeds: of its training set.
        label_source: who labeled.
        versions: of the libraries.
        C: of the SVM.
        gamma: of its RBF kernel.
        support_vectors: how many.
        training_examples: how many.
        accuracy: of its cross-validation, 0 to 1.
        format: of the record.

    Raises:
        ModelError: values that contradict each other.
    """

    version: str
    part: Literal["single", "face", "side", "top"]
    sampling: str
    resolution_m: Positive
    lines: Annotated[int, Meta(ge=1, le=99)]
    largest_edge_m: Positive | None
    features: tuple[str, ...]
    schema_hash: str
    classes: tuple[int, ...]
    gripper: Gripper
    object_set: str
    seeds: tuple[int, ...]
    label_source: str
    versions: dict[str, str]
    C: Positive
    gamma: Positive
    support_vectors: Count
    training_examples: Count
    accuracy: Annotated[float, Meta(ge=0.0, le=1.0)]
    format: int = FORMAT

    def __post_init__(self) -> None:
        most = {"single": 5 * self.lines + 1, "face": 6}.get(self.part, self.lines)
        rising = list(self.classes) == sorted(set(self.classes))
        if (
            len(self.classes) < 2
            or not rising
            or not 1 <= self.classes[0] <= self.classes[-1] <= most
        ):
            raise ModelError(
                f"classes are {list(self.classes)}; valid: two or more, rising, from 1 to {most}"
            )
        if FeatureSchema(self.features).hash != self.schema_hash:
            raise ModelError("schema_hash is not that of the features named")

    @property
    def name(self) -> str:
        """Its file's name without `.onnx`: `single-grid`, `cascade-grid-face`, ..."""
        return model_name(self.version, self.part)


def model_name(version: str, part: str) -> str:
    """A model file's name without `.onnx`: the version, and the part unless it is the only one.

    Args:
        version: as `Record.version`.
        part: as `Record.part`.

    Returns:
        The name.
    """
    return version if part == "single" else f"{version}-{part}"


def to_json(record: Record) -> str:
    """The record as it is stored.

    Args:
        record: any.

    Returns:
        JSON on one line, keys in order.
    """
    return json.dumps(plain(record), sort_keys=True, separators=(",", ":"), allow_nan=False)


def from_json(text: bytes) -> Record:
    """The record of a file.

    Args:
        text: as it is stored.

    Returns:
        The record, every value validated.

    Raises:
        ModelError: not a record, or one of another format.
    """
    try:
        data: Any = json.loads(text.decode("utf-8"))
    except (ValueError, RecursionError):
        raise ModelError("the record is not JSON") from None
    if not isinstance(data, dict):
        raise ModelError("the record is not a JSON object")
    found = data.get("format")
    if found != FORMAT or isinstance(found, bool):
        raise ModelError(
            f"record format is {_short(found)}; valid: {FORMAT} (a model trained by this version)"
        )
    return build(Record, data, "record", ModelError)


def validate_fits(record: Record, schema: FeatureSchema) -> None:
    """Refuse a model that was trained on other features than the code computes.

    Args:
        record: the model's.
        schema: of the features that the code computes.

    Raises:
        ModelError: naming both schemas and the first feature that differs.
    """
    if record.schema_hash == schema.hash:
        return
    mine, its = schema.names, record.features
    k = next((k for k, (a, b) in enumerate(zip(its, mine, strict=False)) if a != b), None)
    k = min(len(its), len(mine)) if k is None else k
    a, b = (names[k] if k < len(names) else "none" for names in (its, mine))
    raise ModelError(
        f"{record.name} has {len(its)} features of schema {record.schema_hash[:16]}, this code "
        f"computes {len(mine)} of schema {schema.hash[:16]}; first difference: feature {k} is "
        f"{a} there, {b} here; valid: a model trained with these features"
    )


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 40 else text[:37] + "..."
