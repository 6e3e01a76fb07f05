"""Do the whole thesis again into OUT: cast, label, train, judge, and write the report.

Started again, it goes on where it stopped. report.html opens in any browser, offline. Labels are
those of a stand-in operator, not of a person. Extra: pip install 'boxgrasp[train]'.
"""

from __future__ import annotations

import argparse


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options.

    Args:
        parser: of the command.
    """
    from boxgrasp.cli._arguments import add_workers

    parser.add_argument("out", metavar="OUT", help="folder or URL to write to")
    parser.add_argument(
        "--full", action="store_true",
        help="also curves over cells, labels and lines, a neural network, 2,000 noisy scenes",
    )  # fmt: skip
    parser.add_argument("--seed", type=int, default=2017, help="default: 2017")
    parser.add_argument("--captures", metavar="DIR", help="real captures to decide on, too")
    parser.add_argument(
        "--small", action="store_true", help="a twentieth of everything, to see that it runs"
    )
    add_workers(parser)


def run(args: argparse.Namespace) -> int:
    """Reproduce.

    Args:
        args: parsed.

    Returns:
        0, or 2 without the folder of captures.

    Raises:
        BoxgraspError: a place that cannot be used, or one with a study made otherwise.
    """
    from pathlib import Path

    from boxgrasp.cli import complain
    from boxgrasp.execution import Store, workers_for
    from boxgrasp.study.report_pages import summary
    from boxgrasp.study.reproduce import reproduce
    from boxgrasp.study.study import SMALL, Scale, Study

    captures = Path(args.captures) if args.captures else None
    if captures is not None and not captures.is_dir():
        complain(f"no folder {captures}; valid: a folder of captures")
        return 2
    scale = SMALL if args.small else Scale()
    store = Store(args.out)
    with workers_for(args.processes, args.cluster) as workers:
        report = reproduce(Study(store, workers, args.seed, scale.fully(args.full)), captures)
    print(summary(report)[0])
    print(f"{store}/report.html")
    return 0
