"""The interface of byte streams, the deadline of every wait, and streams within this process.

A stream knows nothing of messages. Two errors leave it: ReplyTimeout if nothing came in time, ConnectionLost if nothing
will ever come. What wraps a stream (a recorder, a fault injector) is a `ByteStream` again.

MemoryStream is a byte stream to a peer in this process, such as the emulator: no socket and no waiting.

    address -> entry point of the group `nomad.openers`, by its scheme -> Peer -> MemoryStream

Peers are found by name and never imported here.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Final, Protocol, runtime_checkable

from nclient.errors import AddressError, ConnectionLost, ReplyTimeout, entry_points

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint


class Deadline:
    """A moment on a clock in seconds: the monotonic one unless another is given, such as that of a simulation."""

    __slots__ = ("_at_s", "_clock")

    def __init__(self, at_s: float, clock: Callable[[], float] | None = None) -> None:
        self._at_s = at_s
        self._clock = clock or time.monotonic

    @classmethod
    def after(cls, seconds: float, clock: Callable[[], float] | None = None) -> Deadline:
        """Return the deadline that many seconds from now."""
        clock = clock or time.monotonic
        return cls(clock() + seconds, clock)

    def remaining(self) -> float:
        """Return the seconds left, 0 if the deadline has passed."""
        return max(0.0, self._at_s - self._clock())


class ByteStream(Protocol):
    """Bytes to and from the other end of a connection."""

    def send(self, data: bytes) -> None:
        """Send all bytes. Raises ConnectionLost."""

    def receive(self, deadline: Deadline) -> bytes:
        """Return at least one byte, as soon as there is one.

        A deadline that has passed still returns what has already arrived.

        Raises
        ------
        ReplyTimeout
            If nothing arrives before the deadline.
        ConnectionLost
            If either end has closed the connection.
        """

    def close(self) -> None:
        """Close the stream; a `receive` in another thread ends with ConnectionLost. May be called twice."""


GROUP: Final = "nomad.openers"
"""Entry points: the name is a scheme, the object a function from an address to a `Peer`."""


class Peer(Protocol):
    """The other end of a `MemoryStream`."""

    def send(self, data: bytes) -> None:
        """Process bytes from the client."""

    def receive(self) -> bytes:
        """Return the replies so far; empty if nothing more comes until something is sent."""

    def close(self) -> None:
        """Close: the client has disconnected."""


@runtime_checkable
class LinePeer(Peer, Protocol):
    """A peer that speaks the serial protocol."""

    def beside(self) -> Peer:
        """Return a peer of the same simulation that speaks the TCP protocol and whose requests take no time."""


class MemoryStream:
    """A stream to a peer in this process. Deadlines have no effect: a reply is there at once or never."""

    def __init__(self, peer: Peer) -> None:
        self._peer: Peer | None = peer

    def send(self, data: bytes) -> None:
        """Pass the bytes to the peer. Raises ConnectionLost after `close`."""
        self._open_peer().send(data)

    def receive(self, deadline: Deadline) -> bytes:
        """Return the peer's replies. Raises ReplyTimeout at once if there are none, ConnectionLost after `close`."""
        del deadline
        data = self._open_peer().receive()
        if not data:
            raise ReplyTimeout("no reply from the peer in this process")
        return data

    def beside(self) -> MemoryStream:
        """Return a stream to the simulation behind a serial line.

        Raises
        ------
        AddressError
            If the peer does not speak the serial protocol.
        """
        peer = self._open_peer()
        if not isinstance(peer, LinePeer):
            raise AddressError("the peer in this process has no serial line: leave line=1 out")
        return MemoryStream(peer.beside())

    def close(self) -> None:
        """Close the peer. May be called twice."""
        # The peer is closed once, however often the stream is.
        if self._peer is not None:
            self._peer.close()
            self._peer = None

    def _open_peer(self) -> Peer:
        if self._peer is None:
            raise ConnectionLost("this end has closed the connection")
        return self._peer


def in_process_schemes() -> tuple[str, ...]:
    """Return the address schemes that installed packages open in this process, sorted."""
    return tuple(sorted(_openers()))


def open_in_process(scheme: str, address: str) -> MemoryStream:
    """Open a stream to the peer that an address names.

    Raises
    ------
    AddressError
        If no installed package opens the scheme, or its opener cannot be imported. Errors of the opener itself
        (AddressError, WorldFileError, StartError) pass through.
    """
    opener = _openers().get(scheme)
    if opener is None:
        raise AddressError(f"no installed package opens {scheme}: addresses")
    # Loading imports the package, which may be broken or of another version.
    try:
        open_peer = opener.load()
    except (ImportError, AttributeError) as error:
        raise AddressError(f"{scheme}: addresses cannot be opened, {opener.value} does not load: {error}") from error
    return MemoryStream(open_peer(address))


def _openers() -> dict[str, EntryPoint]:
    return {point.name: point for point in entry_points(group=GROUP)}
