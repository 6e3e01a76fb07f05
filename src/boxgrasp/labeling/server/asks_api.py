"""`POST /ask` and `GET /ask/ID`: a robot that is stuck puts a capture before the operators.

A question lives in the record, so that it and its answer outlive the server.
"""

from __future__ import annotations

import asyncio
import math
import time
import uuid
from dataclasses import dataclass
from datetime import datetime, timedelta, timezone
from typing import Annotated, Any, Final

from fastapi import APIRouter, Query
from starlette.requests import Request
from starlette.responses import JSONResponse, Response

from boxgrasp.errors import BoxgraspError
from boxgrasp.labeling.asks import ASKS, answered, asked_target, unanswered
from boxgrasp.labeling.captures import CaptureStore
from boxgrasp.labeling.record import Record
from boxgrasp.labeling.server.openapi import answers, upload
from boxgrasp.labeling.server.select_api import Selections, in_one_line
from boxgrasp.labeling.server.uploads import RequestError, Upload
from boxgrasp.labeling.sources import capture_scene
from boxgrasp.labeling.words import Ask
from boxgrasp.result import Selection

_MOST_WAIT_S: Final = 60.0  # that may be asked for
_MORE: Final = {
    "seconds": ("how long the answer is of use; default 120", "120"),
    "asker": ("who asks, as operators read it", "arm 3"),
    "id": ("a UUID; the same request with the same one asks once", str(uuid.UUID(int=0))),
}


@dataclass(frozen=True)
class AskLimits:
    """How much may be asked.

    Attributes:
        open_asks: questions that wait at once; a person answers some hundred an hour.
        most_seconds: that a robot may wait, s.
        seconds: that it waits unless it says otherwise, s.
        longest_asker: characters of who asks.
        wait_s: longest that one request waits, s; proxies give up after 30 or 60.
        look_s: between two looks into the record, s; a person does not notice it.
    """

    open_asks: int = 100
    most_seconds: float = 3600.0
    seconds: float = 120.0
    longest_asker: int = 80
    wait_s: float = 25.0
    look_s: float = 0.2


class Asks:
    """The questions of a record, asked and answered by HTTP."""

    def __init__(
        self,
        selections: Selections,
        record: Record,
        captures: CaptureStore,
        limits: AskLimits | None = None,
    ) -> None:
        """Hold what questions need.

        Args:
            selections: what gives the robot's own answer.
            record: where questions live.
            captures: where their captures are kept.
            limits: how much may be asked; None for the defaults.
        """
        self.record = record
        self.captures = captures
        self.selections = selections
        self.limits = limits or AskLimits()

    def add(self, given: Upload) -> Ask:
        """Put a question into the queue; blocks.

        Args:
            given: the request.

        Returns:
            The question, as it is kept.

        Raises:
            RequestError: unreadable, no answer possible, or the queue is full.
        """
        ask_id, seconds, asker = self._id(given), self._seconds(given), self._asker(given)
        selector = self.selections.selector(given.settings())
        target, capture = given.target(), given.capture()
        try:
            own = selector.select(capture, target)
            told = asked_target(capture, target, selector)
        except BoxgraspError as error:
            raise RequestError(422, str(error)) from None
        sha256 = self.captures.add(capture)
        scene = capture_scene(sha256, told, f"asked by {asker}", selector.config)
        known = self.record.ask(ask_id)
        if known is not None:
            if known.scene_key != scene.key:
                raise RequestError(409, f"ask {ask_id} is of another capture; valid: a new id")
            return known
        now = datetime.now(timezone.utc)
        if len(self.record.open_asks(now)) >= self.limits.open_asks:
            raise RequestError(503, f"{self.limits.open_asks} asks wait; valid: try again later")
        until = now + timedelta(seconds=seconds)
        ask = Ask(ask_id, scene.key, now, until, asker, own.to_json())
        self.record.add_scenes(ASKS, [scene])
        self.record.add_ask(ask)
        return ask

    def look(self, ask_id: str) -> Selection | Ask:
        """Whether a question has its answer; blocks.

        Args:
            ask_id: of the question.

        Returns:
            The answer, also where the time ran out; else the question.

        Raises:
            RequestError: no such question.
        """
        ask = self.record.ask(ask_id)
        if ask is None:
            raise RequestError(404, f"no ask {ask_id!r:.60}; valid: the id that POST /ask gave")
        label = self.record.answer_of(ask_id)
        if label is not None:
            own, config = Selection.from_json(ask.selection), self.selections.config
            return answered(own, label, config.checks.pregrasp_distance_m)
        now = datetime.now(timezone.utc)
        if now < ask.expires_at:
            return ask
        seconds = (ask.expires_at - ask.asked_at).total_seconds()
        return unanswered(Selection.from_json(ask.selection), seconds)

    def withdraw(self, ask_id: str) -> None:
        """Take a question back; blocks.

        Args:
            ask_id: of the question.

        Raises:
            RequestError: no such question.
        """
        self.look(ask_id)
        self.record.withdraw_ask(ask_id)

    def _id(self, given: Upload) -> str:
        text = given.text("id")
        try:
            return str(uuid.UUID(text)) if text else str(uuid.uuid4())
        except ValueError:
            raise RequestError(400, f"id is {text!r:.60}; valid: a UUID") from None

    def _seconds(self, given: Upload) -> float:
        text, most = given.text("seconds"), self.limits.most_seconds
        try:
            seconds = float(text) if text else self.limits.seconds
        except ValueError:
            seconds = math.nan
        if not 1 <= seconds <= most:
            raise RequestError(400, f"seconds is {text!r:.40}; valid: 1 to {most:.0f}")
        return seconds

    def _asker(self, given: Upload) -> str:
        text = given.text("asker") or "a program"
        if len(text) > self.limits.longest_asker or not text.isprintable():
            valid = f"at most {self.limits.longest_asker} characters on one line"
            raise RequestError(400, f"asker is {text!r:.60}; valid: {valid}")
        return text


