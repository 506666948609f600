"""Connections to the server: bytes from a port, through a session, and back. All asyncio code of the request path.

The path of a TCP request, file by file (no other module of this package runs; the gateway only with `--real`):

1. `connection.py`         `TcpConnection.buffer_updated`: bytes from the socket
2. `session.py`            `Session.receive`, `process_requests`: framing, decoding, one reply per request in order
3. `handlers/table.py`     `Emulator.answer`: time in lockstep, emergency stop, then the handler of the command
4. `handlers/motion.py`    (or `sensors`, `world`, `server`, `graphics`): the command itself, on `ServerState`
5. `context.py`            `ServerState.state_reply`: the reply with the robot's state, cached between two time steps
6. `state_encoder.py`      inches and radians to the wire's State vector

Framing and field encoding are shared with the client (`nclient.protocol`). The reply returns the same way:
`Session` encodes it, `ConnectionHandler.send` passes it to the socket.

Fair scheduling: a connection processes at most `MAX_BYTES_PER_TURN` bytes and `MAX_REQUESTS_PER_TURN` requests per
event-loop turn, and connections share turns by the processor time they use (scheduling.py). While requests are left
over, or the client does not read its replies, its port is not read, so that memory stays bounded. An exception in a
session closes that connection only.
"""

from __future__ import annotations

import asyncio
import logging
import socket
import weakref
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, Final, Protocol, cast

from nclient.faults.frames import Language, TcpLanguage
from nclient.protocol.types import N150
from nclient.recording.recorder import NULL_RECORDER, TCP, ConnectionRecorder, TrafficRecorder
from nserver_emu.server.admission import AdmissionControl, ConnectionTimeouts, TokenBucket
from nserver_emu.server.client_registry import CLOSED_RETENTION_S, ClientRegistry
from nserver_emu.server.context import ServerState
from nserver_emu.server.link import Arrival, FaultController, FaultyChannel, SerialChannel
from nserver_emu.server.scheduling import FairScheduler
from nserver_emu.server.session import BaseSession, ClientIdentity, CommandHandler, Session

log = logging.getLogger(__name__)

# Bytes read from a port at once.
READ_SIZE: Final = 4096
# Per event-loop turn and connection. A request has at least 4 bytes and takes 2 us to be framed. One request is the
# least that a turn can do: requests differ in cost by a factor of a hundred.
MAX_BYTES_PER_TURN: Final = 512
MAX_REQUESTS_PER_TURN: Final = 1

# Seconds to wait for the second half of a 64-bit CONNECT before it is read as a 32-bit CONNECT to robot 0.
CONNECT_WAIT_S: Final = 1.0
# Socket option that acknowledges received bytes at once; only Linux has it.
_QUICK_ACK: Final[int | None] = getattr(socket, "TCP_QUICKACK", None)


class Server(Protocol):
    """The parts of a server that its connections use."""

    # The command handler behind the port of Nserver: the emulator, or the gateway to real robots.
    handler: CommandHandler
    recorder: TrafficRecorder
    # Open connections of all kinds; a connection adds and removes itself.
    connections: set[ConnectionHandler]
    client_registry: ClientRegistry
    admission: AdmissionControl
    faults: FaultController
    scheduler: FairScheduler
    # Totals of connections that are closed.
    closed_answered: int
    closed_refused: int

    @property
    def emulator(self) -> ServerState:
        """The simulation with the server's settings."""
        ...


