"""Connections to the server: bytes from a port, through a session, and back. All asyncio code of the request path.

The path of a TCP request, file by file (the gateway only with `--real`):

1. `connection.py`                  `TcpConnection.buffer_updated`: bytes from the socket
2. `session.py`                     `Session.receive`, `process_requests`: one reply per request, in order
3. `nclient/protocol/codec.py`      `TcpFramer`, `decode_tcp_request`: frames and calls, shared with the client
4. `server_state.py`                `ServerState.answer`: time in lockstep, emergency stop, then the command's handler
5. `handlers/motion.py`             (or `sensors`, `world`, `server`, `graphics`): the command itself
6. `nserver_emu/simulation/robot.py`    the simulated robot

The reply takes the reverse path: `ServerState.state_reply` reads the robot, `Session` encodes it with `codec.py`,
`ConnectionHandler.send` passes it to the socket.

Fair scheduling: a connection processes at most `MAX_BYTES_PER_TURN` bytes and `MAX_REQUESTS_PER_TURN` requests per
event-loop turn. Turns are bounded by cost, and shared by the processor time that each connection used:

    bytes from a port -> may_run_now()?  yes -> the request is answered at once
                                         no  -> submit() -> a later turn of the event loop, in order of virtual time

While the event loop is idle nothing is queued. Otherwise start-time fair queueing decides
(`FairScheduler`), so that the delay a client sees does not depend on how many requests others send, nor on what they
cost; only a single request is indivisible. While requests are left over, or the client does not read its replies, its
port is not read, so that memory stays bounded. An exception in a session closes that connection only.

References
----------
Goyal, Vin and Cheng, Start-time fair queueing, SIGCOMM 1996.
"""

from __future__ import annotations

import asyncio
import logging
import socket
import time
import weakref
from abc import ABC, abstractmethod
from heapq import heappop, heappush
from itertools import count
from math import inf
from typing import Any, Final, Protocol, cast

from nclient.faults.frames import Language, TcpLanguage
from nclient.protocol.types import N150
from nclient.recording.recorder import NULL_RECORDER, TCP, ConnectionRecorder, TrafficRecorder
from nserver_emu.server.admission import AdmissionControl, ConnectionTimeouts
from nserver_emu.server.client_registry import CLOSED_RETENTION_S, ClientRegistry
from nserver_emu.server.link import Arrival, FaultController, FaultyChannel, SerialChannel
from nserver_emu.server.server_state import ServerState
from nserver_emu.server.session import BaseSession, ClientIdentity, CommandHandler, Session

log = logging.getLogger(__name__)

# Time that all connections together may use in one turn of the event loop. Between two turns the loop polls its
# sockets, which takes some 15 us: 5 % of this.
TURN_BUDGET_S: Final = 0.0003


class Job(Protocol):
    """A connection, or anything else that shares the event loop."""

    # True while it waits in the queue; set to False to withdraw it.
    is_queued: bool
    # Processor time that it had used in virtual time when it was last served.
    finish_tag_s: float
    # Processor time that its work has taken.
    cpu_s: float

    def run_turn(self) -> None:
        """Do the work of one turn; submit itself again if some is left."""


