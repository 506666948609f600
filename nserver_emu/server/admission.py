"""Listening sockets and limits on connections: admission and timeouts.

The path of a new connection:

    socket -> AdmissionProtocol -> TcpConnection      or closed at once without a reply, logged and counted

Connections that do nothing cannot lock others out: at a limit the longest idle one is closed for a new one, and a few
more are accepted for a short time, so that `nomad stop` gets through (`ConnectionReserve`).
"""

import asyncio
import contextlib
import errno
import logging
import os
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from typing import Any, Final, Protocol

from nclient.common.allowlist import NOT_ALLOWED, Allowlist
from nserver_emu.server.limits import Limits

log = logging.getLogger(__name__)

# Connections accepted per turn of the event loop and listening socket. asyncio accepts up to its backlog, 100 by
# default, and then runs the first reads of all of them in one turn: 30 ms beside a client that connects all the time.
ACCEPTS_PER_TURN: Final = 1
# Connections that the system queues meanwhile, per listening socket.
LISTEN_BACKLOG: Final = 128

# Seconds without a request after which a connection may be closed for a new one.
MIN_IDLE_S: Final = 10.0
# Connections beyond the limits, and how long each may stay there. `nomad stop` takes some milliseconds, after which
# its connection may be closed for the next.
RESERVED_CONNECTIONS: Final = 8
RESERVED_S: Final = 2.0
MIN_RESERVED_S: Final = 0.1

# Errors of accept() where the process or the system has no more descriptors or memory.
OUT_OF_RESOURCES: Final = frozenset({errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM})
# Connections that are then accepted to be closed, so that their clients do not wait.
MAX_CLOSED_AT_ONCE: Final = 20

# Timeout checks within the shortest timeout: it is exceeded by at most a quarter.
_CHECKS_PER_TIMEOUT: Final = 4


@dataclass(slots=True)
class AdmissionControl:
    """The rules of all listening ports."""

    limits: Limits = field(default_factory=Limits)
    access: Allowlist = field(default_factory=Allowlist)
    # Number of rejected connections.
    rejected: int = 0

    def rejection_reason(self, host: str, present: Collection[str], at: str = "") -> str:
        """Return the reason to reject a new connection, empty to accept it.

        Parameters
        ----------
        host
            Address of the client.
        present
            Addresses of all open connections.
        at
            The local address that the client connected to.
        """
        # 1. Permitted addresses.
        if not self.access.allows(host, at):
            return NOT_ALLOWED
        # 2. Limits, in total and per address.
        if len(present) >= self.limits.connections:
            return f"there are {len(present)} connections already (--limit-connections)"
        if sum(one == host for one in present) >= self.limits.per_address:
            return f"there are {self.limits.per_address} connections from there already (--limit-per-address)"
        return ""

    def reject(self, host: str, reason: str) -> None:
        """Count and log a rejected connection."""
        self.rejected += 1
        log.warning("%s: rejected: %s", host, reason, extra={"address": host})


async def listen(protocol_factory: Callable[[], asyncio.BaseProtocol], host: str, port: int) -> asyncio.Server:
    """Listen on a host and port; at most ACCEPTS_PER_TURN connections are accepted per turn. Raise OSError."""
    loop = asyncio.get_running_loop()
    server = await loop.create_server(protocol_factory, host, port, backlog=ACCEPTS_PER_TURN)
    # asyncio has one number for both; a second `listen` sets that of the system only.
    for listener in server.sockets:
        with listener.dup() as same:
            same.listen(LISTEN_BACKLOG)
    return server


class AdmissionRules(Protocol):
    """The rules of one port."""

    def rejection_reason(self, host: str, present: Collection[str], at: str = "") -> str:
        """Return the reason to reject a new connection, empty to accept it."""

    def reject(self, host: str, reason: str) -> None:
        """Count and log a rejected connection."""


