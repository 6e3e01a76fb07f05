"""Print what makes a shell complete the commands, options and files of boxgrasp at the tab key.

In ~/.bashrc: eval "$(boxgrasp completion bash)"; in ~/.zshrc, after compinit: eval "$(boxgrasp
completion zsh)". Extra: pip install 'boxgrasp[completion]'.
"""

from __future__ import annotations

import argparse
import os
import re
from typing import Any

from boxgrasp.cli import COMMANDS, FAILED, Parser, complain, fill_parser, main_parser
from boxgrasp.errors import MissingExtraError

SHELLS = ("bash", "zsh", "fish")
_SUFFIXES = ("npz", "pcd", "ply", "bag", "db3", "mcap")  # of captures


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("shell", choices=SHELLS, metavar="SHELL", help=" or ".join(SHELLS))


def run(args: argparse.Namespace) -> int:
    """Print the shell's lines."""
    print(_argcomplete().shellcode(["boxgrasp"], shell=args.shell), end="")
    return 0


def complete() -> None:
    """Tell a shell what may follow, as its lines ask in the environment, and end the process."""
    words = set(re.split(r"[\s'\"]+", os.environ.get("COMP_LINE", "")))
    try:
        argcomplete = _argcomplete()
    except MissingExtraError as error:
        complain(error)
        raise SystemExit(FAILED) from None
    parser = main_parser(with_command=False)
    commands = parser.add_subparsers(dest="command", metavar="COMMAND")
    for name, what in COMMANDS.items():
        own = commands.add_parser(name, help=what)
        if name in words:  # no other command's module is imported
            fill_parser(own, name)
            _add_completers(own)
    argcomplete.autocomplete(parser, always_complete_options=False)


def _add_completers(parser: Parser) -> None:
    """Say what may follow an option where it is neither a choice nor any file."""
    from argcomplete.completers import ChoicesCompleter, FilesCompleter, SuppressCompleter

    from boxgrasp.grasps.candidates import FACES
    from boxgrasp.ranking.ranker import ranker_names

    for action in parser.all_actions:
        said: Any = None
        if action.metavar == "CAPTURE":
            said = FilesCompleter(_SUFFIXES)
        elif action.metavar == "HAND":
            said = _hands
        elif action.dest == "ranker":
            said = ChoicesCompleter({name: name for name in ranker_names()})
        elif action.dest == "faces":
            said = ChoicesCompleter({name: name for name in FACES})
        elif action.type in (int, float) or action.dest in ("topic", "base_frame"):
            said = SuppressCompleter()
        if said is not None:
            action.completer = said  # type: ignore[attr-defined]


def _hands(prefix: str, **_: Any) -> list[str]:
    """Hands that ship, and files of others."""
    from argcomplete.completers import FilesCompleter

    from boxgrasp.config import gripper_names

    return [*gripper_names(), *FilesCompleter(("yaml", "urdf"))(prefix)]


def _argcomplete() -> Any:
    try:
        import argcomplete
    except ImportError:
        raise MissingExtraError(
            "completing in a shell needs argcomplete; install with: "
            "pip install 'boxgrasp[completion]'"
        ) from None
    return argcomplete
