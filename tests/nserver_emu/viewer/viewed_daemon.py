"""A daemon with its page in the test's own loop, and what a page would do there, without a browser."""

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
PATIENCE_S = 10.0
Message = dict[str, Any]


class Page:
    """One websocket, as a page has it."""

    def __init__(self, socket: aiohttp.ClientWebSocketResponse) -> None:
        self.socket = socket

    async def say(self, **message: Any) -> None:
        """Send a message."""
        await self.socket.send_str(json.dumps(message))

    async def until(self, right: Callable[[Message], Any]) -> Message:
        """The next message that is right; those before it are passed over, pictures acknowledged."""
        async with asyncio.timeout(PATIENCE_S):
            while True:
                message: Message = json.loads(await self.socket.receive_str())
                if message["type"] == "picture":
                    await self.say(do="seen", frame=message["frame"])
                if right(message):
                    return message

    async def answer(self, number: int) -> Message:
        """The answer to what was asked under this number."""
        return await self.until(lambda message: message["type"] == "answer" and message["id"] == number)


class Served(NamedTuple):
    """A daemon, its page, where it is, and who asks there."""

    daemon: Daemon
    viewer_server: ViewerServer
    port: int
    web: aiohttp.ClientSession

    @property
    def origin(self) -> str:
        """Where a page that is ours comes from."""
        return f"http://{HOST}:{self.port}"

    @asynccontextmanager
    async def page(self, token: str = "") -> AsyncIterator[Page]:
        """A page that is open."""
        query = {"token": token or self.viewer_server.token}
        async with self.web.ws_connect(f"{self.origin}/ws", params=query, headers={"Origin": self.origin}) as socket:
            yield Page(socket)


def elsewhere() -> aiohttp.ClientSession:
    """Who asks from another address than the one he asks."""
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
