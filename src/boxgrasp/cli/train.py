"""Train the eight SVMs of the thesis from labels, or the network that tells things apart.

SET is what `boxgrasp simulate` wrote: the SVMs go to OUT as ONNX files, and `boxgrasp select
--models OUT --ranker cascade-grid` uses them. Extra: pip install 'boxgrasp[train]'.

With --labels SET is the database of `boxgrasp label`: the SVMs learn what people said, requests for
help too. --mix adds the labels of a simulated set. Extra: pip install 'boxgrasp[label]'.

`boxgrasp train segmentation OUT` casts its own scenes as it goes and writes OUT/network.onnx. It
may be stopped at any time and go on with --resume. Extra: pip install 'boxgrasp[network]'.
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from boxgrasp.execution import Workers
    from boxgrasp.teaching.train import Taught

SEGMENTATION = "segmentation"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options.

    Args:
        parser: of the command.
    """
    from boxgrasp.cli._arguments import add_workers

    parser.add_argument(
        "set", metavar="SET",
        help=f"folder or URL of a set, a database (--labels), or `{SEGMENTATION}`",
    )  # fmt: skip
    parser.add_argument("out", metavar="OUT", help="folder or URL to write the models to")
    parser.add_argument("--seed", type=int, default=0, help="of folds or scenes (default: 0)")
    group = parser.add_argument_group("segmentation")
    group.add_argument("--minutes", type=float, help="of training over all runs (default: 90)")
    group.add_argument("--resume", action="store_true", help="go on with the training in OUT")
    group.add_argument("--start", metavar="FILE", help="network whose weights are the first ones")
    labels = parser.add_argument_group("labels of people")
    labels.add_argument(
        "--labels", action="store_true", help="SET is a database that `boxgrasp label` wrote"
    )
    labels.add_argument(
        "--captures", metavar="PLACE",
        help="folder or URL of the captures (default: beside the database)",
    )  # fmt: skip
    labels.add_argument("--mix", metavar="SET", help="a simulated set, whose labels are added")
    labels.add_argument("--lines", type=int, help="lines a face (default: those of the labels)")
    labels.add_argument("--config", metavar="FILE", help="YAML that captures were labeled with")
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
    own = ("captures", "mix", "lines", "config")
    if not args.labels and any(getattr(args, name) is not None for name in own):
        raise ConfigError(f"--{', --'.join(own)} are of `boxgrasp train --labels`")
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
        if args.labels:
            taught = _taught_by_people(args, workers)
        else:
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


def _taught_by_people(args: argparse.Namespace, workers: Workers) -> Taught:
    from boxgrasp.cli import _labeling, complain
    from boxgrasp.config import load_config
    from boxgrasp.errors import MissingExtraError
    from boxgrasp.execution import Store
    from boxgrasp.labeling.captures import CaptureStore
    from boxgrasp.labeling.lessons import LessonConfig, lessons_of
    from boxgrasp.teaching.sets import read_set

    try:
        from boxgrasp.labeling.record import Record
    except ImportError as error:
        raise MissingExtraError(
            f"labels of people need {error.name}; install with: pip install 'boxgrasp[label]'"
        ) from None
    place = args.captures or _labeling.beside_database(args.set, "captures")
    mix = None if args.mix is None else read_set(Store(args.mix))
    lesson = LessonConfig(load_config(args.config), args.lines)
    with Record.open(args.set, create=False) as record:
        found = lessons_of(record, CaptureStore(Store(place)), workers, lesson, mix=mix)
    mixed = found.taught.rows.count - found.labels
    more = f" and {mixed} of a set" if mixed else ""
    print(f"{found.labels} labels of {found.scenes} scenes{more} by {', '.join(found.operators)}")
    for note in found.notes:
        complain(note)
    return found.taught
