"""What `label` and `assist` share: where scenes come from, where labels go, where the page is."""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
from collections.abc import Iterator
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from boxgrasp.config import Config
    from boxgrasp.labeling.captures import CaptureStore
    from boxgrasp.labeling.record import Record
    from boxgrasp.labeling.server.desk import DeskRules, Mode
    from boxgrasp.labeling.server.run import Listening
    from boxgrasp.labeling.sources import Source

_DATABASE = "labels.sqlite"
_PORT = 8765
_AGAIN_SHARE = 0.05  # a scene in twenty tells how steady an operator is


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options that both commands have.

    Args:
        parser: of the command.
    """
    from boxgrasp.cli import _arguments

    parser.add_argument(
        "source", metavar="SOURCE",
        help="a set, a capture, a folder of captures, or `simulate`",
    )  # fmt: skip
    add_record(parser)
    page = parser.add_argument_group("page")
    page.add_argument("--port", type=int, default=_PORT, help=f"0 for any (default: {_PORT})")
    page.add_argument(
        "--host", default="127.0.0.1",
        help="address to listen on; another than the loopback asks for a token (BOXGRASP_TOKEN)",
    )  # fmt: skip
    page.add_argument("--token-file", metavar="FILE", help="file that holds the token")
    page.add_argument("--no-browser", action="store_true", help="do not open the page here")
    page.add_argument("--operator", default="", metavar="NAME", help="who labels; else it is asked")
    page.add_argument(
        "--second-share", type=float, default=0.0, metavar="SHARE",
        help="share of the scenes that two operators label (default: 0)",
    )  # fmt: skip
    page.add_argument(
        "--again-share", type=float, default=_AGAIN_SHARE, metavar="SHARE",
        help=f"share that comes to the same operator twice (default: {_AGAIN_SHARE})",
    )  # fmt: skip
    drawn = parser.add_argument_group("scenes drawn as they are asked for (SOURCE is `simulate`)")
    drawn.add_argument("--count", type=int, default=800, help="scenes (default: 800)")
    drawn.add_argument("--set", choices=("known", "novel", "all", "real"), default="known")
    drawn.add_argument("--seed", type=int, default=1, help="default: 1")
    _arguments.add_config(parser)


def add_record(parser: argparse.ArgumentParser) -> None:
    """Add where labels and captures are kept.

    Args:
        parser: of the command.
    """
    group = parser.add_argument_group("record")
    group.add_argument(
        "--database", metavar="URL", default=_DATABASE,
        help="SQLite file, or postgresql+pg8000://USER@HOST/DATABASE with the password in "
        f"PGPASSWORD (default: {_DATABASE})",
    )  # fmt: skip
    group.add_argument(
        "--captures", metavar="PLACE",
        help="folder or URL of the captures (default: beside the database)",
    )  # fmt: skip


@contextlib.contextmanager
def extra() -> Iterator[None]:
    """Within, a package that is missing is told as the extra that brings it.

    Raises:
        MissingExtraError: one is not installed.
    """
    from boxgrasp.errors import MissingExtraError

    try:
        yield
    except ImportError as error:
        raise MissingExtraError(
            f"labels need {error.name}; install with: pip install 'boxgrasp[label]'"
        ) from None


def captures_of(args: argparse.Namespace) -> CaptureStore:
    """Where captures are kept.

    Args:
        args: with what `add_record` added.

    Returns:
        The store.

    Raises:
        StoreError: the place cannot be used.
    """
    from boxgrasp.execution import Store
    from boxgrasp.labeling.captures import CaptureStore

    return CaptureStore(Store(args.captures or beside_database(args.database, "captures")))


def beside_database(database: str, what: str) -> str:
    """A folder next to the database; for one that is no file, in the working folder.

    Args:
        database: path or URL.
        what: what is kept there.

    Returns:
        `labels-captures` for `labels.sqlite`.
    """
    path = database.removeprefix("sqlite:///")
    stem = "labels" if "://" in path else os.path.splitext(path)[0]
    return f"{stem}-{what}"


def source_of(args: argparse.Namespace, captures: CaptureStore, config: Config) -> Source:
    """The source that the command names.

    Args:
        args: with what `add_arguments` added.
        captures: where captures are kept.
        config: of the robot.

    Returns:
        The source.

    Raises:
        BoxgraspError: it is none.
    """
    from boxgrasp.labeling.sources import SIMULATE, source_at

    if args.source != SIMULATE:
        return source_at(args.source, captures, config=config)
    from boxgrasp.simulate.scenario import Recipe, targets_of
    from boxgrasp.teaching.rows import RowConfig
    from boxgrasp.teaching.sets import SetConfig

    objects = "real" if args.set == "real" else "simulated"
    recipe = Recipe(targets_of(args.set, objects), objects=objects)
    rows = RowConfig(recipe, args.seed, lines=config.candidates.lines)
    return source_at(SIMULATE, captures, simulate=SetConfig(rows, args.count), config=config)


def serve(args: argparse.Namespace, mode: Mode) -> int:
    """Serve the page until it is stopped.

    Args:
        args: with what `add_arguments` added.
        mode: whether the robot proposes.

    Returns:
        0.

    Raises:
        BoxgraspError: a source, a record or an address that cannot be used.
    """
    from boxgrasp.cli import _arguments
    from boxgrasp.errors import ConfigError
    from boxgrasp.labeling.words import TurnRules

    with extra():
        from boxgrasp.labeling.record import Record
        from boxgrasp.labeling.server.desk import DeskRules
        from boxgrasp.labeling.server.run import Listening
        from boxgrasp.labeling.server.security import access_of
    for name in ("second_share", "again_share"):
        if not 0 <= getattr(args, name) <= 1:
            option = f"--{name.replace('_', '-')}"
            raise ConfigError(f"{option} is {getattr(args, name)}; valid: 0 to 1")
    config = _arguments.resolve_config(args)
    access = access_of(args.host, args.token_file, os.environ)
    captures = captures_of(args)
    source = source_of(args, captures, config)
    scenes = source.scenes()
    turns = TurnRules(second_share=args.second_share, again_share=args.again_share)
    record = Record.open(args.database)
    try:
        record.add_scenes(source.name, scenes)
        desk_rules = DeskRules(mode, turns, args.operator)
        listening = Listening(access, args.port, not args.no_browser)
        _serve(args, (record, source.name, captures, config, desk_rules), listening)
    finally:
        record.close()
    return 0


def _serve(
    args: argparse.Namespace,
    desk_of: tuple[Record, str, CaptureStore, Config, DeskRules],
    listening: Listening,
) -> None:
    from boxgrasp.labeling.learning import Learner
    from boxgrasp.labeling.lessons import LessonConfig
    from boxgrasp.labeling.server.desk import Desk
    from boxgrasp.labeling.server.run import serve as serve_page
    from boxgrasp.labeling.server.select_api import Selections

    record, _, captures, config, _ = desk_of
    learner = Learner(
        args.database,
        captures.store.place,
        beside_database(args.database, "models"),
        LessonConfig(config),
    )
    desk = Desk(*desk_of, learner)

    def ready(url: str) -> None:
        print(f"{len(desk.scenes)} scenes; labels go to {record.name}")
        print(f"the page: {url}  (stop with Ctrl-C)", flush=True)

    desk.warm_up()
    serve_page(desk, Selections(config), listening, ready)
    print("stopped; every label that was saved is in the record", file=sys.stderr)
