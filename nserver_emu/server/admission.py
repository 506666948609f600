"""Listening sockets and limits on connections: admission and timeouts.

The path of a new connection:

    socket -> AdmissionProtocol -> TcpConnection      or closed at once without a reply, logged and counted

Connections that do nothing cannot lock others out: at a limit the longest idle one is closed for a new one, and a few
more are accepted for a short time, so that `nomad stop` gets through (`ConnectionReserve`).

Limits per client: one table from which the options, docs/limits.md and the tests are derived.

A new limit is a new field of `Limits`, with its effect and the module that enforces it. `make_room` raises the
process's limit of open files to what the limits on connections need.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import errno
import logging
import os
from collections.abc import Callable, Collection
from dataclasses import dataclass, field, fields
from typing import Any, Final, NamedTuple, Protocol

from nclient.protocol.codec import MAX_UNKNOWN_WORDS
from nclient.transports.listener import NOT_ALLOWED, Allowlist

_LIMIT: Final = "limit"
# Connections that a browser opens for a page at once: six for files, and the websocket.
CONNECTIONS_PER_PAGE: Final = 7
# Maximum size of a snapshot. With default limits it takes a few MB; with a million shapes 200 MB.
SNAPSHOT_BYTES: Final = 1 << 29
# Value that disables a limit, where that is allowed.
NONE: Final = 0


class Limit(NamedTuple):
    """A limit: field, default, range, unit, subject, effect when exceeded, and the module that enforces it."""

    name: str
    default: int
    min: int
    max: int
    unit: str
    guards: str
    reached: str
    where: str
    may_be_none: bool = False

    @property
    def option(self) -> str:
        """Return the command-line option."""
        return f"--limit-{self.name.replace('_', '-')}"


def _limit(default: int, bounds: tuple[int, int], unit: str, guards: str, reached: str, where: str,
           none: bool = False) -> int:
    return field(default=default, metadata={_LIMIT: (*bounds, unit, guards, reached, where, none)})


@dataclass(frozen=True, slots=True)
class Limits:
    """Values of all limits."""

    connections: int = _limit(
        500, (1, 100_000), "connections", "clients, and hosts of serial lines over TCP, in total",
        "the longest idle connection is closed for a new one; else see below", "server/admission.py")
    per_address: int = _limit(
        300, (1, 100_000), "connections", "clients, and hosts of serial lines over TCP, from one address",
        "the longest idle connection is closed for a new one; else see below", "server/admission.py")
    rate: int = _limit(10_000, (10, 1_000_000), "requests per second", "replies to one connection",
                       "requests are read and answered later, as over a slow network; nothing is lost or refused",
                       "server/connection.py", none=True)
    frame: int = _limit(254, (17, 254), "words", "length of a request; only texts and arm packets are long",
                        "ERROR 2; the request is skipped and the connection continues; a request above "
                        f"{MAX_UNKNOWN_WORDS} words closes it", "server/session.py")
    idle: int = _limit(
        14_400, (1, 31_536_000), "seconds", "time without requests from a connection that waits for no reply",
        "it is closed; robots that it drives stop", "server/admission.py", none=True)
    stall: int = _limit(30, (1, 86_400), "seconds", "time for an incomplete request, or for replies that are not read",
                        "it is closed; robots that it drives stop", "server/admission.py", none=True)
    write_queue: int = _limit(
        65_536, (1024, 16_777_216), "bytes", "replies queued for a slow reader",
        "its requests are not processed until it has read most of the replies", "server/connection.py")
    viewers: int = _limit(
        50, (1, 1000), "pages",
        "open viewer pages, as many rosbridge clients, and as many publishers of velocities in ROS 2",
        "the page's websocket is refused with HTTP 503 and retried by the page. The port accepts "
        f"{CONNECTIONS_PER_PAGE} times as many connections; idle ones are closed as by --limit-stall",
        "viewer/server.py")
    page_rate: int = _limit(
        200, (10, 1_000_000), "messages per second", "messages of one page or rosbridge client, and HTTP requests of "
        "one address to their port", "they are handled later; only a rosbridge client's velocities are refused if they "
        "are late by 0.5 s", "viewer/http_port.py", none=True)
    obstacles: int = _limit(
        1000, (1, 100_000), "polygons", "obstacles in the world, and as many inner walls drawn at run time",
        "ERROR 5 to add_obstacle, an error at the page", "server/handlers/world.py")
    graphics: int = _limit(20_000, (1, 1_000_000), "shapes", "shapes drawn by draw_robot, draw_line and draw_arc",
                           "the oldest shape is removed", "server/handlers/graphics.py")
    log: int = _limit(1_000_000_000, (10_000, 10**15), "bytes", "file of --record",
                      "the recording ends, is valid up to there, and the daemon logs it once; the run continues",
                      "nclient/recording/format.py", none=True)

    @property
    def page_connections(self) -> int:
        """Return the maximum number of connections to the viewer's port."""
        return CONNECTIONS_PER_PAGE * self.viewers