class FairScheduler:
    """Start-time fair queueing of jobs by processor time.

    A job gets a start tag, the later of the virtual time and the end of its own last service. The job with the
    earliest tag runs, its tag becomes the virtual time, and what it costs moves its own next tag. So a job that rested
    is next in line, and those with a backlog share equally, whatever their requests cost.

    Attributes
    ----------
    turns, served
        Number of turns that had queued work, and of jobs that were run in them.
    """

    def __init__(self) -> None:
        self.turns = 0
        self.served = 0
        self._virtual_s = 0.0
        # Queued jobs by start tag. Of equal ones the job that rested longest is first, then the one that came first.
        self._queue: list[tuple[float, float, int, Job]] = []
        self._number = 0
        # Jobs submitted while a turn runs: they wait for the next one, since the loop must poll its sockets first.
        self._submitted: list[Job] = []
        self._is_turn_scheduled = False
        # Processor time left in this turn for work that is done at once, and when such work last ended.
        self._left_s = TURN_BUDGET_S
        self._worked_s = 0.0

    def __len__(self) -> int:
        return len(self._queue)

    def may_run_now(self, now_s: float) -> bool:
        """Return True if work that has just arrived may be done at once, and `charge` it; otherwise `submit` it."""
        if self._is_turn_scheduled:
            return False
        if now_s >= self._worked_s + TURN_BUDGET_S:
            # Nothing was done for so long that this is another turn.
            self._left_s = TURN_BUDGET_S
        self._worked_s = now_s
        return self._left_s > 0.0

    def charge(self, taken_s: float) -> None:
        """Charge this turn for the processor time of work that was done at once."""
        self._left_s -= taken_s
        self._worked_s += taken_s

    def submit(self, job: Job) -> None:
        """Queue a job for a later turn of the event loop."""
        job.is_queued = True
        self._submitted.append(job)
        if not self._is_turn_scheduled:
            self._schedule_turn()

    def _run_turn(self) -> None:
        """Run queued jobs until the time of this turn is used up, each at most once."""
        # 1. What was submitted since the last turn joins the queue.
        for job in self._submitted:
            self._number += 1
            heappush(self._queue, (max(self._virtual_s, job.finish_tag_s), job.finish_tag_s, self._number, job))
        self._submitted.clear()
        # 2. Jobs by their tags, until one that has run and has more to do is before all others.
        self.turns += 1
        loop = asyncio.get_running_loop()
        now_s = loop.time()
        end_s, first_again_s = now_s + TURN_BUDGET_S, inf
        try:
            while self._queue and now_s < end_s and self._queue[0][0] <= first_again_s:
                self._virtual_s, _, _, job = heappop(self._queue)
                if job.is_queued:
                    self._run(job)
                    now_s = loop.time()
                    if job.is_queued:
                        first_again_s = min(first_again_s, job.finish_tag_s)
        finally:
            # 3. The rest follows in the next turn, also after an error, which the event loop logs.
            self._is_turn_scheduled = False
            self._left_s, self._worked_s = end_s - now_s, now_s
            if self._queue or self._submitted:
                self._schedule_turn()

    def _schedule_turn(self) -> None:
        """Run a turn in the next iteration of the event loop, after the sockets are read.

        asyncio runs timers that are due after what it read, and callbacks of `call_soon` before: with those a request
        would wait for one more turn.
        """
        loop = asyncio.get_running_loop()
        self._is_turn_scheduled = True
        loop.call_at(loop.time(), self._run_turn)

    def _run(self, job: Job) -> None:
        """Run a job and charge it for its processor time."""
        self.served += 1
        job.is_queued = False
        start_s = time.thread_time()
        job.run_turn()
        taken_s = time.thread_time() - start_s
        job.cpu_s += taken_s
        job.finish_tag_s = self._virtual_s + taken_s


# Seconds of unused rate that an idle client accumulates.
BURST_S: Final = 0.1


class TokenBucket:
    """A limit on requests per second.

    The bucket holds up to BURST_S of the rate, at least one turn. It may become negative by the last turn, which is
    then waited for before the next. Times are seconds of a monotonic clock.
    """

    def __init__(self, rate: float, turn: int, now_s: float) -> None:
        self._rate = rate
        self._capacity = max(rate * BURST_S, turn)
        self._tokens = self._capacity
        self._updated_s = now_s

    def consume(self, count: int, now_s: float) -> None:
        """Take tokens for `count` answered requests."""
        self._tokens = min(self._capacity, self._tokens + self._rate * (now_s - self._updated_s)) - count
        self._updated_s = now_s

    def wait_s(self, now_s: float) -> float:
        """Return the seconds until a request may be answered, 0 for now."""
        return max(0.0, -self._tokens / self._rate - (now_s - self._updated_s))


# Bytes read from a port at once.
READ_SIZE: Final = 4096
# Per event-loop turn and connection. A request has at least 4 bytes and takes 2 us to be framed. One request is the
# least that a turn can do: requests differ in cost by a factor of a hundred.
MAX_BYTES_PER_TURN: Final = 512
MAX_REQUESTS_PER_TURN: Final = 1
# Steps of simulated time within which the work for one reply is spread over turns: each may bring new work, and at
# unlimited speed there is one in each turn. 16 of 10 ms: a ring among a thousand obstacles takes 16 turns of some 2 ms.
MAX_PREPARING_STEPS: Final = 16

