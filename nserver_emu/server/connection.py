"""One who talks with the server or with a robot, whatever port it comes by: its session asked a few requests a turn.

    port ──> cable ──> session ──> cable ──> port        no cable: bytes pass in no time, as over TCP

Rules: nobody waits for another: so many bytes and requests a turn, the rest after the others' turn, and until then the
port is not read; what goes wrong in a session costs that connection only. The port's own ways are its class's:
Connection (TCP), SerialLine (a pseudo-terminal).

One client's socket and the session behind it: an Nserver's client here, a robot's own line in lines.py.
"""

from __future__ import annotations

import asyncio
import logging
import socket
import weakref
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final, cast

from nclient.faults.frames import Language, TcpLanguage
from nclient.protocol.types import N150
from nclient.recording.recorder import NULL_RECORDER, TCP, ConnectionRecorder
from nserver_emu.server.admission import ConnectionTimeouts, TokenBucket
from nserver_emu.server.client_registry import CLOSED_RETENTION_S
from nserver_emu.server.link import Arrival, FaultyChannel, SerialChannel
from nserver_emu.server.session import BaseSession, ClientIdentity, Host, Session

if TYPE_CHECKING:
    from nserver_emu.server.daemon import Daemon

log = logging.getLogger(__name__)

READ_SIZE: Final = 4096
"""Bytes that are read from a port at once."""
MAX_BYTES_PER_TURN: Final = 512
"""Bytes that are looked at before it is the others' turn: a request has four at least, and takes 2 us to be found."""
MAX_REQUESTS_PER_TURN: Final = 5
"""Requests that are answered, 25 us each, before it is the others' turn. Both are what a flood adds to their wait."""


