"""Choose a grasp for the target of each CAPTURE, or ask for help.

Without --json a short summary; with it one JSON object a line a capture, with `capture` and
`error` for one that cannot be answered.
"""

from __future__ import annotations

import argparse
import logging
from typing import TYPE_CHECKING

from boxgrasp.cli import _arguments, _batch

if TYPE_CHECKING:
    from boxgrasp.result import Selection
    from boxgrasp.sensing.capture import Capture

_log = logging.getLogger("boxgrasp.cli")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    _arguments.add_captures(parser)
    parser.add_argument("--json", action="store_true", help="one JSON object a line a capture")
    parser.add_argument("--picture", metavar="OUT.png", help="draw what was chosen and why")
    _arguments.add_target(parser)
    _arguments.add_scans(parser)
    _arguments.add_config(parser)


def run(args: argparse.Namespace) -> int:
    """Answer each capture."""
    from boxgrasp.cli._report import summary, timings

    def answer(number: int, capture: Capture, selection: Selection) -> None:
        _log.info("%s: %s", selection.capture, timings(selection))
        print(selection.to_json() if args.json else summary(selection), flush=True)
        if args.picture:
            from boxgrasp.draw import draw_selection

            place = _arguments.numbered(args.picture, number, len(args.captures))
            draw_selection(capture, selection, place)

    return _batch.answer_each(args, answer, as_json=args.json)
