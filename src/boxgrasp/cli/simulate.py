"""Cast a set of scenarios, each with its truth and a stand-in operator's label (Parquet).

OUT is a folder or any fsspec URL. Started again, it goes on where it stopped. The labels are those
of a stand-in, not of a person. Extra: pip install 'boxgrasp[train]'.
"""

from __future__ import annotations

import argparse

GROUPS = ("known", "novel", "all", "real")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options.

    Args:
        parser: of the command.
    """
    from boxgrasp.cli._arguments import add_workers
    from boxgrasp.grasps.candidates import LINES
    from boxgrasp.simulate.scenario import NOISES, WISHES

    parser.add_argument("out", metavar="OUT", help="folder or URL to write to")
    parser.add_argument("--count", type=int, default=800, help="scenarios (default: 800)")
    parser.add_argument(
        "--set", choices=GROUPS, default="known", help="whose turn it is as target (default: known)"
    )
    parser.add_argument("--seed", type=int, default=1, help="default: 1")
    parser.add_argument("--objects", metavar="FILE", help="object set of your own, YAML")
    parser.add_argument(
        "--obstacles", type=int, nargs=2, default=(1, 4), metavar=("LEAST", "MOST"),
        help="how many obstacles (default: 1 4)",
    )  # fmt: skip
    parser.add_argument("--noise", choices=tuple(NOISES), default="none", help="default: none")
    parser.add_argument(
        "--wish", choices=WISHES, default="feasible",
        help="which scenes are kept (default: feasible, at least one feasible grasp)",
    )  # fmt: skip
    parser.add_argument("--lines", type=int, default=LINES, help=f"lines a face (default: {LINES})")
    parser.add_argument(
        "--keep-captures", action="store_true", help="write every capture too, as .npz"
    )
    parser.add_argument(
        "--physics", action="store_true",
        help="keep only scenes in which all stands still in MuJoCo (extra: sim)",
    )  # fmt: skip
    add_workers(parser)


def run(args: argparse.Namespace) -> int:
    """Cast the set.

    Args:
        args: parsed.

    Returns:
        0.

    Raises:
        BoxgraspError: scenarios that cannot be drawn, or a place that cannot be used.
    """
    from boxgrasp.execution import Store, workers_for
    from boxgrasp.simulate.scenario import Recipe, targets_of
    from boxgrasp.teaching.rows import RowConfig
    from boxgrasp.teaching.sets import SetConfig, keep_captures, make_set, read_set

    objects = args.objects or ("real" if args.set == "real" else "simulated")
    recipe = Recipe(
        targets_of(args.set, objects),
        objects=objects,
        obstacles=tuple(args.obstacles),
        noise=args.noise,
        wish=args.wish,
        physics=args.physics,
    )
    config = SetConfig(RowConfig(recipe, args.seed, lines=args.lines), args.count)
    store = Store(args.out)
    with workers_for(args.processes, args.cluster) as workers:
        make_set(store, "", config, workers, "simulate")
        if args.keep_captures:
            keep_captures(store, "", config, workers, "captures")
    _, rows = read_set(store)
    refused = int((rows["found_error"] != "").sum())
    print(f"{args.out}: {rows.count} scenarios, {refused} in which the package found no target")
    return 0
