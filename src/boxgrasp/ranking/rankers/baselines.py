"""What a ranker must beat: grasping the box's middle from above, and chance."""

from __future__ import annotations

import hashlib

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Floats
from boxgrasp.grasps.candidates import TOP_PARALLEL
from boxgrasp.ranking.ranker import Ranker, Ranking, RankingContext


class TopDown(Ranker):
    """The box's center from above, fingers over its narrower side; then over the other; the rest.

    The rest follows by label. Its confidence falls evenly along the order and says nothing else.
    """

    name = "top-down"

    def rank(self, context: RankingContext) -> Ranking:
        """Order by being a top face's middle line, then by width, then by label.

        Args:
            context: the candidates.

        Returns:
            The order.
        """
        candidates = context.candidates
        middle = (candidates.line == (candidates.lines + 1) // 2) & (
            candidates.face >= TOP_PARALLEL
        )
        width = np.where(middle, candidates.width_m, 0.0)
        order = np.lexsort((candidates.label, width, ~middle))
        return Ranking(order, _falling(order))


class Random(Ranker):
    """Chance: each order is as likely as another, drawn from a seed made of the box itself.

    The same view gives the same order; another scene gives another. Each candidate has the same
    confidence.
    """

    name = "random"

    def rank(self, context: RankingContext) -> Ranking:
        """Order by chance, from a seed of the box's place and size, to 0.1 mm, alone.

        Args:
            context: the box and the candidates.

        Returns:
            The order.
        """
        box = context.box
        place = np.concatenate([box.T_base_box[:3, 3], box.dimensions_m])
        tenths = np.round(place * 1e4).astype("<i8")
        seed = int.from_bytes(hashlib.sha256(tenths.tobytes()).digest()[:16], "little")
        count = len(context.candidates.label)
        order = np.random.default_rng(seed).permutation(count)
        return Ranking(order, np.full(count, 1.0 / count))


def _falling(order: NDArray[np.int64]) -> Floats:
    confidence = np.empty(len(order))
    confidence[order] = 1.0 - np.arange(len(order)) / len(order)
    return confidence
