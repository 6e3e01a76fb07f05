"""Hold every ranker against the truth of a SET, bare and checked, and print the tables.

SET is what `boxgrasp simulate` wrote. Extra: pip install 'boxgrasp[train]'.
"""

from __future__ import annotations

import argparse

from boxgrasp.cli import _arguments


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
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
    """Evaluate."""
    import json

    from boxgrasp.execution import Store
    from boxgrasp.ranking.onnx.model import SHIPPED
    from boxgrasp.strict import plain
    from boxgrasp.study.evaluation import VERSIONS, Evaluation, model_set_of
    from boxgrasp.study.report_pages import cell
    from boxgrasp.study.sections.rankers import COLUMNS, ranker_table
    from boxgrasp.teaching.sets import read_set

    _, rows = read_set(Store(args.set))
    models = Store(args.models or SHIPPED)
    evaluation = Evaluation(rows, {name: model_set_of(name, models) for name in VERSIONS})
    for check in (False, True):
        lines = ranker_table(evaluation, args.target, check)
        if args.json:
            for line in lines:
                values = {name: plain(value) for name, value in zip(COLUMNS, line, strict=True)}
                print(json.dumps({"checked": check, "target_source": args.target, **values}))
            continue
        print(f"{'checked' if check else 'bare'}, target {args.target}, {rows.count} scenarios")
        table = [COLUMNS, *(tuple(cell(value) for value in line) for line in lines)]
        widths = [max(len(row[k]) for row in table) for k in range(len(COLUMNS))]
        for row in table:
            print(
                "  ".join(
                    text.ljust(width) for text, width in zip(row, widths, strict=True)
                ).rstrip()
            )
    return 0
