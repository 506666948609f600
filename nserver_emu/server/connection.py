"""Connections to the server: bytes from a port, through a session, and back. All asyncio code of the request path.

The path of a TCP request, file by file. With `--real`, `Gateway.answer` (nserver_emu/gateway) comes before step 4, and
passes motions and readings of forwarded robots to the real one.

1. `connection.py`                  `TcpConnection.buffer_updated`: bytes from the socket
2. `session.py`                     `Session.receive`, `process_requests`: one reply per request, in order
3. `nclient/protocol/codec.py`      `TcpFramer`, `decode_tcp_request`: frames and calls, shared with the client
4. `server_state.py`                `ServerState.answer`: time in lockstep, emergency stop, then the command's handler
5. `handlers/robot.py`              (or `world`, `graphics`, `table`): the command itself
6. `nserver_emu/simulation/robot.py`    the simulated robot

The reply takes the reverse path: `ServerState.state_reply` reads the robot, `Session` encodes it with `codec.py`,
`ConnectionHandler.send` passes it to the socket.

Words: *CONNECT* is a client's first request, in words of 32 or 64 bits. It gives a connection its *identity*: the robot
and the width of its words. A connection whose first request is another one *continues* that of a connection from the
same computer (`ClientRegistry`). An *iteration* is one round of asyncio's event loop, which reads the sockets and then
runs callbacks. A *turn* is the piece of work that one connection does at once: at most `MAX_BYTES_PER_TURN` bytes and
`MAX_REQUESTS_PER_TURN` requests. An iteration has room for many turns.

Rule: a port is not read while its connection has requests left over, nor while the client does not read its replies, so
that memory stays bounded.

Guarantee: an exception while bytes are received or a reply is prepared or made closes that connection only.

Limit: a request is indivisible except for its preparation (`ServerState.prepare_reply`), which is spread over turns.

Which connection has its turn when is decided by `FairScheduler`, at the end of this file. A connection uses three of
its methods:

    bytes arrive -> may_run_now()?  yes -> take the turn at once, then charge() its cost
                                    no  -> submit(); the scheduler calls run_turn() in a later iteration
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
import time
import weakref
from abc import ABC, abstractmethod
from enum import Enum, auto
from heapq import heappop, heappush
from itertools import count
from math import inf
from typing import TYPE_CHECKING, Any, Final, Protocol, cast

from nclient.faults.inject import Language, TcpLanguage
from nclient.protocol.types import N150
from nclient.recording.recorder import NULL_RECORDER, TCP, ConnectionRecorder
from nserver_emu.server.admission import ConnectionTimeouts
from nserver_emu.server.serial_session import Arrival, FaultyChannel, SerialChannel
from nserver_emu.server.session import CLOSED_RETENTION_S, BaseSession, ClientIdentity, CommandHandler, Session

if TYPE_CHECKING:
    from nserver_emu.server.daemon import Daemon

log = logging.getLogger(__name__)

# Time that the turns of all connections together may take in one iteration. Between two iterations the loop polls its
# sockets, which takes some 15 us: 5 % of this.
ITERATION_BUDGET_S: Final = 0.0003
# Time by which the clock must have advanced more than the processor's since the last turn, for the loop to have waited:
# then it has nothing else to do. Without a wait the two differ by 1 us.
MIN_WAIT_S: Final = 0.00001
# Seconds of unused rate that an idle client accumulates.
BURST_S: Final = 0.1
# Bytes read from a port at once.
READ_SIZE: Final = 4096
# A request has at least 4 bytes and takes 2 us to be framed. One request is the
# least that a turn can do: requests differ in cost by a factor of a hundred.
MAX_BYTES_PER_TURN: Final = 512
MAX_REQUESTS_PER_TURN: Final = 1
# The work for one reply is spread over turns until simulated time has advanced so often meanwhile: each step may bring
# new work, and at unlimited speed there is one in each iteration. A ring among a thousand obstacles takes 16 turns of
# some 2 ms.
MAX_PREPARING_STEPS: Final = 16

# Seconds to wait for the second half of a 64-bit CONNECT before it is read as a 32-bit CONNECT to robot 0.
CONNECT_WAIT_S: Final = 1.0
# Socket option that acknowledges received bytes at once; only Linux has it.
_QUICK_ACK: Final[int | None] = getattr(socket, "TCP_QUICKACK", None)
_numbers = count(1)
INTERNAL_ERROR: Final = "%s: internal error; connection closed"


class ConnectionState(Enum):
    """State of a connection's port. `ConnectionHandler` has the transitions."""

    # The port is open without a peer: a pseudo-terminal that no host has opened.
    DISCONNECTED = auto()
    # A peer is there, and its requests are answered.
    OPEN = auto()
    # The peer does not read its replies, so that no request is answered (back-pressure).
    PAUSED = auto()
    # The port is closed for good.
    CLOSED = auto()


