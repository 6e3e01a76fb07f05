"""Several captures, one after the other; one that fails does not stop the rest."""

from __future__ import annotations

import argparse
import dataclasses
import logging
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from boxgrasp.cli import FAILED, _arguments, complain
from boxgrasp.errors import BoxgraspError

if TYPE_CHECKING:
    from boxgrasp.grasps.gripper import Gripper
    from boxgrasp.result import Selection
    from boxgrasp.sensing.capture import Capture

_log = logging.getLogger("boxgrasp.cli")


def each(
    items: Sequence[str], work: Callable[[int, str], None], names: Sequence[str] | None = None
) -> int:
    """Call `work(number, item)` for every item; the exit status is 2 if any failed."""
    failed = False
    for number, item in enumerate(items, start=1):
        path = names[number - 1] if names else item
        try:
            work(number, item)
        except BoxgraspError as error:
            failed = True
            text = str(error)
            complain(text if text.startswith(path) else f"{path}: {text}")
        except OSError as error:
            if isinstance(error, BrokenPipeError):
                raise
            failed = True
            complain(f"{error.filename or path}: {error.strerror or error}")
        except MemoryError:
            failed = True
            complain(f"{path}: too large for the memory there is")
        except Exception as error:  # a fault of ours must not cost the rest of the batch
            failed = True
            complain(f"{path}: internal error: {type(error).__name__}: {error}")
            _log.info("%s", path, exc_info=True)
    return FAILED if failed else 0


def answer_each(
    args: argparse.Namespace, tell: Callable[[int, Capture, Selection, Gripper], None]
) -> int:
    """Select for every capture of the command line and `tell(number, capture, answer, hand)`."""
    from boxgrasp.selector import GraspSelector

    selector = GraspSelector(_arguments.resolve_config(args))
    target = _arguments.target_of(args)
    scans, octomap = _arguments.load_surroundings(args)

    def answer(number: int, path: str) -> None:
        capture = _arguments.load_capture(path, args)
        selection = selector.select(capture, target, scans=scans, octomap=octomap)
        selection = dataclasses.replace(selection, capture=path)
        tell(number, capture, selection, selector.config.gripper)

    return each(args.captures, answer)
