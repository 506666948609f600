"""A backend that comes back: the call during which the link broke says so, the next ones open it anew.

    lost ──> ConnectionLost ──> next call: wait 0.1 s, open, greet ──> nobody: ConnectionLost ──> 0.2 s ... longest

Rules: each loss is one ConnectionLost of the call that met it, and nothing is said twice: what that call was to do is
the program's to decide. Opened anew, the robot is told again what was agreed with it (agreed.py): which robot it is (an
Nserver's), mask and laser mode, the time-out of motion, sensors, speeds. Nothing moves by itself.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from nclient.backends.agreed import Agreed
from nclient.backends.backend import Backend
from nclient.backends.wrapper import Wrapper
from nclient.errors import ConnectionLost, NomadError
from nclient.protocol.commands import Call
from nclient.protocol.replies import Reply

FIRST_PAUSE_S = 0.1
LONGEST_PAUSE_S = 5.0
"""Default of the longest pause between two tries."""


class Reconnecting(Wrapper):
    """A backend, and how to open another in its place; `longest_pause_s`: what the pauses grow to, doubling."""

    def __init__(
        self,
        inner: Backend,
        opens: Callable[[], Backend],
        longest_pause_s: float = LONGEST_PAUSE_S,
        *,
        clock: Callable[[], float] = time.monotonic,
        wait: Callable[[float], object] | None = None,
    ) -> None:
        super().__init__(inner)
        self._opens = opens
        self._longest_pause_s = longest_pause_s
        self._clock = clock
        self._left = threading.Event()
        self._wait = wait or self._left.wait
        self._agreed = Agreed()
        self._pause_s = 0.0
        self._next_try_s = 0.0

    @property
    def closed(self) -> bool:
        """Whether this side has closed it; a link that broke is not over."""
        return self._left.is_set()

    def execute(self, call: Call) -> Reply:
        """The answer, of a backend opened anew where it was lost. Raises ConnectionLost for each loss and each try."""
        if self._left.is_set():
            raise ConnectionLost(f"{call.name}: this side closed the connection; connect again")
        if self._inner.closed:
            self._come_back(call.name)
        try:
            reply = self._inner.execute(call)
        except NomadError:
            if self._inner.closed and not self._left.is_set():
                self._lost()
            raise
        self._remember(call)
        return reply

    def close(self) -> None:
        """Close it for good; a wait for the next try ends."""
        self._left.set()
        self._inner.close()

    def _lost(self) -> None:
        if self.link is not None:
            self.link.losses += 1
        self._pause_s = 0.0
        self._pause()

    def _pause(self) -> None:
        self._pause_s = min(max(FIRST_PAUSE_S, 2 * self._pause_s), self._longest_pause_s)
        self._next_try_s = self._clock() + self._pause_s

    def _come_back(self, name: str) -> None:
        """One try, not before its time. Raises ConnectionLost when nobody is there yet."""
        self._wait(max(0.0, self._next_try_s - self._clock()))
        try:
            self._inner = self._greeted()
        except NomadError as error:
            self._pause()
            raise ConnectionLost(f"{name}: not back yet, the next try in {self._pause_s:g} s: {error}") from error
        if self._left.is_set():
            self._inner.close()
        if self.link is not None:
            self.link.reconnects += 1

    def _greeted(self) -> Backend:
        backend = self._opens()
        try:
            for call in self._agreed.calls():
                backend.execute(call)
        except BaseException:
            backend.close()
            raise
        return backend

    def _remember(self, call: Call) -> None:
        self._agreed.remember(call)
        if call.name == "disconnect_robot":
            self._left.set()
