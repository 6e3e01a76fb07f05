"""Which points over the support plane belong together; another way to tell is a line here."""

from __future__ import annotations

from importlib import import_module
from typing import Final

from boxgrasp.perception.segmentation.protocol import Segmentation

# By the names that `scene.segmentation` takes. Imported where it is used alone, so that one with
# heavy needs costs nobody else.
SEGMENTATIONS: Final = {
    "split": "boxgrasp.perception.segmentation.split:split_clusters",
    "euclidean": "boxgrasp.perception.segmentation.euclidean:euclidean_clusters",
}


def segmentation_named(name: str) -> Segmentation:
    """The segmentation of a name.

    Args:
        name: a key of `SEGMENTATIONS`.

    Returns:
        The function.
    """
    module, function = SEGMENTATIONS[name].split(":")
    found: Segmentation = getattr(import_module(module), function)
    return found
