"""Who has come to a TCP port and waits for his turn, one being in already.

    look()    takes in who has come, lets go who has left, turns away who may not; as often as one likes
    next()    whose turn it is: the first who has said something already, or the first, or whoever comes

Rules: nothing of what they say is read here. So many wait and no more: the first of those that say nothing goes then,
so that no crowd of silent ones keeps out one who has something to say.
"""

from __future__ import annotations

import contextlib
import enum
import socket
from collections.abc import Callable
from typing import Final, NamedTuple

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
