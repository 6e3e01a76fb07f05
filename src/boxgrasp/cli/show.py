"""Draw saved answers again, from the lines that `boxgrasp select --json` printed."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from boxgrasp.cli import FAILED, _arguments, _batch, complain
from boxgrasp.errors import BoxgraspError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("answers", metavar="ANSWERS.jsonl", help="one JSON object a line")
    parser.add_argument(
        "--picture",
        metavar="OUT.png",
        help="where to draw (default: ANSWERS.png; several are named after their captures)",
    )
    _arguments.removed(parser, "--gripper", "is gone; valid: none, an answer carries its hand")
    _arguments.add_reading(parser)


def run(args: argparse.Namespace) -> int:
    """Draw each answer and print the pictures' paths."""
    try:
        lines = [line for line in Path(args.answers).read_text("utf-8").splitlines() if line]
    except (OSError, UnicodeDecodeError) as error:
        raise BoxgraspError(f"{args.answers}: {getattr(error, 'strerror', 'not text')}") from None
    if not lines:
        complain(f"{args.answers}: no answers; valid: lines of boxgrasp select --json")
        return FAILED
    out = args.picture if args.picture is not None else f"{Path(args.answers).with_suffix('.png')}"
    captures = [_capture_of(line) for line in lines]
    places = _arguments.picture_places(out, captures)

    def draw(number: int) -> None:
        from boxgrasp.draw import draw_selection
        from boxgrasp.result import Selection

        line, place = lines[number - 1], places[number - 1]
        _refuse_error(line)
        selection = Selection.from_json(line)
        if selection.capture is None:
            raise BoxgraspError("the answer names no capture; valid: answers of boxgrasp select")
        path = _arguments.beside(selection.capture, args.answers)
        draw_selection(_arguments.read_capture(path, args), selection, place)
        print(place, flush=True)

    return _batch.each([f"{args.answers}:{n + 1}" for n in range(len(lines))], draw)


def _capture_of(line: str) -> str:
    """The capture that an answer names, `answer` where it names none."""
    found = _plain(line).get("capture")
    return found if isinstance(found, str) and found else "answer"


def _refuse_error(line: str) -> None:
    """Say what `boxgrasp select --json` said of a capture that it could not answer."""
    data = _plain(line)
    if set(data) == {"capture", "error"}:
        raise BoxgraspError(f"no answer to {data['capture']}: {data['error']}")


def _plain(line: str) -> dict[str, Any]:
    """The object of a line, empty where it is none."""
    try:
        data = json.loads(line)
    except (ValueError, RecursionError):
        return {}
    return data if isinstance(data, dict) else {}
