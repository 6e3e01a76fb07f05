"""Choose a grasp for the target of each CAPTURE, or ask for help.

Without --json a short summary; with it one JSON object a line a capture, with `capture` and
`error` for one that cannot be answered. Pictures of several captures are named after them.

--assist asks the operators at a `boxgrasp label` or `boxgrasp assist` where the answer would be
an ask, and waits: their candidate is the grasp, by ranker `person`. Its token, if it has one, is
taken from BOXGRASP_TOKEN. Where nobody can be asked or nobody answers in time, the robot's own ask
stands with a warning that says why, and the exit status is 0 as for every ask.
"""

from __future__ import annotations

import argparse
import logging
import os
import socket
from typing import TYPE_CHECKING

from boxgrasp.cli import _arguments, _batch

if TYPE_CHECKING:
    from boxgrasp.labeling.client import Assistance
    from boxgrasp.result import Selection

_log = logging.getLogger("boxgrasp.cli")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    _arguments.add_targets(parser)
    parser.add_argument("--json", action="store_true", help="one JSON object a line a capture")
    parser.add_argument("--picture", metavar="OUT.png", help="draw what was chosen and why")
    group = parser.add_argument_group("help by a person")
    group.add_argument("--assist", metavar="URL", help="where to ask, as http://127.0.0.1:8765")
    group.add_argument(
        "--assist-seconds",
        type=float,
        default=120.0,
        metavar="S",
        help="how long to wait for an answer (default: 120)",
    )
    _arguments.add_scans(parser)
    _arguments.add_config(parser)


def run(args: argparse.Namespace) -> int:
    """Answer each capture."""
    from boxgrasp.cli._report import summary, timings

    asked = _arguments.asked_of(args)
    assistance = _assistance(args)
    places = _arguments.picture_places(args.picture, [item.capture for item in asked])

    def tell(answered: _batch.Answered) -> None:
        selection = answered.selection
        if assistance is not None and selection.status == "ask":
            selection = _asked(answered, assistance)
        _log.info("%s: %s", answered.name, timings(selection))
        if places:
            from boxgrasp.draw import draw_selection

            draw_selection(answered.capture, selection, places[answered.number - 1])
        print(selection.to_json() if args.json else summary(selection, answered.name), flush=True)

    return _batch.answer_each(args, asked, tell, as_json=args.json)


def _assistance(args: argparse.Namespace) -> Assistance | None:
    """Who is asked where no candidate passes; None for nobody."""
    from boxgrasp.errors import ConfigError

    if args.assist is None:
        return None
    from boxgrasp.labeling.client import TOKEN_VARIABLE, Assistance

    if args.scan or args.octomap is not None:
        raise ConfigError("--assist and --scan or --octomap are given; valid: --assist alone")
    token = os.environ.get(TOKEN_VARIABLE, "")
    return Assistance(args.assist, args.assist_seconds, socket.gethostname()[:80], token)


def _asked(answered: _batch.Answered, assistance: Assistance) -> Selection:
    """The answer with a person's help."""
    from boxgrasp.labeling.client import Stuck, ask_person

    _log.info("%s: asking %s for up to %g s", answered.name, assistance.url, assistance.seconds)
    stuck = Stuck(
        answered.capture, answered.target, answered.selection, answered.pregrasp_distance_m
    )
    return ask_person(stuck, assistance)
