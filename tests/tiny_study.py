"""`boxgrasp`, its `--small` made tiny and sets in more parts, to be killed on the way."""

from __future__ import annotations

import sys

import boxgrasp.study.study as study
import boxgrasp.teaching.sets as sets

TINY = study.Scale(
    labels=64, tested=12, first=8, need=1, central=1, real=2, ad_hoc=1, runs=2, fused=2,
    curve_tested=8,
)  # fmt: skip
PART_ROWS = 8

if __name__ == "__main__":
    from boxgrasp.cli import main

    study.SMALL, sets.PART_ROWS = TINY, PART_ROWS
    sys.exit(main())
