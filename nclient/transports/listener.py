"""Who has come to a TCP port and waits for his turn, one being in already.

    look()    takes in who has come, lets go who has left, turns away who may not; as often as one likes
    next()    whose turn it is: the first who has said something already, or the first, or whoever comes

Rules: nothing of what they say is read here. So many wait and no more: the first of those that say nothing goes then,
so that no crowd of silent ones keeps out one who has something to say.

Where others come in: a TCP port or a pseudo-terminal that waits for one peer after the other.

    door.peer() ──> a ByteStream to whoever came; the next one is waited for when that is closed
    door.wanted()   whether another has something to say meanwhile; to be asked now and then (lobby.py)

Rules: one peer at a time. A pseudo-terminal is raw, stands behind a symbolic link, and knows its peer by the other end
being open; what is at the link's place and is no link stays. POSIX only, where a pseudo-terminal is asked for.
"""

from __future__ import annotations

import contextlib
import enum
import os
import select
import socket
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final, NamedTuple, Protocol

from nclient.errors import ConnectionLost, ReplyTimeout
from nclient.transports.stream import ByteStream, Deadline
from nclient.transports.tcp import TcpStream

MOST_WAITING: Final = 8
CROWDED: Final = f"{MOST_WAITING} others wait already"


class Caller(NamedTuple):
    """Who came, and from where."""

    socket: socket.socket
    host: str
    port: int


class _Said(enum.Enum):
    """What was heard of one who waits."""

    NOTHING = enum.auto()
    SOMETHING = enum.auto()
    GOODBYE = enum.auto()


class Lobby:
    """Before the port that `listening` listens at.

    `refusal`: why somebody from that address may not come in to that one of ours; empty: he may. `turned_away` is told
    of each who may not, with the reason.
    """

    def __init__(
        self, listening: socket.socket, refusal: Callable[[str, str], str], turned_away: Callable[[str, str], None]
    ) -> None:
        self._listening = listening
        self._refusal, self._turned_away = refusal, turned_away
        self._waiting: list[Caller] = []

    def look(self) -> bool:
        """See the head of this file. Whether somebody waits who has said something."""
        self._gather()
        for caller in [one for one in self._waiting if _said(one) is _Said.GOODBYE]:
            self._let_go(caller)
        while len(self._waiting) > MOST_WAITING:
            self._turn_away(next((one for one in self._waiting if _said(one) is _Said.NOTHING), self._waiting[-1]))
        return self._first_to_speak() is not None

    def next(self) -> Caller:
        """See the head of this file; waits for somebody where nobody waits."""
        self._gather()
        self._listening.setblocking(True)
        while not self._waiting:
            with contextlib.suppress(ConnectionAbortedError):
                self._waiting += self._come()
        caller = self._first_to_speak() or self._waiting[0]
        self._waiting.remove(caller)
        return caller

    def close(self) -> None:
        """Send everybody away. Twice is fine."""
        for caller in tuple(self._waiting):
            self._let_go(caller)

    def _gather(self) -> None:
        self._listening.setblocking(False)
        with contextlib.suppress(BlockingIOError, ConnectionAbortedError):
            for _ in range(MOST_WAITING):
                self._waiting += self._come()

    def _come(self) -> list[Caller]:
        """Whoever came, if he may."""
        accepted, address = self._listening.accept()
        accepted.setblocking(False)
        caller = Caller(accepted, str(address[0]), int(address[1]))
        if not (reason := self._refusal(caller.host, str(accepted.getsockname()[0]))):
            return [caller]
        accepted.close()
        self._turned_away(caller.host, reason)
        return []

    def _turn_away(self, caller: Caller) -> None:
        self._let_go(caller)
        self._turned_away(caller.host, CROWDED)

    def _first_to_speak(self) -> Caller | None:
        return next((one for one in self._waiting if _said(one) is _Said.SOMETHING), None)

    def _let_go(self, caller: Caller) -> None:
        self._waiting.remove(caller)
        caller.socket.close()


def _said(caller: Caller) -> _Said:
    try:
        return _Said.SOMETHING if caller.socket.recv(1, socket.MSG_PEEK) else _Said.GOODBYE
    except BlockingIOError:
        return _Said.NOTHING
    except OSError:
        return _Said.GOODBYE


_LOOK_S = 0.02
"""How often a pseudo-terminal that nobody has open is looked at."""
_CHUNK = 65536
_TAKING_S = 5.0
"""How long a peer may take to read what is sent to it."""


