"""A daemon with its page in the test's own event loop, and a websocket client in place of a browser."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any, NamedTuple

import aiohttp

from nserver_emu.server.daemon import Daemon
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.viewer.server import ViewerServer

HOST = "127.0.0.1"
TIMEOUT_S = 10.0
Message = dict[str, Any]


class Page:
    """The websocket of one page."""

    def __init__(self, socket: aiohttp.ClientWebSocketResponse) -> None:
        self.socket = socket

    async def send_message(self, **message: Any) -> None:
        """Send a message."""
        await self.socket.send_str(json.dumps(message))

    async def until(self, right: Callable[[Message], Any]) -> Message:
        """Return the next matching message; skip others, acknowledge pictures."""
        async with asyncio.timeout(TIMEOUT_S):
            while True:
                message: Message = json.loads(await self.socket.receive_str())
                if message["type"] == "picture":
                    await self.send_message(do="seen", frame=message["frame"])
                if right(message):
                    return message

    async def answer(self, number: int) -> Message:
        """Return the reply to the message of this number."""
        return await self.until(lambda message: message["type"] == "answer" and message["id"] == number)


class Served(NamedTuple):
    """A daemon, its page server, the port, and an HTTP client."""

    daemon: Daemon
    viewer_server: ViewerServer
    port: int
    web: aiohttp.ClientSession

    @property
    def origin(self) -> str:
        """Origin of the page."""
        return f"http://{HOST}:{self.port}"

    @asynccontextmanager
    async def page(self, token: str = "") -> AsyncIterator[Page]:
        """A page that is open."""
        query = {"token": token or self.viewer_server.token}
        async with self.web.ws_connect(f"{self.origin}/ws", params=query, headers={"Origin": self.origin}) as socket:
            yield Page(socket)


def elsewhere() -> aiohttp.ClientSession:
    """Connect from another local address than the server's."""
    return aiohttp.ClientSession(connector=aiohttp.TCPConnector(local_addr=("127.0.0.2", 0)))


@asynccontextmanager
async def serve_viewer(emulator: Emulator) -> AsyncIterator[Served]:
    """Daemon and page, running."""
    daemon = Daemon(emulator)
    viewer_server = ViewerServer(daemon)
    await daemon.listen(HOST, 0)
    port = await viewer_server.open(HOST, 0)
    stop = asyncio.Event()
    running = asyncio.create_task(daemon.serve(stop))
    try:
        async with aiohttp.ClientSession() as web:
            yield Served(daemon, viewer_server, port, web)
    finally:
        await viewer_server.close()
        stop.set()
        await running
