"""The operators who are at the page now; one session each, whatever number of browsers."""

from __future__ import annotations

import threading
import time
from typing import Final

from boxgrasp.errors import BoxgraspError
from boxgrasp.labeling.server.desk import Desk
from boxgrasp.labeling.server.session import LONGEST_NAME, Session

_MOST: Final = 64  # operators at once: each has a thread or two and a port
_GONE_S: Final = 300.0  # after which an operator without a browser is taken to have left


class UnknownSessionError(BoxgraspError):
    """The page speaks for a session that is not there: the server was started again."""


class Sessions:
    """Sessions by operator; safe from several threads.

    Args:
        desk: what they share.
    """

    def __init__(self, desk: Desk) -> None:
        self.desk = desk
        self._lock = threading.Lock()
        self._by_operator: dict[str, Session] = {}
        self._seen: dict[str, float] = {}
        self._beginning: dict[str, threading.Lock] = {}

    def of(self, operator: str) -> Session:
        """The session of an operator, begun where there is none.

        Args:
            operator: the name.

        Returns:
            One for all browsers of that operator.

        Raises:
            BoxgraspError: no name, or too many operators.
        """
        name = " ".join(operator.split())
        if not name or len(name) > LONGEST_NAME or not name.isprintable():
            raise BoxgraspError(
                f"operator's name has {len(name)} characters; valid: 1 to {LONGEST_NAME} printable"
            )
        self._drop_gone()
        with self._lock:
            beginning = self._beginning.setdefault(name, threading.Lock())
        # Beginning prepares a scene, which nobody but this operator waits for.
        with beginning:
            with self._lock:
                session = self._by_operator.get(name)
                if session is None and len(self._by_operator) >= _MOST:
                    raise BoxgraspError(f"{_MOST} operators are at the page; valid: fewer")
            session = session or Session(self.desk, name)
            with self._lock:
                self._by_operator[name] = session
                self._seen[name] = time.monotonic()
        return session

    def get(self, id: str) -> Session:
        """A session by its id.

        Args:
            id: as the page was told.

        Returns:
            The session.

        Raises:
            UnknownSessionError: there is none.
        """
        with self._lock:
            for name, session in self._by_operator.items():
                if session.id == id:
                    self._seen[name] = time.monotonic()
                    return session
        raise UnknownSessionError("no such session; valid: reload the page")

    def all(self) -> list[Session]:
        """Everybody who is there.

        Returns:
            Their sessions.
        """
        with self._lock:
            return list(self._by_operator.values())

    def close(self) -> None:
        """Give every scene back."""
        with self._lock:
            for session in self._by_operator.values():
                session.close()
            self._by_operator.clear()

    def _drop_gone(self) -> None:
        with self._lock:
            names = [n for n, at in self._seen.items() if time.monotonic() - at > _GONE_S]
            gone = [self._by_operator.pop(name) for name in names]
            for name in names:
                del self._seen[name]
        for session in gone:
            session.close()
