"""Reaching the database: its URL, how transactions run, its schema, its faults in one line."""

from __future__ import annotations

import logging
import os
import sqlite3
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from weakref import WeakSet

import sqlalchemy as sa
from alembic import command
from alembic.config import Config
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy.exc import ArgumentError, DBAPIError, IntegrityError
from sqlalchemy.exc import TimeoutError as PoolTimeoutError

from boxgrasp.errors import ConfigError, StoreError
from boxgrasp.forks import drop_in_child

VALID = "a path, sqlite:///PATH or postgresql+pg8000://USER@HOST/DATABASE"
BUSY_S = 20.0  # how long a writer of SQLite waits for another; each holds it for milliseconds
_VERSION_TABLE = "boxgrasp_labels_version"
_MIGRATIONS = Path(__file__).parent / "migrations"
_SETUP_LOCK = 0x626F786772617370  # of PostgreSQL's advisory locks: held while tables are made
_WRITES = "boxgrasp_writes"
_one_migrates = threading.Lock()  # Alembic keeps what it works on in its modules
_open: WeakSet[Database] = WeakSet()
_of_parent: list[sa.Pool] = []  # kept: to close what the parent opened would disturb it


class Database:
    """A database of labels that is there and has this schema.

    Args:
        url: as `Record.open` takes it.
        create: whether to make it where nothing is.

    Attributes:
        name: the URL as it may be printed.

    Raises:
        ConfigError: no such URL.
        StoreError: it cannot be reached, is something else, or is newer.
    """

    name: str

    def __init__(self, url: str | os.PathLike[str], create: bool = True) -> None:
        parsed = _parsed(os.fspath(url))
        self.name = _printable(parsed)
        self._is_sqlite = parsed.get_backend_name() == "sqlite"
        self._password = parsed.password
        if self._is_sqlite:
            _look_at_file(str(parsed.database), create)
        with self._told():
            self._engine = self._make_engine(parsed)
        self._writer = self._engine.execution_options(**{_WRITES: True})
        _open.add(self)
        try:
            with self._told():
                self._set_up(create)
        except BaseException:
            self._engine.dispose()
            raise

    def close(self) -> None:
        """Let go of every connection."""
        self._engine.dispose()

    def forget_connections(self) -> None:
        """Let a forked child make connections of its own."""
        _of_parent.append(self._engine.pool)
        self._engine.dispose(close=False)

    @contextmanager
    def reads(self) -> Iterator[sa.Connection]:
        """A transaction that only reads.

        Yields:
            Its connection.

        Raises:
            StoreError: the database cannot be read.
        """
        with self._told(), self._engine.begin() as connection:
            yield connection

    @contextmanager
    def writes(self) -> Iterator[sa.Connection]:
        """A transaction that writes; what it wrote is on the disk when it ends.

        Yields:
            Its connection.

        Raises:
            StoreError: the database cannot be written.
            IntegrityError: a row contradicts what is there.
        """
        with self._told(), self._writer.begin() as connection:
            yield connection

    def _make_engine(self, url: sa.URL) -> sa.Engine:
        if not self._is_sqlite:
            logging.getLogger("sqlalchemy.pool.impl.QueuePool").addFilter(_is_of_use)
            return sa.create_engine(url, pool_pre_ping=True, connect_args={"timeout": 30})
        engine = sa.create_engine(url, connect_args={"timeout": BUSY_S})
        sa.event.listen(engine, "connect", _set_up_sqlite)
        sa.event.listen(engine, "begin", _begin_sqlite)
        return engine

    def _set_up(self, create: bool) -> None:
        """Make the tables, or bring them to this schema; several processes may do so at once."""
        script = ScriptDirectory(str(_MIGRATIONS))
        head = script.get_current_head()
        with self._engine.begin() as connection:  # before anything is written to it
            found = self._revision(connection, script)
        if found is None and not create:
            raise StoreError(
                f"{self.name}: holds no labels; valid: a database of boxgrasp's labels"
            )
        if self._is_sqlite:
            self._log_ahead()
        if found == head:
            return
        with self._writer.begin() as connection:
            if not self._is_sqlite:
                connection.execute(sa.select(sa.func.pg_advisory_xact_lock(_SETUP_LOCK)))
            if self._revision(connection, script) != head:
                _migrate(connection)

    def _log_ahead(self) -> None:
        """Switch the file to a write-ahead log, which it keeps; SQLite does not wait there."""
        deadline = time.monotonic() + BUSY_S
        while True:
            connection = self._engine.raw_connection()
            try:
                (mode,) = connection.cursor().execute("PRAGMA journal_mode = WAL").fetchone()
            except sqlite3.OperationalError as error:
                if "locked" not in str(error) or time.monotonic() > deadline:
                    raise StoreError(self._line(error)) from None
                time.sleep(0.02)
                continue
            except sqlite3.Error as error:
                raise StoreError(self._line(error)) from None
            finally:
                connection.close()
            if mode != "wal":
                raise StoreError(
                    f"{self.name}: SQLite keeps no write-ahead log here; valid: a local disk"
                )
            return

    def _revision(self, connection: sa.Connection, script: ScriptDirectory) -> str | None:
        """Which schema is there; None where nothing is.

        Raises:
            StoreError: a newer one, or the tables of something else.
        """
        tables = sa.inspect(connection).get_table_names()
        if _VERSION_TABLE not in tables:
            if tables:
                raise StoreError(
                    f"{self.name}: holds {', '.join(sorted(tables)[:3])} and no labels; valid: a "
                    "database of boxgrasp's labels, or an empty one"
                )
            return None
        context = MigrationContext.configure(connection, opts={"version_table": _VERSION_TABLE})
        found = context.get_current_revision()
        known = [item.revision for item in script.walk_revisions()]
        if found is not None and found not in known:
            raise StoreError(
                f"{self.name}: its schema is {found}, which a newer boxgrasp made; valid: "
                f"{known[0]} or an earlier one"
            )
        return found

    @contextmanager
    def _told(self) -> Iterator[None]:
        """Turns what the database or its driver raises into one line."""
        try:
            yield
        except IntegrityError:
            raise
        except DBAPIError as error:
            raise StoreError(self._line(error.orig)) from None
        except PoolTimeoutError:
            raise StoreError(
                f"{self.name}: all connections are in use; valid: fewer at once"
            ) from None
        except (OSError, sqlite3.Error) as error:
            raise StoreError(self._line(error)) from None

    def _line(self, error: BaseException | None) -> str:
        said = _said(error)
        if self._password:
            said = said.replace(str(self._password), "***")
        return f"{self.name}: {said}; valid: {_remedy(said)}"


