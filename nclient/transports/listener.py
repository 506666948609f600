"""Listening: the addresses that may connect and those to listen on, and listeners on TCP ports and pseudo-terminals.

Listeners: a TCP port or a pseudo-terminal that serves one connection after the other.

    listener.accept()               the next connection, as a ByteStream
    listener.has_pending_request()  True if another client has sent something meanwhile; to be polled

TCP connections wait in an `AcceptQueue`. Those that have sent something are served first, so that idle connections,
however many, do not block a client with a request. A pseudo-terminal stands behind a symbolic link; POSIX only.

Network addresses: those that may connect, and those to listen on.

    --allow ADDRESS[/BITS]    of all servers        [HOST:]PORT    of the page and of rosbridge

Without --allow every address may connect; with it the listed networks, and always this machine, by any of its
addresses. A peer name that is no IP address (a Unix socket) is on this machine. An IPv4 address mapped to IPv6 counts
as the IPv4 address.
"""

from __future__ import annotations

import argparse
import contextlib
import ipaddress
import os
import select
import socket
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple, TypeVar

from nclient.errors import ConnectionLost, ReplyTimeout
from nclient.transports.stream import ByteStream, Deadline, TcpStream

T = TypeVar("T")
Network = ipaddress.IPv4Network | ipaddress.IPv6Network
LOOPBACK: Final = "127.0.0.1"
LOOPBACK_NAME: Final = "localhost"
NOT_ALLOWED: Final = "that address is not allowed (--allow)"
"""Reason for rejecting a connection."""
DRIVES: Final = "may drive the robots"
"""What a client of most ports may do, for the warning."""


@dataclass(frozen=True, slots=True)
class Allowlist:
    """Networks that may connect; none for all."""

    allowed: tuple[Network, ...] = ()

    def allows(self, host: str, at: str = "") -> bool:
        """Return True if `host` may connect; `at` is the local address that it connected to."""
        if not self.allowed or is_same_machine(host, at):
            return True
        # A scope such as %eth0 is no part of the address.
        address = ipaddress.ip_address(host.partition("%")[0])
        mapped = getattr(address, "ipv4_mapped", None) or address
        return any(mapped in network for network in self.allowed)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add --allow."""
    parser.add_argument("--allow", action="append", type=_network, default=[], metavar="ADDRESS[/BITS]",
                        help="accept connections only from this address or network; repeatable; this machine is "
                        "always accepted (default: accept all)")


def allowlist_from_options(options: argparse.Namespace) -> Allowlist:
    """Return the allowlist of parsed options."""
    return Allowlist(tuple(options.allow))


def is_same_machine(host: str, at: str) -> bool:
    """Return True if a connection from `host` to the local address `at` comes from this machine.

    The kernel drops packets from elsewhere whose source is a local address, so that equal addresses are proof.
    """
    return not host or host == at or is_loopback(host)


def is_loopback(host: str) -> bool:
    """Return True if the address or name is reachable from this machine only."""
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return host.lower() == LOOPBACK_NAME
    return (getattr(address, "ipv4_mapped", None) or address).is_loopback


def warning(host: str, allowlist: Allowlist, may: str = DRIVES) -> str:
    """Return a warning about listening on an address; "" on loopback.

    Parameters
    ----------
    host
        Address to listen on.
    allowlist
        Addresses that may connect.
    may
        What clients may do, such as DRIVES.
    """
    if is_loopback(host):
        return ""
    networks = ", ".join(map(str, allowlist.allowed))
    clients = f"any client from {networks}" if allowlist.allowed else "any client that reaches it"
    remedy = "" if allowlist.allowed else " --allow ADDRESS/BITS restricts the addresses;"
    return (f"open to the network at {host}: the protocol has no authentication and no encryption, and {clients} {may};"
            f"{remedy} ssh -L forwards a port on loopback to another machine (docs/limits.md)")


def _network(text: str) -> Network:
    try:
        return ipaddress.ip_network(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"an address or a network such as 192.168.1.0/24: {error}") from None


class ListenAddress(NamedTuple):
    """Address to listen on; port 0 takes a free one."""

    host: str = LOOPBACK
    port: int = 0


def parse_listen_address(text: str) -> ListenAddress:
    """Return the address of PORT or HOST:PORT. Raises ArgumentTypeError."""
    host, _, port = text.rpartition(":")
    if not port.isdecimal() or int(port) > 65535:
        raise argparse.ArgumentTypeError(f"a port is 0 to 65535, or HOST:PORT, not {text!r}")
    return ListenAddress(host.strip("[]") or LOOPBACK, int(port))


def before_world(option: str, parse: Callable[[str], T]) -> Callable[[str], T]:
    """Return the type of an option whose value may be left out: what follows it may be meant as the world."""

    def read(text: str) -> T:
        try:
            return parse(text)
        except argparse.ArgumentTypeError as error:
            raise argparse.ArgumentTypeError(f"{error}; the world goes before {option}") from None

    return read


MAX_PENDING: Final = 8
QUEUE_FULL: Final = f"{MAX_PENDING} others wait already"
_POLL_S: Final = 0.02
"""Interval at which a pseudo-terminal is polled for a program that opens it."""
_CHUNK: Final = 65536
_SEND_TIMEOUT_S: Final = 5.0
"""Maximum time for a client to read what is sent to it."""


class PendingConnection(NamedTuple):
    """An accepted TCP connection that is not served yet, with the client's address."""

    socket: socket.socket
    host: str
    port: int


