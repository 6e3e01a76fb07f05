"""`POST /select`: a capture in, the answer of schema 2 out, for programs in any language."""

from __future__ import annotations

import asyncio
import logging
import threading
from collections import OrderedDict
from collections.abc import Awaitable, Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any, Final, TypeVar

from fastapi import APIRouter
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, Response

from boxgrasp.config import Config, load_config
from boxgrasp.errors import BoxgraspError, StoreError
from boxgrasp.labeling.server.openapi import UPLOAD, answers
from boxgrasp.labeling.server.security import UploadLimits
from boxgrasp.labeling.server.uploads import RequestError, Settings, Upload, read_upload
from boxgrasp.result import Selection
from boxgrasp.selector import GraspSelector
from boxgrasp.strict import plain

_AT_ONCE: Final = 2  # selections that run; each has threads of its own for its kernels
_IN_HAND: Final = 8  # requests whose bodies are held, running or waiting
_SENDING_S: Final = 60.0  # that a body may take to come, s: 64 MiB by a slow wireless network
_PREPARED: Final = 8  # selectors kept; one holds a ranker's models, a few MB
_log = logging.getLogger("boxgrasp.labeling")
_Answer = TypeVar("_Answer")


class Selections:
    """Answers uploads by worker threads, a bounded number at once."""

    def __init__(self, config: Config | None = None, limits: UploadLimits | None = None) -> None:
        """Start no thread yet.

        Args:
            config: what a request does not say otherwise; None for the defaults.
            limits: how much a request may hold; None for the defaults.
        """
        self.config = load_config(config)
        self.limits = limits or UploadLimits()
        self._workers = ThreadPoolExecutor(_AT_ONCE, "boxgrasp-select")
        self._prepared: OrderedDict[Settings, GraspSelector] = OrderedDict()
        self._lock = threading.Lock()
        self._in_hand = 0

    def close(self) -> None:
        """Let the threads end; what waits is not begun."""
        self._workers.shutdown(wait=False, cancel_futures=True)

    async def read(self, request: Request, more: tuple[str, ...] = ()) -> Upload:
        """Take a request's body.

        Args:
            request: whose body nobody has read.
            more: as `read_upload`.

        Returns:
            The upload.

        Raises:
            RequestError: as `read_upload`, and where the body takes too long to come.
        """
        try:
            return await asyncio.wait_for(read_upload(request, self.limits, more), _SENDING_S)
        except asyncio.TimeoutError:
            line = f"the body did not come within {_SENDING_S:.0f} s; valid: the whole of it"
            raise RequestError(408, line) from None

    @contextmanager
    def place(self) -> Iterator[None]:
        """A place among the requests whose bodies are held.

        Yields:
            Nothing.

        Raises:
            RequestError: none is free.
        """
        if self._in_hand >= _IN_HAND:
            raise RequestError(503, f"{_IN_HAND} captures are in hand; valid: try again later")
        self._in_hand += 1
        try:
            yield
        finally:
            self._in_hand -= 1

    async def run(self, work: Callable[[], _Answer]) -> _Answer:
        """Do something by a worker thread, so that other requests go on.

        Args:
            work: called there.

        Returns:
            What it returned.

        Raises:
            Exception: what it raised.
        """
        return await asyncio.get_running_loop().run_in_executor(self._workers, work)

    def answer(self, upload: Upload) -> Selection:
        """The answer to an upload; blocks.

        Args:
            upload: any.

        Returns:
            A grasp or a refusal.

        Raises:
            RequestError: unreadable, too large, or no answer is possible.
        """
        selector = self.selector(upload.settings())
        target, capture = upload.target(), upload.capture()
        try:
            return selector.select(capture, target)
        except BoxgraspError as error:
            raise RequestError(422, str(error)) from None

    def selector(self, settings: Settings) -> GraspSelector:
        """The selector that answers by such settings, kept for the next such request.

        Args:
            settings: what is wanted otherwise than the server's configuration.

        Returns:
            The selector.

        Raises:
            RequestError: unknown ranker or faces.
        """
        with self._lock:
            found = self._prepared.get(settings)
            if found is None:
                try:
                    found = GraspSelector(self._config(settings))
                except BoxgraspError as error:
                    raise RequestError(400, str(error)) from None
                self._prepared[settings] = found
            self._prepared.move_to_end(settings)
            if len(self._prepared) > _PREPARED:
                self._prepared.popitem(last=False)
            return found

    def _config(self, settings: Settings) -> Config:
        values: dict[str, Any] = plain(self.config)
        if settings.ranker is not None:
            values["ranker"] = settings.ranker
        if settings.faces is not None:
            values["candidates"]["faces"] = list(settings.faces)
        if settings.checked is not None:
            values["unchecked"] = not settings.checked
        return load_config(values)


def select_router(selections: Selections) -> APIRouter:
    """The route of `POST /select`.

    Args:
        selections: what answers.

    Returns:
        To be included in the app, at its root.
    """
    router = APIRouter(tags=["select"])

    @router.post(
        "/select",
        summary="Choose a grasp for the target of a capture, or ask for help",
        responses=answers(200, (400, 408, 413, 415, 422, 503)),
        openapi_extra=UPLOAD,
        response_class=Response,
    )
    async def select(request: Request) -> Response:
        async def work() -> Response:
            with selections.place():
                upload = await selections.read(request)
                selection = await selections.run(lambda: selections.answer(upload))
            return Response(selection.to_json(), media_type="application/json")

        return await in_one_line(work)

    return router


async def in_one_line(work: Callable[[], Awaitable[Response]]) -> Response:
    """The answer of a route; whatever goes wrong is one line.

    Args:
        work: called for the answer.

    Returns:
        Its answer, or an object with `error`.
    """
    try:
        return await work()
    except RequestError as error:
        status, line = error.status, error.line
    except ClientDisconnect:
        status, line = 400, "the body ended before its length; valid: the whole of it"
    except MemoryError:
        status, line = 413, "too large for the memory there is; valid: a smaller capture"
    except StoreError as error:  # a full disk; another try may do
        status, line = 503, str(error)
    except BoxgraspError as error:
        status, line = 422, str(error)
    except Exception as error:
        _log.exception("a request failed")
        status, line = 500, f"internal error: {type(error).__name__}; valid: tell who runs this"
    return JSONResponse({"error": " ".join(line.split())}, status)