class ConnectionHandler(ABC):
    """A connection to the server or to a robot's own line, whatever its transport.

    Data flow, where a channel is a serial line's rate or injected faults (none: no delay):

        port -> data_received -> channel -> process -> session -> send -> channel -> _write -> port

    Subclasses implement the transport: `TcpConnection`, `PtyConnection` (serial_lines.py).
    """

    # Created by the subclass as soon as the port is open.
    session: BaseSession[Any]
    # Name of this line in a fault plan.
    line: str
    # False for a connection whose requests are always answered at once.
    is_scheduled = True

    def __init__(self, server: Server, channel: SerialChannel | None = None) -> None:
        self._server = server
        self._loop = asyncio.get_running_loop()
        # Delay and faults between port and session; None passes bytes at once.
        self._channel = channel
        self._has_faults = False
        # True while `_deliver` runs: replies to delivered bytes must not recurse into it.
        self._is_delivering = False
        self._recorder: ConnectionRecorder = NULL_RECORDER
        # Rate limit; None is unlimited.
        self._rate_limit: TokenBucket | None = None
        # False while a port is open without a peer (a pseudo-terminal that no host has opened).
        self.is_connected = True
        # True while the peer does not read its replies.
        self.is_write_paused = False
        # True if the channel was full when last checked, so that reading is suspended.
        self._is_channel_full = False
        # Bytes received and not yet given to the session.
        self._receive_backlog = b""
        # The next turn: in the scheduler's queue, or when the rate limit allows it.
        self.is_queued = False
        self.finish_tag_s = 0.0
        self._turn: asyncio.TimerHandle | None = None
        # Fires when bytes in the channel are due.
        self._delivery_timer: asyncio.TimerHandle | None = None
        # Time at which the bytes being processed left the channel; None without one.
        self._delivered_at_s: float | None = None

    # Input.

    def data_received(self, data: bytes) -> None:
        """Accept bytes from the port."""
        self._install_faults()
        if self._channel is None:
            self.process(data)
            return
        self._channel.to_robot(data, self._loop.time())
        self._deliver()

    def process(self, data: bytes) -> None:
        """Give bytes to the session and send the replies, now or in a later turn."""
        is_turn_pending = self.is_queued or self._turn is not None
        if is_turn_pending or not (self._server.scheduler.may_run_now(self._loop.time()) or not self.is_scheduled):
            self._receive_backlog += data
            self._schedule()
        else:
            self._take_turn(data)

    def run_turn(self) -> None:
        """Do the work of one turn, for the scheduler."""
        self._take_turn(b"")

    def _take_turn(self, data: bytes) -> None:
        """Give at most MAX_BYTES_PER_TURN bytes to the session, and answer at most MAX_REQUESTS_PER_TURN requests."""
        if self._receive_backlog or len(data) > MAX_BYTES_PER_TURN:
            self._receive_backlog += data
            data = self._next_chunk()
        if data:
            self._recorder.to_robot(data)
            self.session.receive(data)
        self._process_requests()

    def tick(self) -> None:
        """Send a deferred reply if simulated time has completed it."""
        if self.session.waiting or self.session.unfinished:
            self._run_session(self.session.tick, by_time=True)
            self._schedule()

    def _next_chunk(self) -> bytes:
        """Take from the backlog what may be processed in this turn."""
        if not self._has_backlog:
            return b""
        chunk = self._receive_backlog[:MAX_BYTES_PER_TURN]
        self._receive_backlog = self._receive_backlog[MAX_BYTES_PER_TURN:]
        return chunk

    @property
    def _has_backlog(self) -> bool:
        """True if received bytes wait and the session can take them."""
        session = self.session
        return bool(self._receive_backlog) and not (session.ready or session.is_queue_full or session.closing)

    # Requests and replies.

    def _process_requests(self) -> None:
        """Answer the requests of this turn, unless the peer does not read or its rate limit is used up."""
        if not self.is_write_paused and not self._rate_limit_wait_s():
            before = self.session.answered
            self._run_session(lambda: self.session.process_requests(MAX_REQUESTS_PER_TURN))
            if self._rate_limit is not None:
                self._rate_limit.consume(self.session.answered - before, self._loop.time())
        self._schedule()

    def _run_session(self, step: Callable[[], bytes], by_time: bool = False) -> None:
        """Run a step of the session, record and send its replies; an exception closes this connection only."""
        has_request = self.session.ready and not by_time
        try:
            replies = step()
        except Exception:
            log.exception("%s: internal error; connection closed", self.session.name)
            self._abort()
            return
        if has_request or replies:
            self._recorder.to_host(replies, by_time)
        if replies:
            self.send(replies)
        if self.session.closing:
            self._close_port()

    def send(self, data: bytes) -> None:
        """Send replies to the peer, through the channel if there is one."""
        self._install_faults()
        if self._channel is None:
            self._write(data)
            return
        self._channel.to_host(data, self._loop.time() if self._delivered_at_s is None else self._delivered_at_s)
        self._deliver()

    # Scheduling.

    def _schedule(self) -> None:
        """Schedule the next turn if work is left, and read from the port only if none is left.

        During a deferred reply (ws, zr) reading continues until the queue is full, so that a closed connection is
        noticed.
        """
        is_ready = (self.session.ready or self._has_backlog) and not self.is_write_paused
        if is_ready and self._turn is None and not self.is_queued:
            if wait_s := self._rate_limit_wait_s():
                self._turn = self._loop.call_later(wait_s, self._next_turn)
            else:
                self._server.scheduler.submit(self)
        self._is_channel_full = self._channel is not None and self._channel.full
        self._set_reading(
            not (is_ready or self.is_write_paused or self._is_channel_full or self.session.is_queue_full)
        )

    def _next_turn(self) -> None:
        self._turn = None
        self._schedule()

    def _rate_limit_wait_s(self) -> float:
        """Return the seconds until the rate limit allows the next turn, 0 for now."""
        return 0.0 if self._rate_limit is None else self._rate_limit.wait_s(self._loop.time())

    def _cancel_timers(self) -> None:
        """Cancel the next turn and deliveries that are due later."""
        for handle in (self._turn, self._delivery_timer):
            if handle is not None:
                handle.cancel()
        self._turn = self._delivery_timer = None
        self.is_queued = False

    # The channel: baud rate and faults.

    def _deliver(self) -> None:
        """Pass on the bytes that have come through the channel, and set a timer for those still on their way.

        Replies produced meanwhile are delivered by the same loop instead of by recursion.
        """
        channel = self._channel
        if self._is_delivering or channel is None:
            return
        # 1. Deliver all that is due. A reply may fill the channel, and a delivery empty it again.
        was_full, self._is_delivering = channel.full, True
        try:
            while arrival := channel.arrived(self._loop.time()):
                self._handle_arrival(arrival)
        finally:
            self._is_delivering = False
        # 2. Wake up for the next piece.
        if self._delivery_timer is not None:
            self._delivery_timer.cancel()
        due_s = channel.due_s
        self._delivery_timer = None if due_s is None else self._loop.call_at(due_s, self._deliver)
        # 3. Resume reading if it was suspended for a full channel.
        if was_full or self._is_channel_full:
            self._schedule()

    def _handle_arrival(self, arrival: Arrival) -> None:
        if arrival.hang_up:
            log.info("%s: closed by an injected fault", self.session.name)
            self._close_port()
        elif arrival.to_robot:
            self._delivered_at_s = arrival.at_s
            self.process(arrival.data)
            self._delivered_at_s = None
        else:
            self._write(arrival.data)

    def _install_faults(self) -> None:
        """Put the fault injector into the channel, as soon as a plan acts on this line and no frame is incomplete."""
        faults, line = self._server.faults, self.line
        if self._has_faults or not faults.plan.rules or self._is_mid_request or not faults.acts_on(line):
            return
        self._has_faults = True
        self._channel = FaultyChannel(self._language(), lambda: faults.injector(line), self._channel)

    @property
    def _is_mid_request(self) -> bool:
        """True if part of a request was received, or bytes wait in the backlog."""
        return bool(self.session.unfinished or self._receive_backlog)

    # Implemented by the transport.

    @abstractmethod
    def _language(self) -> Language:
        """Return the framing of this line, which the fault injector needs; called between two frames."""

    @abstractmethod
    def _write(self, data: bytes) -> None:
        """Write to the port, which buffers what it cannot take at once."""

    @abstractmethod
    def _set_reading(self, on: bool) -> None:
        """Read from the port, or suspend reading."""

    @abstractmethod
    def _close_port(self) -> None:
        """Close the connection after the replies in its buffer are sent."""

    @abstractmethod
    def _abort(self) -> None:
        """Close the connection now and drop its buffer."""

    @abstractmethod
    def close(self) -> None:
        """Close the connection because the server stops."""


