"""Who comes in at a port: asked before there is a conversation, by the address and by how many are there.

    socket ──> Doorkeeper ──> Connection      or closed at once, without a word, logged once and counted

Rules: a newcomer costs nothing but this question. Who was let in has the socket from then on.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from typing import Protocol

from nclient.access import NOT_ALLOWED, Access
from nserver_emu.server.admission.limits import Limits

log = logging.getLogger(__name__)


@dataclass(slots=True)
class Door:
    """The rules of all ports. `turned_away` counts those who were not let in."""

    limits: Limits = field(default_factory=Limits)
    access: Access = field(default_factory=Access)
    turned_away: int = 0

    def refusal(self, host: str, present: Collection[str], at: str = "") -> str:
        """Why a newcomer from this address may not come in; empty: he may. `present`: addresses of those who are;
        `at`: the one of ours that he came to."""
        if not self.access.admits(host, at):
            return NOT_ALLOWED
        if len(present) >= self.limits.connections:
            return f"there are {len(present)} connections already (--limit-connections)"
        if sum(one == host for one in present) >= self.limits.per_address:
            return f"there are {self.limits.per_address} connections from there already (--limit-per-address)"
        return ""

    def turn_away(self, host: str, reason: str) -> None:
        """He was not let in."""
        self.turned_away += 1
        level = logging.WARNING if self.turned_away == 1 else logging.DEBUG
        log.log(level, "%s: turned away: %s (further ones are counted, and logged at debug)", host, reason)


class Rules(Protocol):
    """Whose port it is: whether a newcomer may come in, and who is told where not."""

    def refusal(self, host: str, present: Collection[str], at: str = "") -> str:
        """As Door has it."""
        ...

    def turn_away(self, host: str, reason: str) -> None:
        """As Door has it."""
        ...


class Doorkeeper(asyncio.Protocol):
    """See the head of this file. `who` makes the one who talks, `present` tells the addresses of those who do."""

    def __init__(
        self, door: Rules, present: Callable[[], Collection[str]], who: Callable[[], asyncio.BaseProtocol]
    ) -> None:
        self._door, self._present, self._who = door, present, who

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        peer, own = transport.get_extra_info("peername"), transport.get_extra_info("sockname")
        host = peer[0] if peer else ""
        reason = self._door.refusal(host, self._present(), own[0] if own else "")
        if reason:
            self._door.turn_away(host, reason)
            transport.close()
            return
        inside = self._who()
        transport.set_protocol(inside)
        inside.connection_made(transport)