TABLE: Final[tuple[Limit, ...]] = tuple(
    Limit(row.name, int(getattr(Limits(), row.name)), *row.metadata[_LIMIT]) for row in fields(Limits)
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add an option for each limit."""
    group = parser.add_argument_group("limits", "limits per client; docs/limits.md describes the effects")
    for row in TABLE:
        none = f"; {NONE}: no limit" if row.may_be_none else ""
        group.add_argument(row.option, type=_reader(row), default=row.default, metavar="N",
                           help=f"at most N {row.unit}: {row.guards} (default: {row.default}{none})")


def limits_of(options: argparse.Namespace) -> Limits:
    """Return the limits that the options set."""
    return Limits(**{row.name: getattr(options, f"{_LIMIT}_{row.name}") for row in TABLE})


def _reader(row: Limit) -> Callable[[str], int]:
    def read(text: str) -> int:
        number = int(text) if text.isdecimal() else -1
        if not row.min <= number <= row.max and not (row.may_be_none and number == NONE):
            none = f", or {NONE} for none" if row.may_be_none else ""
            raise argparse.ArgumentTypeError(f"{row.min} to {row.max} {row.unit}{none}, not {text!r}")
        return number

    return read


log = logging.getLogger(__name__)

# File descriptors of the daemon itself: ports, logs, recordings, lines, event loop.
OTHER_DESCRIPTORS: Final = 64
# Connections that are accepted however few files the process may have open.
MIN_CONNECTIONS: Final = 16


def make_room(connections: int) -> int:
    """Raise the limit of open files for that many connections, and return for how many there is room.

    Logs a warning if these are fewer.
    """
    try:
        import resource
    except ImportError:
        return connections
    wanted = connections + OTHER_DESCRIPTORS
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft == resource.RLIM_INFINITY or soft >= wanted:
        return connections
    may = wanted if hard == resource.RLIM_INFINITY else min(hard, wanted)
    with contextlib.suppress(OSError, ValueError):
        resource.setrlimit(resource.RLIMIT_NOFILE, (may, hard))
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft < wanted:
        log.warning("this process may have %d files open, and --limit-connections and --limit-viewers allow %d: raise "
                    "the limit (ulimit -n, LimitNOFILE=) or lower the options", soft, connections)  # fmt: skip
    return max(MIN_CONNECTIONS, min(connections, soft - OTHER_DESCRIPTORS))


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


def at_port(host: str, port: int) -> str:
    """Return HOST:PORT, with an IPv6 address in brackets."""
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


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

    def __init__(self, rules: AdmissionRules, present: Callable[[], Collection[str]],
                 new_protocol: Callable[[], asyncio.BaseProtocol],
                 make_room: Callable[[str], bool] = lambda _host: False) -> None:
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

    def __call__(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """Handle an error that asyncio reports."""
        error, listener = context.get("exception"), context.get("socket")
        if not isinstance(error, OSError) or error.errno not in OUT_OF_RESOURCES or listener is None:
            if self.previous is None:
                loop.default_exception_handler(context)
            else:
                self.previous(loop, context)
            return
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
    # Time of the last bytes received; set it to reset the idle timeout.
    active_s: float
    # Since when the connection is stalled, and the requests answered by then.
    _stalled_s: float | None = None
    _answered: int = 0

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