class ConnectionHandler(ABC):
    """A connection to the server or to a robot's own line, whatever its transport.

    Data flow, where a channel is a serial line's rate or injected faults (none: no delay):

        port -> data_received -> channel -> _process -> session -> send -> channel -> _write -> port

    Transitions of `state`. It begins with OPEN, for a pseudo-terminal with DISCONNECTED. CLOSED follows any of them:

                       a host opens the link       replies are not read
        DISCONNECTED  ----------------------> OPEN --------------------> PAUSED        (any) ----> CLOSED
                      <----------------------      <--------------------
                          the host leaves            most of them are read

    What is legal in each state. Work is left if the session can answer a request, or its queue can take bytes of the
    backlog. It can do neither once it is `closing` (after DISCONNECT or an invalid frame); the port is then closed as
    soon as the replies are written.

        state          work left   next turn                                  port is read
        OPEN           no          none                                       unless channel or queue is full
        OPEN           yes         queued, or the timer of the rate limit     no
        PAUSED         any         none; a queued one answers no request      no
        DISCONNECTED   no          none                                       no; `tick` looks for a host
        CLOSED         no          none                                       no

    Subclasses implement the transport: `TcpConnection`, `PtyConnection` (serial_lines.py), `ViewerClient`
    (viewer/clients.py).
    """

    # Created by the subclass as soon as the port is open, and anew for each host of a pseudo-terminal.
    session: BaseSession[Any]
    # Name of this line in a fault plan.
    line: str
    # False for a connection whose requests are always answered at once.
    is_scheduled = True
    # True for a connection whose identity another one may continue.
    is_registered = False
    # Address of the client, if it has one.
    host = ""

    def __init__(self, server: Daemon, channel: SerialChannel | None = None) -> None:
        self._server = server
        self._loop = asyncio.get_running_loop()
        self._recorder: ConnectionRecorder = NULL_RECORDER

        # -- The peer --
        self.state = ConnectionState.OPEN
        # Name of this connection where its address must not be named.
        self.number = next(_numbers)
        # The identity last reported by the session.
        self._identity: ClientIdentity | None = None
        # True until the first request: until then the connection may turn out to continue a closed one.
        self._awaits_first_request = True

        # -- The next turn (`Job`): queued, or when the rate limit allows it, never both --
        self.is_queued = False
        self.finish_tag_s = self.cpu_s = 0.0
        self._rate_limit_timer: asyncio.TimerHandle | None = None
        # Requests per second; None is unlimited.
        self._rate_limit: TokenBucket | None = None

        # -- Its work --
        # Bytes received and not yet given to the session.
        self._receive_backlog = b""
        # Steps of simulated time in which the next reply was prepared, and the time of the last, -1 before the first.
        self._preparing_steps = 0
        self._prepared_ps = -1

        # -- The channel between port and session --
        # None passes bytes at once.
        self._channel = channel
        # True once the fault injector is part of it.
        self._has_faults = False
        # True if it was full when last checked, so that reading is suspended.
        self._is_channel_full = False
        # Fires when bytes in it are due.
        self._delivery_timer: asyncio.TimerHandle | None = None
        # True while `_deliver` runs: replies to delivered bytes must not recurse into it.
        self._is_delivering = False
        # Time at which the bytes being processed left it; None without one.
        self._delivered_at_s: float | None = None

    @property
    def is_connected(self) -> bool:
        """True while a peer is there, whether it reads its replies or not."""
        return self.state is ConnectionState.OPEN or self.state is ConnectionState.PAUSED

    # Entry points: port, scheduler and daemon call them. An exception of the session never leaves them.

    def data_received(self, data: bytes) -> None:
        """Accept bytes from the port, any number of them.

        The transport calls it while the connection is OPEN or PAUSED. `_set_reading(False)` asks it to stop; bytes that
        it passes on nevertheless wait in the backlog.
        """
        if self._server.faults.plan.rules:
            self._install_faults()
        if self._channel is None:
            self._process(data)
            return
        self._channel.to_robot(data, self._loop.time())
        self._deliver()

    def run_turn(self) -> None:
        """Do the work of one turn. Only the scheduler calls it, once for each `submit`."""
        self._take_turn(b"")

    def tick(self) -> None:
        """Send the deferred reply if it is complete. The daemon calls it whenever simulated time has passed."""
        session = self.session
        if not (session.waiting or session.unfinished):
            return
        try:
            replies = session.tick()
        except Exception:
            log.exception(INTERNAL_ERROR, session.name)
            self._abort()
            return
        self._send_replies(replies, by_time=True)
        self._schedule()

    def send(self, data: bytes) -> None:
        """Send bytes to the peer, through the channel if there is one.

        It never waits: what the peer does not read at once is buffered by the transport, which then pauses the
        connection, or lost on a line without flow control.
        """
        if self._server.faults.plan.rules:
            self._install_faults()
        if self._channel is None:
            self._write(data)
            return
        self._channel.to_host(data, self._loop.time() if self._delivered_at_s is None else self._delivered_at_s)
        self._deliver()

    # A turn.

    def _process(self, data: bytes) -> None:
        """Process bytes from the channel in a turn: at once if the scheduler allows it, otherwise later."""
        waits_for_turn = self.is_queued or self._rate_limit_timer is not None
        scheduler, start_s = self._server.scheduler, time.thread_time()
        if not waits_for_turn and (not self.is_scheduled or scheduler.may_run_now(self._loop.time(), start_s)):
            self._take_turn(data)
            taken_s = time.thread_time() - start_s
            self.cpu_s += taken_s
            scheduler.charge(taken_s)
        else:
            self._receive_backlog += data
            self._schedule()

    def _take_turn(self, data: bytes) -> None:
        """Process at most MAX_BYTES_PER_TURN bytes and MAX_REQUESTS_PER_TURN requests; `data` are the latest bytes."""
        session, limit = self.session, self._rate_limit
        # 1. Take the bytes of this turn, the oldest ones; the rest waits in the backlog.
        if self._receive_backlog or len(data) > MAX_BYTES_PER_TURN:
            self._receive_backlog += data
            size = MAX_BYTES_PER_TURN if self._has_backlog else 0
            data, self._receive_backlog = self._receive_backlog[:size], self._receive_backlog[size:]
        try:
            # 2. The session finds the requests in them.
            if data:
                self._recorder.to_robot(data)
                session.receive(data)
            # 3. It answers the next one, unless the peer does not read, its rate limit is used up, or the reply needs
            #    more preparation.
            is_in_rate = limit is None or not self._rate_limit_wait_s()
            may_answer = self.state is ConnectionState.OPEN and is_in_rate and self._prepare_next_reply()
            has_request, answered_before = session.ready, session.answered
            replies = session.process_requests(MAX_REQUESTS_PER_TURN) if may_answer else b""
        except Exception:
            log.exception(INTERNAL_ERROR, session.name)
            self._abort()
            return
        # 4. Send the reply.
        if may_answer:
            self._send_replies(replies, has_request)
            if limit is not None:
                limit.consume(session.answered - answered_before, self._loop.time())
        # 5. Schedule the next turn if work is left; otherwise read from the port.
        self._schedule()

    @property
    def _has_backlog(self) -> bool:
        """True if received bytes wait and the session can take them."""
        if not self._receive_backlog:
            return False
        session = self.session
        return not (session.ready or session.is_queue_full or session.closing)

    def _prepare_next_reply(self) -> bool:
        """Do part of the work for the next reply; return True if it can be made now, False if later turns are needed.

        Other connections get their turns in between, so time may pass and bring new work. After MAX_PREPARING_STEPS
        the reply is made with whatever is left to do.
        """
        server, session = self._server, self.session
        if session.ready and self.is_scheduled and server.handler is server.emulator:
            if not server.emulator.prepare_reply(session.context, session.call_to_prepare()):
                now_ps = server.emulator.simulation.time_ps
                if now_ps != self._prepared_ps:
                    self._preparing_steps += 1
                    self._prepared_ps = now_ps
                if self._preparing_steps < MAX_PREPARING_STEPS:
                    return False
            self._preparing_steps, self._prepared_ps = 0, -1
        return True

    def _send_replies(self, replies: bytes, has_request: bool = False, by_time: bool = False) -> None:
        """Send what the session has returned, and do what its new state requires.

        Parameters
        ----------
        replies
            Encoded replies; empty if there is none, or it is deferred.
        has_request
            True if a request was processed.
        by_time
            True for a deferred reply that simulated time has completed.
        """
        session = self.session
        if has_request or replies:
            self._recorder.to_host(replies, by_time)
        if replies:
            self.send(replies)
        if session.closing:
            self._close_port()
        if session.identity is not self._identity or (has_request and self._awaits_first_request):
            self._identity, self._awaits_first_request = session.identity, False
            if self.is_registered:
                self._server.client_registry.register(self, self.host, self._identity)

    # The next turn.

    def _schedule(self) -> None:
        """Schedule the next turn if work is left, and read from the port only if none is left.

        During a deferred reply (ws, zr) reading continues until the queue is full, so that a closed connection is
        noticed.
        """
        session, is_open = self.session, self.state is ConnectionState.OPEN
        is_ready = is_open and (session.ready or self._has_backlog)
        if is_ready and self._rate_limit_timer is None and not self.is_queued:
            if wait_s := self._rate_limit_wait_s():
                self._rate_limit_timer = self._loop.call_later(wait_s, self._on_rate_limit_timer)
            else:
                self._server.scheduler.submit(self)
        self._is_channel_full = self._channel is not None and self._channel.full
        self._set_reading(is_open and not (is_ready or self._is_channel_full or session.is_queue_full))

    def _on_rate_limit_timer(self) -> None:
        self._rate_limit_timer = None
        self._schedule()

    def _rate_limit_wait_s(self) -> float:
        """Return the seconds until the rate limit allows the next turn, 0 for now."""
        return 0.0 if self._rate_limit is None else self._rate_limit.wait_s(self._loop.time())

    def _cancel_timers(self) -> None:
        """Cancel the next turn and deliveries that are due later."""
        for timer in (self._rate_limit_timer, self._delivery_timer):
            if timer is not None:
                timer.cancel()
        self._rate_limit_timer = self._delivery_timer = None
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
            while channel is not None and (arrival := channel.arrived(self._loop.time())):
                self._handle_arrival(arrival)
                # Faults may have been put in front of it, or the host of a pseudo-terminal may have been disconnected.
                channel = self._channel
        finally:
            self._is_delivering = False
        # 2. Wake up for the next piece.
        if self._delivery_timer is not None:
            self._delivery_timer.cancel()
        due_s = None if channel is None else channel.due_s
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
            self._process(arrival.data)
            self._delivered_at_s = None
        else:
            self._write(arrival.data)

    def _install_faults(self) -> None:
        """Put the fault injector into the channel as soon as a plan acts on this line and no frame is incomplete."""
        faults, line = self._server.faults, self.line
        is_mid_request = self.session.unfinished or self._receive_backlog
        if self._has_faults or is_mid_request or not faults.acts_on(line):
            return
        self._has_faults = True
        self._channel = FaultyChannel(self._language(), lambda: faults.injector(line), self._channel)

    # Implemented by the transport.

    @abstractmethod
    def _language(self) -> Language:
        """Return the framing of this line, which the fault injector needs; called between two frames."""

    @abstractmethod
    def _write(self, data: bytes) -> None:
        """Write to the port without waiting: buffer or drop what it cannot take at once."""

    @abstractmethod
    def _set_reading(self, on: bool) -> None:
        """Read from the port, or suspend reading; called after each turn, mostly without a change."""

    def _close_port(self) -> None:
        """Close the connection after the replies in its buffer are sent."""
        self.close()

    def _abort(self) -> None:
        """Close the connection now and drop its buffer."""
        self._close_port()

    @abstractmethod
    def close(self) -> None:
        """Close the connection because the server stops."""


