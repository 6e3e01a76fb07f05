"""Draw saved answers again, from the lines that `boxgrasp select --json` printed."""

from __future__ import annotations

import argparse
import json
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
    _arguments.removed(parser, "--gripper", "is gone; valid: none, an answer carries its hand")
    _arguments.add_reading(parser)


def run(args: argparse.Namespace) -> int:
    """Draw each answer and print the pictures' paths."""
    try:
        lines = [line for line in Path(args.answers).read_text("utf-8").splitlines() if line]
    except (OSError, UnicodeDecodeError) as error:
        raise BoxgraspError(f"{args.answers}: {getattr(error, 'strerror', 'not text')}") from None
    out = args.picture or str(Path(args.answers).with_suffix(".png"))

    def draw(number: int, line: str) -> None:
        from boxgrasp.draw import draw_selection
        from boxgrasp.result import Selection

        _refuse_error(line)
        selection = Selection.from_json(line)
        if selection.capture is None:
            raise BoxgraspError("the answer names no capture; valid: answers of boxgrasp select")
        capture = _arguments.read_capture(_find(selection.capture, args.answers), args)
        place = _arguments.numbered(out, number, len(lines))
        draw_selection(capture, selection, place)
        print(place, flush=True)

    if not lines:
        complain(f"{args.answers}: no answers; valid: lines of boxgrasp select --json")
        return FAILED
    return _batch.each(lines, draw, [f"{args.answers}:{n + 1}" for n in range(len(lines))])


def _refuse_error(line: str) -> None:
    """Say what `boxgrasp select --json` said of a capture that it could not answer."""
    try:
        data = json.loads(line)
    except (ValueError, RecursionError):
        return
    if isinstance(data, dict) and set(data) == {"capture", "error"}:
        raise BoxgraspError(f"no answer to {data['capture']}: {data['error']}")


def _find(capture: str, answers: str) -> str:
    """The capture as it was named, or so seen from the folder of the answers."""
    beside = Path(answers).parent / capture
    return str(beside) if not Path(capture).exists() and beside.exists() else capture
