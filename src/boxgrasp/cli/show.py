"""Draw saved answers again, from the lines that `boxgrasp select --json` printed."""

from __future__ import annotations

import argparse
from pathlib import Path

from boxgrasp.cli import FAILED, _arguments, _batch, complain
from boxgrasp.errors import BoxgraspError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("answers", metavar="ANSWERS.jsonl", help="one JSON object a line")
    parser.add_argument(
        "--picture",
        metavar="OUT.png",
        help="where to draw (default: ANSWERS.png; several answers are numbered)",
    )
    parser.add_argument("--gripper", metavar="FILE", help="the hand that was selected for")
    _arguments.add_reading(parser)


def run(args: argparse.Namespace) -> int:
    """Draw each answer and print the pictures' paths."""
    from boxgrasp.config import load_gripper

    try:
        lines = [line for line in Path(args.answers).read_text("utf-8").splitlines() if line]
    except (OSError, UnicodeDecodeError) as error:
        raise BoxgraspError(f"{args.answers}: {getattr(error, 'strerror', 'not text')}") from None
    gripper = load_gripper(args.gripper) if args.gripper else None
    out = args.picture or str(Path(args.answers).with_suffix(".png"))

    def draw(number: int, line: str) -> None:
        from boxgrasp.draw import draw_selection
        from boxgrasp.result import Selection

        selection = Selection.from_json(line)
        if selection.capture is None:
            raise BoxgraspError("the answer names no capture; valid: answers of boxgrasp select")
        capture = _arguments.load_capture(_find(selection.capture, args.answers), args)
        place = _arguments.numbered(out, number, len(lines))
        draw_selection(capture, selection, place, gripper=gripper)
        print(place, flush=True)

    if not lines:
        complain(f"{args.answers}: no answers; valid: lines of boxgrasp select --json")
        return FAILED
    return _batch.each(lines, draw, [f"{args.answers}:{n + 1}" for n in range(len(lines))])


def _find(capture: str, answers: str) -> str:
    """The capture as it was named, or so seen from the folder of the answers."""
    beside = Path(answers).parent / capture
    return str(beside) if not Path(capture).exists() and beside.exists() else capture
