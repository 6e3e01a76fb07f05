"""How fast scenarios are made and the eight SVMs are found. `python benchmarks/study.py`.

A scenario is drawn, cast with noise, seen twice (target given; target found by the package), with
both feature sets, every check of every candidate, exact truth, labeled, and written as Parquet. The
searches are the eight of the thesis, coarse and fine, with 5 folds, on the labels just made; beside
them, on one SVM, scikit-learn's own grid search over the same coarse grid.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time

import numpy as np
from sklearn.model_selection import GridSearchCV, StratifiedKFold
from sklearn.svm import SVC

from boxgrasp.execution import Store, Workers, workers_for
from boxgrasp.grasps.candidates import LINES
from boxgrasp.ranking.model_set import SVMS
from boxgrasp.simulate.scenario import Recipe, targets_of
from boxgrasp.teaching.rows import RowConfig
from boxgrasp.teaching.samples import largest_edge_m
from boxgrasp.teaching.search import COARSE_C, COARSE_GAMMA, search
from boxgrasp.teaching.sets import Rows, SetConfig, make_set, read_set
from boxgrasp.teaching.train import examples, taught_by_set, train_svms

LEAST_A_SECOND = 10
MOST_TRAINING_S = 180


def scenarios(store: Store, count: int, workers: Workers) -> None:
    """Cast a set, and print how fast."""
    recipe = Recipe(targets_of("known"))
    # The kernels are loaded in every process before the clock starts.
    make_set(store, "warm/", SetConfig(RowConfig(recipe, 1), count // 5), workers, "warm")
    start = time.perf_counter()
    make_set(store, "labels/", SetConfig(RowConfig(recipe, 2), count), workers, "scenarios")
    spent = time.perf_counter() - start
    cores, rate = len(os.sched_getaffinity(0)), count / spent
    held = "held" if rate >= LEAST_A_SECOND else "MISSED"
    said = f"{rate:.1f} a second; {LEAST_A_SECOND}: {held}"
    print(f"{cores} cores; {count} made in {spent:.1f} s, {said}")


def training(store: Store, labeled: tuple[SetConfig, Rows], workers: Workers) -> None:
    """Train the eight SVMs, and print how fast."""
    start = time.perf_counter()
    train_svms(store, "models/", taught_by_set(*labeled), workers)
    spent = time.perf_counter() - start
    held = "held" if spent <= MOST_TRAINING_S else "MISSED"
    said = f"{spent:.1f} s; {MOST_TRAINING_S} s: {held}"
    print(f"eight grid searches, training and export: {said}")


def rival(rows: Rows) -> None:
    """Search one SVM's C and gamma by scikit-learn too, and print how fast both are."""
    svm = SVMS[1]
    X, y = examples(rows, svm, LINES, largest_edge_m(rows))
    start = time.perf_counter()
    search(X, y, seed=0)
    ours = time.perf_counter() - start
    folds = StratifiedKFold(5, shuffle=True, random_state=0)
    grid = {"C": np.array(COARSE_C), "gamma": np.array(COARSE_GAMMA)}
    start = time.perf_counter()
    GridSearchCV(SVC(), grid, cv=folds).fit(X, y)
    theirs = time.perf_counter() - start
    print(f"{svm.name}: coarse and fine {ours:.1f} s; GridSearchCV, coarse {theirs:.1f} s")


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=800)
    parser.add_argument("--processes", type=int, default=None)
    parser.add_argument("--rival", action="store_true", help="scikit-learn's grid search too")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, workers_for(args.processes, None) as workers:
        store = Store(folder)
        scenarios(store, args.count, workers)
        labeled = read_set(store, "labels/")
        training(store, labeled, workers)
    if args.rival:
        rival(labeled[1])


if __name__ == "__main__":
    main()