def _after_fork() -> None:
    global _one_migrates
    _one_migrates = threading.Lock()
    for database in _open:
        database.forget_connections()


drop_in_child(_after_fork)


def is_taken(error: IntegrityError, column: str) -> bool:
    """Whether a row was refused since another one has that value.

    Args:
        error: of the database.
        column: a unique one of `labels`.

    Returns:
        Whether it was.
    """
    said = str(error.orig)
    return column in said and ("UNIQUE" in said or "unique" in said or "23505" in said)


def _parsed(url: str) -> sa.URL:
    """A URL, or a bare path, as SQLAlchemy takes it; what is refused is not printed whole."""
    if "://" not in url:
        if not url:
            raise ConfigError(f"no database given; valid: {VALID}")
        return sa.URL.create("sqlite", database=url)
    scheme = url.partition("://")[0]
    if scheme not in ("sqlite", "postgresql", "postgres", "postgresql+pg8000"):
        raise ConfigError(f"no databases of {scheme[:40]!r} are known; valid: {VALID}")
    try:
        parsed = sa.make_url(url)
    except (ArgumentError, ValueError):
        raise ConfigError(f"the {scheme} URL cannot be read; valid: {VALID}") from None
    if parsed.query:  # a file would take no notice, a server may be handed a password there
        raise ConfigError(f"the {scheme} URL has options after `?`; valid: {VALID}")
    if scheme == "sqlite":
        if not parsed.database or parsed.database == ":memory:":
            raise ConfigError(f"the sqlite URL names no file; valid: {VALID}")
        return parsed
    # As PostgreSQL's own programs: every user of the machine sees a command line.
    password = parsed.password or os.environ.get("PGPASSWORD")
    return parsed.set(drivername="postgresql+pg8000", password=password)


def _printable(url: sa.URL) -> str:
    if url.get_backend_name() == "sqlite":
        return str(url.database)
    return url.render_as_string(hide_password=True)


def _look_at_file(path: str, create: bool) -> None:
    """Refuse a path where no database can be.

    Raises:
        StoreError: nothing is there, or something else.
    """
    folder = os.path.dirname(path) or "."
    if os.path.isdir(path):
        raise StoreError(f"{path}: is a folder; valid: a file")
    if not os.path.isdir(folder):
        raise StoreError(f"{path}: {folder} is no folder; valid: a file in a folder that is there")
    if not create and not os.path.exists(path):
        raise StoreError(f"{path}: no such file; valid: a database of boxgrasp's labels")


def _is_of_use(record: logging.LogRecord) -> bool:
    """Not that a connection, which a restarted server broke, could not be closed: with a trace."""
    return not str(record.msg).startswith("Exception terminating connection")


def _set_up_sqlite(connection: sqlite3.Connection, record: object) -> None:
    """Each connection: SQLAlchemy begins transactions, every commit is on the disk."""
    connection.isolation_level = None
    cursor = connection.cursor()
    cursor.execute("PRAGMA synchronous = FULL")
    cursor.execute("PRAGMA foreign_keys = ON")
    cursor.close()


def _begin_sqlite(connection: sa.Connection) -> None:
    """A writer takes its turn at the start: later it could no longer wait for another one."""
    writes = connection.get_execution_options().get(_WRITES, False)
    connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")


def _migrate(connection: sa.Connection) -> None:
    """Bring the tables to the newest schema, within the connection's transaction."""
    config = Config()
    config.set_main_option("script_location", str(_MIGRATIONS).replace("%", "%%"))
    config.attributes["boxgrasp"] = {"connection": connection, "version_table": _VERSION_TABLE}
    with _one_migrates:
        command.upgrade(config, "head")


def _said(error: BaseException | None) -> str:
    """What a driver says, on one line."""
    if error is None:
        return "it does not answer"
    first = error.args[0] if error.args else None
    if isinstance(first, dict):  # PostgreSQL's, as pg8000 hands it on
        return " ".join(str(first.get("M", "an error")).split())
    text = getattr(error, "strerror", None) or str(error) or type(error).__name__
    return " ".join(str(text).split())


_REMEDIES = {
    "not a database": "a database of boxgrasp's labels, or a new file",
    "malformed": "a database of boxgrasp's labels that is not damaged",
    "disk is full": "free space, or another disk",
    "disk I/O error": "a disk that works and has free space",
    "readonly": "a file that may be written",
    "read-only": "a file that may be written",
    "unable to open": "a file that may be read and written, in a folder that may be too",
    "locked": "a database that no other program keeps locked",
}


def _remedy(said: str) -> str:
    found = (remedy for part, remedy in _REMEDIES.items() if part in said)
    return next(found, "a database that can be reached, read and written")
