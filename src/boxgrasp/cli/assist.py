"""Serve a page on which the robot proposes a grasp of each thing, and an operator decides.

The operator sees the clearance and what speaks against a candidate, confirms, takes another one, or
says that help is needed. Every answer is a label, with the checks that were overridden. SOURCE and
the record are those of `boxgrasp label`; the robot's questions (`boxgrasp select --assist URL`) are
answered on either page. Extra: pip install 'boxgrasp[label]'.
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
    return _labeling.serve(args, "assist")
