"""Several captures, one after the other; one that fails does not stop the rest."""

from __future__ import annotations

import argparse
import dataclasses
import json
import logging
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from boxgrasp.cli import FAILED, _arguments, complain
from boxgrasp.errors import BoxgraspError

if TYPE_CHECKING:
    from boxgrasp.result import Selection
    from boxgrasp.sensing.capture import Capture

_log = logging.getLogger("boxgrasp.cli")


def each(
    items: Sequence[str],
    work: Callable[[int, str], None],
    names: Sequence[str] | None = None,
    *,
    as_json: bool = False,
) -> int:
    """Work on every item; one that fails costs a line on standard error.

    Args:
        items: what to work on.
        work: called with an item's number, from 1, and the item.
        names: what the lines call the items, where that is not the item itself.
        as_json: print an object with `capture` and `error` for one that fails, too.

    Returns:
        The exit status: 0, or 2 if any failed.
    """
    failed = False
    for number, item in enumerate(items, start=1):
        name = names[number - 1] if names else item
        try:
            work(number, item)
        except BrokenPipeError:
            raise
        except Exception as error:  # a fault of ours must not cost the rest of the batch
            failed = True
            reason = _reason(error).removeprefix(f"{name}: ")
            complain(reason if reason.startswith(name) else f"{name}: {reason}")
            if as_json:
                print(json.dumps({"capture": name, "error": reason}), flush=True)
            if not isinstance(error, BoxgraspError):
                _log.info("%s", name, exc_info=True)
    return FAILED if failed else 0


def _reason(error: Exception) -> str:
    """What went wrong, in one line."""
    if isinstance(error, BoxgraspError):
        text = str(error)
    elif isinstance(error, OSError):
        text = f"{error.filename}: {error.strerror}" if error.filename else str(error)
    elif isinstance(error, MemoryError):
        text = "too large for the memory there is"
    else:
        text = f"internal error: {type(error).__name__}: {error}"
    return " ".join(text.split())


def answer_each(
    args: argparse.Namespace,
    tell: Callable[[int, Capture, Selection], None],
    *,
    as_json: bool = False,
) -> int:
    """Select for every capture of the command line.

    Args:
        args: with the options of `add_captures`, `add_target`, `add_scans` and `add_config`.
        tell: called with a capture's number, from 1, the capture and its answer.
        as_json: as `each`.

    Returns:
        The exit status.

    Raises:
        BoxgraspError: settings, target, scans or map cannot be read.
    """
    from boxgrasp.selector import GraspSelector

    selector = GraspSelector(_arguments.resolve_config(args))
    target = _arguments.target_of(args)
    scans, octomap = _arguments.load_surroundings(args)

    def answer(number: int, path: str) -> None:
        capture = _arguments.load_capture(path, args)
        selection = selector.select(capture, target, scans=scans, octomap=octomap)
        tell(number, capture, dataclasses.replace(selection, capture=path))

    return each(args.captures, answer, as_json=as_json)
