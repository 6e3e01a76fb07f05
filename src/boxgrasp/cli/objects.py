"""List what stands on the support plane: number, center, size, distance, points."""

from __future__ import annotations

import argparse

from boxgrasp.cli import _arguments, _batch


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    _arguments.add_captures(parser)
    parser.add_argument("--picture", metavar="OUT.png", help="draw the numbers into the image")
    _arguments.add_config(parser)


def run(args: argparse.Namespace) -> int:
    """List the objects of each capture, the nearest first."""
    from boxgrasp.cli._report import table
    from boxgrasp.selector import GraspSelector

    selector = GraspSelector(_arguments.resolve_config(args))
    head = ("object", "center x", "y", "z", "size x", "y", "z", "distance", "points")

    def list_objects(number: int, path: str) -> None:
        capture = _arguments.load_capture(path, args)
        objects = selector.objects(capture)
        rows = [
            (
                str(item.number),
                *(f"{value:.3f}" for value in (*item.center_m, *item.size_m)),
                f"{item.distance_m:.3f}",
                str(item.points),
            )
            for item in objects
        ]
        print(
            f"{path}: {len(objects)} objects; meters, base frame\n{table(head, rows)}", flush=True
        )
        if args.picture:
            from boxgrasp.draw import draw_objects

            place = _arguments.numbered(args.picture, number, len(args.captures))
            draw_objects(capture, objects, place)

    return _batch.each(args.captures, list_objects)
