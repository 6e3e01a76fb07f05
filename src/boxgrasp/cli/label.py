"""Serve a page on which an operator teaches the robot: which grasp to take of each thing.

SOURCE is what is labeled: a set that `boxgrasp simulate` wrote, a capture or a folder of them, or
the word `simulate`. Labels are kept in --database and are never overwritten. `boxgrasp train
--labels` learns from them, and so does the page itself. Extra: pip install 'boxgrasp[label]'.

With --from-pose no page is served: a pose that the gripper reached by teleoperation becomes the
label of the one thing in SOURCE.
"""

from __future__ import annotations

import argparse

from boxgrasp.cli import _labeling


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options.

    Args:
        parser: of the command.
    """
    _labeling.add_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Serve the page until it is stopped.

    Args:
        args: parsed.

    Returns:
        0.

    Raises:
        BoxgraspError: a source, a record or an address that cannot be used.
    """
    return _labeling.serve(args, "label")
