"""Bytes over a TCP connection, and the host names that mean this machine.

Rules: the only room of the client with a socket. Every OSError leaves as a ConnectionLost that names host and port.
"""

from __future__ import annotations

import contextlib
import socket

from nclient.errors import ConnectionLost, ReplyTimeout
from nclient.transports.stream import Deadline

CONNECT_TIMEOUT_S = 5.0
SERVER, ROBOT_LINE = "nserver --port", "nserver --robotd"
"""What listens at a port in the language of an Nserver, and in a robot's own."""
_CHUNK = 65536


class TcpStream:
    """A connection to host and port. Raises ConnectionLost when nobody answers there within `timeout_s`.

    What is sent must be taken by the other end within the same time. `served_by`: the command that listens so at a
    port, for the errors.
    """

    def __init__(
        self, host: str, port: int, timeout_s: float = CONNECT_TIMEOUT_S, *, served_by: str = SERVER
    ) -> None:
        self.name = f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
        self._timeout_s = timeout_s
        try:
            self._socket = socket.create_connection((host, port), timeout_s)
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        except (socket.gaierror, UnicodeError) as error:
            raise ConnectionLost(
                f"there is no host {host!r} ({_reason(error)}); is its name right, and this machine on its network?"
            ) from error
        except (OSError, OverflowError) as error:
            raise ConnectionLost(
                f"nobody answers at {self.name} ({_reason(error)}); is nserver running? `{served_by} {port}`"
            ) from error

    def send(self, data: bytes) -> None:
        """Send all of it. Raises ConnectionLost."""
        try:
            self._socket.settimeout(self._timeout_s)
            self._socket.sendall(data)
        except OSError as error:
            raise self._lost(_reason(error)) from error

    def receive(self, deadline: Deadline) -> bytes:
        """At least one byte. Raises ReplyTimeout at the deadline, ConnectionLost when the other end has closed."""
        try:
            self._socket.settimeout(deadline.remaining())
            data = self._socket.recv(_CHUNK)
        except (TimeoutError, BlockingIOError):
            raise ReplyTimeout(f"{self.name} did not answer in time") from None
        except OSError as error:
            raise self._lost(_reason(error)) from error
        if not data:
            raise self._lost("it closed the connection")
        return data

    def close(self) -> None:
        """Close the connection; what waits in `receive` on another thread ends with ConnectionLost."""
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()

    def _lost(self, reason: str) -> ConnectionLost:
        return ConnectionLost(f"{self.name} is gone: {reason}; is nserver still running?")


def names_of_this_machine() -> tuple[str, ...]:
    """The names an Nserver on this machine may listen under: loopback, and the one that C clients take."""
    return ("localhost", socket.gethostname())


def _reason(error: Exception) -> str:
    return str(getattr(error, "strerror", None) or error)
