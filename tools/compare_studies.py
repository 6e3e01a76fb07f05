"""Whether two studies came out the same: `python tools/compare_studies.py BEFORE AFTER`.

BEFORE and AFTER are folders that `boxgrasp reproduce` wrote, by two versions, with the same
options. Every number of their reports and the graph of every trained model must be equal to the
last bit; words may differ, and are printed with `--words`. Exit status 1 where a number or a graph
differs.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from boxgrasp.onnx.guard import parse

NO_FIGURES = ("made_with", "schema")


def leaves(value: Any, place: str = "") -> Iterator[tuple[str, Any]]:
    """Every number, text and null of nested plain values, and where it stands."""
    if isinstance(value, dict):
        for key, item in value.items():
            yield from leaves(item, f"{place}.{key}")
    elif isinstance(value, list):
        for k, item in enumerate(value):
            yield from leaves(item, f"{place}[{k}]")
    else:
        yield place, value


def figures(folder: Path) -> dict[str, Any]:
    """What a report says, by its place."""
    report = json.loads((folder / "report.json").read_text("utf-8"))
    return dict(leaves({key: item for key, item in report.items() if key not in NO_FIGURES}))


def graphs(folder: Path) -> dict[str, bytes]:
    """The trained models' graphs, by their file names."""
    return {path.name: parse(path.read_bytes()).graph for path in folder.glob("models/*.onnx")}


def main() -> int:
    """Compare, print the counts, and end with 1 where anything but words differs."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("before", type=Path)
    parser.add_argument("after", type=Path)
    parser.add_argument("--words", action="store_true", help="print every text that differs")
    args = parser.parse_args()
    before, after = figures(args.before), figures(args.after)
    numbers, different = 0, 0
    for place in sorted({*before, *after}):
        a, b = before.get(place), after.get(place)
        if isinstance(a, str) and isinstance(b, str):
            if args.words and a != b:
                print(f"{place}: {a!r} | {b!r}")
            continue
        numbers += 1
        if a != b or type(a) is not type(b):
            different += 1
            print(f"{place}: {a!r} | {b!r}")
    models, others = graphs(args.before), graphs(args.after)
    changed = [name for name in sorted({*models, *others}) if models.get(name) != others.get(name)]
    print(f"{numbers} numbers, {different} different")
    print(f"{len(models)} trained models, {len(changed)} with another graph {' '.join(changed)}")
    return int(bool(different or changed or not numbers or not models))


if __name__ == "__main__":
    sys.exit(main())
