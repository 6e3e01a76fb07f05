"""Several captures, one after the other; one that fails does not stop the rest."""

from __future__ import annotations

import argparse
import dataclasses
import json
import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from boxgrasp.cli import FAILED, _arguments, complain, reason
from boxgrasp.errors import BoxgraspError

if TYPE_CHECKING:
    from boxgrasp.perception.target import Target
    from boxgrasp.result import Selection
    from boxgrasp.sensing.capture import Capture

_log = logging.getLogger("boxgrasp.cli")


@dataclass(frozen=True, eq=False)
class Answered:
    """A capture of the command line with its answer.

    Attributes:
        number: its place among the captures, from 1.
        name: what lines for people call it: its path, and its target where a file names it.
        capture: the view.
        selection: the answer.
        target: what was asked for; None for the capture's own.
        pregrasp_distance_m: that the answer was made with, m.
    """

    number: int
    name: str
    capture: Capture
    selection: Selection
    target: Target | None
    pregrasp_distance_m: float


def each(
    names: Sequence[str],
    work: Callable[[int], None],
    *,
    as_json: bool = False,
    captures: Sequence[str] | None = None,
) -> int:
    """Work on every item; one that fails costs a line on standard error.

    Args:
        names: what the lines call the items.
        work: called with an item's number, from 1.
        as_json: print an object with `capture` and `error` for one that fails, too.
        captures: what that object calls them, where that is not the name.

    Returns:
        The exit status: 0, or 2 if any failed.
    """
    failed = False
    for number, name in enumerate(names, start=1):
        try:
            work(number)
        except BrokenPipeError:
            raise
        except Exception as error:  # a fault of ours must not cost the rest of the batch
            failed = True
            path = captures[number - 1] if captures else name
            said = reason(error).removeprefix(f"{name}: ").removeprefix(f"{path}: ")
            complain(said if said.startswith(name) else f"{name}: {said}")
            if as_json:
                print(json.dumps({"capture": path, "error": said}), flush=True)
            if not isinstance(error, BoxgraspError):
                _log.info("%s", name, exc_info=True)
    return FAILED if failed else 0


def answer_each(
    args: argparse.Namespace,
    asked: Sequence[_arguments.Asked],
    tell: Callable[[Answered], None],
    *,
    as_json: bool = False,
) -> int:
    """Select for every capture that is asked for.

    Args:
        args: with the options of `add_targets`, `add_scans` and `add_config`.
        asked: what `asked_of` gave.
        tell: called with each answer.
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

    def answer(number: int) -> None:
        path, own = asked[number - 1].capture, asked[number - 1].target
        capture = _arguments.load_capture(path, args)
        wanted = target if own is None else _arguments.target_of(own)
        selection = selector.select(capture, wanted, scans=scans, octomap=octomap)
        selection = dataclasses.replace(selection, capture=path)
        distance_m = selector.config.checks.pregrasp_distance_m
        name = asked[number - 1].name
        tell(Answered(number, name, capture, selection, wanted, distance_m))

    return each(
        [item.name for item in asked],
        answer,
        as_json=as_json,
        captures=[item.capture for item in asked],
    )
