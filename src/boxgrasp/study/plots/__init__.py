"""The report's plots as SVG text. Matplotlib (extra `train`) is imported on first use."""

from __future__ import annotations

from boxgrasp.study.plots.bars import category_shares, label_distribution
from boxgrasp.study.plots.lines import curves, heat_map, score_functions
from boxgrasp.study.plots.points import forest, ranker_points
from boxgrasp.study.plots.space import golden_spiral, samples_3d, spiral_layers

__all__ = [
    "category_shares",
    "ranker_points",
    "curves",
    "forest",
    "golden_spiral",
    "heat_map",
    "label_distribution",
    "samples_3d",
    "score_functions",
    "spiral_layers",
]
