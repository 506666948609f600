"""Who comes in at a port: asked before there is a conversation, by the address and by how many are there.

    socket ──> Doorkeeper ──> Connection      or closed at once, without a word, logged once and counted

Rules: a newcomer costs nothing but this question. Who was let in has the socket from then on.

How fast one connection may be answered: a token bucket. Pure; the clock is handed in.

    spend(n, now)      so many answers were given        wait_s(now)      how long until the next may be

Rules: an idle client saves up a tenth of a second's worth, or one turn's; a turn that began is finished, and what it
took too much is waited for before the next.

How long a connection is put up with that says nothing, or stops in the middle. Pure; the clock is handed in.

    idle     nothing came for so long, and no answer is outstanding
    stuck    a request is begun, or replies are not taken, and nothing was answered for so long: a byte now and then
             does not count

Rules: looked at a few times within the shortest limit (`look_s`), so that nothing is counted at each request.
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


@dataclass(slots=True)
class AdmissionControl:
    """The rules of all ports. `turned_away` counts those who were not let in."""

    limits: Limits = field(default_factory=Limits)
    access: Allowlist = field(default_factory=Allowlist)
    rejected: int = 0

    def rejection_reason(self, host: str, present: Collection[str], at: str = "") -> str:
        """Why a newcomer from this address may not come in; empty: he may. `present`: addresses of those who are;
        `at`: the one of ours that he came to."""
        if not self.access.allows(host, at):
            return NOT_ALLOWED
        if len(present) >= self.limits.connections:
            return f"there are {len(present)} connections already (--limit-connections)"
        if sum(one == host for one in present) >= self.limits.per_address:
            return f"there are {self.limits.per_address} connections from there already (--limit-per-address)"
        return ""

    def reject(self, host: str, reason: str) -> None:
        """He was not let in."""
        self.rejected += 1
        level = logging.WARNING if self.rejected == 1 else logging.DEBUG
        log.log(level, "%s: turned away: %s (further ones are counted, and logged at debug)", host, reason)


class Rules(Protocol):
    """Whose port it is: whether a newcomer may come in, and who is told where not."""

    def rejection_reason(self, host: str, present: Collection[str], at: str = "") -> str:
        """As Door has it."""
        ...

    def reject(self, host: str, reason: str) -> None:
        """As Door has it."""
        ...


class AdmissionProtocol(asyncio.Protocol):
    """See the head of this file. `who` makes the one who talks, `present` tells the addresses of those who do."""

    def __init__(
        self, door: Rules, present: Callable[[], Collection[str]], who: Callable[[], asyncio.BaseProtocol]
    ) -> None:
        self._door, self._present, self._who = door, present, who

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        peer, own = transport.get_extra_info("peername"), transport.get_extra_info("sockname")
        host = peer[0] if peer else ""
        reason = self._door.rejection_reason(host, self._present(), own[0] if own else "")
        if reason:
            self._door.reject(host, reason)
            transport.close()
            return
        inside = self._who()
        transport.set_protocol(inside)
        inside.connection_made(transport)


SAVED_S: Final = 0.1


class TokenBucket:
    """`rate`: answers a second, more than 0; `turn`: the most that are given at once."""

    def __init__(self, rate: float, turn: int, now_s: float) -> None:
        self._rate = rate
        self._most = max(rate * SAVED_S, turn)
        self._left = self._most
        self._at_s = now_s

    def consume(self, count: int, now_s: float) -> None:
        """So many were given."""
        self._left = min(self._most, self._left + self._rate * (now_s - self._at_s)) - count
        self._at_s = now_s

    def wait_s(self, now_s: float) -> float:
        """Seconds until one more may be given; 0 for now."""
        return max(0.0, -self._left / self._rate - (now_s - self._at_s))


_LOOKS: Final = 4
"""Looks within the shortest limit: a limit is kept to a quarter of it."""


@dataclass(slots=True)
class ConnectionTimeouts:
    """Limits in seconds, 0 for none, and since when the connection is as it is."""

    idle_s: float
    stall_s: float
    now_s: float
    _stuck_s: float | None = None
    _answered: int = 0
    _heard_s: float = 0.0

    def __post_init__(self) -> None:
        self._heard_s = self.now_s

    @property
    def check_interval_s(self) -> float | None:
        """How often to look; None: never."""
        return min((limit / _LOOKS for limit in (self.idle_s, self.stall_s) if limit), default=None)

    def heard(self, now_s: float) -> None:
        """Something came, or is being waited for."""
        self._heard_s = now_s

    def timeout_reason(self, now_s: float, answered: int, stuck: bool) -> str:
        """Why the connection should end; empty for not yet. `answered`: requests so far; `stuck`: in the middle."""
        if not stuck or answered != self._answered or self._stuck_s is None:
            self._stuck_s, self._answered = now_s if stuck else None, answered
        elif self.stall_s and now_s - self._stuck_s >= self.stall_s:
            return f"stopped in the middle of a request, or took no replies, for {self.stall_s:g} s"
        if self.idle_s and now_s - self._heard_s >= self.idle_s:
            return f"said nothing for {self.idle_s:g} s"
        return ""
