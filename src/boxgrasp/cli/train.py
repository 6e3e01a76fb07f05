"""Train the eight SVMs of the thesis from a labeled SET, or the network that tells things apart.

SET is what `boxgrasp simulate` wrote: the SVMs go to OUT as ONNX files, and `boxgrasp select
--models OUT --ranker cascade-grid` uses them. Extra: pip install 'boxgrasp[train]'.

`boxgrasp train segmentation OUT` casts its own scenes as it goes and writes OUT/network.onnx. It
may be stopped at any time and go on with --resume. Extra: pip install 'boxgrasp[network]'.
"""

from __future__ import annotations

import argparse

SEGMENTATION = "segmentation"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options.

    Args:
        parser: of the command.
    """
    from boxgrasp.cli._arguments import add_workers

    parser.add_argument("set", metavar="SET", help=f"folder or URL of a set, or `{SEGMENTATION}`")
    parser.add_argument("out", metavar="OUT", help="folder or URL to write the models to")
    parser.add_argument("--seed", type=int, default=0, help="of folds or scenes (default: 0)")
    group = parser.add_argument_group("segmentation")
    group.add_argument("--minutes", type=float, help="of training over all runs (default: 90)")
    group.add_argument("--resume", action="store_true", help="go on with the training in OUT")
    group.add_argument("--start", metavar="FILE", help="network whose weights are the first ones")
    add_workers(parser)


def run(args: argparse.Namespace) -> int:
    """Train, and print a table like the thesis's B-1, or how the network fared.

    Args:
        args: parsed.

    Returns:
        0.

    Raises:
        BoxgraspError: a set that cannot be read or cannot teach, a training that cannot go on, or
            a place that cannot be used.
    """
    if args.set == SEGMENTATION:
        return _train_network(args)
    from boxgrasp.errors import ConfigError

    if args.minutes is not None or args.resume or args.start is not None:
        raise ConfigError("--minutes, --resume and --start are of `boxgrasp train segmentation`")
    return _train_svms(args)


def _train_network(args: argparse.Namespace) -> int:
    from boxgrasp.errors import MissingExtraError
    from boxgrasp.execution import Store, workers_for
    from boxgrasp.onnx.session import load_file

    try:
        from boxgrasp.teaching.network.training import MODEL, TrainingParams, train_network
    except ImportError as error:
        raise MissingExtraError(
            f"training the network needs {error.name}; install with: "
            "pip install 'boxgrasp[network]'"
        ) from None
    minutes = TrainingParams.minutes if args.minutes is None else args.minutes
    params = TrainingParams(minutes=minutes, seed=args.seed)
    store = Store(args.out)
    start = None if args.start is None else load_file(args.start, bytes)
    with workers_for(args.processes, args.cluster) as workers:
        record = train_network(store, workers, params, resume=args.resume, start=start)
    told = record["training"]
    print(f"{store}/{MODEL}: {record['scenes']['examples']} examples in {told['seconds']} s")
    print("to use it, set scene.segmentation to network and scene.network to that file")
    return 0


def _train_svms(args: argparse.Namespace) -> int:
    from boxgrasp.execution import Store, workers_for
    from boxgrasp.ranking.onnx.record import model_name
    from boxgrasp.teaching.sets import read_set
    from boxgrasp.teaching.train import taught_by_set, train_svms

    store = Store(args.out)
    with workers_for(args.processes, args.cluster) as workers:
        taught = taught_by_set(*read_set(Store(args.set)))
        trained = train_svms(store, "", taught, workers, seed=args.seed)
    print("model                 C        gamma     vectors  examples  accuracy")
    for item in trained:
        record = item["record"]
        name = model_name(record["version"], record["part"])
        print(
            f"{name:20} {record['C']:9.4g} {record['gamma']:9.4g} {record['support_vectors']:9d}"
            f" {record['training_examples']:9d} {record['accuracy']:9.3f}"
        )
    return 0
