"""Identities of connected clients, for old clients that continue over a second connection without another CONNECT.

Such a client's second connection continues one of the connections from the same address:

- one that no other connection continues already, if there are any;
- of these, one that has sent nothing since its CONNECT but the sensor mask, if there are any.

If the remaining ones differ in their robot or word size, the connection is ambiguous and refused: it could be given the
robot of another program, or be misread. A word size seen in its first bytes excludes clients of the other size. The
entry of a closed connection stays while an unidentified connection from the same address is pending. A DISCONNECT
over the second connection removes the entry of the first too.

No sockets: a connection is represented by any hashable key.
"""

from collections.abc import Hashable
from dataclasses import dataclass
from typing import Final

from nserver_emu.server.session import ClientIdentity

# Seconds. The close of one connection may be seen this much earlier than the opening of the one that continues it.
CLOSED_RETENTION_S: Final = 0.2


@dataclass(slots=True)
class _Entry:
    host: str
    identity: ClientIdentity
    is_continued: bool = False
    is_closed: bool = False


class ClientRegistry:
    """Identities of all connections, in the order in which they were registered."""

    def __init__(self) -> None:
        self._entries: dict[Hashable, _Entry] = {}
        # For a connection without CONNECT: the connection that it continues.
        self._continued: dict[Hashable, Hashable] = {}
        # Addresses of connections that have not sent enough to be identified.
        self._pending: dict[Hashable, str] = {}

    def __len__(self) -> int:
        return len(self._entries)

    def add_pending(self, connection: Hashable, host: str) -> None:
        """Add a new connection that is not yet identified."""
        self._pending[connection] = host

    def register(self, connection: Hashable, host: str, identity: ClientIdentity | None) -> None:
        """Set the identity of a connection, None to remove it."""
        entry = self._entries.get(connection)
        if identity is None:
            self._entries.pop(connection, None)
        elif entry is None:
            self._entries[connection] = _Entry(host, identity)
        else:
            entry.identity = identity
        self._resolve(connection)

    def lookup(self, connection: Hashable, host: str, wide: bool | None) -> list[ClientIdentity]:
        """Return the identity that a new connection without CONNECT continues.

        Parameters
        ----------
        connection, host
            The new connection and its address.
        wide
            True for 64-bit words, False for 32-bit words, None if the first bytes do not show it.

        Returns
        -------
        list
            One identity; none if there is no such client; several, with different robots or word sizes, if the
            connection is ambiguous.
        """
        # 1. Entries from this address with a matching word size.
        matching = {
            other: entry
            for other, entry in self._entries.items()
            if entry.host == host and wide in (None, entry.identity.wide)
        }
        # 2. Prefer clients that nothing continues yet, and of these the ones that only connected: old clients open
        #    their second connection right after that.
        originals = {other: entry for other, entry in matching.items() if other not in self._continued}
        fresh = {other: entry for other, entry in originals.items() if not entry.is_continued}
        silent = {other: entry for other, entry in fresh.items() if entry.identity.silent}
        candidates = silent or fresh or originals or matching
        # 3. Continue one if it makes no difference which.
        distinct = {entry.identity[:2]: entry.identity for entry in candidates.values()}
        if len(distinct) == 1:
            first = next(iter(candidates))
            candidates[first].is_continued = True
            self._continued[connection] = first
        self._resolve(connection)
        return list(distinct.values())

    def remove(self, connection: Hashable, *, disconnected: bool = False) -> None:
        """Mark a connection as closed; `disconnected`: after DISCONNECT, which ends the one it continued too."""
        if connection in self._entries:
            self._entries[connection].is_closed = True
        first = self._continued.pop(connection, None)
        if disconnected:
            self._entries.pop(connection, None)
            self._entries.pop(first, None)
        self._resolve(connection)

    def _resolve(self, connection: Hashable) -> None:
        """End the pending state of a connection and drop closed entries that no pending connection can continue."""
        self._pending.pop(connection, None)
        pending_hosts = set(self._pending.values())
        for other in [other for other, e in self._entries.items() if e.is_closed and e.host not in pending_hosts]:
            del self._entries[other]
