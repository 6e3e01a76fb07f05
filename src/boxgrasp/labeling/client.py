"""Asks the operators of a labeling server, for a robot that is stuck; needs no extra."""

from __future__ import annotations

import http.client
import ipaddress
import json
import math
import time
import urllib.error
import urllib.request
import uuid
from collections.abc import Mapping
from dataclasses import dataclass, replace
from io import BytesIO
from typing import Any, Final
from urllib.parse import urlencode, urlsplit

import numpy as np

from boxgrasp.errors import BoxgraspError, CodedWarning, ConfigError
from boxgrasp.io.npz import save_npz
from boxgrasp.perception.target import Target
from boxgrasp.result import BOX_WRONG, NOBODY_ANSWERED, PERSON, PERSON_WOULD_HELP, Selection
from boxgrasp.sensing.capture import Capture

TOKEN_VARIABLE: Final = "BOXGRASP_TOKEN"
ASSIST_FAILED: Final = "assist_failed"
MOST_SECONDS: Final = 3600.0
_CONNECT_S: Final = 10.0  # for an answer that a server gives at once
_WAIT_S: Final = 20.0  # that one request waits for a person
_AGAIN_S: Final = 1.0  # before the next try while the server is away or full
_MOST_BYTES: Final = 16 << 20  # of an answer; one of 5 x 100 candidates has 1 MB
_SAME_M: Final = 1e-6  # of poses that came as text


@dataclass(frozen=True)
class Assistance:
    """Who is asked, and for how long.

    Attributes:
        url: of the server, without a path.
        seconds: how long a person has, s.
        asker: who asks, as operators read it.
        token: that the server asks for; empty for none.
    """

    url: str
    seconds: float = 120.0
    asker: str = "a robot"
    token: str = ""

    def __post_init__(self) -> None:
        try:
            parts = urlsplit(self.url)
            parts.port  # noqa: B018 - raises for what is none
            whole = bool(parts.scheme in ("http", "https") and parts.hostname)
        except ValueError:
            whole = False
        if not whole or parts.path not in ("", "/") or parts.query or parts.username:
            raise ConfigError(
                f"--assist is {_without_query(self.url)!r:.60}; valid: http://HOST:PORT, the token "
                f"in {TOKEN_VARIABLE}"
            )
        if not (math.isfinite(self.seconds) and 1 <= self.seconds <= MOST_SECONDS):
            raise ConfigError(
                f"--assist-seconds is {self.seconds:g}; valid: 1 to {MOST_SECONDS:.0f}"
            )

    def __repr__(self) -> str:
        return f"Assistance({self.url!r}, {self.seconds:g} s)"


class AssistError(BoxgraspError):
    """No operator can be asked."""


@dataclass(frozen=True, eq=False)
class Stuck:
    """What a robot asks about.

    Attributes:
        capture: the view.
        target: what was pointed at; None for the capture's own.
        own: the robot's own answer.
        pregrasp_distance_m: of its configuration, m.
    """

    capture: Capture
    target: Target | None
    own: Selection
    pregrasp_distance_m: float


def ask_person(stuck: Stuck, assistance: Assistance) -> Selection:
    """The answer with an operator's help; without one the robot's own, and a warning.

    Args:
        stuck: what is asked about; an answer that is no `ask` comes back as it is.
        assistance: who is asked.

    Returns:
        A grasp of ranker `person`, or an `ask`: the person's, or the robot's own with warning
        `nobody_answered` or `assist_failed`.
    """
    if stuck.own.status != "ask":
        return stuck.own
    try:
        theirs = _Question(assistance).answer(stuck)
    except AssistError as error:
        return stuck.own.with_warnings(CodedWarning(ASSIST_FAILED, str(error)))
    if theirs is not None and theirs.grasp is not None:
        return stuck.own.taken(theirs.grasp.label, stuck.pregrasp_distance_m)
    if theirs is not None and theirs.refusal is not None:
        return stuck.own.asking(theirs.refusal.code, theirs.refusal.message)
    said = f"nobody answered within {assistance.seconds:.0f} s"
    return stuck.own.with_warnings(CodedWarning(NOBODY_ANSWERED, said))