class TcpConnection(ConnectionHandler, asyncio.BufferedProtocol):
    """A client's TCP connection to the port of Nserver."""

    line = "nserver"
    is_registered = True

    def __init__(self, server: Daemon) -> None:
        super().__init__(server)
        limits, now_s = server.admission.limits, self._loop.time()
        # Executes the calls of the session.
        self._handler: CommandHandler = server.handler
        self._rate_limit = TokenBucket(limits.rate, MAX_REQUESTS_PER_TURN, now_s) if limits.rate else None

        # -- The socket --
        # Receive buffer, reused: asyncio fills it in place.
        self._buffer = bytearray(READ_SIZE)
        self._is_reading = True

        # -- Timeouts --
        self.opened_s = now_s
        self._timeouts = ConnectionTimeouts(limits.idle, limits.stall, now_s)
        # Fires when they are to be checked; None without any.
        self._timeout_check: asyncio.TimerHandle | None = None
        # True once the reason of the end is logged.
        self._is_end_logged = False
        # Fires if a CONNECT of a 64-bit client remains incomplete.
        self._connect_timer: asyncio.TimerHandle | None = None

    # asyncio.BufferedProtocol: asyncio calls these, `connection_made` first and `connection_lost` last.

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
        self.state = ConnectionState.CLOSED
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
        if not self._is_end_logged and (exc or session.unfinished):
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
        """Return the receive buffer, which is reused for every read: its bytes are valid in `buffer_updated` only."""
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
        """Stop answering requests: the client leaves more than --limit-write-queue bytes of replies unread."""
        self.state = ConnectionState.PAUSED
        self._schedule()

    def resume_writing(self) -> None:
        """Continue to answer requests: the client has read most of them."""
        self.state = ConnectionState.OPEN
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
        is_stalled = self.state is ConnectionState.PAUSED or (bool(self.session.unfinished) and not is_waiting)
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
        self._is_end_logged = True
        self._abort()


