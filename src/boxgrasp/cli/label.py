"""Serve a page on which an operator teaches the robot: which grasp to take of each thing.

SOURCE is what is labeled: a set that `boxgrasp simulate` wrote, a capture or a folder of them, or
the word `simulate`. Labels are kept in --database and are never overwritten. `boxgrasp train
--labels` learns from them, and so does the page itself. Extra: pip install 'boxgrasp[label]'.

With --from-pose no page is served: a pose that the gripper reached by teleoperation becomes the
label of the thing in the capture SOURCE whose candidate is nearest.
"""

from __future__ import annotations

import argparse
import math

from boxgrasp.cli import _labeling


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options.

    Args:
        parser: of the command.
    """
    _labeling.add_arguments(parser)
    group = parser.add_argument_group("a pose instead of the page")
    group.add_argument(
        "--from-pose", metavar="POSE",
        help="file of T_base_gripper, or `x y z qx qy qz qw`; --operator says who reached it",
    )  # fmt: skip
    group.add_argument("--note", default="", help="the operator's own words")


def run(args: argparse.Namespace) -> int:
    """Serve the page until it is stopped, or keep one label.

    Args:
        args: parsed.

    Returns:
        0.

    Raises:
        BoxgraspError: a source, a record, a pose or an address that cannot be used.
    """
    return _labeling.serve(args, "label") if args.from_pose is None else _keep_pose(args)


def _keep_pose(args: argparse.Namespace) -> int:
    from boxgrasp.cli import _arguments
    from boxgrasp.errors import ConfigError
    from boxgrasp.grasps.candidates import FACES

    with _labeling.extra():
        from boxgrasp.labeling.poses import PoseOf, label_from_pose
        from boxgrasp.labeling.record import Record
    if not args.operator:
        raise ConfigError("--from-pose without --operator; valid: the name of who reached the pose")
    config, captures = _arguments.resolve_config(args), _labeling.captures_of(args)
    with Record.open(args.database) as record:
        reached = PoseOf(args.from_pose, args.operator, args.note)
        label = label_from_pose(args.source, reached, record, captures, config)
    if label.label is None or label.pose_distance_m is None or label.pose_angle_rad is None:
        raise ConfigError(f"label {label.id} names no candidate; valid: a pose near one")
    face, line = divmod(label.label - 1, label.lines)
    print(
        f"{args.source}: label {label.label} ({FACES[face]}, line {line + 1}), "
        f"{100 * label.pose_distance_m:.1f} cm and {math.degrees(label.pose_angle_rad):.0f} "
        "degrees from the pose"
    )
    return 0