class _Question:
    """One question, from sending the capture to its answer."""

    def __init__(self, assistance: Assistance) -> None:
        self._to = assistance
        self._id = str(uuid.uuid4())
        self._end = time.monotonic() + assistance.seconds
        host = urlsplit(assistance.url).hostname or ""
        handlers = [urllib.request.ProxyHandler({})] if _is_here(host) else []
        self._opener = urllib.request.build_opener(_NoRedirect, *handlers)

    def answer(self, stuck: Stuck) -> Selection | None:
        """A person's answer; None when the time ran out.

        Raises:
            AssistError: nobody can be asked.
        """
        try:
            self._put(stuck)
            return self._wait()
        except KeyboardInterrupt:
            self._withdraw()
            raise

    def _put(self, stuck: Stuck) -> None:
        """Put the capture into the queue.

        Raises:
            AssistError: the server takes none, or sees other candidates.
        """
        body, asked = _packed(stuck.capture, stuck.target)
        asked |= {"id": self._id, "seconds": f"{self._to.seconds:g}", "asker": self._to.asker}
        while True:
            try:
                status, found = self._request("POST", f"/ask?{urlencode(asked)}", body)
            except OSError as error:
                raise AssistError(
                    f"{self._to.url} cannot be asked ({_reason(error)}, {len(body)} bytes to send);"
                    " valid: a running `boxgrasp label` or `boxgrasp assist`"
                ) from None
            if status == 202:
                break
            if status != 503 or not self._pause():
                raise AssistError(_refused(self._to.url, status, found))
        theirs = _selection_of(found.get("selection"), self._to.url)
        if not _same_candidates(stuck.own, theirs):
            self._withdraw()
            raise AssistError(
                f"{self._to.url} sees other candidates or another gripper; valid: a server with "
                "the same --config and --gripper"
            )

    def _wait(self) -> Selection | None:
        """Wait for the answer, also over a restart of the server.

        Raises:
            AssistError: the server does not know the question.
        """
        while (left := self._end - time.monotonic()) > 0:
            status, found = self._look(min(left, _WAIT_S))
            if status == 200:
                return _of_person(_selection_of(found, self._to.url))
            if status in (400, 401, 403, 404, 421):
                raise AssistError(_refused(self._to.url, status, found))
            if status != 202:
                self._pause()
        self._withdraw()
        status, found = self._look(0.0)  # somebody may have answered at the last moment
        return _of_person(_selection_of(found, self._to.url)) if status == 200 else None

    def _look(self, wait: float) -> tuple[int, dict[str, Any]]:
        """Status and object of what is known of the question; 503 while nobody is there."""
        try:
            return self._request("GET", f"/ask/{self._id}?wait={wait:.3f}", None, wait)
        except OSError:
            return 503, {}

    def _pause(self) -> bool:
        """Wait before the next try; False where no time is left."""
        left = self._end - time.monotonic()
        time.sleep(max(0.0, min(left, _AGAIN_S)))
        return left > _AGAIN_S

    def _withdraw(self) -> None:
        """Spare the operators a question whose answer nobody waits for."""
        try:
            self._request("DELETE", f"/ask/{self._id}", None)
        except OSError:
            pass  # it ends by itself

    def _request(
        self, method: str, path: str, body: bytes | None, wait: float = 0.0
    ) -> tuple[int, dict[str, Any]]:
        """Status and object of an answer.

        Raises:
            OSError: there is none.
        """
        request = urllib.request.Request(self._to.url.rstrip("/") + path, body, method=method)
        if body is not None:
            request.add_header("Content-Type", "application/octet-stream")
        if self._to.token:
            request.add_header("Authorization", f"Bearer {self._to.token}")
        try:
            with self._opener.open(request, timeout=_CONNECT_S + wait) as answer:
                return int(answer.status), _object(answer.read(_MOST_BYTES))
        except urllib.error.HTTPError as error:
            with error:
                return int(error.code), _object(error.read(_MOST_BYTES))
        except http.client.HTTPException as error:
            raise OSError(f"no HTTP: {type(error).__name__}") from None


class _NoRedirect(urllib.request.HTTPRedirectHandler):
    """A token goes to the server that was named, and to no other."""

    def redirect_request(self, *_given: Any) -> None:
        return None


def _packed(capture: Capture, target: Target | None) -> tuple[bytes, dict[str, str]]:
    """The capture's bytes, and the target as parameters.

    Raises:
        AssistError: a cloud.
    """
    if capture.depth is None:
        raise AssistError("a cloud is not sent; valid: a capture with a depth image")
    asked: dict[str, str] = {}
    if target is not None and target.mask is not None:
        capture = replace(capture, mask=np.asarray(target.mask) != 0, target_pixel=None)
    elif target is not None:
        given: Mapping[str, Any] = {
            "pixel": target.pixel, "point": target.point, "box": target.box,
            "object": None if target.object is None else (target.object,),
        }  # fmt: skip
        asked = {
            name: ",".join(str(number) for number in value)
            for name, value in given.items()
            if value is not None
        }
    held = BytesIO()
    save_npz(capture, held)
    return held.getvalue(), asked


def _of_person(found: Selection) -> Selection | None:
    """The answer if it is a person's; None for the server's own."""
    by_person = found.ranker == PERSON if found.refusal is None else (
        found.refusal.code in (PERSON_WOULD_HELP, BOX_WRONG)
    )  # fmt: skip
    return found if by_person else None


def _same_candidates(own: Selection, theirs: Selection) -> bool:
    """Whether a label means the same to both."""
    mine, other = (
        np.array([item.T_base_gripper for item in said.candidates]) for said in (own, theirs)
    )
    return (
        own.gripper == theirs.gripper
        and mine.shape == other.shape
        and np.allclose(mine, other, rtol=0.0, atol=_SAME_M)
    )


def _selection_of(found: Any, url: str) -> Selection:
    """The answer in an object.

    Raises:
        AssistError: there is none of this version.
    """
    try:
        return Selection.from_json(json.dumps(found))
    except BoxgraspError as error:
        raise AssistError(f"{url} answers something else ({error}); valid: schema 2") from None


def _object(data: bytes) -> dict[str, Any]:
    try:
        found = json.loads(data)
    except (ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


def _refused(url: str, status: int, found: Mapping[str, Any]) -> str:
    said = found.get("error")
    line = " ".join(said.split())[:300] if isinstance(said, str) else "no labeling server"
    hint = f" (in {TOKEN_VARIABLE})" if status == 401 else ""
    return f"{url} refuses to ask: {line}{hint}"


def _reason(error: OSError) -> str:
    inner = getattr(error, "reason", error)
    return str(getattr(inner, "strerror", None) or inner or type(error).__name__)[:100]


def _is_here(host: str) -> bool:
    """Whether it is this machine, which no proxy leads to."""
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _without_query(url: str) -> str:
    """What may be shown of an address, which may name a token."""
    return url.partition("?")[0].rpartition("@")[2]