class ConnectionHandler(ABC):
    """See the head of this file. `session` and `_tape` are there once the port is open."""

    session: BaseSession[Any]
    line: str
    """What a plan of faults calls this line."""

    def __init__(self, daemon: Daemon, cable: SerialChannel | None = None) -> None:
        self._daemon = daemon
        self._loop = asyncio.get_running_loop()
        self._cable = cable
        self._faulty = False
        self._delivering = False
        self._tape: ConnectionRecorder = NULL_RECORDER
        self._allowance: TokenBucket | None = None
        """How fast it is answered; None: as fast as it asks."""
        self.here = True
        """Whether there is anybody: a port may be open with nobody at its other end."""
        self.blocked = False
        """Whether what is said is not taken at present."""
        self._held_back = False
        """Whether it is not read from because too much was on its way when that was looked at last."""
        self._receive_backlog = b""
        """What came and was not looked at yet."""
        self._turn: asyncio.Handle | None = None
        self._alarm: asyncio.TimerHandle | None = None
        self._moment_s: float | None = None

    def tick(self) -> None:
        """Time has passed: an answer may be there."""
        if self.session.waiting or self.session.unfinished:
            self._guarded(self.session.tick, by_time=True)
            self._answer()

    def data_received(self, data: bytes) -> None:
        """Bytes from the port."""
        self._install_faults()
        if self._cable is None:
            self.process(data)
            return
        self._cable.to_robot(data, self._loop.time())
        self._deliver()

    def send(self, data: bytes) -> None:
        self._install_faults()
        if self._cable is None:
            self._send(data)
            return
        self._cable.to_host(data, self._loop.time() if self._moment_s is None else self._moment_s)
        self._deliver()

    def process(self, data: bytes) -> None:
        if self._receive_backlog or len(data) > MAX_BYTES_PER_TURN:
            self._receive_backlog += data
            data = b"" if self._turn else self._next_chunk()
        if data:
            self._tape.to_robot(data)
            self.session.receive(data)
        self._answer()

    def _next_chunk(self) -> bytes:
        """What is to be looked at in this turn."""
        if not self._has_backlog:
            return b""
        data, self._receive_backlog = (
            self._receive_backlog[:MAX_BYTES_PER_TURN],
            self._receive_backlog[MAX_BYTES_PER_TURN:],
        )
        return data

    @property
    def _has_backlog(self) -> bool:
        """Whether something came that is to be looked at now."""
        return bool(self._receive_backlog) and not (
            self.session.ready or self.session.is_queue_full or self.session.closing
        )

    def _answer(self) -> None:
        if not self.blocked and self._turn is None:
            if self._owed_s():
                self._pace()
                return
            before = self.session.answered
            self._guarded(lambda: self.session.process_requests(MAX_REQUESTS_PER_TURN))
            if self._allowance is not None:
                self._allowance.consume(self.session.answered - before, self._loop.time())
        self._pace()

    def _guarded(self, speak: Callable[[], bytes], by_time: bool = False) -> None:
        asked = self.session.ready and not by_time
        try:
            replies = speak()
        except Exception:
            log.exception("%s: closed because of a fault of ours", self.session.name)
            self._abort()
            return
        if asked or replies:
            self._tape.to_host(replies, by_time)
        if replies:
            self.send(replies)
        if self.session.closing:
            self._hang_up()

    def _pace(self) -> None:
        """Read on when what was read is answered; the rest of it gets its turn after the others'.

        While an answer takes its time the reading goes on, up to a crowd, so that a client's leaving is seen.
        """
        ready = (self.session.ready or self._has_backlog) and not self.blocked
        if ready and self._turn is None:
            owed_s = self._owed_s()
            later = self._loop.call_later
            self._turn = later(owed_s, self._next_turn) if owed_s else self._loop.call_soon(self._next_turn)
        self._held_back = self._cable is not None and self._cable.full
        self._listen(not (ready or self.blocked or self._held_back or self.session.is_queue_full))

    def _next_turn(self) -> None:
        self._turn = None
        self.process(b"")

    def _deliver(self) -> None:
        """What has come through the cable, to where it goes; for what is still on its way an alarm is set.

        What is answered meanwhile takes its turn in the same loop: answers to answers would pile up on the stack.
        """
        cable = self._cable
        if self._delivering or cable is None:
            return
        was_full, self._delivering = cable.full, True  # or it gets full by answers on the way, and empty again
        try:
            while arrival := cable.arrived(self._loop.time()):
                self._arrived(arrival)
        finally:
            self._delivering = False
        if self._alarm is not None:
            self._alarm.cancel()
        due_s = cable.due_s
        self._alarm = None if due_s is None else self._loop.call_at(due_s, self._deliver)
        if was_full or self._held_back:
            self._pace()

    def _arrived(self, arrival: Arrival) -> None:
        if arrival.hang_up:
            log.info("%s: hung up on purpose", self.session.name)
            self._hang_up()
        elif arrival.to_robot:
            self._moment_s = arrival.at_s
            self.process(arrival.data)
            self._moment_s = None
        else:
            self._send(arrival.data)

    def _install_faults(self) -> None:
        """From the first plan that acts on this line on, its faults lie between port and session."""
        desk, line = self._daemon.faults, self.line
        if self._faulty or not desk.plan.rules or self._unfinished or not desk.acts_on(line):
            return
        self._faulty = True
        self._cable = FaultyChannel(self._language(), lambda: desk.injector(line), self._cable)

    @property
    def _unfinished(self) -> bool:
        """Whether more is needed of what was begun, or is to be looked at."""
        return bool(self.session.unfinished or self._receive_backlog)

    def _silence(self) -> None:
        """Nothing more comes through the cable, and nobody gets a turn."""
        for handle in (self._turn, self._alarm):
            if handle is not None:
                handle.cancel()
        self._turn = self._alarm = None

    def _owed_s(self) -> float:
        """How long the next turn has to wait, for this one has asked too fast."""
        return 0.0 if self._allowance is None else self._allowance.wait_s(self._loop.time())

    @abstractmethod
    def _language(self) -> Language:
        """What is spoken here, for a plan of faults to know its frames; between two frames."""

    @abstractmethod
    def _send(self, data: bytes) -> None:
        """Give these to the port; what it cannot take at once is the port's own matter."""

    @abstractmethod
    def _listen(self, on: bool) -> None:
        """Read from the port, or let it wait."""

    @abstractmethod
    def _hang_up(self) -> None:
        """End the connection, once what was said is sent."""

    @abstractmethod
    def _abort(self) -> None:
        """End the connection now."""

    @abstractmethod
    def close(self) -> None:
        """Say nothing more, for the daemon ends."""


if TYPE_CHECKING:
    from nserver_emu.server.daemon import Daemon


