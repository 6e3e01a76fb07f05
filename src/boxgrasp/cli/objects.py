"""List what stands on the support plane: number, center, size, distance, points.

With --json one JSON object a line a capture, with `capture` and `error` for one that fails.
--masks writes an image a capture: the value of a pixel is the number of the object that it shows.
"""

from __future__ import annotations

import argparse
import json
from typing import TYPE_CHECKING, Any

from boxgrasp.cli import _arguments, _batch

if TYPE_CHECKING:
    from collections.abc import Sequence

    from boxgrasp.errors import CodedWarning
    from boxgrasp.perception.numbering import SceneObject
    from boxgrasp.perception.scene import Scene

_HEAD = ("object", "center x", "y", "z", "size x", "y", "z", "distance", "points")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    _arguments.add_captures(parser)
    parser.add_argument("--json", action="store_true", help="one JSON object a line a capture")
    parser.add_argument("--picture", metavar="OUT.png", help="draw the numbers into the image")
    parser.add_argument("--masks", metavar="OUT.png", help="write the image of object numbers")
    _arguments.add_config(parser)


def run(args: argparse.Namespace) -> int:
    """List the objects of each capture, the nearest first."""
    from boxgrasp.selector import GraspSelector, scene_warnings

    selector = GraspSelector(_arguments.resolve_config(args))
    told = _json if args.json else _table

    masks = _arguments.picture_places(args.masks, args.captures)
    pictures = _arguments.picture_places(args.picture, args.captures)

    def list_objects(number: int) -> None:
        path = args.captures[number - 1]
        capture = _arguments.load_capture(path, args)
        scene = selector.scene(capture)
        if masks:
            from boxgrasp.io.images import write_object_image

            write_object_image(masks[number - 1], scene.object_image())
        if pictures:
            from boxgrasp.draw import draw_objects

            draw_objects(capture, scene, pictures[number - 1])
        warnings = (*capture.warnings, *scene_warnings(scene))
        print(told(path, scene, warnings), flush=True)

    return _batch.each(args.captures, list_objects, as_json=args.json)


def _json(path: str, scene: Scene, warnings: Sequence[CodedWarning]) -> str:
    from boxgrasp.strict import plain

    T = scene.T_base_camera
    answer: dict[str, Any] = {
        "capture": path,
        "frame": scene.frame,
        "T_base_camera": None if T is None else T.tolist(),
        "objects": [_object(item) for item in scene.objects_with_pixels()],
        "flying_pixels": scene.flying_pixels,
        "warnings": [plain(warning) for warning in warnings],
    }
    return json.dumps(answer, allow_nan=False)


def _object(item: SceneObject) -> dict[str, Any]:
    return {
        "number": item.number,
        "center_m": item.center_m.tolist(),
        "size_m": item.size_m.tolist(),
        "distance_m": item.distance_m,
        "points": item.points,
        "pixel": None if item.pixel is None else list(item.pixel),
    }


def _table(path: str, scene: Scene, warnings: Sequence[CodedWarning]) -> str:
    from boxgrasp.cli._report import table

    rows = [
        (
            str(item.number),
            *(f"{value:.3f}" for value in (*item.center_m, *item.size_m, item.distance_m)),
            str(item.points),
        )
        for item in scene.objects
    ]
    lines = [f"{path}: {len(rows)} objects; meters, {scene.frame} frame", table(_HEAD, rows)]
    return "\n".join([*lines, *(f"  warning: {warning.message}" for warning in warnings)])
