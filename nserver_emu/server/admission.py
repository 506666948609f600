"""Listening sockets and limits on connections: admission and timeouts.

The path of a new connection:

    socket -> AdmissionProtocol -> TcpConnection      or closed at once without a reply, logged once and counted
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from typing import Final, Protocol

from nclient.common.allowlist import NOT_ALLOWED, Allowlist
from nserver_emu.server.limits import Limits

log = logging.getLogger(__name__)

# Connections accepted per turn of the event loop and listening socket. asyncio accepts up to its backlog, 100 by
# default, and then runs the first reads of all of them in one turn: 30 ms beside a client that connects all the time.
ACCEPTS_PER_TURN: Final = 1
# Connections that the system queues meanwhile, per listening socket.
LISTEN_BACKLOG: Final = 128

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
        """Count and log a rejected connection; only the first is a warning, so that a flood does not fill the log."""
        self.rejected += 1
        level = logging.WARNING if self.rejected == 1 else logging.DEBUG
        log.log(level, "%s: rejected: %s (further ones are counted, and logged at debug)", host, reason)


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
        ...

    def reject(self, host: str, reason: str) -> None:
        """Count and log a rejected connection."""
        ...


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
    """

    def __init__(
        self,
        rules: AdmissionRules,
        present: Callable[[], Collection[str]],
        new_protocol: Callable[[], asyncio.BaseProtocol],
    ) -> None:
        self._rules, self._present, self._new_protocol = rules, present, new_protocol

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Admit the connection to its own protocol, or close it."""
        # A connection that is closed immediately may have no peer any more.
        peer, own = transport.get_extra_info("peername"), transport.get_extra_info("sockname")
        host = peer[0] if peer else ""
        reason = self._rules.rejection_reason(host, self._present(), own[0] if own else "")
        if reason:
            self._rules.reject(host, reason)
            transport.close()
            return
        protocol = self._new_protocol()
        transport.set_protocol(protocol)
        protocol.connection_made(transport)


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