# Seconds to wait for the second half of a 64-bit CONNECT before it is read as a 32-bit CONNECT to robot 0.
CONNECT_WAIT_S: Final = 1.0
# Socket option that acknowledges received bytes at once; only Linux has it.
_QUICK_ACK: Final[int | None] = getattr(socket, "TCP_QUICKACK", None)
_numbers = count(1)


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
    closed_cpu_s: float

    @property
    def emulator(self) -> ServerState:
        """The simulation with the server's settings."""


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
    # True for a connection whose identity another one may continue.
    is_registered = False
    # Address of the client, if it has one.
    host = ""

    def __init__(self, server: Server, channel: SerialChannel | None = None) -> None:
        self._server = server
        # Name of this connection where its address must not be named.
        self.number = next(_numbers)
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
        # The identity last reported by the session.
        self._identity: ClientIdentity | None = None
        # True until the first request: until then the connection may turn out to continue a closed one.
        self._is_pending = True
        # True while the peer does not read its replies.
        self.is_write_paused = False
        # True if the channel was full when last checked, so that reading is suspended.
        self._is_channel_full = False
        # Bytes received and not yet given to the session.
        self._receive_backlog = b""
        # The next turn: in the scheduler's queue, or when the rate limit allows it.
        self.is_queued = False
        self.finish_tag_s = self.cpu_s = 0.0
        self._turn: asyncio.TimerHandle | None = None
        # Steps of simulated time spent on the preparation of the next reply, and the time of the last.
        self._preparing = 0
        self._prepared_ps = -1
        # Fires when bytes in the channel are due.
        self._delivery_timer: asyncio.TimerHandle | None = None
        # Time at which the bytes being processed left the channel; None without one.
        self._delivered_at_s: float | None = None

    # Input.

    def data_received(self, data: bytes) -> None:
        """Accept bytes from the port."""
        if self._server.faults.plan.rules:
            self._install_faults()
        if self._channel is None:
            self.process(data)
            return
        self._channel.to_robot(data, self._loop.time())
        self._deliver()

    def process(self, data: bytes) -> None:
        """Give bytes to the session and send the replies, now or in a later turn."""
        is_turn_pending = self.is_queued or self._turn is not None
        if not is_turn_pending and (not self.is_scheduled or self._server.scheduler.may_run_now(self._loop.time())):
            start_s = time.thread_time()
            self._take_turn(data)
            taken_s = time.thread_time() - start_s
            self.cpu_s += taken_s
            self._server.scheduler.charge(taken_s)
        else:
            self._receive_backlog += data
            self._schedule()

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
            self._run_session(by_time=True)
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
        if not self._receive_backlog:
            return False
        session = self.session
        return not (session.ready or session.is_queue_full or session.closing)

    # Requests and replies.

    def _process_requests(self) -> None:
        """Answer the requests of this turn, unless the peer does not read or its rate limit is used up."""
        limit = self._rate_limit
        if not self.is_write_paused and (limit is None or not self._rate_limit_wait_s()) and self._is_prepared():
            before = self.session.answered
            self._run_session()
            if limit is not None:
                limit.consume(self.session.answered - before, self._loop.time())
        self._schedule()

    def _is_prepared(self) -> bool:
        """Do part of the work for the next reply; return False if the rest is for later turns."""
        server = self._server
        is_simulated = self.is_scheduled and server.handler is server.emulator
        if is_simulated and self.session.ready:
            now_ps = server.emulator.simulation.time_ps
            self._preparing += now_ps != self._prepared_ps
            self._prepared_ps = now_ps
            if self._preparing <= MAX_PREPARING_STEPS and not self._prepare():
                return False
        self._preparing, self._prepared_ps = 0, -1
        return True

    def _prepare(self) -> bool:
        session = self.session
        return self._server.emulator.prepare_reply(session.context, session.call_to_prepare())

    def _run_session(self, by_time: bool = False) -> None:
        """Answer requests, or a deferred one `by_time`; an exception closes this connection only."""
        session = self.session
        has_request = not by_time and session.ready
        try:
            replies = session.tick() if by_time else session.process_requests(MAX_REQUESTS_PER_TURN)
        except Exception:
            log.exception("%s: internal error; connection closed", session.name)
            self._abort()
            return
        if has_request or replies:
            self._recorder.to_host(replies, by_time)
        if replies:
            self.send(replies)
        if session.closing:
            self._close_port()
        if session.identity is not self._identity or (has_request and self._is_pending):
            self._identity, self._is_pending = session.identity, False
            if self.is_registered:
                self._server.client_registry.register(self, self.host, self._identity)

    def send(self, data: bytes) -> None:
        """Send replies to the peer, through the channel if there is one."""
        if self._server.faults.plan.rules:
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
        session = self.session
        is_ready = (session.ready or self._has_backlog) and not self.is_write_paused
        if is_ready and self._turn is None and not self.is_queued:
            if wait_s := self._rate_limit_wait_s():
                self._turn = self._loop.call_later(wait_s, self._next_turn)
            else:
                self._server.scheduler.submit(self)
        self._is_channel_full = self._channel is not None and self._channel.full
        self._set_reading(
            not (is_ready or self.is_write_paused or self._is_channel_full or session.is_queue_full)
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
        """Pass on the bytes that have come through the channel, and set a timer for those still in it.

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
        if self._has_faults or self._is_mid_request or not faults.acts_on(line):
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
    is_registered = True

    def __init__(self, server: Server) -> None:
        super().__init__(server)
        self._handler: CommandHandler = server.handler
        # Receive buffer, reused: asyncio fills it in place.
        self._buffer = bytearray(READ_SIZE)
        self._is_reading = True
        limits, now_s = server.admission.limits, self._loop.time()
        self._rate_limit = TokenBucket(limits.rate, MAX_REQUESTS_PER_TURN, now_s) if limits.rate else None
        self._timeouts = ConnectionTimeouts(limits.idle, limits.stall, now_s)
        self._timeout_check: asyncio.TimerHandle | None = None
        self._is_closed_by_timeout = False
        # Fires if a CONNECT of a 64-bit client remains incomplete.
        self._connect_timer: asyncio.TimerHandle | None = None
        self.opened_s = now_s

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
        log.info("%s: connected", self.session.name, extra=self.session.log_extra)

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
                        f": {exc}" if exc else "", extra=session.log_extra)
        # 3. Axes that this connection set in motion stop.
        self._handler.on_disconnect(session.context)
        self._server.closed_answered += session.answered
        self._server.closed_refused += session.refused
        self._server.closed_cpu_s += self.cpu_s
        self._recorder.close()
        session.closing = True
        log.info("%s: closed after %d refused requests", session.name, session.refused, extra=session.log_extra)

    def get_buffer(self, sizehint: int) -> bytearray:
        """Return the receive buffer, which is reused for every read."""
        del sizehint
        return self._buffer

    def buffer_updated(self, nbytes: int) -> None:
        """Process the bytes read into the buffer."""
        self._timeouts.active_s = self._loop.time()
        self.data_received(bytes(self._buffer[:nbytes]))

    def _take_turn(self, data: bytes) -> None:
        super()._take_turn(data)
        if self.session.unfinished:
            self._await_rest()

    def _await_rest(self) -> None:
        """Prepare for the rest of an incomplete request.

        A client that writes it in pieces does not send the next piece before the first is acknowledged. The system
        delays that by 40 ms unless a socket option forbids it, which lasts for one read.
        """
        if _QUICK_ACK is not None and not self._transport.is_closing():
            self._socket.setsockopt(socket.IPPROTO_TCP, _QUICK_ACK, 1)
        session = self.session
        if isinstance(session, Session) and session.may_have_32_bit_words and self._connect_timer is None:
            self._connect_timer = self._loop.call_later(CONNECT_WAIT_S, self._assume_32_bit_words, session)

    def _assume_32_bit_words(self, session: Session) -> None:
        session.assume_32_bit_words()
        self._schedule()

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
        if on == self._is_reading or self._transport.is_closing():
            return
        self._is_reading = on
        if on:
            self._transport.resume_reading()
        else:
            self._transport.pause_reading()

    def _close_port(self) -> None:
        self._transport.close()

    def _abort(self) -> None:
        self._transport.abort()

    def _start_session(self, name: str) -> None:
        """Create the session; `name` is the client's in logs and recordings."""
        # The session must not hold a reference to its connection: the cycle would live until the next garbage
        # collection, and those are rare (daemon.py).
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
            self._timeouts.active_s = now_s
        is_stalled = self.is_write_paused or (bool(self.session.unfinished) and not is_waiting)
        reason = self._timeouts.timeout_reason(now_s, self.session.answered, is_stalled)
        if not reason:
            self._schedule_timeout_check()
            return
        self.close_because(reason)

    @property
    def idle_s(self) -> float:
        """Seconds since the last bytes from the client; 0 while it waits for a deferred reply."""
        return 0.0 if self.session.waiting else self._loop.time() - self._timeouts.active_s

    def close_because(self, reason: str) -> None:
        """Close the connection now and log the reason."""
        log.warning("%s: closed: %s", self.session.name, reason, extra=self.session.log_extra)
        self._is_closed_by_timeout = True
        self._abort()
