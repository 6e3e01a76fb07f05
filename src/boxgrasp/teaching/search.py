"""Grid search over C and gamma as in the thesis (3-3-2, 4-1): coarse, then finer, 5-fold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Array, Bools, Floats, Points
from boxgrasp.errors import BoxgraspError, MissingExtraError

FOLDS = 5
# Powers of two, both grids wider than the thesis's choices (B-1: C 1.2 to 175, gamma 0.0035 to
# 0.29).
STEP = 1.25
COARSE_C = tuple(float(2**k) for k in -1 + STEP * np.arange(9))
COARSE_GAMMA = tuple(float(2**k) for k in -10 + STEP * np.arange(9))
# Accuracies this near to the best are as good: half a point is 4 of 800 examples, less than what
# another deal of the folds changes.
AS_GOOD = 0.005

_DECIMALS = 12  # of a squared distance that count: the rest differs between machines


@dataclass(frozen=True)
class SearchParams:
    """How C and gamma are searched.

    Attributes:
        costs: rising values of C of the coarse grid.
        gammas: rising values of gamma of the coarse grid.
        fine_steps: finer steps in a coarse one, to either side of the best; 0 for none.
    """

    costs: tuple[float, ...] = COARSE_C
    gammas: tuple[float, ...] = COARSE_GAMMA
    fine_steps: int = 4


SEARCH = SearchParams()


@dataclass(frozen=True, eq=False)
class Grid:
    """The heat map of figure 3-12.

    Attributes:
        costs: values of C.
        gammas: values of gamma.
        accuracies: (len(gammas), len(costs)) means over the folds, 0 to 1.
        balanced: (len(gammas), len(costs)) means over the classes of the share of each that is
            found again, 0 to 1.
        constant: (len(gammas), len(costs)) bool, whether every example got the same answer.
    """

    costs: tuple[float, ...]
    gammas: tuple[float, ...]
    accuracies: Floats
    balanced: Floats
    constant: Bools


@dataclass(frozen=True, eq=False)
class Search:
    """The pair that was chosen, and all that were tried.

    Attributes:
        C: of the SVM.
        gamma: of its RBF kernel.
        accuracy: mean over the folds, 0 to 1.
        balanced: balanced accuracy, as `Grid.balanced`.
        commonest: share of the commonest class, what a constant answer is worth, 0 to 1.
        coarse: the first grid.
        fine: the grid round the choice of the first.
    """

    C: float
    gamma: float
    accuracy: float
    balanced: float
    commonest: float
    coarse: Grid
    fine: Grid


def search(
    X: Points,
    y: Array,
    *,
    seed: int = 0,
    params: SearchParams = SEARCH,
    groups: Array | None = None,
) -> Search:
    """C and gamma of an RBF SVM (thesis 3-3-2, 4-1).

    A coarse grid, then a finer one round its choice, one coarse step to either side; the choice is
    made among all pairs of both.

    Args:
        X: (N, F) float32 features.
        y: (N,) classes.
        seed: of the folds.
        params: what is tried.
        groups: (N,) as `folds_of` takes it.

    Returns:
        The choice.

    Raises:
        BoxgraspError: fewer than two classes, fewer rows than folds, or nothing but constant
            answers.
        MissingExtraError: scikit-learn is not installed.
    """
    distances = squared_distances(X)
    fold = folds_of(y, FOLDS, seed, groups)
    coarse = grid(distances, y, fold, params.costs, params.gammas)
    first, steps = chosen(coarse), params.fine_steps
    costs = _round(first.C, params.costs, steps)
    fine = grid(distances, y, fold, costs, _round(first.gamma, params.gammas, steps))
    pair = chosen(coarse, fine)
    commonest = float(np.unique(y, return_counts=True)[1].max() / len(y))
    return Search(pair.C, pair.gamma, pair.accuracy, pair.balanced, commonest, coarse, fine)


def train(X: Points, y: Array, C: float, gamma: float) -> Any:
    """The SVM of all rows.

    Args:
        X: (N, F) float32 features.
        y: (N,) classes.
        C: of the SVM.
        gamma: of its RBF kernel.

    Returns:
        A scikit-learn SVC.

    Raises:
        BoxgraspError: fewer than two classes.
        MissingExtraError: scikit-learn is not installed.
    """
    _validate_classes(y)
    return _svm().SVC(C=float(C), gamma=float(gamma), kernel="rbf").fit(X, y)


def one_vs_rest_accuracy(
    X: Points, y: Array, C: float, gamma: float, *, seed: int = 0, groups: Array | None = None
) -> float:
    """Cross-validated accuracy of one SVM a class, each against the rest; the surest one wins.

    The thesis's text says one against the rest, LIBSVM does one against one.

    Args:
        X: (N, F) float32 features.
        y: (N,) classes.
        C: of the SVMs.
        gamma: of their RBF kernels.
        seed: as `search` takes it.
        groups: as `search` takes them.

    Returns:
        The mean over the folds, 0 to 1.

    Raises:
        BoxgraspError: fewer than two classes, fewer rows than folds.
        MissingExtraError: scikit-learn is not installed.
    """
    distances, fold = squared_distances(X), folds_of(y, FOLDS, seed, groups)
    kernel = np.exp(-gamma * distances)
    scores = []
    for k in range(FOLDS):
        seen, asked = np.flatnonzero(fold != k), np.flatnonzero(fold == k)
        known = np.unique(y[seen])
        surest = np.zeros((len(asked), len(known)))
        for column, one in enumerate(known if len(known) > 1 else ()):
            svc = _precomputed(C).fit(kernel[np.ix_(seen, seen)], y[seen] == one)
            surest[:, column] = svc.decision_function(kernel[np.ix_(asked, seen)])
        scores.append(float(np.mean(known[surest.argmax(axis=1)] == y[asked])))
    return float(np.mean(scores))


def folds_of(y: Array, folds: int, seed: int, groups: Array | None = None) -> NDArray[np.int64]:
    """The fold of each row: shuffled, every class spread evenly, fold sizes within one.

    A class with fewer rows than folds is in that many folds alone; where it has one row, that row
    is asked of a model that never saw its class, and counts as an error.

    Args:
        y: (N,) classes.
        folds: how many.
        seed: of the shuffling.
        groups: (N,) what rows belong together, as labels of one scene do: they are in the fold of
            the first of them, so that none is asked of a model that saw another. None for none.

    Returns:
        (N,) int64 from 0.

    Raises:
        BoxgraspError: fewer than two classes, fewer rows or groups than folds.
    """
    if groups is not None:
        places: dict[Any, int] = {}
        of_group = np.array([places.setdefault(one, len(places)) for one in groups.tolist()])
        first = np.unique(of_group, return_index=True)[1]
        _validate_classes(y)
        return np.asarray(folds_of(y[first], folds, seed)[of_group])
    _validate_classes(y)
    if not 2 <= folds <= len(y):
        raise BoxgraspError(f"{folds} folds of {len(y)} rows; valid: 2 to as many as rows")
    order = np.random.default_rng(seed).permutation(len(y))
    # Dealt like cards: rows by class, one to each fold in turn, on and on over the classes.
    by_class = order[np.argsort(y[order], kind="stable")]
    fold = np.empty(len(y), dtype=np.int64)
    fold[by_class] = np.arange(len(y)) % folds
    return fold


def squared_distances(X: Points) -> Floats:
    """Squared distances between all rows.

    Args:
        X: (N, F).

    Returns:
        (N, N) float64.
    """
    rows = np.asarray(X, dtype=np.float64)
    norms = (rows * rows).sum(axis=1)
    squared = norms[:, None] + norms[None, :] - 2.0 * (rows @ rows.T)
    return np.asarray(np.maximum(np.round(squared, _DECIMALS), 0.0))


def grid(
    distances: Floats, y: Array, fold: Array, costs: Sequence[float], gammas: Sequence[float]
) -> Grid:
    """What cross-validation finds of all pairs.

    Args:
        distances: (N, N) of `squared_distances`.
        y: (N,) classes.
        fold: (N,) of `folds_of`.
        costs: values of C.
        gammas: values of gamma.

    Returns:
        The grid.
    """
    # (gammas, costs, N)
    said = np.array([predictions(distances, y, fold, gamma, costs) for gamma in gammas])
    hits = said == y
    folds = [hits[..., fold == k].mean(axis=-1) for k in np.unique(fold)]
    classes = [hits[..., y == one].mean(axis=-1) for one in np.unique(y)]
    return Grid(
        tuple(costs),
        tuple(gammas),
        np.mean(folds, axis=0),
        np.mean(classes, axis=0),
        (said == said[..., :1]).all(axis=-1),
    )


def predictions(
    distances: Floats, y: Array, fold: Array, gamma: float, costs: Sequence[float]
) -> Array:
    """What is said of each row by a model that did not see its fold, of one gamma.

    Args:
        distances: (N, N) of `squared_distances`.
        y: (N,) classes.
        fold: (N,) of `folds_of`.
        gamma: of the RBF kernel.
        costs: values of C.

    Returns:
        (len(costs), N) classes.
    """
    kernel = np.exp(-gamma * distances)
    said = np.empty((len(costs), len(y)), dtype=y.dtype)
    for k in np.unique(fold):
        seen, asked = np.flatnonzero(fold != k), np.flatnonzero(fold == k)
        if len(np.unique(y[seen])) == 1:  # nothing to tell apart
            said[:, asked] = y[seen[0]]
            continue
        among, across = kernel[np.ix_(seen, seen)], kernel[np.ix_(asked, seen)]
        for row, C in enumerate(costs):
            said[row, asked] = _precomputed(C).fit(among, y[seen]).predict(across)
    return said


class Pair(NamedTuple):
    """C and gamma, and what cross-validation finds of them."""

    C: float
    gamma: float
    accuracy: float
    balanced: float


def chosen(*grids: Grid) -> Pair:
    """The choice: high accuracy, then a balanced one, then the larger gamma (4-1).

    The thesis takes a pair of high accuracy and large gamma, to counter the bias that comes with
    unequal classes. Where nearly all examples are of one class every pair is as accurate, and the
    largest gamma says that class always; so of the pairs within `AS_GOOD` of the best accuracy the
    best balanced one is taken, which is what the larger gamma was to bring, then the largest gamma,
    the more accurate, the smaller C. A pair that gives all examples one answer is never taken.

    Args:
        grids: one or more.

    Returns:
        The pair.

    Raises:
        BoxgraspError: every pair answers the same always.
    """
    pairs = [
        Pair(C, gamma, float(tried.accuracies[at]), float(tried.balanced[at]))
        for tried in grids
        for g, gamma in enumerate(tried.gammas)
        for c, C in enumerate(tried.costs)
        if not tried.constant[at := (g, c)]
    ]
    if not pairs:
        raise BoxgraspError(
            "every C and gamma answers the same class always; valid: more examples of the others"
        )
    best = max(pair.accuracy for pair in pairs)
    good = [pair for pair in pairs if pair.accuracy >= best - AS_GOOD - 1e-9]
    return max(good, key=lambda p: (round(p.balanced, 9), p.gamma, round(p.accuracy, 9), -p.C))


def _round(middle: float, coarse: Sequence[float], steps: int) -> tuple[float, ...]:
    """Finer values from one coarse step below to one above, the middle one exactly."""
    if steps == 0:
        return (middle,)
    step = (coarse[-1] / coarse[0]) ** (1 / (len(coarse) - 1)) if len(coarse) > 1 else 2.0
    return tuple(middle * step ** (k / steps) if k else middle for k in range(-steps, steps + 1))


def _validate_classes(y: Array) -> None:
    found = np.unique(y)
    if len(found) < 2:
        said = f"all {len(y)} examples are of class {found[0]}" if len(found) else "no examples"
        raise BoxgraspError(f"{said}; valid: at least two classes")


def _precomputed(C: float) -> Any:
    return _svm().SVC(C=float(C), kernel="precomputed")


def _svm() -> Any:
    try:
        import sklearn.svm
    except ImportError:
        raise MissingExtraError(
            "training needs scikit-learn; install with: pip install 'boxgrasp[train]'"
        ) from None
    return sklearn.svm
