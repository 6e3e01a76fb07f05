"""Hold every ranker against the truth of a SET, bare and checked, and print the tables.

SET is what `boxgrasp simulate` wrote. Extra: pip install 'boxgrasp[train]'.
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from boxgrasp.cli import _arguments

if TYPE_CHECKING:
    from boxgrasp.study.sections.rankers import Line


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options.

    Args:
        parser: of the command.
    """
    parser.add_argument("set", metavar="SET", help="folder or URL of a set")
    parser.add_argument(
        "--models", metavar="DIR", help="folder or URL of `boxgrasp train` (default: the shipped)"
    )
    parser.add_argument(
        "--target", choices=("given", "found"), default="found",
        help="target points given, or found by the package (default: found)",
    )  # fmt: skip
    parser.add_argument("--json", action="store_true", help="one JSON object a line a ranker")
    _arguments.renamed(parser, "--sight", "--target")


def run(args: argparse.Namespace) -> int:
    """Evaluate.

    Args:
        args: parsed.

    Returns:
        0.

    Raises:
        BoxgraspError: a set or models that cannot be read, or do not fit each other.
    """
    from boxgrasp.execution import Store
    from boxgrasp.ranking.onnx.model import SHIPPED
    from boxgrasp.study.evaluation import Evaluation, model_sets_in
    from boxgrasp.study.sections.rankers import ranker_table
    from boxgrasp.teaching.sets import read_set

    _, rows = read_set(Store(args.set))
    evaluation = Evaluation(rows, model_sets_in(Store(args.models or SHIPPED)))
    for checked in (False, True):
        lines = ranker_table(evaluation, args.target, checked=checked)
        if args.json:
            _print_json(lines, {"checked": checked, "target_source": args.target})
        else:
            kind = "checked" if checked else "bare"
            print(f"{kind}, target {args.target}, {rows.count} scenarios")
            _print_table(lines)
    return 0


def _print_json(lines: tuple[Line, ...], about: dict[str, Any]) -> None:
    import json

    from boxgrasp.strict import plain
    from boxgrasp.study.sections.rankers import COLUMNS

    for line in lines:
        values = {name: plain(value) for name, value in zip(COLUMNS, line, strict=True)}
        print(json.dumps({**about, **values}))


def _print_table(lines: tuple[Line, ...]) -> None:
    from boxgrasp.study.report_pages import cell
    from boxgrasp.study.sections.rankers import COLUMNS

    table = [COLUMNS, *(tuple(map(cell, line)) for line in lines)]
    widths = [max(len(row[k]) for row in table) for k in range(len(COLUMNS))]
    for row in table:
        texts = (text.ljust(width) for text, width in zip(row, widths, strict=True))
        print("  ".join(texts).rstrip())
