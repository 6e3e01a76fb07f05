"""The grid search against scikit-learn's own, and its rule for choosing."""

from __future__ import annotations

import warnings
from itertools import product
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("sklearn")

from sklearn.metrics import balanced_accuracy_score
from sklearn.model_selection import GridSearchCV, cross_val_predict
from sklearn.multiclass import OneVsRestClassifier
from sklearn.svm import SVC

from boxgrasp.errors import BoxgraspError
from boxgrasp.teaching.search import (
    AS_GOOD,
    COARSE_C,
    COARSE_GAMMA,
    Grid,
    chosen,
    folds_of,
    grid,
    one_vs_rest_accuracy,
    search,
    squared_distances,
    train,
)


def problem(seed: int, count: int = 90, classes: int = 4) -> tuple[Any, Any]:
    """Occupancy and dimensions with skewed classes that depend on them."""
    r = np.random.default_rng(seed)
    X = np.concatenate([r.choice([0, 0.5, 1], (count, 12)), r.random((count, 3))], axis=1)
    metrics = X @ r.normal(size=(15, classes)) + np.linspace(0, 2, classes)
    return X.astype(np.float32), metrics.argmax(axis=1) + 1


def splits(fold: Any) -> list[tuple[Any, Any]]:
    return [(np.flatnonzero(fold != k), np.flatnonzero(fold == k)) for k in range(fold.max() + 1)]


@pytest.mark.parametrize("seed", range(3))
def test_scores_are_those_of_scikit_learns_grid_search(seed: int) -> None:
    X, y = problem(seed)
    found = search(X, y, seed=seed)
    fold = folds_of(y, 5, seed)
    for pairs in (found.coarse, found.fine):
        theirs = GridSearchCV(
            SVC(kernel="rbf"), {"gamma": pairs.gammas, "C": pairs.costs}, cv=splits(fold)
        ).fit(X, y)
        told = {
            (p["gamma"], p["C"]): score
            for p, score in zip(
                theirs.cv_results_["params"], theirs.cv_results_["mean_test_score"], strict=True
            )
        }
        expected = [[told[gamma, C] for C in pairs.costs] for gamma in pairs.gammas]
        np.testing.assert_allclose(pairs.accuracies, expected, atol=1e-12)
        assert np.ptp(pairs.accuracies) > 0.01  # there was something to tell apart


@pytest.mark.parametrize("seed", range(3))
def test_one_against_the_rest_is_scikit_learns(seed: int) -> None:
    X, y = problem(seed)
    scores = []
    for seen, asked in splits(folds_of(y, 5, 3)):
        model = OneVsRestClassifier(SVC(C=7.0, gamma=0.1)).fit(X[seen], y[seen])
        scores.append(np.mean(model.predict(X[asked]) == y[asked]))
    assert one_vs_rest_accuracy(X, y, 7.0, 0.1, seed=3) == pytest.approx(np.mean(scores))


def test_the_choice_is_made_among_all_pairs_of_both_grids() -> None:
    X, y = problem(1)
    found = search(X, y)
    best = max(found.coarse.accuracies.max(), found.fine.accuracies.max())
    good = [
        (pairs.balanced[g, c], gamma, pairs.accuracies[g, c], -C)
        for pairs in (found.coarse, found.fine)
        for g, gamma in enumerate(pairs.gammas)
        for c, C in enumerate(pairs.costs)
        if pairs.accuracies[g, c] >= best - 0.005 - 1e-9
    ]
    balanced, gamma, accuracy, C = max(good)
    assert (found.balanced, found.gamma, found.accuracy, found.C) == (balanced, gamma, accuracy, -C)
    C, gamma, *_ = chosen(found.coarse)
    assert C in found.fine.costs and gamma in found.fine.gammas
    assert found.commonest == np.bincount(y).max() / len(y)


@pytest.mark.parametrize("seed", range(3))
def test_balanced_accuracy_is_scikit_learns(seed: int) -> None:
    X, y = problem(seed)
    fold = folds_of(y, 5, seed)
    found = grid(squared_distances(X), y, fold, (1.0, 8.0), (0.01, 0.1))
    for (g, gamma), (c, C) in product(enumerate(found.gammas), enumerate(found.costs)):
        said = cross_val_predict(SVC(C=C, gamma=gamma), X, y, cv=splits(fold))
        assert found.balanced[g, c] == pytest.approx(balanced_accuracy_score(y, said))
        assert found.constant[g, c] == (len(set(said.tolist())) == 1)


def tried(accuracies: Any, balanced: Any, constant: Any = False) -> Grid:
    table = np.array(accuracies)
    flat = np.broadcast_to(constant, table.shape)
    return Grid((1.0, 2.0), (0.1, 0.2, 0.3), table, np.array(balanced), flat)


