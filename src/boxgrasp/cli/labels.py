"""Count the labels in DB by operator and verdict, and say how often operators agree.

DB is a path, or postgresql+pg8000://USER@HOST/DATABASE. FILE ends in .parquet or .csv; what is
imported twice is kept once. Extra: pip install 'boxgrasp[label]'.
"""

from __future__ import annotations

import argparse
from collections import Counter
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from boxgrasp.labeling.record import Record

_STANDING = ("candidate", "none", "box_wrong")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options.

    Args:
        parser: of the command.
    """
    parser.add_argument("database", metavar="DB", help="path or URL of a database of labels")
    parser.add_argument("--export", metavar="FILE", help="write every label with its scene")
    parser.add_argument(
        "--import", metavar="FILE", dest="taken", help="add what another database exported"
    )
    parser.add_argument("--json", action="store_true", help="one JSON object")


def run(args: argparse.Namespace) -> int:
    """Import, export, and say what stands.

    Args:
        args: parsed.

    Returns:
        0.

    Raises:
        BoxgraspError: a database or a file that cannot be used.
    """
    from boxgrasp.errors import MissingExtraError

    try:
        from boxgrasp.labeling.record import Record
        from boxgrasp.labeling.record.exchange import export_labels, import_labels
    except ImportError as error:
        raise MissingExtraError(
            f"labels need {error.name}; install with: pip install 'boxgrasp[label]'"
        ) from None
    said: dict[str, Any] = {}
    with Record.open(args.database, create=args.taken is not None) as record:
        if args.taken is not None:
            said["imported"], said["known"] = import_labels(record, args.taken)
        if args.export is not None:
            said["exported"] = export_labels(record, args.export)
        said = {**_counts(record), **said}
    _print_json(said) if args.json else _print(said, args)
    return 0


def _counts(record: Record) -> dict[str, Any]:
    from boxgrasp.labeling.record.agreement import agreements
    from boxgrasp.strict import plain

    labels = record.standing()
    by_operator: dict[str, Counter[str]] = {}
    for label in labels:
        by_operator.setdefault(label.operator, Counter())[label.verdict] += 1
    return {
        "database": record.name,
        "labels": len(labels),
        "scenes": len({label.scene_key for label in labels}),
        "operators": [
            {"operator": name, "labels": counts.total(), **{v: counts[v] for v in _STANDING}}
            for name, counts in sorted(by_operator.items())
        ],
        "agreements": plain(agreements(labels)),
    }


def _print_json(said: dict[str, Any]) -> None:
    import json

    print(json.dumps(said))


def _print(said: dict[str, Any], args: argparse.Namespace) -> None:
    if "imported" in said:
        print(f"{args.taken}: {said['imported']} new, {said['known']} there already")
    if "exported" in said:
        print(f"{args.export}: {said['exported']} rows")
    print(f"{said['labels']} labels of {said['scenes']} scenes")
    if said["operators"]:
        print("\noperator              labels  candidate       none  box wrong")
    for line in said["operators"]:
        counts = "".join(f"{line[verdict]:11d}" for verdict in _STANDING)
        print(f"{_plain(line['operator']):20} {line['labels']:7d}{counts}")
    if said["agreements"]:
        print("\nagreement of                                 scenes    same   kappa")
    for line in said["agreements"]:
        kappa = "-" if line["kappa"] is None else f"{line['kappa']:.3f}"
        names = f"{_plain(line['first']):20} {_plain(line['second']):20}"
        print(f"{names} {line['scenes']:9d} {100 * line['same']:6.1f}% {kappa:>7}")


def _plain(name: str) -> str:
    """A name as it may be written on a terminal, which acts on some characters."""
    return "".join(char if char.isprintable() else "?" for char in name)
