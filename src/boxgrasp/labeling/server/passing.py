"""Passes a browser's view through to the viser server of its operator."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Final

import websockets.asyncio.client
import websockets.exceptions
from starlette.websockets import WebSocket, WebSocketDisconnect

from boxgrasp.labeling.server.view import LOOPBACK

# Its panel has no control of ours, and its notices would cover the cloud.
_WITHOUT_PANEL: Final = (
    b"<style>.mantine-Paper-root, .mantine-Notifications-root { display: none !important }</style>"
)
_LARGEST: Final = 64 * 2**20  # bytes of a message: a cloud of 50,000 points has 0.8 MB


def client_page() -> bytes:
    """The viser client, a page that holds all it needs, with its own panel hidden.

    Returns:
        HTML.
    """
    import viser

    page = (Path(viser.__file__).parent / "client" / "build" / "index.html").read_bytes()
    return page.replace(b"</head>", _WITHOUT_PANEL + b"</head>", 1)


async def pass_through(browser: WebSocket, port: int) -> None:
    """Pass a WebSocket on, both ways, until one side closes it.

    Args:
        browser: not accepted yet.
        port: of the viser server, on the loopback.
    """
    try:
        server = await websockets.asyncio.client.connect(
            f"ws://{LOOPBACK}:{port}",
            subprotocols=[websockets.Subprotocol(name) for name in browser.scope["subprotocols"]],
            compression=None,
            max_size=_LARGEST,
            proxy=None,
        )
    except (OSError, websockets.exceptions.InvalidHandshake):
        await browser.close(1011)
        return
    await browser.accept(subprotocol=server.subprotocol)
    tasks = [
        asyncio.create_task(_to_server(browser, server)),
        asyncio.create_task(_to_browser(browser, server)),
    ]
    try:
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        await server.close()


async def _to_server(
    browser: WebSocket, server: websockets.asyncio.client.ClientConnection
) -> None:
    while True:
        try:
            message = await browser.receive()
        except (WebSocketDisconnect, RuntimeError):
            return
        if message["type"] != "websocket.receive":
            return
        held = message.get("bytes")
        await server.send(held if held is not None else message["text"])


async def _to_browser(
    browser: WebSocket, server: websockets.asyncio.client.ClientConnection
) -> None:
    async for message in server:
        if isinstance(message, str):
            await browser.send_text(message)
        else:
            await browser.send_bytes(message)
