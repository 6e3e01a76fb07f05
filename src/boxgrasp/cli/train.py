"""Search and train the eight SVMs of the thesis from a labeled SET, and write them as ONNX files.

SET is what `boxgrasp simulate` wrote. `boxgrasp select --models OUT --ranker cascade-grid` uses
them. Extra: pip install 'boxgrasp[train]'.
"""

from __future__ import annotations

import argparse


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options.

    Args:
        parser: of the command.
    """
    from boxgrasp.cli._arguments import add_workers

    parser.add_argument("set", metavar="SET", help="folder or URL of a set")
    parser.add_argument("out", metavar="OUT", help="folder or URL to write the models to")
    parser.add_argument("--seed", type=int, default=0, help="of the folds (default: 0)")
    add_workers(parser)


def run(args: argparse.Namespace) -> int:
    """Train, and print a table like the thesis's B-1.

    Args:
        args: parsed.

    Returns:
        0.

    Raises:
        BoxgraspError: a set that cannot be read or cannot teach, or a place that cannot be used.
    """
    from boxgrasp.execution import Store, workers_for
    from boxgrasp.ranking.onnx.record import model_name
    from boxgrasp.teaching.sets import read_set
    from boxgrasp.teaching.train import train_svms

    store = Store(args.out)
    with workers_for(args.processes, args.cluster) as workers:
        trained = train_svms(store, "", read_set(Store(args.set)), workers, seed=args.seed)
    print("model                 C        gamma     vectors  examples  accuracy")
    for item in trained:
        record = item["record"]
        name = model_name(record["version"], record["part"])
        print(
            f"{name:20} {record['C']:9.4g} {record['gamma']:9.4g} {record['support_vectors']:9d}"
            f" {record['training_examples']:9d} {record['accuracy']:9.3f}"
        )
    return 0
