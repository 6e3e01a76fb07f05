"""Choose a grasp for the target of each CAPTURE, or ask for help.

Without --json a short summary; with it one JSON object a line a capture, with `capture` and
`error` for one that cannot be answered. Pictures of several captures are named after them.
"""

from __future__ import annotations

import argparse
import logging

from boxgrasp.cli import _arguments, _batch

_log = logging.getLogger("boxgrasp.cli")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    _arguments.add_targets(parser)
    parser.add_argument("--json", action="store_true", help="one JSON object a line a capture")
    parser.add_argument("--picture", metavar="OUT.png", help="draw what was chosen and why")
    _arguments.add_scans(parser)
    _arguments.add_config(parser)


def run(args: argparse.Namespace) -> int:
    """Answer each capture."""
    from boxgrasp.cli._report import summary, timings

    asked = _arguments.asked_of(args)
    places = _arguments.picture_places(args.picture, [item.capture for item in asked])

    def tell(answered: _batch.Answered) -> None:
        selection = answered.selection
        _log.info("%s: %s", answered.name, timings(selection))
        if places:
            from boxgrasp.draw import draw_selection

            draw_selection(answered.capture, selection, places[answered.number - 1])
        print(selection.to_json() if args.json else summary(selection, answered.name), flush=True)

    return _batch.answer_each(args, asked, tell, as_json=args.json)