def test_the_rule_by_hand() -> None:
    table = [[0.80, 0.900], [0.895, 0.895], [0.8949, 0.7]]
    even = np.full((3, 2), 0.5)
    assert chosen(tried(table, even))[:3] == (1.0, 0.2, 0.895)
    table[2][0] = 0.8951
    assert chosen(tried(table, even))[:3] == (1.0, 0.3, 0.8951)
    better = even.copy()
    better[0, 1] = 0.6
    assert chosen(tried(table, better)) == (2.0, 0.1, 0.9, 0.6)
    assert AS_GOOD == 0.005


def test_a_constant_is_never_chosen() -> None:
    """Nine in ten are of one class: the largest gamma says it always and is as accurate."""
    constant = np.array([[False, False], [True, True], [True, True]])
    table = [[0.88, 0.87], [0.9, 0.9], [0.9, 0.9]]
    assert chosen(tried(table, np.full((3, 2), 0.5), constant))[:2] == (1.0, 0.1)
    with pytest.raises(BoxgraspError, match="answers the same class always"):
        chosen(tried(table, np.full((3, 2), 0.5), True))


def test_a_plateau_of_one_class_gives_an_svm_that_says_others_too() -> None:
    r = np.random.default_rng(3)
    X = r.random((400, 6)).astype(np.float32)
    y = np.where(X[:, 0] > 0.9, 1, 2)
    y[r.random(400) < 0.03] = 3
    found = search(X, y)
    assert found.commonest > 0.85
    assert len(set(train(X, y, found.C, found.gamma).predict(r.random((400, 6))).tolist())) > 1


def test_the_coarse_grid_covers_the_thesis() -> None:
    """Appendix B-1."""
    assert len(COARSE_C) == len(COARSE_GAMMA) == 9
    assert COARSE_C[0] < 1.2311 and COARSE_C[-1] > 174.8532
    assert COARSE_GAMMA[0] < 0.0035 and COARSE_GAMMA[-1] > 0.2871


@given(st.lists(st.integers(1, 6), min_size=5, max_size=60), st.integers(0, 9))
def test_folds_are_even_and_stratified(labels: list[int], seed: int) -> None:
    y = np.array(labels)
    if len(set(labels)) < 2:
        with pytest.raises(BoxgraspError, match="at least two classes"):
            folds_of(y, 5, seed)
        return
    fold = folds_of(y, 5, seed)
    np.testing.assert_array_equal(fold, folds_of(y, 5, seed))
    sizes = np.bincount(fold, minlength=5)
    assert sizes.max() - sizes.min() <= 1
    for label in set(labels):
        of_class = np.bincount(fold[y == label], minlength=5)
        assert of_class.max() - of_class.min() <= 1


def test_folds_are_shuffled() -> None:
    y = np.repeat([1, 2], 50)
    assert (folds_of(y, 5, 0) != folds_of(y, 5, 1)).any()


@settings(max_examples=20, deadline=None)
@given(st.lists(st.integers(1, 4), min_size=5, max_size=12), st.integers(0, 9))
def test_rare_classes_give_no_warning(labels: list[int], seed: int) -> None:
    """Down to one row a class, and folds whose training rows are all of one class."""
    if len(set(labels)) < 2:
        return
    X, _ = problem(seed, len(labels))
    y = np.array(labels)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        fold = folds_of(y, 5, seed)
        found = grid(squared_distances(X), y, fold, (1.0, 8.0), (0.1,)).accuracies[0]
        rest = one_vs_rest_accuracy(X, y, 1.0, 0.1, seed=seed)
    assert found.shape == (2,) and ((found >= 0) & (found <= 1)).all() and 0 <= rest <= 1


@given(st.integers(0, 99))
@settings(max_examples=20, deadline=None)
def test_distances(seed: int) -> None:
    X, _ = problem(seed, 9)
    rows = X.astype(np.float64)
    expected = ((rows[:, None] - rows[None]) ** 2).sum(axis=2)
    np.testing.assert_allclose(squared_distances(X), expected, atol=1e-11)
    assert (np.diag(squared_distances(X)) == 0).all()


def test_search_and_training_are_repeatable() -> None:
    X, y = problem(5)
    one, two = search(X, y, seed=1), search(X, y, seed=1)
    assert (one.C, one.gamma, one.accuracy) == (two.C, two.gamma, two.accuracy)
    np.testing.assert_array_equal(one.fine.accuracies, two.fine.accuracies)
    model = train(X, y, one.C, one.gamma)
    assert np.mean(model.predict(X) == y) > 0.8
    np.testing.assert_array_equal(model.dual_coef_, train(X, y, one.C, one.gamma).dual_coef_)


@pytest.mark.parametrize("labels", [[], [2] * 9])
def test_one_class_is_refused(labels: list[int]) -> None:
    X = np.zeros((len(labels), 4), dtype=np.float32)
    for attempt in (lambda: search(X, np.array(labels)), lambda: train(X, np.array(labels), 1, 1)):
        with pytest.raises(BoxgraspError, match="valid: at least two classes"):
            attempt()


def test_fewer_rows_than_folds_are_refused() -> None:
    with pytest.raises(BoxgraspError, match="5 folds of 3 rows"):
        search(np.zeros((3, 4), dtype=np.float32), np.array([1, 2, 1]))
