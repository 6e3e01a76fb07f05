"""Serves the page until it is stopped."""

from __future__ import annotations

import contextlib
import signal
import socket
import threading
import webbrowser
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import uvicorn

from boxgrasp.errors import StoreError
from boxgrasp.labeling.server.app import make_app
from boxgrasp.labeling.server.asks_api import Asks, asks_router
from boxgrasp.labeling.server.desk import Desk
from boxgrasp.labeling.server.openapi import publish_schemas
from boxgrasp.labeling.server.security import QUIET, Access, Guard, UploadLimits
from boxgrasp.labeling.server.select_api import Selections, select_router

_LAST_PORT = 65535
_GRACE_S = 2  # that open connections get when the server is stopped


@dataclass(frozen=True)
class Listening:
    """Where the server listens.

    Attributes:
        access: address and token.
        port: of it; 0 for any that is free.
        open_browser: whether to open the page here, where it asks for no token.
    """

    access: Access
    port: int
    open_browser: bool


def serve(
    desk: Desk, selections: Selections, listening: Listening, ready: Callable[[str], None]
) -> None:
    """Serve the page, and the HTTP interface beside it, until the process is interrupted.

    Args:
        desk: scenes and record.
        selections: what answers `POST /select`.
        listening: where.
        ready: called with the page's address once it is served.

    Raises:
        StoreError: the address cannot be listened on.
    """
    access, limits = listening.access, UploadLimits()
    app = make_app(desk)
    app.include_router(select_router(selections))
    app.include_router(asks_router(Asks(selections, desk.record, desk.captures)))
    publish_schemas(app)
    held = _listen(access.host, listening.port)
    server = uvicorn.Server(
        uvicorn.Config(
            Guard(app, access, limits), timeout_graceful_shutdown=_GRACE_S, lifespan="on", **QUIET
        )
    )
    port = int(held.getsockname()[1])

    try:
        # The address is told within: whoever reads it may stop the server at once.
        with contextlib.closing(held), _stopped_by_signals():
            # The socket takes connections from here on; they are answered a moment later.
            ready(access.url(port, with_token=access.is_made))
            # An address stands in the list of processes: with a token no browser is opened here.
            if listening.open_browser and access.token is None:
                # In a thread of its own: a browser in a terminal would hold the server up.
                threading.Thread(
                    target=webbrowser.open, args=(access.url(port),), daemon=True
                ).start()
            server.run(sockets=[held])
    finally:
        selections.close()
        desk.close()


@contextlib.contextmanager
def _stopped_by_signals() -> Iterator[None]:
    """Within, Ctrl-C and SIGTERM end what is served, as its end and not as a fault."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    except KeyboardInterrupt:  # uvicorn raises the signal again when it has ended
        pass
    finally:
        signal.signal(signal.SIGTERM, before)


def _listen(host: str, port: int) -> socket.socket:
    """A socket that listens, refused in one line where the address is taken or not ours."""
    if not 0 <= port <= _LAST_PORT:  # else it would be taken modulo 65536
        raise StoreError(f"--port is {port}; valid: 0 to {_LAST_PORT}, 0 for any that is free")
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
        held = socket.socket(family, kind, protocol)
        held.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        held.bind(address)
        held.listen(128)
    except (OSError, OverflowError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise StoreError(
            f"{host} port {port}: {reason}; valid: another --port (0 takes any that is free)"
        ) from None
    return held
