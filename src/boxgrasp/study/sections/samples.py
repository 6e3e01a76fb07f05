"""The samplings and portions, re-derived and drawn: figures 2-5 to 2-8, 3-5 and 3-7 to 3-9."""

from __future__ import annotations

import numpy as np

from boxgrasp.grasps.candidates import RIGHT, TOP_PERPENDICULAR
from boxgrasp.ranking.sampling import grid, portion, sampling
from boxgrasp.study.plots import golden_spiral, samples_3d
from boxgrasp.study.report import Picture, Row, Section


def samples_section() -> Section:
    """Counts of samples and portions, and their pictures."""
    spiral_points = sampling("spiral")
    gaps = _nearest(spiral_points)
    rows = [
        Row("samples, dense at 3 cm", 2256, len(sampling("dense"))),
        Row("samples, grid", 184, len(sampling("grid"))),
        Row("samples, spiral", 184, len(spiral_points)),
        Row("nearest neighbors of the spiral, least, cm", 6.6, round(100 * gaps.min(), 2)),
        Row("nearest neighbors of the spiral, average, cm", 7.2, round(100 * gaps.mean(), 2)),
        Row("nearest neighbors of the spiral, most, cm", 7.5, round(100 * gaps.max(), 2)),
    ]
    for name, side, top in (("spiral", 57, 118), ("grid", 60, 120)):
        points = sampling(name)
        rows += [
            Row(f"portion before a side face, {name}", side, len(portion(points, RIGHT))),
            Row(f"portion before a top face, {name}", top, len(portion(points, TOP_PERPENDICULAR))),
        ]
    drawn = (
        ("2-5", "dense samples, one in every 3 cm cell", sampling("dense"), None),
        ("2-7", "layers of the spiral", spiral_points, None),
        ("2-8", "a grid of 0.2 in a unit half sphere", grid(0.2, 1.0), None),
        ("3-5", "spiral sampling", spiral_points, None),
        ("3-7", "grid sampling", sampling("grid"), None),
        ("3-8-spiral", "spiral portion before the right face", spiral_points, RIGHT),
        ("3-8-grid", "grid portion before the right face", sampling("grid"), RIGHT),
        ("3-9-spiral", "spiral portion, top-perpendicular", spiral_points, TOP_PERPENDICULAR),
        ("3-9-grid", "grid portion, top-perpendicular", sampling("grid"), TOP_PERPENDICULAR),
    )
    pictures = [
        Picture(
            "figure-2-6",
            "256 points of a golden spiral on a disc, blue first (figure 2-6).",
            svg=golden_spiral(),
            alt="Sunflower pattern of 256 points",
        )
    ]
    for number, words, points, face in drawn:
        kept = None if face is None else portion(points, face)
        pictures.append(
            Picture(
                f"figure-{number}",
                f"{words[0].upper()}{words[1:]} (figure {number[:3]}).",
                svg=samples_3d(points, kept),
                alt=words,
            )
        )
    return Section(
        key="samples",
        title="Samplings and portions",
        place="sections 2-2, 3-2; figures 2-5 to 2-8, 3-5, 3-7 to 3-9, table 3-2",
        words=(
            "Counts are the thesis's. Algorithm 4 as printed would give 195 grid points, the "
            "spiral's angles as printed would give portions of 58 and 116; both are read so that "
            "its counts come out.",
        ),
        rows=tuple(rows),
        pictures=tuple(pictures),
    )


def _nearest(points: np.ndarray) -> np.ndarray:
    """(N,) distance of each point to its nearest neighbor."""
    away = np.linalg.norm(points[:, None] - points[None], axis=2)
    np.fill_diagonal(away, np.inf)
    return np.asarray(away.min(axis=1))
