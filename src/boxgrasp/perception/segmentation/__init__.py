"""Which points over the support plane belong together; another way to tell is a line here."""

from __future__ import annotations

from importlib import import_module
from typing import Final

from boxgrasp.perception.segmentation.protocol import Segmentation

# By the names that `scene.segmentation` takes. Imported where it is used alone, so that one with
# heavy needs costs nobody else.
SEGMENTATIONS: Final = {
    "split": "boxgrasp.perception.segmentation.split:split_segments",
    "euclidean": "boxgrasp.perception.segmentation.euclidean:euclidean_segments",
    "network": "boxgrasp.perception.segmentation.network:network_segments",
}

# Segmentations that look at the image: a cloud, which has none, is segmented by another one.
NEED_IMAGE: Final = frozenset(("network",))
WITHOUT_IMAGE: Final = "split"


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
