"""Chapters 2 and 3, appendix B: samples, portions, classes, features, the score; all counted."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from boxgrasp.arrays import Array, Floats
from boxgrasp.grasps.candidates import FACES, LINES, RIGHT, TOP_PERPENDICULAR
from boxgrasp.grasps.scoring import THESIS_SCORE
from boxgrasp.ranking.model_set import SVMS, VERSIONS, Part, Svm
from boxgrasp.ranking.sampling import LAYERS, RADIUS_M, RESOLUTION_M, portion, sampling
from boxgrasp.study.answers.figures import Answer, Answers, Figures
from boxgrasp.study.intervals import share

_CLASSES: dict[Part, int] = {
    "single": len(FACES) * LINES, "face": len(FACES), "side": LINES, "top": LINES,
}  # fmt: skip
_DRAWS, _STEP = 20_000, 2_000
TABLE_M = 0.80  # the height of the thesis's table (3-1)
_CENTER_M = 0.05  # of the half sphere over the table (3-2)


def nearest_m(points: Floats) -> Floats:
    """How far the nearest neighbor of each point is.

    Args:
        points: (N, 3) m.

    Returns:
        (N,) m.
    """
    away = np.linalg.norm(points[:, None] - points[None], axis=2)
    np.fill_diagonal(away, np.inf)
    return np.asarray(away.min(axis=1))


def _gap_cm(of: Callable[[Floats], float]) -> Answer:
    # Four digits, so that one rounding alone comes before the comparison.
    return Answer(round(100 * float(of(nearest_m(sampling("spiral")))), 4), "in cm")


def _denser_center(_: Figures) -> Answer:
    gaps, first = nearest_m(sampling("spiral")), LAYERS[0][1]
    inner, outer = 100 * gaps[:first].mean(), 100 * gaps[-LAYERS[-1][1] :].mean()
    return Answer(
        "denser" if inner < outer else "not denser",
        f"nearest neighbors {inner:.2f} cm in the first layer, {outer:.2f} cm in the fourth",
    )


def _gaps_alike(_: Figures) -> Answer:
    gaps, grid_m = nearest_m(sampling("spiral")), float(nearest_m(sampling("grid")).mean())
    within = gaps.min() <= grid_m <= gaps.max()
    return Answer(
        "grid's distance lies between spiral's least and most" if within else "outside",
        f"7.0 cm with grid, {100 * gaps.mean():.1f} cm with spiral",
    )


def _homogeneous(_: Figures) -> Answer:
    """How evenly the half sphere is covered: spread of the distance to the nearest sample."""
    rng = np.random.default_rng(0)
    drawn = rng.uniform(-RADIUS_M, RADIUS_M, (_DRAWS, 3))
    drawn[:, 2] = np.abs(drawn[:, 2])
    drawn = drawn[np.linalg.norm(drawn, axis=1) <= RADIUS_M]
    spread = {}
    for name in ("spiral", "grid"):
        points = sampling(name)
        away = np.concatenate(
            [
                np.linalg.norm(drawn[k : k + _STEP, None] - points[None], axis=2).min(axis=1)
                for k in range(0, len(drawn), _STEP)
            ]
        )
        spread[name] = away.std() / away.mean()
    return Answer(
        "more even" if spread["spiral"] < spread["grid"] else "less even",
        "spread of the distance from any place to the nearest sample, over its mean: "
        f"{spread['spiral']:.3f} with spiral, {spread['grid']:.3f} with grid",
    )


def _diverse(_: Figures) -> Answer:
    directions = {}
    for name in ("spiral", "grid"):
        points = sampling(name)
        turned = np.degrees(np.arctan2(points[:, 1], points[:, 0]))
        directions[name] = len(np.unique(turned.round(1)))
    return Answer(
        "more directions" if directions["spiral"] > directions["grid"] else "fewer directions",
        f"{directions['spiral']} directions round the vertical with spiral, "
        f"{directions['grid']} with grid",
    )


def cells_of(points: Floats, resolution_m: float) -> Array:
    """The cells that points lie in, aligned with the half sphere.

    Args:
        points: (N, 3) map frame, m.
        resolution_m: edge of a cell, m.

    Returns:
        (n, 3) int, each cell once.
    """
    across = np.floor(points[:, :2] / resolution_m)
    up = np.round(points[:, 2:] / resolution_m)
    return np.asarray(np.unique(np.hstack((across, up)).astype(int), axis=0))


def _coverage_grid(_: Figures) -> Answer:
    points = sampling("grid")
    return Answer(f"{len(cells_of(points, RESOLUTION_M['grid']))} of {len(points)}")


def _coverage_spiral(_: Figures) -> Answer:
    inside = cells_of(sampling("dense"), RESOLUTION_M["spiral"])
    hit = cells_of(sampling("spiral"), RESOLUTION_M["spiral"])
    every = {tuple(cell) for cell in inside.tolist()}
    both = len(every & {tuple(cell) for cell in hit.tolist()})
    return Answer(
        "in part" if both < len(every) else "complete",
        f"{both} of the {len(every)} cells of 3 cm whose middles lie in the half sphere",
    )


def _voxels_cubic(_: Figures) -> Answer:
    ratio = len(sampling("dense")) / len(sampling("grid"))
    cubed = (RESOLUTION_M["grid"] / RESOLUTION_M["dense"]) ** 3
    return Answer(
        "by the cube" if abs(ratio / cubed - 1) < 0.1 else "otherwise",
        f"2,256 over 184 is {ratio:.1f}, 7 over 3 cubed {cubed:.1f}",
    )


def _portion(name: str, face: int) -> Answer:
    return Answer(len(portion(sampling(name), face)))


def _class_8(_: Figures) -> Answer:
    face, line = divmod(8 - 1, LINES)
    return Answer(f"{FACES[face]}, line {line + 1}")


def _score(clearance_m: float) -> Answer:
    return Answer(round(float(THESIS_SCORE([clearance_m], [0.083])[0]), 4), "best 8.3 cm")


def _features(svm: Svm) -> Callable[[Figures], Answer]:
    return lambda _: Answer(f"{len(svm.schema)} x {_CLASSES[svm.part]}")


def table_in_lowest_cell(resolution_m: float, table_m: float = TABLE_M) -> bool:
    """Whether the lowest samples share a cell with the table's top, cells on the world's lattice.

    Args:
        resolution_m: edge of a cell; cell k reaches from k to k + 1 edges over the floor, m.
        table_m: height of the top, m.

    Returns:
        Whether they do.
    """
    slack = 1e-9  # 0.84 is the lower end of a 7 cm cell
    return int(table_m / resolution_m + slack) == int((table_m + _CENTER_M) / resolution_m + slack)


def _table_not_sampled(_: Figures) -> Answer:
    shared = [size for size in (0.03, 0.07) if table_in_lowest_cell(size)]
    return Answer(
        "sampled" if shared else "not sampled",
        "By arithmetic: the top at 0.80 m lies in the 7 cm cell from 0.77 to 0.84 m of the world's "
        "lattice, the lowest samples at 0.85 m in the next; with 3 cm cells from 0.78 to 0.81 and "
        "from 0.84 to 0.87 m.",
    )


def _few_labels(figures: Figures) -> Answer:
    # Examples of the four planners that section 1-2-4 compares with.
    factors = [others / 800 for others in (6_500, 6_700_000)]
    low, high = (10 ** round(float(np.log10(factor))) for factor in factors)
    return Answer(
        f"{low:,} to {high:,}",
        f"6,500 to 6.7 million examples of others against 800: {factors[0]:.1f} to "
        f"{factors[1]:,.0f} times, to the nearest power of ten. None of the others was trained "
        f"again here, and what {figures.labels.rows.count} labels give is `clear-simulation`.",
    )


def _vectors(svm: Svm) -> Callable[[Figures], Answer]:
    def answer(figures: Figures) -> Answer:
        record = figures.study.trained[svm.name]["record"]
        vectors, count = record["support_vectors"], record["training_examples"]
        return Answer(share(vectors, count), f"{vectors} of {count}")

    return answer


ANSWERS: Answers = {
    "samples-dense": lambda _: Answer(len(sampling("dense"))),
    "image-values": lambda _: Answer(480 * 360),
    "voxels-cubic": _voxels_cubic,
    "samples-spiral": lambda _: Answer(len(sampling("spiral"))),
    "samples-grid": lambda _: Answer(len(sampling("grid"))),
    "gap-average": lambda _: _gap_cm(lambda gaps: gaps.mean()),
    "gap-least": lambda _: _gap_cm(lambda gaps: gaps.min()),
    "gap-most": lambda _: _gap_cm(lambda gaps: gaps.max()),
    "denser-center": _denser_center,
    "gaps-alike": _gaps_alike,
    "homogeneous": _homogeneous,
    "diverse": _diverse,
    "coverage-grid": _coverage_grid,
    "coverage-spiral": _coverage_spiral,
    "portion-side-spiral": lambda _: _portion("spiral", RIGHT),
    "portion-side-grid": lambda _: _portion("grid", RIGHT),
    "portion-top-spiral": lambda _: _portion("spiral", TOP_PERPENDICULAR),
    "portion-top-grid": lambda _: _portion("grid", TOP_PERPENDICULAR),
    "svms": lambda _: Answer(len(SVMS)),
    "versions": lambda _: Answer(len(VERSIONS)),
    "classes": lambda _: Answer(len(FACES) * LINES),
    "class-8": _class_8,
    "score-83mm": lambda _: _score(0.083),
    "score-28mm": lambda _: _score(0.028),
    "score-0mm": lambda _: _score(0.0),
    "table-not-sampled": _table_not_sampled,
    "few-labels": _few_labels,
    **{f"features-{svm.number}": _features(svm) for svm in SVMS},
    **{f"vectors-{svm.number}": _vectors(svm) for svm in SVMS},
}
