"""A TCP connection as a byte stream. Every OSError becomes a ConnectionLost that names host and port."""

import contextlib
import socket
from typing import Final

from nclient.errors import ConnectionLost, ReplyTimeout
from nclient.transports.stream import Deadline

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
