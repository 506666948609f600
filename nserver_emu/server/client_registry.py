"""Who is connected from where, for clients that go on over a second connection without another CONNECT.

    second connection from an address  ──>  first: one whose connection said nothing since its CONNECT, the oldest
                                            else:  the one that connected last

Rules: a width of words that the newcomer's first bytes tell leaves out all others. A connection goes on for one only,
as long as there are silent ones. Whoever closes is forgotten, once nobody is there from that address who has yet to say
who he is; so is, at a DISCONNECT over the second connection, the first. No sockets: a guest is whatever stands for a
connection.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from typing import Final

from nserver_emu.server.session import ClientIdentity

CLOSED_RETENTION_S: Final = 0.2
"""Who closes a connection and goes on over one made before is seen to close before the other is seen to be there."""


@dataclass(slots=True)
class _Guest:
    host: str
    identity: ClientIdentity
    continued: bool = False
    gone: bool = False


class ClientRegistry:
    """See the head of this file."""

    def __init__(self) -> None:
        self._guests: dict[Hashable, _Guest] = {}
        self._first_of: dict[Hashable, Hashable] = {}
        self._unknown: dict[Hashable, str] = {}

    def __len__(self) -> int:
        return len(self._guests)

    def add_pending(self, guest: Hashable, host: str) -> None:
        """Somebody has connected, and said nothing yet."""
        self._unknown[guest] = host

    def register(self, guest: Hashable, host: str, met: ClientIdentity | None) -> None:
        """What a connection has agreed by now; None: nothing."""
        known = self._guests.get(guest)
        if met is None:
            self._guests.pop(guest, None)
        elif known is None:
            self._guests[guest] = _Guest(host, met)
        else:
            known.identity = met
        self._tell_apart(guest)

    def lookup(self, guest: Hashable, host: str, wide: bool | None) -> ClientIdentity | None:
        """Whom a new connection from this address goes on for; `wide` as its first bytes tell, None: they do not."""
        here = {
            other: known
            for other, known in self._guests.items()
            if known.host == host and (wide is None or known.identity.wide == wide)
        }
        silent = [other for other, known in here.items() if known.identity.silent and not known.continued]
        first = silent[0] if silent else next(reversed(here), None)
        if first is not None:
            here[first].continued = True
            self._first_of[guest] = first
        self._tell_apart(guest)
        return None if first is None else here[first].identity

    def remove(self, guest: Hashable, *, disconnected: bool = False) -> None:
        """The connection is closed; `disconnected`: it said so, and for its first one too."""
        if guest in self._guests:
            self._guests[guest].gone = True
        first = self._first_of.pop(guest, None)
        if disconnected:
            self._guests.pop(guest, None)
            self._guests.pop(first, None)
        self._tell_apart(guest)

    def _tell_apart(self, guest: Hashable) -> None:
        """This one is no longer unknown: nobody waits any more for those who have gone, where it was the last."""
        self._unknown.pop(guest, None)
        waiting = set(self._unknown.values())
        for other in [other for other, known in self._guests.items() if known.gone and known.host not in waiting]:
            del self._guests[other]
