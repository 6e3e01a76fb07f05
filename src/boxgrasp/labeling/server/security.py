"""Who may talk to the server, from where, and how much: one layer round the whole app.

On a loopback address anybody on this machine may, but no web page of another site: the Host header
must name this machine (else a site whose name is pointed at 127.0.0.1 could read along) and an
Origin, where a browser sends one, must be our own. On any other address everybody needs the token.
"""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import html
import ipaddress
import json
import re
import secrets
import socket
from collections.abc import Awaitable, Callable, Mapping, MutableMapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final
from urllib.parse import parse_qsl, quote, urlencode, urlsplit

from boxgrasp.errors import ConfigError
from boxgrasp.labeling.client import TOKEN_VARIABLE

Scope = MutableMapping[str, Any]
Message = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]

COOKIE: Final = "boxgrasp_token"
# For uvicorn: its logs of requests and of WebSockets would hold `?token=...`; and no header of a
# client is believed about where it comes from.
QUIET: Final[Mapping[str, Any]] = {
    "access_log": False,
    "log_level": "warning",
    "server_header": False,
    "proxy_headers": False,
}
_TOKEN: Final = re.compile(r"[A-Za-z0-9._~-]{16,200}")  # fits a header, a cookie and a URL as it is
_VALID_TOKEN: Final = "valid: 16 to 200 letters, digits, '-', '_', '.' or '~'"
_NAMES_OF_LOOPBACK: Final = frozenset(("localhost", "127.0.0.1", "[::1]"))
_READING: Final = ("GET", "HEAD", "OPTIONS")  # methods that change nothing
_POLICY_VIOLATION: Final = 1008  # of WebSockets; before one opens, the server answers 403
_DRAINING_S: Final = 10.0  # that the rest of a refused body may take
_PORTS: Final = {"http": 80, "https": 443}  # where an address names none
_VIEW: Final = "/view/"  # the 3D client, a page of viser that is not ours

_HEADERS: Final = {
    "x-content-type-options": "nosniff",
    "x-frame-options": "SAMEORIGIN",
    "referrer-policy": "no-referrer",
    "cross-origin-resource-policy": "same-origin",
}
_OWN_POLICY: Final = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; "
    "font-src 'self'; connect-src 'self'; frame-src 'self'; worker-src 'self'; base-uri 'none'; "
    "form-action 'self'; frame-ancestors 'self'"
)
# Its script stands in the page, and it unpacks with WebAssembly in workers made from blobs.
_VIEW_POLICY: Final = (
    "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval' blob:; "
    "style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; font-src 'self' data:; "
    "connect-src 'self' data: blob:; worker-src 'self' blob:; object-src 'none'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'self'"
)


@dataclass(frozen=True)
class UploadLimits:
    """How much one request may hold.

    Attributes:
        body_bytes: of the whole body. A 1280 x 720 view with color takes some 5 MB; 64 MiB hold
            one of 12 megapixels as it comes, and a few at once fit every machine's memory.
        parts: of a multipart body, files and fields each; a request has 13 names.
        field_bytes: of one field that is no file; a pose takes a few hundred.
        pixels: of the depth image; selecting takes about 100 bytes a pixel.
        unpacked_bytes: of all the arrays of an .npz together; float64 depth and color of as many
            pixels fit.
    """

    body_bytes: int = 64 << 20
    parts: int = 24
    field_bytes: int = 1 << 16
    pixels: int = 1 << 24
    unpacked_bytes: int = 1 << 28


