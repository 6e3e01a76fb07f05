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
from typing import NoReturn

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
    "train": "train the thesis's eight SVMs on a set",
    "evaluate": "hold every ranker against the truth of a set",
    "reproduce": "do the whole thesis again and write the report",
}
_WITH_SCIPY = ("simulate", "train", "evaluate", "reproduce")
_WITH_KERNELS = ("select", "objects", "explain", "demo", "warm-up")
FAILED = 2
INTERRUPTED = 130
BROKEN_PIPE = 141


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
        before = _main_parser().parse_args(arguments[: split + 1])
        if before.command is None:
            _main_parser().print_help()
            return 0
        parser = command_parser(before.command)
        args = parser.parse_intermixed_args(arguments[split + 1 :])
    except SystemExit as stop:  # argparse ends the process itself for --help and errors
        return stop.code if isinstance(stop.code, int) else FAILED
    handler = _log_to_stderr(max(before.verbose, args.verbose))
    try:
        return _answer(before.command, args)
    finally:
        logging.getLogger("boxgrasp").removeHandler(handler)


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
        return FAILED


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


def _main_parser() -> Parser:
    commands = "\n".join(f"  {name:10}{what}" for name, what in COMMANDS.items())
    parser = Parser(
        prog="boxgrasp",
        usage="boxgrasp [-h] [--version] [-v] COMMAND ...",
        description="One depth view in, one checked gripper pose out.",
        epilog=f"commands:\n{commands}\n\n`boxgrasp COMMAND --help` tells more.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"boxgrasp {__version__}")
    _add_verbose(parser)
    parser.add_argument("command", nargs="?", choices=COMMANDS, help=argparse.SUPPRESS)
    return parser


def command_parser(command: str) -> Parser:
    """The parser of one command; only that command's file is imported.

    Args:
        command: a key of `COMMANDS`.

    Returns:
        The parser, with the command's own arguments and --verbose.
    """
    module = _module_of(command)
    parser = Parser(
        prog=f"boxgrasp {command}",
        description=module.__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    module.add_arguments(parser)
    _add_verbose(parser)
    return parser


def _add_verbose(parser: Parser) -> None:
    parser.add_argument(
        "-v", "--verbose", action="count", default=0, help="log to standard error; -vv logs more"
    )


def _log_to_stderr(verbose: int) -> logging.Handler:
    logger = logging.getLogger("boxgrasp")
    handler = logging.StreamHandler()
    handler.setFormatter(logging.Formatter("%(name)s: %(message)s"))
    logger.addHandler(handler)
    logger.setLevel((logging.WARNING, logging.INFO, logging.DEBUG)[min(verbose, 2)])
    return handler