class AcceptQueue:
    """The pending connections of a listening socket, at most `MAX_PENDING`.

    Parameters
    ----------
    listening
        The socket.
    refusal
        Returns why a client at the first address may not connect to this machine's second one, "" if it may.
    on_rejected
        Called with the address of each rejected client, and the reason.
    """

    def __init__(self, listening: socket.socket, refusal: Callable[[str, str], str],
                 on_rejected: Callable[[str, str], None]) -> None:
        self._listening = listening
        self._refusal, self._on_rejected = refusal, on_rejected
        self._pending: list[PendingConnection] = []

    def poll(self) -> bool:
        """Accept and drop connections without waiting; return True if a pending one has sent something."""
        # 1. New connections.
        self._accept_available()
        # 2. Connections whose client has disconnected.
        for connection in [each for each in self._pending if _peek(each) == b""]:
            self._drop(connection)
        # 3. Too many: reject the oldest idle one, or the newest if none is idle.
        while len(self._pending) > MAX_PENDING:
            idle = (each for each in self._pending if _peek(each) is None)
            connection = next(idle, self._pending[-1])
            self._drop(connection)
            self._on_rejected(connection.host, QUEUE_FULL)
        return self._first_with_data() is not None

    def next(self) -> PendingConnection:
        """Return the first connection that has sent something, else the first; wait for one if there is none."""
        self._accept_available()
        # Clients may disconnect between the kernel's accept and this one.
        self._listening.setblocking(True)
        while not self._pending:
            with contextlib.suppress(ConnectionAbortedError):
                self._accept_one()
        connection = self._first_with_data() or self._pending[0]
        self._pending.remove(connection)
        return connection

    def close(self) -> None:
        """Close all pending connections. May be called twice."""
        for connection in tuple(self._pending):
            self._drop(connection)

    def _accept_available(self) -> None:
        self._listening.setblocking(False)
        with contextlib.suppress(BlockingIOError, ConnectionAbortedError):
            for _ in range(MAX_PENDING):
                self._accept_one()

    def _accept_one(self) -> None:
        accepted, address = self._listening.accept()
        accepted.setblocking(False)
        connection = PendingConnection(accepted, str(address[0]), int(address[1]))
        reason = self._refusal(connection.host, str(accepted.getsockname()[0]))
        if not reason:
            self._pending.append(connection)
            return
        accepted.close()
        self._on_rejected(connection.host, reason)

    def _first_with_data(self) -> PendingConnection | None:
        return next((each for each in self._pending if _peek(each)), None)

    def _drop(self, connection: PendingConnection) -> None:
        self._pending.remove(connection)
        connection.socket.close()


def _peek(connection: PendingConnection) -> bytes | None:
    """Return the first byte that was received, without consuming it: None if there is none yet, b"" at the end."""
    try:
        return connection.socket.recv(1, socket.MSG_PEEK)
    except BlockingIOError:
        return None
    except OSError:
        return b""