@dataclass(frozen=True)
class Access:
    """Where the server listens, and what it asks of whoever comes.

    Attributes:
        host: address or name.
        token: that everybody needs; None where none is asked for.
        is_loopback: whether only this machine reaches it.
        is_made: whether the token was made here, so that it must be told.
    """

    host: str
    token: str | None
    is_loopback: bool
    is_made: bool = False

    def url(self, port: int, *, with_token: bool = True) -> str:
        """The page's address.

        Args:
            port: where it listens.
            with_token: whether to name the token, for the one line that tells it.

        Returns:
            `http://host:port/`, for an address that stands for all of them with this machine's
            name.
        """
        host = socket.gethostname() if self.host in ("0.0.0.0", "::", "") else self.host
        host = f"[{host}]" if ":" in host else host
        asked = f"?token={quote(self.token)}" if self.token and with_token else ""
        return f"http://{host}:{port}/{asked}"

    def __repr__(self) -> str:
        told = "no token" if self.token is None else "with a token"
        return f"Access({self.host!r}, {told})"


def access_of(
    host: str, token_file: str | None = None, environment: Mapping[str, str] | None = None
) -> Access:
    """The rule of --host: a loopback address needs no token, every other one has one.

    Args:
        host: address or name to listen on.
        token_file: path of a file that holds the token; None for the environment's, if any. A
            token is no option, since every user of the machine sees a command line.
        environment: the process's, where `BOXGRASP_TOKEN` may be.

    Returns:
        What to ask of whoever comes; with a token that is made here where none is given.

    Raises:
        ConfigError: no host, or a token that is missing from its file, too short or of other
            characters.
    """
    if not host or re.search(r"[\s/?#@]", host):
        raise ConfigError(f"--host is {host!r:.60}; valid: an address or a name, as 127.0.0.1")
    host = host[1:-1] if host[:1] == "[" and host[-1:] == "]" else host
    is_loopback = _is_loopback(host)
    token = _given_token(token_file, environment or {})
    if token is None and not is_loopback:
        return Access(host, secrets.token_urlsafe(32), is_loopback, is_made=True)
    return Access(host, token, is_loopback)


def _is_loopback(host: str) -> bool:
    """Whether it can be reached from this machine alone; a name that may be anywhere is not."""
    if host.lower() == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _given_token(token_file: str | None, environment: Mapping[str, str]) -> str | None:
    """The token, never told in a message.

    Raises:
        ConfigError: it cannot be read, or is no token.
    """
    if token_file is None:
        place, token = TOKEN_VARIABLE, environment.get(TOKEN_VARIABLE, "")
        if not token:
            return None
    else:
        place = f"--token-file {token_file}"
        try:
            token = Path(token_file).read_text("utf-8").strip()
        except (OSError, ValueError) as error:
            what = getattr(error, "strerror", None) or "is no text"
            raise ConfigError(f"{place}: {what}; valid: a file that holds a token") from None
    if not _TOKEN.fullmatch(token):
        raise ConfigError(
            f"{place} holds {len(token)} characters that are no token; {_VALID_TOKEN}"
        )
    return token


