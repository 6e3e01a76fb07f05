"""Arguments that several commands share, and what they mean."""

from __future__ import annotations

import argparse
import logging
import os
import shlex
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from boxgrasp.config import Config
    from boxgrasp.mapping.octomap_leaves import MapCells
    from boxgrasp.perception.target import Target
    from boxgrasp.sensing.capture import Capture

_log = logging.getLogger("boxgrasp.cli")


class _Refuse(argparse.Action):
    """Ends the command where an option is met that is gone; `const` says what to do instead."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: str | Sequence[Any] | None,
        option_string: str | None = None,
    ) -> NoReturn:
        parser.error(str(self.const))


def removed(parser: argparse.ArgumentParser, option: str, instead: str) -> None:
    """Refuse an option of earlier versions, out of sight of --help.

    Args:
        parser: of the command.
        option: as it was typed.
        instead: what is said of it, in one line.
    """
    parser.add_argument(
        option, action=_Refuse, nargs="?", const=f"{option} {instead}", help=argparse.SUPPRESS
    )


def renamed(parser: argparse.ArgumentParser, old: str, new: str) -> None:
    """Refuse the former name of an option and say what it is now.

    Args:
        parser: of the command.
        old: the former name, `--chooser`.
        new: the name that it has now, `--ranker`.
    """
    removed(parser, old, f"is now {new}")


def add_captures(parser: argparse.ArgumentParser, nargs: str = "+") -> None:
    """Add CAPTURE... and how to read them.

    Args:
        parser: of the command.
        nargs: how many, as argparse has it.
    """
    parser.add_argument(
        "captures",
        nargs=nargs,
        metavar="CAPTURE",
        help=".npz, folder, .pcd, .ply, bag or MCAP; each gets its own answer",
    )
    parser.add_argument(
        "--T-base-camera",
        metavar="FILE",
        help="the camera's pose, .json, .yaml or .npy: 4 x 4, or position and quaternion; goes "
        "before a CAPTURE's own",
    )
    add_reading(parser)


def add_reading(parser: argparse.ArgumentParser) -> None:
    """Add how to read a capture.

    Args:
        parser: of the command.
    """
    group = parser.add_argument_group("reading captures")
    group.add_argument(
        "--cloud-frame",
        choices=("optical", "base"),
        default="optical",
        help="frame of a cloud's points (default: optical, the camera at the origin, z forward)",
    )
    group.add_argument("--topic", metavar="T", help="topic of the message in a bag")
    group.add_argument(
        "--stamp", type=float, metavar="S", help="take a bag's message nearest to this time, s"
    )
    group.add_argument(
        "--base-frame", metavar="FRAME", help="base frame in a bag's /tf; gives the camera's pose"
    )
    group.add_argument(
        "--robot-mask", metavar="FILE", help="image, nonzero where the robot's own arm is seen"
    )


def add_target(parser: argparse.ArgumentParser) -> None:
    """Add which object is wanted; else the capture's own mask or pixel.

    Args:
        parser: of the command.
    """
    group = parser.add_argument_group("target").add_mutually_exclusive_group()
    group.add_argument("--pixel", type=int, nargs=2, metavar=("U", "V"), help="column and row")
    group.add_argument("--mask", metavar="FILE", help="image, nonzero on the target")
    group.add_argument(
        "--point", type=float, nargs=3, metavar=("X", "Y", "Z"), help="base frame, m"
    )
    group.add_argument(
        "--object", type=int, metavar="N", help="number of `boxgrasp objects`, 1 is the nearest"
    )
    group.add_argument(
        "--box",
        type=float,
        nargs=4,
        metavar=("U0", "V0", "U1", "V1"),
        help="pixels round it, as an object detector gives them",
    )


def add_targets(parser: argparse.ArgumentParser) -> None:
    """Add CAPTURE..., or a file that names captures with their targets.

    Args:
        parser: of the command.
    """
    add_captures(parser, nargs="*")
    parser.add_argument(
        "--targets",
        metavar="FILE",
        help="in place of CAPTURE: a capture a line, and its target by one of the options below",
    )
    add_target(parser)


@dataclass(frozen=True)
class Asked:
    """A capture that is asked for.

    Attributes:
        capture: its path.
        name: what lines for people call it.
        target: options of its own target, as `add_target` has them; None for the command's.
    """

    capture: str
    name: str
    target: argparse.Namespace | None = None


def asked_of(args: argparse.Namespace) -> list[Asked]:
    """The captures that are asked for, on the command line or in a file.

    Args:
        args: with what `add_targets` added.

    Returns:
        At least one.

    Raises:
        ConfigError: none, both, or a file that cannot be read.
    """
    from boxgrasp.errors import ConfigError

    if args.targets is None:
        if not args.captures:
            raise ConfigError("the following arguments are required: CAPTURE, or --targets FILE")
        return [Asked(path, path) for path in args.captures]
    if args.captures or _has_target(args):
        what = f"CAPTURE {args.captures[0]}" if args.captures else "a target"
        raise ConfigError(f"--targets and {what} are given; valid: one of them")
    try:
        lines = Path(args.targets).read_text("utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        said = getattr(error, "strerror", None) or "not text; valid: a capture and target a line"
        raise ConfigError(f"{args.targets}: {said}") from None
    asked = []
    for number, line in enumerate(lines, start=1):
        try:
            asked += _asked_by(line, args.targets)
        except ValueError as error:
            raise ConfigError(f"{args.targets}, line {number}: {error}") from None
    if not asked:
        raise ConfigError(f"{args.targets}: no lines; valid: a capture and target a line")
    return asked


def _asked_by(line: str, file: str) -> list[Asked]:
    """What a line of a file of targets asks for; nothing for a blank one or a comment.

    Raises:
        ValueError: not a capture and at most one target.
    """
    words = shlex.split(line, comments=True)
    if not words:
        return []
    parser = _LineParser(add_help=False, allow_abbrev=False)
    parser.add_argument("capture", metavar="CAPTURE")
    add_target(parser)
    own = parser.parse_args(words)
    if own.mask is not None:
        own.mask = beside(own.mask, file)
    name = " ".join(words)
    return [Asked(beside(own.capture, file), name, own if _has_target(own) else None)]


class _LineParser(argparse.ArgumentParser):
    """Parses a line of a file; raises ValueError where the command line would end."""

    def error(self, message: str) -> NoReturn:
        raise ValueError(f"{message}; valid: CAPTURE and one target, table.npz --pixel 320 240")


def _has_target(args: argparse.Namespace) -> bool:
    named = (args.pixel, args.mask, args.point, args.object, args.box)
    return any(value is not None for value in named)


def add_config(parser: argparse.ArgumentParser) -> None:
    """Add what to run with; an option here wins over the configuration file.

    Args:
        parser: of the command.
    """
    group = parser.add_argument_group("configuration")
    group.add_argument("--config", metavar="FILE", help="YAML as `boxgrasp config` prints it")
    group.add_argument("--gripper", metavar="HAND", help="a hand that ships, or its YAML file")
    group.add_argument("--faces", metavar="front,right", help="only these faces may be chosen")
    group.add_argument("--ranker", metavar="NAME", help="what orders the candidates")
    group.add_argument("--models", metavar="DIR", help="an SVM ranker's models (default: shipped)")
    group.add_argument(
        "--unchecked",
        action="store_true",
        help="take the ranker's first candidate, whatever the checks say",
    )
    renamed(parser, "--chooser", "--ranker")


def add_scans(parser: argparse.ArgumentParser) -> None:
    """Add what else is known of the scene.

    Args:
        parser: of the command.
    """
    group = parser.add_argument_group("more of the same scene")
    group.add_argument(
        "--scan",
        nargs="+",
        action="extend",
        default=[],
        metavar="CAPTURE",
        help="further views, all with T_base_camera",
    )
    group.add_argument("--octomap", metavar="FILE", help="map of the scene, .bt or .ot, base frame")


def add_workers(parser: argparse.ArgumentParser) -> None:
    """Add which processes do the work.

    Args:
        parser: of the command.
    """
    group = parser.add_argument_group("workers").add_mutually_exclusive_group()
    group.add_argument(
        "--processes", type=int, metavar="N", help="processes (default: one a usable core)"
    )
    group.add_argument(
        "--cluster", metavar="ADDRESS", help="an existing Dask scheduler, tcp://HOST:PORT"
    )


def resolve_config(args: argparse.Namespace) -> Config:
    """Take file and options together.

    Args:
        args: with what `add_config` added.

    Returns:
        The whole configuration.

    Raises:
        ConfigError: as `load_config`.
        GripperError: as `load_gripper`.
    """
    from boxgrasp.config import load_config, load_gripper
    from boxgrasp.strict import plain

    config: dict[str, Any] = plain(load_config(args.config))
    if args.gripper is not None:
        config["gripper"] = plain(load_gripper(args.gripper))
    if args.faces is not None:
        faces = (face.strip() for face in args.faces.split(","))
        config["candidates"]["faces"] = [face for face in faces if face]
    if args.ranker is not None:
        config["ranker"] = args.ranker
    if args.models is not None:
        config["models"] = args.models
    if args.unchecked:
        config["unchecked"] = True
    return load_config(config)


def load_capture(path: str, args: argparse.Namespace) -> Capture:
    """Read a capture that is asked for, with the pose that the options give it.

    Args:
        path: of the capture.
        args: with what `add_captures` added.

    Returns:
        The capture; the pose of --T-base-camera goes before its own, which it then warns of.

    Raises:
        BoxgraspError: as `read_capture`, or the pose cannot be read.
    """
    capture = read_capture(path, args)
    if args.T_base_camera is None:
        return capture
    from boxgrasp.io.pose import load_pose

    return capture.with_pose(load_pose(args.T_base_camera))


def read_capture(path: str, args: argparse.Namespace) -> Capture:
    """Read a capture as the options say.

    Args:
        path: of the capture.
        args: with what `add_reading` added.

    Returns:
        The capture, without the points under the robot's mask.

    Raises:
        BoxgraspError: it cannot be read, or the mask does not fit.
    """
    from boxgrasp import io

    start = time.perf_counter()
    capture = io.load_capture(
        path,
        cloud_frame=args.cloud_frame,
        topic=args.topic,
        stamp=args.stamp,
        base_frame=args.base_frame,
    )
    _log.info("%s: read in %.1f ms", path, 1e3 * (time.perf_counter() - start))
    if args.robot_mask is None:
        return capture
    return _without_robot(capture, read_mask(args.robot_mask))


def load_surroundings(args: argparse.Namespace) -> tuple[list[Capture], MapCells | None]:
    """Read further scans and the map, as the options name them.

    Args:
        args: with what `add_scans` and `add_reading` added.

    Returns:
        The scans, and the map or None.

    Raises:
        BoxgraspError: one of them cannot be read.
    """
    octomap = None
    if args.octomap is not None:
        from boxgrasp.io.octomap import read_octomap

        octomap = read_octomap(args.octomap)
    return [read_capture(path, args) for path in args.scan], octomap


def target_of(args: argparse.Namespace) -> Target | None:
    """Take the target that the options name.

    Args:
        args: with what `add_target` added.

    Returns:
        The target, or None for the capture's own.

    Raises:
        TargetError: its mask cannot be read.
    """
    from boxgrasp.perception.target import Target

    if args.mask is not None:
        return Target(mask=read_mask(args.mask))
    if args.pixel:
        return Target(pixel=tuple(args.pixel))
    if args.point:
        return Target(point=tuple(args.point))
    if args.box:
        return Target(box=tuple(args.box))
    return Target(object=args.object) if args.object is not None else None


def read_mask(path: str) -> NDArray[np.bool_]:
    """Read a mask.

    Args:
        path: of a PNG.

    Returns:
        (H, W) bool, True where it is not black.

    Raises:
        TargetError: not such an image.
    """
    from boxgrasp.errors import BoxgraspError, TargetError
    from boxgrasp.io.images import read_mask as read

    try:
        return read(Path(path))
    except BoxgraspError as error:
        raise TargetError(f"{path}: {error}") from None
    except (OSError, ValueError, SyntaxError) as error:
        what = getattr(error, "strerror", None) or "damaged image"
        raise TargetError(f"{path}: {what}; valid: a PNG, not black on the object") from None


def _without_robot(capture: Capture, mask: NDArray[np.bool_]) -> Capture:
    import numpy as np

    from boxgrasp.sensing.capture import Capture

    given: dict[str, Any] = {"T_base_camera": capture.T_base_camera, "mask": capture.mask}
    given |= {"target_pixel": capture.target_pixel, "robot_mask": mask}
    if capture.depth is not None:
        masked = Capture(capture.depth, capture.intrinsics, rgb=capture.rgb, **given)
    else:
        points, colors = capture.points, capture.colors
        if capture.cloud_shape is not None and points is not None:
            points = points.reshape(*capture.cloud_shape, 3)
            colors = colors.reshape(*capture.cloud_shape, 3) if colors is not None else None
        masked = Capture.from_cloud(
            np.asarray(points), colors=colors, cloud_frame=capture.cloud_frame, **given
        )
    # What was mended in reading is not seen a second time.
    return masked.with_warnings(*(w for w in capture.warnings if w not in masked.warnings))


def picture_places(path: str | None, captures: Sequence[str]) -> list[Path]:
    """Where the pictures of several captures go.

    Args:
        path: OUT.png, or None where none are wanted.
        captures: their paths.

    Returns:
        OUT.png for one capture, OUT_table.png for table.npz among several; those of one name get
        their numbers too, OUT_table_1.png. Nothing without a path.

    Raises:
        ConfigError: a path without a name.
    """
    if path is None:
        return []
    place = Path(path)
    if not place.name:
        from boxgrasp.errors import ConfigError

        raise ConfigError(f"the picture's path is {path!r}; valid: OUT.png")
    if len(captures) == 1:
        return [place]
    names = [_name_of(Path(capture)) for capture in captures]
    while len(counts := Counter(names)) < len(names):
        numbered = enumerate(names, start=1)
        names = [f"{name}_{k}" if counts[name] > 1 else name for k, name in numbered]
    return [place.with_name(f"{place.stem}_{name}{place.suffix}") for name in names]


def _name_of(capture: Path) -> str:
    """A capture's name without folders and suffix."""
    return capture.resolve().name if capture.is_dir() else capture.stem


def beside(path: str, file: str) -> str:
    """A path that a file names.

    Args:
        path: as it stands in the file.
        file: path of the file.

    Returns:
        The same where something is there, else seen from the file's folder where something is.
    """
    other = Path(file).parent / path
    return str(other) if not os.path.lexists(path) and os.path.lexists(other) else path
