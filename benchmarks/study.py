"""How fast scenarios are made and the eight SVMs are found. `python benchmarks/study.py`.

A scenario is drawn, cast with noise, seen twice (target given; target found by the package), with
both feature sets, every candidate's numbers and exact truth, labeled, and written as Parquet. The
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

from boxgrasp.execution import Store, workers_for
from boxgrasp.simulate.scenario import Recipe, targets_of
from boxgrasp.teaching.matrices import largest_edge_m
from boxgrasp.teaching.rows import RowConfig
from boxgrasp.teaching.search import COARSE_C, COARSE_GAMMA, search
from boxgrasp.teaching.sets import SetConfig, make_set, read_set
from boxgrasp.teaching.train import SVMS, examples, train_svms


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=800)
    parser.add_argument("--processes", type=int, default=None)
    parser.add_argument("--rival", action="store_true", help="scikit-learn's grid search too")
    args = parser.parse_args()
    recipe = Recipe(targets_of("known"))
    with tempfile.TemporaryDirectory() as folder, workers_for(args.processes, None) as workers:
        store = Store(folder)
        # The kernels are loaded in every process before the clock starts.
        make_set(store, "warm/", SetConfig(RowConfig(recipe, 1), args.count // 5), workers, "warm")
        start = time.perf_counter()
        made = SetConfig(RowConfig(recipe, 2), args.count)
        make_set(store, "labels/", made, workers, "scenarios")
        spent = time.perf_counter() - start
        cores = len(os.sched_getaffinity(0))
        rate = args.count / spent
        held = "held" if rate >= 10 else "MISSED"
        print(f"{cores} cores; {args.count} made in {spent:.1f} s, {rate:.1f} a second; 10: {held}")
        labeled = read_set(store, "labels/")
        start = time.perf_counter()
        train_svms(store, "models/", labeled, workers)
        spent = time.perf_counter() - start
        held = "held" if spent <= 180 else "MISSED"
        print(f"eight grid searches, training and export: {spent:.1f} s; 180 s: {held}")
    if args.rival:
        rows = labeled[1]
        X, y = examples(rows, SVMS[1], 3, largest_edge_m(rows))
        start = time.perf_counter()
        search(X, y, seed=0)
        ours = time.perf_counter() - start
        folds = StratifiedKFold(5, shuffle=True, random_state=0)
        grid = {"C": np.array(COARSE_C), "gamma": np.array(COARSE_GAMMA)}
        start = time.perf_counter()
        GridSearchCV(SVC(), grid, cv=folds).fit(X, y)
        theirs = time.perf_counter() - start
        print(f"{SVMS[1].name}: coarse and fine {ours:.1f} s; GridSearchCV, coarse {theirs:.1f} s")


if __name__ == "__main__":
    main()
