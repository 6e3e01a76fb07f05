"""`boxgrasp`, its `--small` made tiny, sets in more parts, to be killed on the way, and few pairs
of C and gamma."""

from __future__ import annotations

import sys

import boxgrasp.study.study as study
import boxgrasp.teaching.sets as sets
import boxgrasp.teaching.train as train
from boxgrasp.teaching.search import SearchParams

TINY = study.Scale(
    labels=64, tested=12, first=8, need=1, central=1, real=2, ad_hoc=1, runs=2, fused=2,
    curve_tested=8,
)  # fmt: skip
PART_ROWS = 8
SEARCH = SearchParams(costs=(0.5, 8.0, 128.0), gammas=(0.001, 0.03, 1.0), fine_steps=1)

if __name__ == "__main__":
    from boxgrasp.cli import main

    study.SMALL, sets.PART_ROWS, train.SEARCH = TINY, PART_ROWS, SEARCH
    sys.exit(main())
