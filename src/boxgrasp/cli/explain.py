"""Show all candidates of each CAPTURE with what every check says, and why each was rejected.

A star stands beside a value that a check refused; the line `limit` says what it was compared with.
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from boxgrasp.cli import _arguments, _batch

if TYPE_CHECKING:
    from boxgrasp.result import Selection
    from boxgrasp.sensing.capture import Capture


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    _arguments.add_captures(parser)
    _arguments.add_target(parser)
    _arguments.add_scans(parser)
    _arguments.add_config(parser)


def run(args: argparse.Namespace) -> int:
    """Explain each capture."""
    from boxgrasp.cli._report import candidates_table, rejections, summary

    def explain(_number: int, _capture: Capture, selection: Selection) -> None:
        parts = (summary(selection), candidates_table(selection), rejections(selection))
        print("\n\n".join(part for part in parts if part), flush=True)

    return _batch.answer_each(args, explain)
