"""The page and what it asks for, as one ASGI app."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Annotated, Any, Final

from fastapi import APIRouter, FastAPI, Query, Request, WebSocket
from fastapi.responses import FileResponse, JSONResponse, Response, StreamingResponse
from pydantic import BaseModel, ConfigDict, Field

from boxgrasp.errors import BoxgraspError
from boxgrasp.labeling.server.desk import Desk
from boxgrasp.labeling.server.learn_api import learn_router
from boxgrasp.labeling.server.passing import client_page, pass_through
from boxgrasp.labeling.server.session import LONGEST_NOTE, Said, Session, StaleError
from boxgrasp.labeling.server.sessions import Sessions, UnknownSessionError
from boxgrasp.version import __version__

PAGE: Final = Path(__file__).parent / "page"
_PAGE_FILES: Final = ("page.css", "page.js", "curve.js")
_BEAT_S: Final = 2.0  # between looks for the robot's questions, and signs of life to the browser
_RENEW_S: Final = 30.0  # between renewals of the operator's hold on a scene


class _Words(BaseModel):
    model_config = ConfigDict(extra="forbid")


class _Begin(_Words):
    operator: str = Field(max_length=200)


class _Of(_Words):
    session: str = Field(max_length=64)


class _Choose(_Of):
    serial: int
    face: int | None = None
    label: int | None = None


class _Switch(_Of):
    on: bool


class _Jump(_Of):
    number: int


class _Save(_Of):
    label_id: str = Field(pattern=r"^[0-9a-f]{8}(-[0-9a-f]{4}){3}-[0-9a-f]{12}$")
    scene_key: str = Field(max_length=120)
    verdict: str = Field(pattern="^(candidate|none|box_wrong)$")
    label: int | None = None
    note: str = Field("", max_length=LONGEST_NOTE)
    pixel: tuple[int, int] | None = None


def make_app(desk: Desk) -> FastAPI:
    """The app of a desk, without the token that guards it.

    Args:
        desk: scenes and record.

    Returns:
        An ASGI app.
    """
    sessions = Sessions(desk)

    @contextlib.asynccontextmanager
    async def lifespan(_app: FastAPI) -> AsyncIterator[None]:
        yield
        await asyncio.to_thread(sessions.close)

    app = FastAPI(
        title="boxgrasp",
        version=__version__,
        description="Select a grasp, or have a person asked.",
        docs_url=None,
        redoc_url=None,
        lifespan=lifespan,
    )
    app.state.sessions = sessions
    for router in (_page_router, _label_router, _step_router, _look_router, learn_router):
        app.include_router(router(sessions))
    for kind, status in ((UnknownSessionError, 404), (StaleError, 409), (BoxgraspError, 422)):
        app.add_exception_handler(kind, _refusal(status))
    return app


def _refusal(status: int) -> Any:
    async def refuse(_request: Request, error: Exception) -> JSONResponse:
        return JSONResponse({"error": " ".join(str(error).split())}, status)

    return refuse


def _page_router(sessions: Sessions) -> APIRouter:
    """The page's own files, and the view in it."""
    router = APIRouter(include_in_schema=False)
    client = client_page()

    @router.get("/")
    def page() -> FileResponse:
        return FileResponse(PAGE / "index.html", headers={"Cache-Control": "no-store"})

    @router.get("/page/{name}")
    def file(name: str) -> Response:
        if name not in _PAGE_FILES:
            return JSONResponse({"error": f"no file {name}"}, 404)
        return FileResponse(PAGE / name, headers={"Cache-Control": "no-store"})

    @router.get("/view/{session}/")
    def view(session: str) -> Response:
        sessions.get(session)
        return Response(client, media_type="text/html")

    @router.websocket("/view/{session}")
    async def view_socket(browser: WebSocket, session: str) -> None:
        try:
            port = sessions.get(session).view.port
        except UnknownSessionError:
            await browser.close(1008)
            return
        await pass_through(browser, port)

    @router.get("/api/image")
    def image(session: Annotated[str, Query(max_length=64)]) -> Response:
        found = sessions.get(session).image
        if found is None:
            return JSONResponse({"error": "no scene is shown"}, 404)
        return Response(found, media_type="image/jpeg", headers={"Cache-Control": "no-store"})

    @router.get("/api/events")
    async def events(session: Annotated[str, Query(max_length=64)]) -> StreamingResponse:
        found = await asyncio.to_thread(sessions.get, session)
        return StreamingResponse(
            _events(sessions, found),
            media_type="text/event-stream",
            headers={"Cache-Control": "no-store", "X-Accel-Buffering": "no"},
        )

    return router


