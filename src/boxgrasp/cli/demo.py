"""The main job in one go: cast a cluttered table (or take CAPTUREs), select, write the picture.

--save writes the cast table as a capture, for the other commands to go on with.
"""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING

from boxgrasp.cli import _arguments, _batch

if TYPE_CHECKING:
    from boxgrasp.sensing.capture import Capture

PICTURE = "out/demo.png"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    _arguments.add_captures(parser, nargs="*")
    parser.add_argument(
        "--picture", metavar="OUT.png", default=PICTURE, help=f"where to draw (default: {PICTURE})"
    )
    parser.add_argument(
        "--save", metavar="OUT.npz", help="write the cast table, a capture for the other commands"
    )
    parser.add_argument(
        "--seed", type=int, default=0, metavar="N", help="seed of the noise on the cast"
    )
    _arguments.add_target(parser)
    _arguments.add_config(parser)


def run(args: argparse.Namespace) -> int:
    """Select, draw, and print the summary and the picture's path."""
    from boxgrasp.cli._report import summary
    from boxgrasp.draw import draw_selection
    from boxgrasp.errors import BoxgraspError
    from boxgrasp.selector import GraspSelector

    if args.save and args.captures:
        raise BoxgraspError("--save writes the cast table; valid: without CAPTURE")
    if args.save and Path(args.save).suffix != ".npz":
        raise BoxgraspError(f"--save {args.save}: valid: a name that ends in .npz")
    selector = GraspSelector(_arguments.resolve_config(args))
    target = _arguments.target_of(args)
    names = args.captures or [f"cast table, seed {args.seed}"]
    places = _arguments.picture_places(args.picture, names)

    def demonstrate(number: int) -> None:
        name, place = names[number - 1], places[number - 1]
        capture = _arguments.load_capture(name, args) if args.captures else _cast(args)
        selection = dataclasses.replace(selector.select(capture, target), capture=name)
        place.parent.mkdir(parents=True, exist_ok=True)
        draw_selection(capture, selection, place)
        print(f"{summary(selection, name)}\n{place}", flush=True)
        if args.save:
            print(args.save, flush=True)

    return _batch.each(names, demonstrate)


def _cast(args: argparse.Namespace) -> Capture:
    """The table, kept where --save says."""
    from boxgrasp.io.npz import save_npz
    from boxgrasp.simulate import demo_capture

    capture = demo_capture(args.seed)
    if args.save:
        Path(args.save).parent.mkdir(parents=True, exist_ok=True)
        save_npz(capture, args.save)
    return capture