def asks_router(asks: Asks) -> APIRouter:
    """The routes of questions.

    Args:
        asks: what keeps them.

    Returns:
        To be included in the app, at its root.
    """
    router = APIRouter(tags=["ask"])
    _add_post(router, asks)
    _add_get(router, asks)
    _add_delete(router, asks)
    return router


def _add_post(router: APIRouter, asks: Asks) -> None:
    @router.post(
        "/ask",
        status_code=202,
        summary="Put a capture before the operators",
        responses=answers(202, (400, 408, 409, 413, 415, 422, 503), "Asked"),
        openapi_extra=upload(_MORE),
        response_class=Response,
    )
    async def add(request: Request) -> Response:
        async def work() -> Response:
            with asks.selections.place():
                given = await asks.selections.read(request, tuple(_MORE))
                ask = await asks.selections.run(lambda: asks.add(given))
            return JSONResponse(_told(ask, whole=True), 202)

        return await in_one_line(work)


def _add_get(router: APIRouter, asks: Asks) -> None:
    @router.get(
        "/ask/{ask_id}",
        summary="The answer of an operator, or 202 while there is none",
        responses=answers(200, (400, 404, 422)) | answers(202, (), "Asked"),
        response_class=Response,
    )
    async def look(
        ask_id: str,
        wait: Annotated[str, Query(description="seconds to wait for it, 0 to 60")] = "0",
    ) -> Response:
        async def work() -> Response:
            end = time.monotonic() + min(_wait_of(wait), asks.limits.wait_s)
            while True:
                found = await asyncio.to_thread(lambda: asks.look(ask_id))
                if isinstance(found, Selection):
                    return Response(found.to_json(), media_type="application/json")
                left = end - time.monotonic()
                if left <= 0:
                    return JSONResponse(_told(found), 202)
                await asyncio.sleep(min(left, asks.limits.look_s))

        return await in_one_line(work)


def _add_delete(router: APIRouter, asks: Asks) -> None:
    @router.delete(
        "/ask/{ask_id}",
        status_code=204,
        summary="Take a question back",
        responses=answers(None, (404, 422)),
        response_class=Response,
    )
    async def withdraw(ask_id: str) -> Response:
        async def work() -> Response:
            await asyncio.to_thread(lambda: asks.withdraw(ask_id))
            return Response(status_code=204)

        return await in_one_line(work)


def _wait_of(text: str) -> float:
    """Seconds that a request waits.

    Raises:
        RequestError: no such number.
    """
    try:
        wait = float(text)
    except ValueError:
        wait = math.nan
    if not 0 <= wait <= _MOST_WAIT_S:
        raise RequestError(400, f"wait is {text!r:.40}; valid: 0 to {_MOST_WAIT_S:.0f}")
    return wait


def _told(ask: Ask, *, whole: bool = False) -> dict[str, Any]:
    """A question as JSON."""
    left = (ask.expires_at - datetime.now(timezone.utc)).total_seconds()
    told: dict[str, Any] = {"id": ask.id, "seconds_left": max(0.0, round(left, 3))}
    if whole:
        told["selection"] = Selection.from_json(ask.selection).to_dict()
    return told
