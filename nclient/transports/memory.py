"""Bytes to something that answers in this very process: an emulator, without a socket and without waiting.

    address ──> entry point of the group `nomad.openers`, by its scheme ──> a Peer ──> MemoryStream

Rules: what answers is found by name and never imported here; it needs send, receive and close, and no clock.
A robot's own line knows no simulation: whoever wants to look at the one behind it has a second stream (`beside`).
"""

from __future__ import annotations

from importlib.metadata import EntryPoint, entry_points
from typing import Protocol, runtime_checkable

from nclient.errors import AddressError, ConnectionLost, ReplyTimeout
from nclient.transports.stream import Deadline

GROUP = "nomad.openers"
"""Entry points: a scheme each, a function address -> Peer."""


class Peer(Protocol):
    """What answers in this process."""

    def send(self, data: bytes) -> None:
        """Take in bytes, and answer them."""
        ...

    def receive(self) -> bytes:
        """What has been answered; empty when no more will come before something is sent."""
        ...

    def close(self) -> None:
        """The client is gone."""
        ...


@runtime_checkable
class LinePeer(Peer, Protocol):
    """A peer that speaks as a robot's own line does."""

    def beside(self) -> Peer:
        """Another one, of the same simulation, that speaks as a server does; its questions take no time."""
        ...


class MemoryStream:
    """A stream to a peer in this process. No deadline matters: what has not come at once will not come."""

    def __init__(self, peer: Peer) -> None:
        self._peer: Peer | None = peer

    def send(self, data: bytes) -> None:
        """Hand the bytes over. Raises ConnectionLost after `close`."""
        self._open().send(data)

    def receive(self, deadline: Deadline) -> bytes:
        """What the peer has answered. Raises ReplyTimeout at once where that is nothing; ConnectionLost when closed."""
        del deadline
        data = self._open().receive()
        if not data:
            raise ReplyTimeout("what answers in this process has nothing to say to that")
        return data

    def beside(self) -> MemoryStream:
        """A stream to the simulation behind a line. Raises AddressError where what answers has no such thing."""
        peer = self._open()
        if not isinstance(peer, LinePeer):
            raise AddressError("what answers in this process has no robot's own line: leave line=1 out")
        return MemoryStream(peer.beside())

    def close(self) -> None:
        """Let the peer go."""
        if self._peer is not None:
            self._peer.close()
            self._peer = None

    def _open(self) -> Peer:
        if self._peer is None:
            raise ConnectionLost("this end has closed the connection")
        return self._peer


def schemes() -> tuple[str, ...]:
    """The address schemes that something installed here answers in this process."""
    return tuple(sorted(_openers()))


def open_in_process(scheme: str, address: str) -> MemoryStream:
    """A stream to what the address names. Raises AddressError for a scheme without opener, or one that is broken.

    What the opener itself has against the address (AddressError, WorldFileError, StartError) passes through.
    """
    opener = _openers().get(scheme)
    if opener is None:
        raise AddressError(f"nothing installed here answers {scheme}: addresses")
    try:
        opens = opener.load()
    except (ImportError, AttributeError) as error:
        raise AddressError(f"{scheme}: addresses cannot be served, {opener.value} does not load: {error}") from error
    return MemoryStream(opens(address))


def _openers() -> dict[str, EntryPoint]:
    return {point.name: point for point in entry_points(group=GROUP)}