class Door(Protocol):
    """See the head of this file. `name`: what a peer is told to connect to."""

    name: str

    def peer(self) -> ByteStream:
        """Wait for the next one."""
        ...

    def wanted(self) -> bool:
        """Whether somebody waits who has said something."""
        ...

    def close(self) -> None:
        """Let nobody in any more. Twice is fine."""
        ...


class TcpDoor:
    """A port of this machine; port 0 takes a free one. Raises ConnectionLost where it cannot be had.

    `refusal`, `turned_away`: who may not come in, and who is told of it, as Lobby has them.
    """

    def __init__(
        self,
        host: str,
        port: int,
        refusal: Callable[[str, str], str] = lambda _, __: "",
        turned_away: Callable[[str, str], None] = lambda _, __: None,
    ) -> None:
        try:
            family = socket.AF_INET6 if ":" in host else socket.AF_INET
            self._socket = socket.create_server((host, port), family=family, backlog=MOST_WAITING)
        except OSError as error:
            raise ConnectionLost(
                f"cannot listen on {host}:{port}: {error.strerror or error}; port 0 takes a free one"
            ) from error
        self._lobby = Lobby(self._socket, refusal, turned_away)
        self.port: int = self._socket.getsockname()[1]
        self.name = f"[{host}]:{self.port}" if ":" in host else f"{host}:{self.port}"

    def peer(self) -> ByteStream:
        """Whose turn it is, or whoever connects next."""
        caller = self._lobby.next()
        return _Visitor(caller.socket, f"{caller.host}:{caller.port}")

    def wanted(self) -> bool:
        """Whether somebody waits who has said something."""
        return self._lobby.look()

    def close(self) -> None:
        """Stop listening."""
        self._lobby.close()
        self._socket.close()


class _Visitor(TcpStream):
    """Who came to a TCP door."""

    def __init__(self, accepted: socket.socket, name: str) -> None:
        self.name = name
        self._timeout_s = _TAKING_S
        self._socket = accepted
        accepted.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def _lost(self, reason: str) -> ConnectionLost:
        return ConnectionLost(f"{self.name} has left: {reason}")


class TerminalDoor:
    """A pseudo-terminal behind a symbolic link. Raises ConnectionLost where it cannot be made."""

    def __init__(self, link: Path) -> None:
        import tty

        self.name = str(link)
        self._link = link
        if os.path.lexists(link) and not link.is_symlink():
            raise ConnectionLost(f"{link} is there and no symbolic link: it stays; name another path, or move it away")
        self._fd, other = os.openpty()
        try:
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

    def peer(self) -> ByteStream:
        """Whoever opens the other end next."""
        while any(event & select.POLLHUP for _, event in self._poll.poll(0)):
            time.sleep(_LOOK_S)
        return _TerminalPeer(self._fd, self.name)

    def wanted(self) -> bool:
        """Nobody waits for what one has open: all who open it share it."""
        return False

    def close(self) -> None:
        """Take the link away, if it is still ours."""
        if self._fd >= 0:
            with contextlib.suppress(OSError):
                if self._link.readlink() == Path(self._device):
                    self._link.unlink()
            os.close(self._fd)
            self._fd = -1


class _TerminalPeer:
    """Who opened the other end of a pseudo-terminal; the end itself stays the door's."""

    def __init__(self, fd: int, name: str) -> None:
        self._fd, self.name = fd, name
        self._poll = select.poll()
        self._poll.register(fd, select.POLLIN)

    def send(self, data: bytes) -> None:
        """Send all of it; what a peer does not take within a while is lost, as on a cable."""
        deadline = Deadline.after(_TAKING_S)
        while data and deadline.remaining():
            try:
                data = data[os.write(self._fd, data) :]
            except BlockingIOError:
                time.sleep(_LOOK_S)
            except OSError as error:
                raise self._left() from error

    def receive(self, deadline: Deadline) -> bytes:
        """At least one byte. Raises ReplyTimeout at the deadline, ConnectionLost when the other end was closed."""
        if not self._poll.poll(deadline.remaining() * 1000):
            raise ReplyTimeout(f"nothing came at {self.name}")
        try:
            return os.read(self._fd, _CHUNK)
        except OSError as error:
            raise self._left() from error

    def close(self) -> None:
        """Nothing to let go: the other end belongs to the peer."""

    def _left(self) -> ConnectionLost:
        return ConnectionLost(f"whoever had {self.name} open has left")
