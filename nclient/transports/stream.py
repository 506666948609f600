"""The interface of byte streams, the deadline of every wait, TCP connections, and streams within this process.

A stream knows nothing of messages. Two errors leave it: ReplyTimeout if nothing came in time, ConnectionLost if nothing
will ever come. What wraps a stream (a recorder, a fault injector) is a `ByteStream` again.

TcpStream is a TCP connection: every OSError becomes a ConnectionLost that names host and port. MemoryStream is a byte
stream to a peer in this process, such as the emulator: no socket and no waiting.

    address -> entry point of the group `nomad.openers`, by its scheme -> Peer -> MemoryStream

Peers are found by name and never imported here.
"""

from __future__ import annotations

import contextlib
import socket
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Final, Protocol, runtime_checkable

from nclient.errors import AddressError, ConnectionLost, ReplyTimeout, entry_points

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint


@contextlib.contextmanager
def on_error(undo: Callable[[], object]) -> Iterator[None]:
    """Call a function if the block fails, by Ctrl-C too; the error goes on."""
    try:
        yield
    except BaseException:
        undo()
        raise


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


CONNECT_TIMEOUT_S: Final = 5.0
SERVER: Final = "nserver --port"
ROBOT_LINE: Final = "nserver --robotd"
"""Commands that listen on a port in the TCP protocol and in the serial one; errors suggest them."""
_CHUNK: Final = 65536
# Relative, so that 0 s, what has already arrived, is exact.
_TIMEOUT_TOLERANCE: Final = 0.01


class TcpStream:
    """A connection to a TCP port.

    Parameters
    ----------
    host, port
        The address of the listener.
    timeout_s
        Maximum time to connect, and for the other end to take what is sent.
    served_by
        The command that listens on such a port, for error messages.

    Raises
    ------
    ConnectionLost
        If nothing accepts the connection in time.
    """

    # The timeout that the socket has; negative until one was set.
    _socket_timeout_s = -1.0

    def __init__(self, host: str, port: int, timeout_s: float = CONNECT_TIMEOUT_S, *, served_by: str = SERVER) -> None:
        self.name = f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
        self._timeout_s = timeout_s
        try:
            self._socket = socket.create_connection((host, port), timeout_s)
            # Requests are small and each waits for its reply: Nagle's algorithm would only delay them.
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        except (socket.gaierror, UnicodeError) as error:
            raise ConnectionLost(
                f"there is no host {host!r} ({_reason(error)}); is its name right, and this machine on its network?"
            ) from error
        except (OSError, OverflowError) as error:
            raise ConnectionLost(
                f"no answer at {self.name} ({_reason(error)}); is nserver running? `{served_by} {port}`"
            ) from error

    def send(self, data: bytes) -> None:
        """Send all bytes. Raises ConnectionLost."""
        try:
            self._set_timeout(self._timeout_s)
            self._socket.sendall(data)
        except OSError as error:
            raise self._lost(_reason(error)) from error

    def receive(self, deadline: Deadline) -> bytes:
        """Return at least one byte. Raises ReplyTimeout at the deadline, ConnectionLost if the other end has closed."""
        try:
            self._set_timeout(deadline.remaining())
            data = self._socket.recv(_CHUNK)
        except (TimeoutError, BlockingIOError):
            raise ReplyTimeout(f"{self.name} did not answer in time") from None
        except OSError as error:
            raise self._lost(_reason(error)) from error
        if not data:
            raise self._lost("it closed the connection")
        return data

    def close(self) -> None:
        """Close the connection; a `receive` in another thread ends with ConnectionLost."""
        # close() alone does not wake a receive() in another thread.
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()

    def _set_timeout(self, seconds: float) -> None:
        """Set the timeout of the socket, unless it is nearly that: the system call takes as long as a send."""
        if abs(seconds - self._socket_timeout_s) > _TIMEOUT_TOLERANCE * seconds:
            self._socket.settimeout(seconds)
            self._socket_timeout_s = seconds

    def _lost(self, reason: str) -> ConnectionLost:
        return ConnectionLost(f"{self.name} is gone: {reason}; is nserver still running?")


def names_of_this_machine() -> tuple[str, ...]:
    """Return the names under which an Nserver of this machine may listen: loopback, then the one of C clients."""
    return ("localhost", socket.gethostname())


def _reason(error: Exception) -> str:
    return str(getattr(error, "strerror", None) or error)
