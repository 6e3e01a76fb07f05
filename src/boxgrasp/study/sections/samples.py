"""The samplings and portions, re-derived and drawn: figures 2-5 to 2-8, 3-5 and 3-7 to 3-9."""

from __future__ import annotations

import numpy as np

from boxgrasp.arrays import Floats
from boxgrasp.grasps.candidates import RIGHT, TOP_PERPENDICULAR
from boxgrasp.ranking.sampling import grid, portion, sampling
from boxgrasp.study.plots import golden_spiral, samples_3d, spiral_layers
from boxgrasp.study.report import Picture, Row, Section


def samples_section() -> Section:
    """Counts of samples and portions, and their pictures.

    Returns:
        The section.
    """
    return Section(
        key="samples",
        title="Samplings and portions",
        place="sections 2-2, 3-2; figures 2-5 to 2-8, 3-5, 3-7 to 3-9, table 3-2",
        words=(
            "Counts are the thesis's. Algorithm 4 as printed would give 195 grid points, the "
            "spiral's angles as printed would give portions of 58 and 116; both are read so that "
            "its counts come out.",
        ),
        rows=_rows(),
        pictures=_pictures(),
    )


def _rows() -> tuple[Row, ...]:
    spiral = sampling("spiral")
    gaps = _nearest(spiral)
    portions = []
    for name, side, top in (("spiral", 57, 118), ("grid", 60, 120)):
        points = sampling(name)
        portions += [
            Row(f"portion before a side face, {name}", side, len(portion(points, RIGHT))),
            Row(f"portion before a top face, {name}", top, len(portion(points, TOP_PERPENDICULAR))),
        ]
    return (
        Row("samples, dense at 3 cm", 2256, len(sampling("dense"))),
        Row("samples, grid", 184, len(sampling("grid"))),
        Row("samples, spiral", 184, len(spiral)),
        Row("nearest neighbors of the spiral, least, cm", 6.6, round(100 * gaps.min(), 2)),
        Row("nearest neighbors of the spiral, average, cm", 7.2, round(100 * gaps.mean(), 2)),
        Row("nearest neighbors of the spiral, most, cm", 7.5, round(100 * gaps.max(), 2)),
        *portions,
    )


def _pictures() -> tuple[Picture, ...]:
    spiral, grid_7cm = sampling("spiral"), sampling("grid")
    disc = Picture(
        "figure-2-6",
        "256 points of a golden spiral on a disc, blue first (figure 2-6).",
        svg=golden_spiral(),
        alt="Sunflower pattern of 256 points",
    )
    layers = Picture(
        "figure-2-7",
        "A layer of the spiral sampling, and a section through all four, a color and a mark a "
        "layer (figure 2-7). A section is half a spacing thick to both sides, so that some of its "
        "samples lie before or behind their circle.",
        svg=spiral_layers(spiral),
        alt="Half a sphere of samples, and four half circles with samples along them",
    )
    return (
        disc,
        _drawn("2-5", "dense samples, one in every 3 cm cell", sampling("dense")),
        layers,
        _drawn("2-8", "a grid of 0.2 in a unit half sphere", grid(0.2, 1.0)),
        _drawn("3-5", "spiral sampling", spiral),
        _drawn("3-7", "grid sampling", grid_7cm),
        _drawn("3-8-spiral", "spiral portion before the right face", spiral, RIGHT),
        _drawn("3-8-grid", "grid portion before the right face", grid_7cm, RIGHT),
        _drawn("3-9-spiral", "spiral portion, top-perpendicular", spiral, TOP_PERPENDICULAR),
        _drawn("3-9-grid", "grid portion, top-perpendicular", grid_7cm, TOP_PERPENDICULAR),
    )


def _drawn(number: str, words: str, points: Floats, face: int | None = None) -> Picture:
    kept = None if face is None else portion(points, face)
    return Picture(
        f"figure-{number}",
        f"{words[0].upper()}{words[1:]} (figure {number[:3]}).",
        svg=samples_3d(points, kept),
        alt=words,
    )


def _nearest(points: Floats) -> Floats:
    """(N,) distance of each point to its nearest neighbor."""
    away = np.linalg.norm(points[:, None] - points[None], axis=2)
    np.fill_diagonal(away, np.inf)
    return np.asarray(away.min(axis=1))
