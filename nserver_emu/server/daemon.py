"""The daemon: sockets and the clock around sessions and the simulation. The only room here that knows either.

    Connection   one client's socket <-> its Session; answers a few requests a turn, so that nobody waits for another
    Daemon       listens, lets simulated time pass, stops cleanly

Rules: no client can stop the daemon or stall another: a bounded number of requests a turn, reading stops while a
client does not read its replies or waits for one, and whatever goes wrong in a session costs that connection only.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import signal
import socket
from collections.abc import Callable
from typing import cast

from nclient.errors import ConnectionLost
from nserver_emu.server.acquaintances import Acquaintances
from nserver_emu.server.handlers import Emulator
from nserver_emu.server.session import Acquaintance, Session

log = logging.getLogger(__name__)

TICK_S = 0.01
"""Real time between two steps of the simulation."""
LONGEST_CATCH_UP_S = 0.25
"""Real time that is made up for when the machine was busy or asleep; the rest is lost to the simulation."""
FAST_STEP_S = 0.1
REQUESTS_A_TURN = 20
READ_SIZE = 4096
"""Bytes of one client that are looked at before it is the others' turn."""
LOCKSTEPS_A_TURN = 100
"""Steps made at once for a client that waits in lockstep, before the others have their turn."""
FORGOTTEN_AFTER_S = 0.2
"""Who closes a connection and goes on over one made before is seen to close before the other is seen to be there."""
LOOPBACK = "127.0.0.1"
LOOPBACK_NAMES = (LOOPBACK, "localhost")
HOST_NAME_LOOPBACK = "127.0.1.1"
"""Where Debian puts a machine's own host name, which old clients connect to when they are given no host."""


class Connection(asyncio.BufferedProtocol):
    """A client's socket."""

    def __init__(self, daemon: Daemon) -> None:
        self._daemon = daemon
        self._loop = asyncio.get_running_loop()
        self.blocked = False
        self._inbox = bytearray(READ_SIZE)
        self._turn: asyncio.Handle | None = None
        self._met: Acquaintance | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.Transport, transport)
        peer = transport.get_extra_info("peername")
        transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        self._host = peer[0] if peer else ""
        name = f"{peer[0]}:{peer[1]}" if peer else "client"
        self.session = Session(
            self._daemon.emulator.answer, name, lambda wide: self._daemon.acquaintances.find(self, self._host, wide)
        )
        self._daemon.connections.add(self)
        self._daemon.acquaintances.arrive(self, self._host)
        log.info("%s: connected", self.session.name)

    def connection_lost(self, exc: Exception | None) -> None:
        self._daemon.connections.discard(self)
        if self.session.closing:
            self._daemon.acquaintances.leave(self, disconnected=True)
        else:
            self._loop.call_later(FORGOTTEN_AFTER_S, self._daemon.acquaintances.leave, self)
        if exc or self.session.unfinished:
            log.warning("%s: vanished%s%s", self.session.name, " in mid-request" if self.session.unfinished else "",
                        f": {exc}" if exc else "")
        self._daemon.emulator.leave(self.session.visit)
        self.session.closing = True
        log.info("%s: gone after %d refusals", self.session.name, self.session.refused)

    def get_buffer(self, sizehint: int) -> bytearray:
        del sizehint
        return self._inbox

    def buffer_updated(self, nbytes: int) -> None:
        self.session.receive(bytes(self._inbox[:nbytes]))
        self._answer()

    def pause_writing(self) -> None:
        self.blocked = True
        self._pace()

    def resume_writing(self) -> None:
        self.blocked = False
        self._answer()

    def tick(self) -> None:
        """Time has passed: an answer may be there."""
        if self.session.waiting:
            self._guarded(self.session.tick)
            self._answer()

    def _answer(self) -> None:
        if not self.blocked and self._turn is None:
            self._guarded(lambda: self.session.answers(REQUESTS_A_TURN))
        self._pace()

    def _guarded(self, speak: Callable[[], bytes]) -> None:
        try:
            replies = speak()
        except Exception:
            log.exception("%s: closed because of a fault of ours", self.session.name)
            self._transport.abort()
            return
        if self.session.met != self._met:
            self._met = self.session.met
            self._daemon.acquaintances.note(self, self._host, self._met)
        if replies:
            self._transport.write(replies)
        if self.session.closing:
            self._transport.close()

    def _pace(self) -> None:
        """Read on when what was read is answered; the rest of it gets its turn after the others'.

        While an answer takes its time the reading goes on, up to a crowd, so that a client's leaving is seen.
        """
        ready = self.session.ready and not self.blocked
        if ready and self._turn is None:
            self._turn = self._loop.call_soon(self._next_turn)
        if self._transport.is_closing():
            return
        if ready or self.blocked or self.session.crowded:
            self._transport.pause_reading()
        else:
            self._transport.resume_reading()

    def _next_turn(self) -> None:
        self._turn = None
        self._answer()

    def close(self) -> None:
        """Say nothing more."""
        self._transport.close()


