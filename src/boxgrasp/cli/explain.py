"""Show all candidates of each CAPTURE with what every check says, and why each was rejected.

A star stands beside a value that a check refused; the line `limit` says what it was compared with.
With --json the answer of `boxgrasp select --json`, which has the same candidates and reasons.
"""

from __future__ import annotations

import argparse

from boxgrasp.cli import _arguments, _batch


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    _arguments.add_targets(parser)
    parser.add_argument("--json", action="store_true", help="one JSON object a line a capture")
    _arguments.add_scans(parser)
    _arguments.add_config(parser)


def run(args: argparse.Namespace) -> int:
    """Explain each capture."""
    from boxgrasp.cli._report import candidates_table, rejections, summary

    def tell(answered: _batch.Answered) -> None:
        selection = answered.selection
        if args.json:
            print(selection.to_json(), flush=True)
            return
        told = summary(selection, answered.name)
        parts = (told, candidates_table(selection), rejections(selection))
        print("\n\n".join(part for part in parts if part), flush=True)

    return _batch.answer_each(args, _arguments.asked_of(args), tell, as_json=args.json)