class TcpConnection(ConnectionHandler, asyncio.BufferedProtocol):
    """A client's TCP connection to the port of Nserver."""

    line = "nserver"

    def __init__(self, server: Server) -> None:
        super().__init__(server)
        self._handler: CommandHandler = server.handler
        # Receive buffer, reused: asyncio fills it in place.
        self._buffer = bytearray(READ_SIZE)
        # The identity last reported to the client registry.
        self._identity: ClientIdentity | None = None
        limits, now_s = server.admission.limits, self._loop.time()
        self._rate_limit = TokenBucket(limits.rate, MAX_REQUESTS_PER_TURN, now_s) if limits.rate else None
        self._timeouts = ConnectionTimeouts(limits.idle, limits.stall, now_s)
        self._timeout_check: asyncio.TimerHandle | None = None
        self._is_closed_by_timeout = False
        # Fires if a CONNECT of a 64-bit client remains incomplete.
        self._connect_timer: asyncio.TimerHandle | None = None
        # Address of the client.
        self.host = ""

    # asyncio.BufferedProtocol.

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Set socket options, then start the session."""
        self._transport = cast(asyncio.Transport, transport)
        peer = transport.get_extra_info("peername")
        self._socket: socket.socket = transport.get_extra_info("socket")
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        self.host = peer[0] if peer else ""
        self._transport.set_write_buffer_limits(high=self._server.admission.limits.write_queue)
        self._start_session(f"{peer[0]}:{peer[1]}" if peer else "client")
        self._server.connections.add(self)
        self._server.client_registry.add_pending(self, self.host)
        self._schedule_timeout_check()
        log.info("%s: connected", self.session.name)

    def connection_lost(self, exc: Exception | None) -> None:
        """Release everything the session owns: timers, axes, registry entry."""
        session, registry = self.session, self._server.client_registry
        # 1. No more turns and timers.
        self._cancel_timers()
        for timer in (self._timeout_check, self._connect_timer):
            if timer is not None:
                timer.cancel()
        self._server.connections.discard(self)
        # 2. After DISCONNECT the registry entry ends at once; otherwise it stays for a second connection of the client
        #    that may continue without CONNECT.
        if session.closing:
            registry.remove(self, disconnected=True)
        else:
            self._loop.call_later(CLOSED_RETENTION_S, registry.remove, self)
        if not self._is_closed_by_timeout and (exc or session.unfinished):
            log.warning("%s: connection lost%s%s", session.name, " in mid-request" if session.unfinished else "",
                        f": {exc}" if exc else "")
        # 3. Axes that this connection set in motion stop.
        self._handler.on_disconnect(session.context)
        self._server.closed_answered += session.answered
        self._server.closed_refused += session.refused
        self._recorder.close()
        session.closing = True
        log.info("%s: closed after %d refused requests", session.name, session.refused)

    def get_buffer(self, sizehint: int) -> bytearray:
        """Return the receive buffer, which is reused for every read."""
        del sizehint
        return self._buffer

    def buffer_updated(self, nbytes: int) -> None:
        """Process the bytes read into the buffer."""
        self._timeouts.on_activity(self._loop.time())
        self.data_received(bytes(self._buffer[:nbytes]))

    def _take_turn(self, data: bytes) -> None:
        super()._take_turn(data)
        if self.session.unfinished:
            self._await_rest()

    def _await_rest(self) -> None:
        """Prepare for the rest of an incomplete request.

        A client that writes it in pieces does not send the next piece before the first is acknowledged. The system
        delays that by 40 ms unless it is told otherwise, after each read again.
        """
        if _QUICK_ACK is not None and not self._transport.is_closing():
            self._socket.setsockopt(socket.IPPROTO_TCP, _QUICK_ACK, 1)
        session = self.session
        if isinstance(session, Session) and session.may_have_32_bit_words and self._connect_timer is None:
            self._connect_timer = self._loop.call_later(CONNECT_WAIT_S, self._assume_32_bit_words, session)

    def _assume_32_bit_words(self, session: Session) -> None:
        session.assume_32_bit_words()
        self._process_requests()

    def pause_writing(self) -> None:
        """Stop answering requests: the client does not read its replies."""
        self.is_write_paused = True
        self._schedule()

    def resume_writing(self) -> None:
        """Continue to answer requests."""
        self.is_write_paused = False
        self._schedule()

    # ConnectionHandler.

    def close(self) -> None:
        """Close the connection after sending buffered replies."""
        self._transport.close()

    def _language(self) -> Language:
        return TcpLanguage(None if self.session.identity is None else self.session.identity.wide)

    def _write(self, data: bytes) -> None:
        self._transport.write(data)

    def _set_reading(self, on: bool) -> None:
        if self._transport.is_closing():
            return
        if on:
            self._transport.resume_reading()
        else:
            self._transport.pause_reading()

    def _close_port(self) -> None:
        self._transport.close()

    def _abort(self) -> None:
        self._transport.abort()

    def _run_session(self, step: Callable[[], bytes], by_time: bool = False) -> None:
        super()._run_session(step, by_time)
        if self.session.identity != self._identity:
            self._identity = self.session.identity
            self._server.client_registry.register(self, self.host, self._identity)

    def _start_session(self, name: str) -> None:
        """Create the session; `name` is the client's in logs and recordings."""
        # The session must not hold a reference to its connection: the cycle would live until the next garbage
        # collection, and those are rare (garbage.py).
        lookup = weakref.WeakMethod(self._lookup_identity)
        self.session = Session(
            self._handler.answer, name, lambda wide: method(wide) if (method := lookup()) else [],
            self._server.emulator.allowed.frame,
        )  # fmt: skip
        self._recorder = self._server.recorder.open(name, TCP, N150)

    def _lookup_identity(self, wide: bool | None) -> list[ClientIdentity]:
        return self._server.client_registry.lookup(self, self.host, wide)

    # Timeouts.

    def _schedule_timeout_check(self) -> None:
        interval_s = self._timeouts.check_interval_s
        self._timeout_check = None if interval_s is None else self._loop.call_later(interval_s, self._check_timeouts)

    def _check_timeouts(self) -> None:
        """Close the connection if it is idle or stalled for too long."""
        now_s, is_waiting = self._loop.time(), self.session.waiting
        if is_waiting:
            # A client that waits for a deferred reply is not idle.
            self._timeouts.on_activity(now_s)
        is_stalled = self.is_write_paused or (bool(self.session.unfinished) and not is_waiting)
        reason = self._timeouts.timeout_reason(now_s, self.session.answered, is_stalled)
        if not reason:
            self._schedule_timeout_check()
            return
        log.warning("%s: closed: %s", self.session.name, reason)
        self._is_closed_by_timeout = True
        self._abort()
