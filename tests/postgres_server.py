"""A PostgreSQL of its own for a test: in a temporary folder, on a free port of the loopback."""

from __future__ import annotations

import os
import shutil
import signal
import socket
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

_BINARIES = sorted(Path("/usr/lib/postgresql").glob("*/bin/initdb"))
USER = "boxgrasp"
LOCKED = "locked"  # the user who needs a password


class PostgresServer:
    """A running server; fsync is on, as where labels are kept."""

    def __init__(self, folder: Path, port: int, run_as: list[str]) -> None:
        self._folder, self._port, self._run_as = folder, port, run_as
        self._process: subprocess.Popen[bytes] | None = None
        self._made = 0
        self._emptied: str | None = None

    def start(self) -> None:
        binary = _BINARIES[-1].parent / "postgres"
        settings = [f"port={self._port}", "listen_addresses=127.0.0.1", "fsync=on"]
        settings += [f"unix_socket_directories={self._folder}", "max_connections=60"]
        words = [str(binary), "-D", str(self._folder / "data")]
        for setting in settings:
            words += ["-c", setting]
        with (self._folder / "log").open("ab") as log:
            self._process = subprocess.Popen([*self._run_as, *words], stdout=log, stderr=log)
        deadline = time.monotonic() + 30
        while not self._answers():
            assert self._process.poll() is None, (self._folder / "log").read_text()
            assert time.monotonic() < deadline, (self._folder / "log").read_text()
            time.sleep(0.05)

    def _answers(self) -> bool:
        ready = [str(_BINARIES[-1].parent / "pg_isready"), "-q", "-h", "127.0.0.1"]
        return subprocess.run([*ready, "-p", str(self._port)]).returncode == 0

    def stop(self) -> None:
        assert self._process is not None
        self._process.send_signal(signal.SIGQUIT)  # at once, as a crash does
        self._process.wait(timeout=30)

    def new_database(self) -> str:
        """The URL of a new, empty database: 7 MB and 300 files."""
        self._made += 1
        self._run("postgres", f"CREATE DATABASE labels{self._made}")
        return self._url(f"labels{self._made}")

    def emptied_database(self) -> str:
        """The URL of one database, without what the last who had it left there."""
        if self._emptied is None:
            self._emptied = self.new_database()
        self._run(self._emptied.rpartition("/")[2], "DROP SCHEMA public CASCADE")
        self._run(self._emptied.rpartition("/")[2], "CREATE SCHEMA public")
        return self._emptied

    def locked_database(self, password: str) -> str:
        """The URL of a new database whose owner needs a password, without it."""
        url = self.new_database()
        name = url.rpartition("/")[2]
        self._run("postgres", f"CREATE USER {LOCKED} PASSWORD '{password}'")
        self._run("postgres", f"ALTER DATABASE {name} OWNER TO {LOCKED}")
        return url.replace(f"{USER}@", f"{LOCKED}@")

    def _url(self, name: str) -> str:
        return f"postgresql+pg8000://{USER}@127.0.0.1:{self._port}/{name}"

    def _run(self, database: str, words: str) -> None:
        import pg8000.dbapi

        connection = pg8000.dbapi.connect(
            USER, host="127.0.0.1", port=self._port, database=database
        )
        connection.autocommit = True
        connection.cursor().execute(words)
        connection.close()


def why_not() -> str | None:
    """Why no server can be started here; None where one can."""
    if not _BINARIES:
        return "no PostgreSQL in /usr/lib/postgresql (Debian's package `postgresql`)"
    if os.geteuid() == 0 and _other_user() is None:
        return "PostgreSQL refuses to run as root, and there is no user postgres or nobody"
    return None


@contextmanager
def running_postgres() -> Iterator[PostgresServer]:
    """A server that is gone afterwards; the test is skipped where none can be started."""
    pytest.importorskip("pg8000")
    reason = why_not()
    if reason:
        pytest.skip(reason)
    # Not pytest's folder: that is the test user's alone, and the server is another one.
    folder = Path(tempfile.mkdtemp(prefix="boxgrasp-postgres-"))
    run_as: list[str] = []
    if os.geteuid() == 0:
        user = _other_user()
        assert user is not None
        shutil.chown(folder, user.pw_name)
        run_as = ["setpriv", f"--reuid={user.pw_uid}", f"--regid={user.pw_gid}", "--clear-groups"]
    init = [str(_BINARIES[-1]), "-D", str(folder / "data"), "-U", USER, "--auth=trust"]
    init += ["--no-sync", "--encoding=UTF8", "--locale=C"]
    try:
        subprocess.run([*run_as, *init], check=True, capture_output=True)
        rules = folder / "data" / "pg_hba.conf"  # the first that fits counts
        rules.write_text(f"host all {LOCKED} samehost scram-sha-256\n" + rules.read_text())
        server = PostgresServer(folder, _free_port(), run_as)
        server.start()
        try:
            yield server
        finally:
            server.stop()
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _other_user() -> Any:
    import pwd  # Windows has none, and no server here

    for name in ("postgres", "nobody"):
        try:
            return pwd.getpwnam(name)
        except KeyError:
            continue
    return None


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
