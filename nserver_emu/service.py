"""What a daemon tells the service manager that started it, as sd_notify(3) has it: a datagram to NOTIFY_SOCKET.

    READY=1      all doors are open             WATCHDOG=1    the loop goes round, twice within WATCHDOG_USEC
    STOPPING=1   told to end                    nothing       where no service manager asked for it

Rules: the watchdog is fed by the loop that serves the clients, so that a loop that hangs is seen. Nothing said here can
fail the daemon, nor is it waited for: what a manager does not take now, since its queue is full or it is begun anew, is
told again the next time. That is logged once, until it listens again.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import socket
from collections.abc import AsyncIterator, Mapping
from typing import Final

log = logging.getLogger(__name__)

READY: Final = "READY=1"
STOPPING: Final = "STOPPING=1"
WATCHDOG: Final = "WATCHDOG=1"
_US_PER_S: Final = 1e6
_AGAIN_S: Final = 1.0
"""How soon what was not taken is told again, where no watchdog is fed."""


class Manager:
    """Whoever started us. `environment`: NOTIFY_SOCKET, a path or @abstract; WATCHDOG_USEC, for WATCHDOG_PID or all."""

    def __init__(self, environment: Mapping[str, str]) -> None:
        self._place = environment.get("NOTIFY_SOCKET", "")
        meant = environment.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        asked = environment.get("WATCHDOG_USEC", "")
        self.feed_s = int(asked) / _US_PER_S / 2 if self._place and meant and asked.isdecimal() else 0.0
        """How often the watchdog is fed; 0: there is none."""
        self._owed: list[str] = []
        self._listens = True

    @property
    def again_s(self) -> float:
        """How soon there is something to tell; 0: never."""
        return self.feed_s or (_AGAIN_S if self._owed else 0.0)

    def feed(self) -> None:
        """Tell what is owed, and that the loop goes round."""
        self.tell(*self._owed, *([WATCHDOG] if self.feed_s else []))

    def tell(self, *words: str) -> None:
        """Say this, one a line; what is not taken is owed, but for WATCHDOG, which is out of date then."""
        if not self._place:
            return
        self._owed = [word for word in words if word != WATCHDOG]
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as teller:
                teller.setblocking(False)
                teller.sendto("\n".join(words).encode(), self._place.replace("@", "\0", 1) if self._place[0] == "@"
                              else self._place)
        except OSError as error:
            if self._listens:
                log.warning("the service manager at %s does not listen: %s; it is told again", self._place, error)
            self._listens = False
            return
        if not self._listens:
            log.warning("the service manager at %s listens again", self._place)
        self._listens, self._owed = True, []


@contextlib.asynccontextmanager
async def announced(manager: Manager) -> AsyncIterator[None]:
    """The daemon is ready; while it lasts, the watchdog is fed."""
    manager.tell(READY)
    feeding = asyncio.create_task(_feed(manager)) if manager.again_s else None
    try:
        yield
    finally:
        if feeding is not None:
            feeding.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await feeding


async def _feed(manager: Manager) -> None:
    while manager.again_s:
        manager.feed()
        await asyncio.sleep(manager.again_s)
