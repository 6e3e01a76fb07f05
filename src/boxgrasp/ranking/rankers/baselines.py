"""What a chooser must beat: grasping the box's middle from above, and chance."""

from __future__ import annotations

import hashlib

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Floats
from boxgrasp.grasps.candidates import TOP_PARALLEL
from boxgrasp.ranking.ranker import Chooser, Preference, Situation


class TopDown(Chooser):
    """The box's center from above, fingers over its narrower side; then over the other; the rest.

    The rest follows by label. Its sureness falls evenly along the order and says nothing else.
    """

    def prefer(self, situation: Situation) -> Preference:
        """Order by being a top face's middle line, then by width, then by label."""
        options = situation.options
        middle = (options.line == (options.lines + 1) // 2) & (options.face >= TOP_PARALLEL)
        width = np.where(middle, options.width_m, 0.0)
        order = np.lexsort((options.label, width, ~middle))
        return Preference(order, _falling(order))


class Random(Chooser):
    """Chance: each order is as likely as another, drawn from a seed made of the box itself.

    The same view gives the same order; another scene gives another. Sure of nothing: each option
    has the same sureness.
    """

    def prefer(self, situation: Situation) -> Preference:
        """A permutation that depends on the box's place and size, to 0.1 mm, alone."""
        box = situation.box
        place = np.concatenate([box.T_base_box[:3, 3], box.dimensions_m])
        tenths = np.round(place * 1e4).astype("<i8")
        seed = int.from_bytes(hashlib.sha256(tenths.tobytes()).digest()[:16], "little")
        count = len(situation.options.label)
        order = np.random.default_rng(seed).permutation(count)
        return Preference(order, np.full(count, 1.0 / count))


def _falling(order: NDArray[np.int64]) -> Floats:
    sureness = np.empty(len(order))
    sureness[order] = 1.0 - np.arange(len(order)) / len(order)
    return sureness
