"""Show all candidates of each CAPTURE as a table, with the reason each was kept or dropped.

Distances are in cm: to seen obstacles, to unseen space, to the support plane (signed), along
the approach.
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from boxgrasp.cli import _arguments, _batch

if TYPE_CHECKING:
    from boxgrasp.grasps.gripper import Gripper
    from boxgrasp.result import Selection
    from boxgrasp.sensing.capture import Capture


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    _arguments.add_captures(parser)
    _arguments.add_target(parser)
    _arguments.add_scans(parser)
    _arguments.add_config(parser)


def run(args: argparse.Namespace) -> int:
    """Explain each capture."""
    from boxgrasp.cli._report import candidates_table, summary

    def explain(_number: int, _capture: Capture, selection: Selection, _hand: Gripper) -> None:
        print(f"{summary(selection)}\n\n{candidates_table(selection)}", flush=True)

    return _batch.answer_each(args, explain)
