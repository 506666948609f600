"""A daemon on real sockets in the test's own loop, and plain clients for it."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable
from typing import cast

from nclient.protocol import codec
from nclient.protocol.codec import TcpFrame, TcpFramer, reply_bounds
from nclient.protocol.commands import BY_NAME, Call
from nclient.protocol.replies import Reply
from nclient.protocol.types import N150, tcp_wire_state
from nserver_emu.server.daemon import Daemon
from nserver_emu.server.handlers.table import Emulator
from tests.nserver_emu.server.wire_client import simulation


class Client:
    """An asyncio client on a real socket that tracks the mask and the laser mode."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer
        self.transport = cast(asyncio.Transport, writer.transport)
        self.wire_state = tcp_wire_state(N150)
        self._framer = TcpFramer(reply_bounds, wide=False)
        self._frames: list[TcpFrame] = []

    async def ask(self, name: str, *args: int) -> Reply:
        call = Call(name, args)
        codec.update_from_request(call, self.wire_state)
        self.writer.write(codec.encode_tcp_request(call))
        return await self.reply(name)

    async def reply(self, name: str) -> Reply:
        while not self._frames:
            data = await self.reader.read(65536)
            assert data, "the daemon closed the connection"
            self._frames += [f for f in self._framer.receive(data) if isinstance(f, TcpFrame)]
        return codec.decode_tcp_reply(BY_NAME[name], self._frames.pop(0), self.wire_state)


class RunningServer:
    """A listening daemon and its clients, which are closed at the end."""

    def __init__(self, daemon: Daemon, port: int) -> None:
        self.daemon, self.port = daemon, port
        self._writers: list[asyncio.StreamWriter] = []

    async def open_client(self, host: str = "127.0.0.1", of: str | None = None) -> Client:
        reader, writer = await asyncio.open_connection(host, self.port, local_addr=None if of is None else (of, 0))
        self._writers.append(writer)
        return Client(reader, writer)

    async def connect_client(self, host: str = "127.0.0.1") -> Client:
        client = await self.open_client(host)
        assert (await client.ask("connect_robot", 1, 1)).values == (self.port,)
        return client

    async def close_clients(self) -> None:
        for writer in self._writers:
            writer.close()
            with contextlib.suppress(OSError):
                await writer.wait_closed()


@contextlib.asynccontextmanager
async def serving(daemon: Daemon, within_s: float = 120.0) -> AsyncIterator[None]:
    """Serve during the block, which fails after `within_s`: long enough for a busy machine."""
    stop = asyncio.Event()
    served = asyncio.create_task(daemon.serve(stop))
    try:
        async with asyncio.timeout(within_s):
            yield
    finally:
        stop.set()
        await served


@contextlib.asynccontextmanager
async def running_server(
    speed: float | None = 1.0, emulator: Emulator | None = None,
    before: Callable[[RunningServer], None] = lambda _: None,
) -> AsyncIterator[RunningServer]:
    """Run a daemon on a free port; `before` is called before time passes. All connections must be closed at the end."""
    daemon = Daemon(emulator or Emulator(simulation()), speed)
    server = RunningServer(daemon, await daemon.listen("127.0.0.1", 0))
    before(server)
    try:
        async with serving(daemon, 120):  # long enough for a busy machine
            yield server
    finally:
        await server.close_clients()
    assert not daemon.connections
