"""Show all options of each CAPTURE as a table, with the reason each was kept or dropped.

Distances are in cm: to seen obstacles, to unseen space, to the support plane (signed), along
the approach.
"""

from __future__ import annotations

import argparse
import dataclasses

from boxgrasp.cli import _arguments, _batch


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    _arguments.add_captures(parser)
    _arguments.add_target(parser)
    _arguments.add_scans(parser)
    _arguments.add_config(parser)


def run(args: argparse.Namespace) -> int:
    """Explain each capture."""
    from boxgrasp.cli._report import options_table, summary
    from boxgrasp.select import GraspSelector

    selector = GraspSelector(_arguments.resolve_config(args))
    target = _arguments.target_of(args)
    scans, octomap = _arguments.load_surroundings(args)

    def explain(number: int, path: str) -> None:
        capture = _arguments.load_capture(path, args)
        selection = selector.select(capture, target, scans=scans, octomap=octomap)
        selection = dataclasses.replace(selection, capture=path)
        print(f"{summary(selection)}\n\n{options_table(selection)}", flush=True)

    return _batch.each(args.captures, explain)
