"""Hands: list those that ship, show one with the sources of its sizes, make one from a URDF.

  boxgrasp gripper list
  boxgrasp gripper show NAME|FILE.yaml [--picture OUT.png]
  boxgrasp gripper from-urdf FILE.urdf --palm LINK --fingers A,B [--output HAND.yaml]

`show` and `from-urdf` print the YAML that --gripper takes; from-urdf needs the extra `urdf`.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from boxgrasp.errors import BoxgraspError

if TYPE_CHECKING:
    from boxgrasp.grasps.gripper import Gripper

_WORK = ("list", "show", "from-urdf")
_HEAD = ("hand", "length", "width", "thickness", "opens", "inserts", "boxes", "flange")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("work", choices=_WORK, metavar="list|show|from-urdf", help="what to do")
    parser.add_argument("hand", nargs="?", metavar="HAND", help="a name, a YAML file, or a URDF")
    parser.add_argument("--picture", metavar="OUT.png", help="draw it from three sides")
    parser.add_argument("--output", metavar="HAND.yaml", help="write the YAML there")
    group = parser.add_argument_group("from a URDF")
    group.add_argument("--palm", metavar="LINK", help="link that the fingers move against")
    group.add_argument("--fingers", metavar="A,B", help="links of both fingertips")
    group.add_argument(
        "--flange", metavar="LINK", help="link fixed to the palm, as the arm has it (default: palm)"
    )
    group.add_argument(
        "--insertion", type=float, metavar="M", help="how far the tips pass the target's face, m"
    )
    group.add_argument(
        "--visual", action="store_true", help="take the visual geometry, not what collides"
    )


def run(args: argparse.Namespace) -> int:
    """List, show, or read a URDF."""
    _refuse_mixed(args)
    if args.work == "list":
        print(_list())
        return 0
    if args.work == "show":
        from boxgrasp.config import load_gripper

        gripper, text = load_gripper(args.hand), _text(args.hand)
    else:
        gripper = _from_urdf(args)
        text = _yaml(gripper)
    if args.picture:
        from boxgrasp.draw import draw_gripper

        draw_gripper(gripper, args.picture)
    if args.output:
        _write(Path(args.output), text)
    else:
        print(text, end="")
    return 0


def _refuse_mixed(args: argparse.Namespace) -> None:
    given = {
        name
        for name in (
            "hand",
            "picture",
            "output",
            "palm",
            "fingers",
            "flange",
            "insertion",
            "visual",
        )
        if getattr(args, name) not in (None, False)
    }
    takes = {"list": set(), "show": {"hand", "picture", "output"}}.get(args.work, given)
    for name in sorted(given - takes):
        what = args.hand if name == "hand" else f"--{name}"
        raise BoxgraspError(f"{what} does not go with gripper {args.work}")
    needs = {"list": (), "show": ("hand",)}.get(args.work, ("hand", "palm", "fingers"))
    missing = [name for name in needs if name not in given]
    if missing:
        words = ", ".join("HAND" if name == "hand" else f"--{name}" for name in missing)
        raise BoxgraspError(f"gripper {args.work} needs {words}")


def _list() -> str:
    from boxgrasp.cli._report import table
    from boxgrasp.config import gripper_names, load_gripper

    rows = []
    for name in gripper_names():
        hand = load_gripper(name)
        sizes = (hand.length_m, hand.width_m, hand.thickness_m, hand.max_opening_m)
        lengths = [f"{100 * size:.1f} cm" for size in (*sizes, hand.insertion_depth_m)]
        boxes = len(hand.boxes_m)
        rows.append((name, *lengths, str(boxes), "known" if hand.T_flange_gripper else "not known"))
    return table(_HEAD, rows, left=(0, 7))


def _text(hand: str) -> str:
    """The file of a hand that was read, with its sources."""
    from importlib import resources

    from boxgrasp.config import gripper_names

    if hand in gripper_names():
        return (resources.files("boxgrasp.grasps") / "hands" / f"{hand}.yaml").read_text("utf-8")
    return Path(hand).read_text("utf-8")


def _from_urdf(args: argparse.Namespace) -> Gripper:
    from boxgrasp.io.urdf_gripper import gripper_from_urdf

    fingers = tuple(args.fingers.split(","))
    if len(fingers) != 2:
        raise BoxgraspError(f"--fingers is {args.fingers!r}; valid: two links, as left,right")
    return gripper_from_urdf(
        args.hand,
        args.palm,
        fingers,
        flange=args.flange,
        insertion_depth_m=args.insertion,
        visual=args.visual,
    )


def _yaml(gripper: Gripper) -> str:
    """As --gripper takes it; a box a line."""
    from boxgrasp.strict import plain, to_yaml

    data = {key: value for key, value in plain(gripper).items() if value is not None}
    boxes = {key: data.pop(key) for key in ("palm", "finger")}
    lines = [to_yaml(data)]
    for key, held in boxes.items():
        lines.append(f"{key}:\n")
        for box in held:
            ends = ", ".join(f"{axis}: {values}" for axis, values in box.items())
            lines.append(f"  - {{{ends}}}\n")
    return "".join(lines)


def _write(place: Path, text: str) -> None:
    try:
        place.write_text(text, "utf-8")
    except OSError as error:
        what = error.strerror or error
        raise BoxgraspError(f"{place} cannot be written: {what}; valid: a file's path") from None
    print(place)
