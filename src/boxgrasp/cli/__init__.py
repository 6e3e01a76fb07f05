"""The command line: a file a command, everything heavy imported by the command that needs it.

A command's module has `add_arguments(parser)` and `run(args)`, which returns the exit status or
raises a BoxgraspError; its docstring is what --help says.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import io
import logging
import os
import sys
from collections.abc import Iterator, Sequence
from types import ModuleType
from typing import Any, NoReturn

from boxgrasp.version import __version__

COMMANDS = {
    "select": "choose a grasp for each capture, or ask for help",
    "objects": "list what stands on the support plane",
    "explain": "show all candidates with what every check says, and why each was rejected",
    "show": "draw saved answers again",
    "demo": "cast a cluttered table, select, and write the picture",
    "gripper": "list and show hands, or make one from a URDF",
    "config": "print the configuration as it is resolved",
    "warm-up": "compile every kernel once, so that no command waits for it later",
    "simulate": "cast a set of labeled scenarios with their truth",
    "labels": "count what operators labeled, and carry it from one database to another",
    "train": "train the thesis's eight SVMs on a set",
    "label": "serve the page on which an operator teaches the robot",
    "assist": "serve the page on which the robot proposes and an operator decides",
    "evaluate": "hold every ranker against the truth of a set",
    "reproduce": "do the whole thesis again and write the report",
    "completion": "print what makes a shell complete commands, options and files",
}
_WITH_SCIPY = ("simulate", "train", "evaluate", "reproduce", "label", "assist")
_WITH_KERNELS = ("select", "objects", "explain", "demo", "warm-up", "label", "assist")
FAILED = 2
INTERRUPTED = 130
BROKEN_PIPE = 141
_LEVELS = (logging.WARNING, logging.INFO, logging.DEBUG)  # for no -v, -v and -vv


class Parser(argparse.ArgumentParser):
    """Says what is wrong in one line, as every error of the command line does."""

    def error(self, message: str) -> NoReturn:
        """End with the exit status of a failure.

        Args:
            message: what is wrong.

        Raises:
            SystemExit: always.
        """
        complain(message)
        raise SystemExit(FAILED)

    def parse_all(self, words: Sequence[str]) -> argparse.Namespace:
        """Parse words in any order; one that is no option of these ends the process.

        Args:
            words: of the command line.

        Returns:
            The arguments.

        Raises:
            SystemExit: for a mistake, and for --help.
        """
        args, unknown = self.parse_known_intermixed_args(words)
        if unknown:
            options = [name for action in self.all_actions for name in action.option_strings]
            wrong = next((word for word in unknown if word[:1] == "-"), "").partition("=")[0]
            self.error(f"unrecognized arguments: {' '.join(unknown)}{_meant(wrong, options)}")
        return args

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """Refuse a value that is no choice, and name the choice that it comes near to."""
        if action.choices is None or value in action.choices:
            return
        choices = [str(choice) for choice in action.choices]
        hint = _meant(str(value), choices)
        raise argparse.ArgumentError(
            action, f"invalid choice: {value!r}; valid: {', '.join(choices)}{hint}"
        )

    @property
    def all_actions(self) -> list[argparse.Action]:
        """What it knows, without the options that are gone."""
        return [action for action in self._actions if action.help != argparse.SUPPRESS]


def _meant(word: str, known: Sequence[str]) -> str:
    """What a misspelt word may have been meant for, as the end of a sentence; else nothing."""
    from difflib import get_close_matches  # 10 ms that only a mistake pays

    close = get_close_matches(word, known, n=1)
    return f"; did you mean {close[0]}?" if close else ""


def complain(message: object) -> None:
    """Write one line on standard error.

    Args:
        message: of any number of lines.
    """
    print(f"boxgrasp: {' '.join(str(message).split())}", file=sys.stderr, flush=True)


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command.

    Args:
        argv: what follows `boxgrasp`; None for the process's own.

    Returns:
        The exit status: 0 all answered, 2 something failed, 130 interrupted, 141 nobody reads.
    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    if sys.stdout is None:  # started with its output closed
        sys.stdout = open(os.devnull, "w")
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # a path may hold any bytes
    try:
        if "_ARGCOMPLETE" in os.environ:  # a shell asks what may follow
            importlib.import_module("boxgrasp.cli.completion").complete()
        return _run(arguments)
    except KeyboardInterrupt:
        complain("interrupted")
        return INTERRUPTED
    except OSError as error:  # nowhere to write to; what is buffered must not raise again at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if isinstance(error, BrokenPipeError):
            return BROKEN_PIPE
        complain(f"output: {error.strerror or error}")
        return FAILED


def _run(arguments: list[str]) -> int:
    try:
        split = next((i for i, word in enumerate(arguments) if word[:1] != "-"), len(arguments))
        before = main_parser().parse_all(arguments[: split + 1])
        if before.command is None:
            main_parser().print_help()
            return 0
        parser = command_parser(before.command)
        args = parser.parse_all(arguments[split + 1 :])
        verbose, quiet = max(before.verbose, args.verbose), before.quiet or args.quiet
        if verbose and quiet:
            parser.error("argument -q/--quiet: not allowed with argument -v/--verbose")
    except SystemExit as stop:  # argparse ends the process itself for --help and errors
        return stop.code if isinstance(stop.code, int) else FAILED
    with _log_to_stderr(logging.ERROR if quiet else _LEVELS[min(verbose, 2)]):
        return _answer(before.command, args)


def _answer(command: str, args: argparse.Namespace) -> int:
    from boxgrasp.errors import BoxgraspError

    module = _module_of(command)
    try:
        # Numba imports scipy where it is installed, 0.3 s for matrix products that no kernel has.
        with contextlib.nullcontext() if command in _WITH_SCIPY else _hidden("scipy"):
            if command in _WITH_KERNELS:
                with _hidden("yaml"):  # 12 ms to look for numba's settings in the working folder
                    importlib.import_module("numba")
            status = int(module.run(args))
        sys.stdout.flush()
        return status
    except BoxgraspError as error:
        complain(error)
    except Exception as error:
        if isinstance(error, OSError) and error.filename is None:
            raise  # of the output
        complain(reason(error))
        logging.getLogger("boxgrasp.cli").info("%s", command, exc_info=True)
    return FAILED


def reason(error: Exception) -> str:
    """What went wrong, in one line.

    Args:
        error: any.

    Returns:
        The message of an error that is meant for people; else its kind too.
    """
    from boxgrasp.errors import BoxgraspError

    if isinstance(error, BoxgraspError):
        text = str(error)
    elif isinstance(error, OSError):
        text = f"{error.filename}: {error.strerror}" if error.filename else str(error)
    elif isinstance(error, MemoryError):
        text = "too large for the memory there is"
    else:
        text = f"internal error: {type(error).__name__}: {error}"
    return " ".join(text.split())


def _module_of(command: str) -> ModuleType:
    return importlib.import_module(f"boxgrasp.cli.{command.replace('-', '_')}")


@contextlib.contextmanager
def _hidden(package: str) -> Iterator[None]:
    """Within, a package that is not loaded yet cannot be imported."""
    if package in sys.modules:
        yield
        return
    sys.modules[package] = None  # type: ignore[assignment]
    try:
        yield
    finally:
        del sys.modules[package]


def main_parser(*, with_command: bool = True) -> Parser:
    """The parser of what stands before a command, and of the command's name.

    Args:
        with_command: False leaves the command's name to the caller.

    Returns:
        The parser.
    """
    commands = "\n".join(f"  {name:11}{what}" for name, what in COMMANDS.items())
    parser = Parser(
        prog="boxgrasp",
        usage="boxgrasp [-h] [--version] [-v | -q] COMMAND ...",
        description="One depth view in, one checked gripper pose out.",
        epilog=f"commands:\n{commands}\n\n`boxgrasp COMMAND --help` tells more.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"boxgrasp {__version__}")
    _add_loudness(parser)
    if with_command:
        parser.add_argument(
            "command", nargs="?", choices=COMMANDS, metavar="COMMAND", help=argparse.SUPPRESS
        )
    return parser


def command_parser(command: str) -> Parser:
    """The parser of one command; only that command's file is imported.

    Args:
        command: a key of `COMMANDS`.

    Returns:
        The parser, with the command's own arguments, --verbose and --quiet.
    """
    parser = Parser(
        prog=f"boxgrasp {command}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    fill_parser(parser, command)
    return parser


def fill_parser(parser: Parser, command: str) -> None:
    """Add what a command knows to a parser of its own.

    Args:
        parser: that knows nothing yet.
        command: a key of `COMMANDS`.
    """
    module = _module_of(command)
    parser.description = module.__doc__
    module.add_arguments(parser)
    _add_loudness(parser)


def _add_loudness(parser: Parser) -> None:
    group = parser.add_mutually_exclusive_group()
    group.add_argument(
        "-v", "--verbose", action="count", default=0, help="log to standard error; -vv logs more"
    )
    group.add_argument(
        "-q", "--quiet", action="store_true", help="only errors on standard error, no progress"
    )


@contextlib.contextmanager
def _log_to_stderr(level: int) -> Iterator[None]:
    """Within, the package's log from a level on is written on standard error."""
    logger = logging.getLogger("boxgrasp")
    handler, before = logging.StreamHandler(), logger.level
    handler.setFormatter(logging.Formatter("%(name)s: %(message)s"))
    logger.addHandler(handler)
    logger.setLevel(level)
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.setLevel(before)