class AdmissionProtocol(asyncio.Protocol):
    """Accept or reject a new connection, then hand its transport to the protocol that serves it.

    Parameters
    ----------
    rules
        The rules of the port.
    present
        Returns the addresses of all open connections.
    new_protocol
        Creates the protocol of an accepted connection.
    make_room
        Called with an address that a limit rejects; returns True if the connection is accepted all the same.
    """

    def __init__(
        self,
        rules: AdmissionRules,
        present: Callable[[], Collection[str]],
        new_protocol: Callable[[], asyncio.BaseProtocol],
        make_room: Callable[[str], bool] = lambda _host: False,
    ) -> None:
        self._rules, self._present, self._new_protocol = rules, present, new_protocol
        self._make_room = make_room

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Admit the connection to its own protocol, or close it."""
        # A connection that is closed immediately may have no peer any more.
        peer, own = transport.get_extra_info("peername"), transport.get_extra_info("sockname")
        host = peer[0] if peer else ""
        reason = self._rules.rejection_reason(host, self._present(), own[0] if own else "")
        if reason and (reason == NOT_ALLOWED or not self._make_room(host)):
            self._rules.reject(host, reason)
            transport.close()
            return
        protocol = self._new_protocol()
        transport.set_protocol(protocol)
        protocol.connection_made(transport)


class ReservableConnection(Protocol):
    """A connection that may have to make room for another."""

    host: str
    opened_s: float

    @property
    def idle_s(self) -> float:
        """Seconds since the last bytes from the client."""

    def close_because(self, reason: str) -> None:
        """Close the connection now and log the reason."""


class ConnectionReserve:
    """Room for new connections where the limits are reached.

    Parameters
    ----------
    admission
        The limits.
    may_close
        Returns False for a connection that must stay, since closing it would stop a robot.
    """

    def __init__(self, admission: AdmissionControl, may_close: Callable[[ReservableConnection], bool]) -> None:
        self._admission, self._may_close = admission, may_close

    def make_room(self, host: str, present: Collection[ReservableConnection], now_s: float) -> bool:
        """Return True if a connection from an address is accepted though a limit is reached."""
        # 1. The place of an idle connection.
        is_full = len(present) >= self._admission.limits.connections
        if self._close_idle(host, present, is_full):
            return True
        # 2. A place of the reserve, if necessary that of the connection which has been there longest.
        reserved = self.reserved(present)
        if len(reserved) < RESERVED_CONNECTIONS:
            return True
        if now_s - reserved[0].opened_s < MIN_RESERVED_S or not self._may_close(reserved[0]):
            return False
        self._close(reserved[0])
        return True

    def check(self, present: Collection[ReservableConnection], now_s: float) -> None:
        """Close the connections that were in the reserve for too long, or others that are idle by now."""
        is_full = len(present) > self._admission.limits.connections
        for connection in self.reserved(present):
            if now_s - connection.opened_s < RESERVED_S or not self._may_close(connection):
                continue
            if not self._close_idle(connection.host, present, is_full):
                self._close(connection)

    def _close_idle(self, host: str, present: Collection[ReservableConnection], is_full: bool) -> bool:
        """Close the longest idle connection: of all, or of this address if only its own limit is reached."""
        pool = present if is_full else [one for one in present if one.host == host]
        idle = [one for one in pool if one.idle_s >= MIN_IDLE_S and self._may_close(one)]
        if idle:
            max(idle, key=lambda one: one.idle_s).close_because("idle, and its place is needed for a new connection")
        return bool(idle)

    def reserved(self, present: Collection[ReservableConnection]) -> list[ReservableConnection]:
        """Return the connections beyond a limit, oldest first."""
        limits, beyond, counts = self._admission.limits, [], dict[str, int]()
        for number, connection in enumerate(sorted(present, key=lambda one: one.opened_s), 1):
            counts[connection.host] = counts.get(connection.host, 0) + 1
            if number > limits.connections or counts[connection.host] > limits.per_address:
                beyond.append(connection)
        return beyond

    def _close(self, connection: ReservableConnection) -> None:
        self._admission.rejected += 1
        connection.close_because("--limit-connections or --limit-per-address is reached")


ExceptionHandler = Callable[[asyncio.AbstractEventLoop, dict[str, Any]], object]


class AcceptErrorHandler:
    """Exception handler of an event loop: accept() without a free descriptor is one line in the log, not a traceback.

    asyncio then leaves the port alone for a second. Two spare descriptors, one for the port and one for the
    connection, serve to close what waits there.
    """

    def __init__(self, previous: ExceptionHandler | None = None) -> None:
        # Handles all other errors; None: asyncio does.
        self.previous = previous
        self._spare = [os.open(os.devnull, os.O_RDONLY) for _ in range(2)]
        self.failed = 0
        """Number of times that no connection could be accepted."""

    def __call__(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """Handle an error that asyncio reports."""
        error, listener = context.get("exception"), context.get("socket")
        if not isinstance(error, OSError) or error.errno not in OUT_OF_RESOURCES or listener is None:
            if self.previous is None:
                loop.default_exception_handler(context)
            else:
                self.previous(loop, context)
            return
        self.failed += 1
        log.error("no connection can be accepted for a second: %s", error.strerror, extra={"address": "all"})
        self.close()
        with contextlib.suppress(OSError), listener.dup() as port:
            for _ in range(MAX_CLOSED_AT_ONCE):
                port.accept()[0].close()
        with contextlib.suppress(OSError):
            self._spare = [os.open(os.devnull, os.O_RDONLY) for _ in range(2)]

    def close(self) -> None:
        """Free the spare descriptors."""
        while self._spare:
            os.close(self._spare.pop())


@dataclass(slots=True)
class ConnectionTimeouts:
    """Idle and stall timeouts of one connection; 0 disables one. Times are seconds of a monotonic clock.

    idle     nothing was received for `idle_s`, and no reply is deferred
    stall    a request is incomplete or replies are not read, and nothing was answered for `stall_s`; single bytes do
             not reset it
    """

    idle_s: float
    stall_s: float
    now_s: float
    # Since when the connection is stalled, and the requests answered by then.
    _stalled_s: float | None = None
    _answered: int = 0
    # Time of the last bytes received; set it to reset the idle timeout.
    active_s: float = 0.0

    def __post_init__(self) -> None:
        self.active_s = self.now_s

    @property
    def check_interval_s(self) -> float | None:
        """Seconds between checks, None for no checks: cheaper than a timer restarted at each request."""
        return min((limit / _CHECKS_PER_TIMEOUT for limit in (self.idle_s, self.stall_s) if limit), default=None)

    def timeout_reason(self, now_s: float, answered: int, is_stalled: bool) -> str:
        """Return the reason to close the connection, empty to keep it open.

        Parameters
        ----------
        now_s
            Current time.
        answered
            Number of requests answered so far.
        is_stalled
            True if a request is incomplete or replies are not read.
        """
        if not is_stalled or answered != self._answered or self._stalled_s is None:
            self._stalled_s, self._answered = now_s if is_stalled else None, answered
        elif self.stall_s and now_s - self._stalled_s >= self.stall_s:
            return f"incomplete request, or replies not read, for {self.stall_s:g} s"
        if self.idle_s and now_s - self.active_s >= self.idle_s:
            return f"idle for {self.idle_s:g} s"
        return ""