class Connection(ConnectionHandler, asyncio.BufferedProtocol):
    """A client's socket."""

    line = "nserver"

    def __init__(self, daemon: Daemon) -> None:
        super().__init__(daemon)
        self._behind: Host = daemon.host
        self._inbox = bytearray(READ_SIZE)
        self._met: ClientIdentity | None = None
        limits, now_s = daemon.admission.limits, self._loop.time()
        self._allowance = TokenBucket(limits.rate, MAX_REQUESTS_PER_TURN, now_s) if limits.rate else None
        self._patience = ConnectionTimeouts(limits.idle, limits.stall, now_s)
        self._look: asyncio.TimerHandle | None = None
        self._closed_by_us = False
        self.host = ""
        """The address that it came from."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.Transport, transport)
        peer = transport.get_extra_info("peername")
        transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        self.host = peer[0] if peer else ""
        self._transport.set_write_buffer_limits(high=self._daemon.admission.limits.write_queue)
        self._meet(f"{peer[0]}:{peer[1]}" if peer else "client")
        self._daemon.connections.add(self)
        self._daemon.client_registry.add_pending(self, self.host)
        self._look_later()
        log.info("%s: connected", self.session.name)

    def connection_lost(self, exc: Exception | None) -> None:
        self._silence()
        if self._look is not None:
            self._look.cancel()
        self._daemon.connections.discard(self)
        if self.session.closing:
            self._daemon.client_registry.remove(self, disconnected=True)
        else:
            self._loop.call_later(CLOSED_RETENTION_S, self._daemon.client_registry.remove, self)
        if not self._closed_by_us and (exc or self.session.unfinished):
            log.warning(
                "%s: vanished%s%s",
                self.session.name,
                " in mid-request" if self.session.unfinished else "",
                f": {exc}" if exc else "",
            )
        self._behind.on_disconnect(self.session.context)
        self._daemon.gone_answered += self.session.answered
        self._daemon.gone_refused += self.session.refused
        self._tape.close()
        self.session.closing = True
        log.info("%s: gone after %d refusals", self.session.name, self.session.refused)

    def get_buffer(self, sizehint: int) -> bytearray:
        del sizehint
        return self._inbox

    def buffer_updated(self, nbytes: int) -> None:
        self._patience.heard(self._loop.time())
        self.data_received(bytes(self._inbox[:nbytes]))

    def pause_writing(self) -> None:
        self.blocked = True
        self._pace()

    def resume_writing(self) -> None:
        self.blocked = False
        self._answer()

    def close(self) -> None:
        self._transport.close()

    def _look_later(self) -> None:
        check_interval_s = self._patience.check_interval_s
        self._look = None if check_interval_s is None else self._loop.call_later(check_interval_s, self._look_at)

    def _look_at(self) -> None:
        """Whether this one is still to be put up with."""
        now_s, waiting = self._loop.time(), self.session.waiting
        if waiting:
            self._patience.heard(now_s)
        stuck = self.blocked or (bool(self.session.unfinished) and not waiting)
        reason = self._patience.timeout_reason(now_s, self.session.answered, stuck)
        if not reason:
            self._look_later()
            return
        log.warning("%s: closed: %s", self.session.name, reason)
        self._closed_by_us = True
        self._abort()

    def _meet(self, name: str) -> None:
        """Begin the conversation."""
        # A session that held its connection would keep both until Python looks for garbage, seldom (garbage.py).
        asks = weakref.WeakMethod(self._met_before)
        self.session = Session(
            self._behind.answer,
            name,
            lambda wide: ask(wide) if (ask := asks()) else None,
            self._daemon.emulator.allowed.frame,
        )
        self._tape = self._daemon.recorder.open(name, TCP, N150)

    def _met_before(self, wide: bool | None) -> ClientIdentity | None:
        return self._daemon.client_registry.lookup(self, self.host, wide)

    def _guarded(self, speak: Callable[[], bytes], by_time: bool = False) -> None:
        super()._guarded(speak, by_time)
        if self.session.identity != self._met:
            self._met = self.session.identity
            self._daemon.client_registry.register(self, self.host, self._met)

    def _language(self) -> Language:
        return TcpLanguage(None if self.session.identity is None else self.session.identity.wide)

    def _send(self, data: bytes) -> None:
        self._transport.write(data)

    def _listen(self, on: bool) -> None:
        if self._transport.is_closing():
            return
        if on:
            self._transport.resume_reading()
        else:
            self._transport.pause_reading()

    def _hang_up(self) -> None:
        self._transport.close()

    def _abort(self) -> None:
        self._transport.abort()