class TcpListener:
    """A TCP port of this machine.

    Parameters
    ----------
    host, port
        The address to listen on; port 0 takes a free one.
    refusal, on_rejected
        As `AcceptQueue` takes them.

    Raises
    ------
    ConnectionLost
        If the port is not available.
    """

    def __init__(self, host: str, port: int, refusal: Callable[[str, str], str] = lambda _, __: "",
                 on_rejected: Callable[[str, str], None] = lambda _, __: None) -> None:
        try:
            # The backlog of the kernel is as long as the queue.
            family = socket.AF_INET6 if ":" in host else socket.AF_INET
            self._socket = socket.create_server((host, port), family=family, backlog=MAX_PENDING)
        except OSError as error:
            raise ConnectionLost(
                f"cannot listen on {host}:{port}: {error.strerror or error}; port 0 takes a free one"
            ) from error
        self._queue = AcceptQueue(self._socket, refusal, on_rejected)
        self.port: int = self._socket.getsockname()[1]
        self.name = f"[{host}]:{self.port}" if ":" in host else f"{host}:{self.port}"

    def accept(self) -> ByteStream:
        """Wait for the next connection and return it."""
        connection = self._queue.next()
        return _AcceptedStream(connection.socket, f"{connection.host}:{connection.port}")

    def has_pending_request(self) -> bool:
        """Return True if a connection that is not served yet has sent something."""
        return self._queue.poll()

    def close(self) -> None:
        """Close the port and all pending connections. May be called twice."""
        self._queue.close()
        self._socket.close()


class _AcceptedStream(TcpStream):
    """A connection to a `TcpListener`."""

    def __init__(self, accepted: socket.socket, name: str) -> None:
        self.name = name
        self._timeout_s = _SEND_TIMEOUT_S
        self._socket = accepted
        accepted.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def _lost(self, reason: str) -> ConnectionLost:
        return ConnectionLost(f"{self.name} has disconnected: {reason}")


class PtyListener:
    """A pseudo-terminal behind a symbolic link.

    Parameters
    ----------
    link
        Path of the symbolic link; one that is there is replaced, any other file stays.

    Raises
    ------
    ConnectionLost
        If the pseudo-terminal or its link cannot be created.
    """

    def __init__(self, link: Path) -> None:
        import tty  # POSIX only, as pseudo-terminals are

        self.name = str(link)
        self._link = link
        if os.path.lexists(link) and not link.is_symlink():
            raise ConnectionLost(f"{link} is there and no symbolic link: it stays; name another path, or move it away")
        self._fd, other = os.openpty()
        try:
            # Raw: the terminal must not change, echo or interpret bytes. The name of the link is stable, the device's
            # number is not.
            tty.setraw(other)
            self._device = os.ttyname(other)
            link.unlink(missing_ok=True)
            link.symlink_to(self._device)
        except OSError as error:
            os.close(self._fd)
            raise ConnectionLost(f"cannot make the serial link {link}: {error.strerror}") from error
        finally:
            os.close(other)
        os.set_blocking(self._fd, False)
        self._poll = select.poll()
        self._poll.register(self._fd, select.POLLIN)

    def accept(self) -> ByteStream:
        """Wait until a program opens the other end, and return the connection to it."""
        # The kernel reports a hang-up as long as no program has the other end open, and has no event for opening.
        while any(event & select.POLLHUP for _, event in self._poll.poll(0)):
            time.sleep(_POLL_S)
        return _PtyStream(self._fd, self.name)

    def has_pending_request(self) -> bool:
        """Return False: all programs that open a pseudo-terminal share it, none waits."""
        return False

    def close(self) -> None:
        """Close the pseudo-terminal and remove the link, unless it points elsewhere by now. May be called twice."""
        if self._fd >= 0:
            with contextlib.suppress(OSError):
                if self._link.readlink() == Path(self._device):
                    self._link.unlink()
            os.close(self._fd)
            self._fd = -1


class _PtyStream:
    """A connection to a `PtyListener`, which owns the file descriptor."""

    def __init__(self, fd: int, name: str) -> None:
        self._fd, self.name = fd, name
        self._poll = select.poll()
        self._poll.register(fd, select.POLLIN)

    def send(self, data: bytes) -> None:
        """Send all bytes; what is not read within 5 s is lost, as on a cable."""
        deadline = Deadline.after(_SEND_TIMEOUT_S)
        while data and deadline.remaining():
            try:
                data = data[os.write(self._fd, data) :]
            except BlockingIOError:
                time.sleep(_POLL_S)
            except OSError as error:
                raise self._disconnected() from error

    def receive(self, deadline: Deadline) -> bytes:
        """Return at least one byte. Raises ReplyTimeout at the deadline, ConnectionLost if the other end was closed."""
        # poll() takes milliseconds.
        if not self._poll.poll(deadline.remaining() * 1000):
            raise ReplyTimeout(f"nothing came at {self.name}")
        try:
            return os.read(self._fd, _CHUNK)
        except OSError as error:
            raise self._disconnected() from error

    def close(self) -> None:
        """Do nothing: the program has its own end, and the listener this one."""

    def _disconnected(self) -> ConnectionLost:
        return ConnectionLost(f"the program at {self.name} has disconnected")


Listener = TcpListener | PtyListener
"""A place that programs connect to; `name` is what they connect to."""