class Guard:
    """The layer: every HTTP request and WebSocket passes it before the app sees it."""

    def __init__(self, app: App, access: Access, limits: UploadLimits | None = None) -> None:
        """Stand before an app.

        Args:
            app: of ASGI.
            access: what is asked of whoever comes.
            limits: how much one request may hold; None for the defaults.
        """
        self._app = app
        self._access = access
        self._most_bytes = (limits or UploadLimits()).body_bytes

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One request, as ASGI has it.

        Args:
            scope: of the request.
            receive: gives its messages.
            send: takes the answer's.
        """
        if scope["type"] not in ("http", "websocket"):
            return await self._app(scope, receive, send)
        headers = _headers(scope)
        refused = self._refusal(scope, headers)
        if scope["type"] == "websocket":
            if refused is None:
                return await self._app(scope, receive, send)
            await receive()
            return await send({"type": "websocket.close", "code": _POLICY_VIOLATION})
        bounded = _Bounded(receive, _with_headers(send, str(scope["path"])), self._most_bytes)
        bounded.is_whole = not _has_body(headers)
        if refused is not None:
            return await _answer(bounded.send, headers, *refused)
        if (place := self._without_token(scope)) is not None:
            return await _enter(bounded.send, place, str(self._access.token))
        await self._within_limit(scope, headers, bounded)

    def _refusal(self, scope: Scope, headers: Mapping[str, str]) -> tuple[int, str] | None:
        """Status and line for whoever may not come in; None for who may."""
        host = headers.get("host", "")
        if self._access.is_loopback and _name_of(host) not in _NAMES_OF_LOOPBACK:
            return 421, f"Host is {host!r:.60}; valid: localhost, 127.0.0.1 or [::1]"
        changes = scope["type"] == "websocket" or scope["method"] not in _READING
        origin = headers.get("origin")
        if changes and origin is not None and not _is_same(origin, host):
            return 403, f"Origin is {origin!r:.60}; valid: this server's own page, or none"
        token = self._access.token
        if token is not None and not any(
            hmac.compare_digest(given.encode(), token.encode()) for given in _given(scope, headers)
        ):
            return 401, (
                "token is missing or wrong; valid: the one that the server was started with, as "
                f"?token=... in the page's address or as 'Authorization: Bearer ...' "
                f"({TOKEN_VARIABLE})"
            )
        return None

    def _without_token(self, scope: Scope) -> str | None:
        """The address without its token, for a page that was opened with one."""
        if self._access.token is None or scope["method"] != "GET":
            return None
        asked = parse_qsl(scope["query_string"].decode("latin-1"), keep_blank_values=True)
        kept = [(name, value) for name, value in asked if name != "token"]
        if len(kept) == len(asked):
            return None
        # One slash in front: two would name another server.
        path = "/" + quote(str(scope["path"]).lstrip("/\\"))
        return path + (f"?{urlencode(kept)}" if kept else "")

    async def _within_limit(
        self, scope: Scope, headers: Mapping[str, str], bounded: _Bounded
    ) -> None:
        """Let the app answer a request whose body stays within the limit, else refuse it."""
        told = headers.get("content-length", "0")
        if not (told.isascii() and told.isdigit()):
            line = f"Content-Length is {told!r:.40}; valid: bytes"
            return await _answer(bounded.send, headers, 400, line)
        if int(told[:20]) > self._most_bytes:
            line = self._too_large(f"{int(told[:20])} bytes")
            return await _answer(bounded.send, headers, 413, line)
        try:
            await self._app(scope, bounded.receive, bounded.send_of_app)
        except _TooLargeError:
            pass
        if bounded.is_over and not bounded.has_started:
            line = self._too_large(f"more than {self._most_bytes} bytes")
            await _answer(bounded.send, headers, 413, line)

    def _too_large(self, found: str) -> str:
        return f"upload has {found}; valid: at most {self._most_bytes} bytes"


class _TooLargeError(Exception):
    """A body grew beyond the limit while it came."""


class _Bounded:
    """One request's messages: counts what comes, and takes all of it before an answer goes.

    Who sends first and reads then would find the connection closed, in place of the answer.
    """

    def __init__(self, receive: Receive, send: Send, most_bytes: int) -> None:
        self._receive, self._send, self._most_bytes = receive, send, most_bytes
        self._left = most_bytes
        self.is_whole = self.has_started = False

    @property
    def is_over(self) -> bool:
        """Whether more came than is allowed."""
        return self._left < 0

    async def receive(self) -> Message:
        """The next message; an error beyond the limit."""
        message = await self._receive()
        self.is_whole = not message.get("more_body", False)
        self._left -= len(message.get("body", b""))
        if self.is_over:
            raise _TooLargeError
        return message

    async def send_of_app(self, message: Message) -> None:
        """Send what the app answers, unless its request is too large."""
        if not self.is_over or self.has_started:
            await self.send(message)

    async def send(self, message: Message) -> None:
        """Send an answer."""
        if not self.has_started:
            self.has_started = True
            with contextlib.suppress(asyncio.TimeoutError):
                await asyncio.wait_for(self._drain(), _DRAINING_S)
        await self._send(message)

    async def _drain(self) -> None:
        """Take and drop what still comes, up to twice as much as is allowed."""
        left = 2 * self._most_bytes
        while not self.is_whole and left > 0:
            message = await self._receive()
            self.is_whole = not message.get("more_body", False)
            left -= len(message.get("body", b""))


def _headers(scope: Scope) -> dict[str, str]:
    return {name.decode("latin-1"): value.decode("latin-1") for name, value in scope["headers"]}


def _has_body(headers: Mapping[str, str]) -> bool:
    return headers.get("content-length", "0") != "0" or "transfer-encoding" in headers


def _name_of(host: str) -> str:
    """Of a Host header, without its port; nothing for one that is none."""
    found = re.fullmatch(r"(\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9._-]+)(?::[0-9]+)?", host)
    return found[1].lower() if found else ""


def _is_same(origin: str, host: str) -> bool:
    """Whether an Origin is that of this server, whether or not something before it speaks TLS."""
    try:
        parts = urlsplit(origin)
        usual = _PORTS[parts.scheme]
        own = urlsplit(f"{parts.scheme}://{host}")
        return (parts.hostname, parts.port or usual) == (own.hostname, own.port or usual)
    except (KeyError, ValueError):
        return False


def _given(scope: Scope, headers: Mapping[str, str]) -> list[str]:
    """Every token that a request brings."""
    found = []
    kind, _, value = headers.get("authorization", "").partition(" ")
    if kind.lower() == "bearer":
        found.append(value.strip())
    # The standard library's reader stops at the first odd cookie, which may be another program's.
    for part in headers.get("cookie", "").split(";"):
        name, _, value = part.strip().partition("=")
        if name == COOKIE:
            found.append(value)
    if scope["type"] == "http" and scope["method"] == "GET":
        asked = parse_qsl(scope["query_string"].decode("latin-1"))
        found += [value for name, value in asked if name == "token"]
    return found


def _with_headers(send: Send, path: str) -> Send:
    """The same, with what a browser must know of every answer."""
    policy = _VIEW_POLICY if path.startswith(_VIEW) else _OWN_POLICY
    ours = {**_HEADERS, "content-security-policy": policy}

    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            names = {name.lower() for name, _ in message.get("headers", ())}
            kept = [
                pair for pair in message.get("headers", ()) if pair[0].lower().decode() not in ours
            ]
            added = [(name.encode(), value.encode()) for name, value in ours.items()]
            if b"cache-control" not in names:
                added.append((b"cache-control", b"no-store"))
            message = {**message, "headers": [*kept, *added]}
        await send(message)

    return sending


async def _answer(send: Send, headers: Mapping[str, str], status: int, line: str) -> None:
    """One line: JSON for a program, a small page for a person."""
    if "text/html" in headers.get("accept", ""):
        kind = "text/html; charset=utf-8"
        # A browser leaves the cookie out where another site's link led here; our own link sends it.
        body = (
            f'<!doctype html><html lang="en"><title>boxgrasp: {status}</title>'
            f'<p>{html.escape(line)}</p><p><a href="">Open again</a></p></html>'
        )
    else:
        kind, body = "application/json", json.dumps({"error": line})
    more = [(b"content-type", kind.encode())]
    if status == 401:
        more.append((b"www-authenticate", b"Bearer"))
    if status in (400, 413):
        more.append((b"connection", b"close"))  # the rest of the body is not read
    await _respond(send, status, more, body.encode())


async def _enter(send: Send, place: str, token: str) -> None:
    """Keep the token in a cookie and leave the address that names it."""
    cookie = f"{COOKIE}={token}; HttpOnly; SameSite=Strict; Path=/"
    more = [(b"location", place.encode("latin-1")), (b"set-cookie", cookie.encode())]
    await _respond(send, 303, more, b"")


async def _respond(
    send: Send, status: int, headers: list[tuple[bytes, bytes]], body: bytes
) -> None:
    length = (b"content-length", str(len(body)).encode())
    start = {"type": "http.response.start", "status": status, "headers": [*headers, length]}
    await send(start)
    await send({"type": "http.response.body", "body": body})