async def _events(sessions: Sessions, session: Session) -> AsyncIterator[str]:
    """Server-sent events: `state` and `choice` when something changed, `asks` with their number."""
    loop, waiting = asyncio.get_running_loop(), asyncio.Queue[str]()

    def told(what: str) -> None:
        loop.call_soon_threadsafe(waiting.put_nowait, what)

    stop = session.listen(told)
    asks, renewed = -1, loop.time()
    try:
        while True:
            with contextlib.suppress(asyncio.TimeoutError):
                what = await asyncio.wait_for(waiting.get(), _BEAT_S)
                held = session.choice() if what == "choice" else {}
                yield f"event: {what}\ndata: {json.dumps(held)}\n\n"
                continue
            await asyncio.to_thread(sessions.get, session.id)
            found = await asyncio.to_thread(session.waiting_asks)
            if found != asks:
                asks = found
                yield f"event: asks\ndata: {asks}\n\n"
            if loop.time() - renewed > _RENEW_S:
                renewed = loop.time()
                await asyncio.to_thread(session.keep)
            yield ": still here\n\n"
    except BoxgraspError:
        return  # the session ended, or the record cannot be read: the page asks for its state
    finally:
        stop()


def _label_router(sessions: Sessions) -> APIRouter:
    """What the operator says, and what is known of it."""
    router = APIRouter(prefix="/api", include_in_schema=False)

    @router.get("/start")
    def start() -> dict[str, Any]:
        desk = sessions.desk
        return {"operator": desk.rules.operator, "source": desk.source, "mode": desk.rules.mode}

    @router.post("/session")
    def begin(words: _Begin) -> dict[str, Any]:
        return sessions.of(words.operator).state()

    @router.get("/state")
    def state(session: Annotated[str, Query(max_length=64)]) -> dict[str, Any]:
        return sessions.get(session).state()

    @router.post("/save")
    def save(words: _Save) -> dict[str, Any]:
        session = sessions.get(words.session)
        said = words.model_dump(exclude={"session"})
        session.save(Said(**said))
        return session.state()

    @router.get("/agreements")
    def agreements(session: Annotated[str, Query(max_length=64)]) -> list[dict[str, Any]]:
        sessions.get(session)
        record, source = sessions.desk.record, sessions.desk.source
        return [vars(item) for item in record.agreements(source)]

    return router


def _step_router(sessions: Sessions) -> APIRouter:
    """From one scene to another."""
    router = APIRouter(prefix="/api", include_in_schema=False)
    steps: dict[str, Callable[[Session], None]] = {
        "skip": Session.skip,
        "skipped": Session.return_to_skipped,
        "undo": Session.undo,
        "back": lambda session: session.back(-1),
        "forward": lambda session: session.back(1),
        "ask": Session.answer_ask,
    }
    for name, step in steps.items():
        router.add_api_route(f"/{name}", _stepping(sessions, step), methods=["POST"])

    @router.post("/jump")
    def jump(words: _Jump) -> dict[str, Any]:
        return _stepping(sessions, lambda session: session.jump(words.number))(words)

    return router


def _stepping(
    sessions: Sessions, step: Callable[[Session], None]
) -> Callable[[_Of], dict[str, Any]]:
    """A route that takes a step, and answers with the state after it."""

    def take(words: _Of) -> dict[str, Any]:
        session = sessions.get(words.session)
        step(session)
        return session.state()

    return take


def _look_router(sessions: Sessions) -> APIRouter:
    """What the operator looks at and points to."""
    router = APIRouter(prefix="/api", include_in_schema=False)

    @router.post("/choose")
    def choose(words: _Choose) -> dict[str, Any]:
        session = sessions.get(words.session)
        session.choose_in(words.serial, words.face, words.label)
        return session.choice()

    @router.post("/reveal")
    def reveal(words: _Switch) -> dict[str, Any]:
        session = sessions.get(words.session)
        session.reveal(on=words.on)
        return session.state()

    @router.post("/pick")
    def pick(words: _Switch) -> dict[str, Any]:
        session = sessions.get(words.session)
        session.pick(on=words.on)
        return session.choice()

    @router.post("/camera")
    def camera(words: _Of) -> dict[str, Any]:
        session = sessions.get(words.session)
        session.view.reset_camera()
        return session.choice()

    return router