class Daemon:
    """An Nserver on sockets. `speed`: simulated seconds a real second, None for as fast as it can; from then on the
    emulator's pace says."""

    def __init__(self, emulator: Emulator, speed: float | None = 1.0) -> None:
        self.emulator = emulator
        self.connections: set[Connection] = set()
        self.acquaintances = Acquaintances()
        self._servers: list[asyncio.Server] = []
        emulator.pace.factor = speed

    async def listen(self, host: str, port: int) -> int:
        """Open the door; the port it is on (port 0: a free one). Raises ConnectionLost, naming the remedy."""
        loop = asyncio.get_running_loop()
        try:
            server = await loop.create_server(lambda: Connection(self), host, port)
        except OSError as error:
            raise ConnectionLost(
                f"cannot listen on {host}:{port}: {error.strerror or error}; is another nserver running? "
                "--port 0 takes a free port"
            ) from error
        self._servers.append(server)
        port = server.sockets[0].getsockname()[1]
        if host in LOOPBACK_NAMES:
            with contextlib.suppress(OSError):  # not every machine has it, and no client needs it but by host name
                self._servers.append(await loop.create_server(lambda: Connection(self), HOST_NAME_LOOPBACK, port))
        self.emulator.port = port
        return port

    async def serve(self, stop: asyncio.Event, before_close: Callable[[], None] = lambda: None) -> None:
        """Let time pass until told to stop, or until a client that may ends it; then close everything.

        `before_close` sees all as it was: no connection closed, no robot stopped for that.
        """
        clock = asyncio.create_task(self._run_clock())
        stopped = asyncio.create_task(stop.wait())
        try:
            await asyncio.wait({clock, stopped}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            stopped.cancel()
            clock.cancel()
            try:
                before_close()
            finally:
                await self._close()
        if clock.done() and not clock.cancelled():
            clock.result()

    async def _run_clock(self) -> None:
        loop = asyncio.get_running_loop()
        last = loop.time()
        while not self.emulator.quitting:
            pace = self.emulator.pace
            await asyncio.sleep(0 if pace.runs_alone and pace.factor is None else TICK_S)
            now = loop.time()
            elapsed, last = now - last, now
            self._pass_time(elapsed)

    def _pass_time(self, elapsed_s: float) -> None:
        pace = self.emulator.pace
        if pace.runs_alone and pace.factor is None:
            self.emulator.pass_time(FAST_STEP_S)
        elif pace.runs_alone and pace.factor is not None:
            if elapsed_s > LONGEST_CATCH_UP_S:
                log.info("%.2f s of real time lost: the machine was busy or asleep", elapsed_s - LONGEST_CATCH_UP_S)
            self.emulator.pass_time(min(elapsed_s, LONGEST_CATCH_UP_S) * pace.factor)
        elif pace.asked_s:
            self._step_for_the_waiting(pace.asked_s)
        self._tick()

    def _step_for_the_waiting(self, step_s: float) -> None:
        """In lockstep, who waits for ws or zr asks for time as long as the answer takes."""
        for _ in range(LOCKSTEPS_A_TURN):
            if not any(connection.session.waiting for connection in self.connections):
                return
            self.emulator.pass_time(step_s)
            self._tick()

    def _tick(self) -> None:
        for connection in tuple(self.connections):
            connection.tick()

    async def _close(self) -> None:
        for server in self._servers:
            server.close()
        for connection in tuple(self.connections):
            connection.close()
        await asyncio.sleep(0)


def stop_on_signals(stop: asyncio.Event) -> None:
    """SIGINT and SIGTERM end the daemon cleanly, where the system has them."""
    loop = asyncio.get_running_loop()
    for name in (signal.SIGINT, signal.SIGTERM):
        with contextlib.suppress(NotImplementedError):
            loop.add_signal_handler(name, stop.set)