# Scheduling: which job has its turn in which iteration. Nothing below knows bytes or requests.


class Job(Protocol):
    """A connection, or anything else that shares the event loop."""

    # True while it waits in the queue; set to False to withdraw it.
    is_queued: bool = False
    # Virtual time at which its last service ended; its next start tag is not before this.
    finish_tag_s: float = 0.0
    # Processor time that its work has taken so far.
    cpu_s: float = 0.0

    def run_turn(self) -> None:
        """Do the work of one turn, and submit the job again if some is left.

        An exception is logged by the event loop. It delays the other queued jobs to the next iteration and loses none.
        """


class FairScheduler:
    """Start-time fair queueing of jobs by processor time.

    An iteration of the event loop works for at most `ITERATION_BUDGET_S`. While that is not used up and nothing is
    queued, work is done as soon as it arrives (`may_run_now`); all else is queued. So the delay that a client sees does
    not depend on how many requests others send, nor on what they cost; only one call of `run_turn` is indivisible.

    A queued job gets a start tag, the later of the virtual time and its finish tag. The job with the earliest start tag
    runs: its tag becomes the virtual time, and its finish tag is that plus what the work cost. So a job that rested is
    next in line, and jobs with a backlog share equally. Of two such jobs, A with 3 ms a turn and B with 1 ms, B has
    three turns for each of A:

        job             A   B   B   B   A
        start tag, ms   0   0   1   2   3
        finish tag, ms  3   1   2   3   6

    Attributes
    ----------
    iterations, served
        Number of iterations that had queued jobs, and of turns that they ran.

    References
    ----------
    Goyal, Vin and Cheng, Start-time fair queueing, SIGCOMM 1996.
    """

    def __init__(self) -> None:
        self.iterations = 0
        self.served = 0
        # Start tag of the job that runs or ran last.
        self._virtual_s = 0.0
        # Queued jobs by start tag. Of equal ones the job that rested longest is first, then the one that came first.
        self._queue: list[tuple[float, float, int, Job]] = []
        # Number of jobs queued so far, the last criterion of that order.
        self._number = 0
        # Jobs submitted since the last run of the queue began: they wait for the next, since the loop must poll its
        # sockets first.
        self._submitted: list[Job] = []
        self._is_run_scheduled = False
        # Time left in this iteration for work that is done at once, and when such work last ended. asyncio does not say
        # when an iteration begins: a wait for sockets, a pause as long as the budget, or a run of the queue begins one.
        self._left_s = ITERATION_BUDGET_S
        self._worked_s = 0.0
        # Loop time less processor time at that work: it grows while the loop waits.
        self._idle_s = -inf

    def __len__(self) -> int:
        return len(self._queue)

    def may_run_now(self, now_s: float, cpu_s: float) -> bool:
        """Return True if work that has just arrived may be done at once.

        The caller must then do it and `charge` what it took; otherwise it must `submit` the job.

        Parameters
        ----------
        now_s, cpu_s
            The event loop's time, and the processor time of its thread.
        """
        if self._is_run_scheduled:
            return False
        idle_s = now_s - cpu_s
        if idle_s >= self._idle_s + MIN_WAIT_S or now_s >= self._worked_s + ITERATION_BUDGET_S:
            # The loop has waited, or done something else for so long, that this is another iteration.
            self._left_s = ITERATION_BUDGET_S
        self._worked_s, self._idle_s = now_s, idle_s
        return self._left_s > 0.0

    def charge(self, taken_s: float) -> None:
        """Charge this iteration for the processor time of work that was done at once."""
        self._left_s -= taken_s
        self._worked_s += taken_s

    def submit(self, job: Job) -> None:
        """Queue a job for a later iteration. It must not be queued already (`Job.is_queued`)."""
        job.is_queued = True
        self._submitted.append(job)
        if not self._is_run_scheduled:
            self._schedule_run()

    def _run_queue(self) -> None:
        """Run queued jobs until the time of this iteration is used up, each at most once."""
        # 1. Jobs submitted since the last run join the queue.
        for job in self._submitted:
            self._number += 1
            heappush(self._queue, (max(self._virtual_s, job.finish_tag_s), job.finish_tag_s, self._number, job))
        self._submitted.clear()
        # 2. Run jobs by their tags. End where a job that has run, and has more to do, would be next: its turn is
        #    in the next iteration, and the jobs behind it must not overtake it.
        self.iterations += 1
        loop = asyncio.get_running_loop()
        now_s = loop.time()
        end_s, earliest_rerun_s = now_s + ITERATION_BUDGET_S, inf
        try:
            while self._queue and now_s < end_s and self._queue[0][0] <= earliest_rerun_s:
                self._virtual_s, _, _, job = heappop(self._queue)
                if job.is_queued:
                    self._run(job)
                    now_s = loop.time()
                    if job.is_queued:
                        earliest_rerun_s = min(earliest_rerun_s, job.finish_tag_s)
        finally:
            # 3. The rest follows in the next iteration, also after an exception, which the event loop logs.
            self._is_run_scheduled = False
            self._left_s, self._worked_s, self._idle_s = end_s - now_s, now_s, now_s - time.thread_time()
            if self._queue or self._submitted:
                self._schedule_run()

    def _schedule_run(self) -> None:
        """Run the queue in the next iteration, after the sockets are read.

        asyncio runs timers that are due after what it read, and callbacks of `call_soon` before: with those a request
        would wait for one more iteration.
        """
        loop = asyncio.get_running_loop()
        self._is_run_scheduled = True
        loop.call_at(loop.time(), self._run_queue)

    def _run(self, job: Job) -> None:
        """Run a job and charge it for its processor time."""
        self.served += 1
        job.is_queued = False
        start_s = time.thread_time()
        job.run_turn()
        taken_s = time.thread_time() - start_s
        job.cpu_s += taken_s
        job.finish_tag_s = self._virtual_s + taken_s


async def end_task(task: asyncio.Task[None] | None) -> None:
    """Cancel a task, and wait for its end; None is none."""
    if task is not None:
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task


class TokenBucket:
    """A limit on requests per second.

    The bucket holds up to `BURST_S` of the rate, at least one turn. It may become negative by the last turn, which is
    then waited for before the next. Times are seconds of a monotonic clock.

    Parameters
    ----------
    rate
        Requests per second, above 0.
    turn
        Maximum number of requests in one turn.
    now_s
        Current time.
    """

    def __init__(self, rate: float, turn: int, now_s: float) -> None:
        self._rate = rate
        self._capacity = max(rate * BURST_S, turn)
        # Requests that may be answered now, when the bucket was last updated.
        self._tokens = self._capacity
        self._updated_s = now_s

    def consume(self, requests: int, now_s: float) -> None:
        """Take tokens for answered requests."""
        self._tokens = min(self._capacity, self._tokens + self._rate * (now_s - self._updated_s)) - requests
        self._updated_s = now_s

    def wait_s(self, now_s: float) -> float:
        """Return the seconds until a request may be answered, 0 for now."""
        return max(0.0, -self._tokens / self._rate - (now_s - self._updated_s))
