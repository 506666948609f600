"""Notification of a service manager, as sd_notify(3) specifies it: datagrams to NOTIFY_SOCKET.

    READY=1      all ports are open             WATCHDOG=1    the event loop runs; sent twice within WATCHDOG_USEC
    STOPPING=1   the daemon ends                nothing       where no service manager started the daemon

The watchdog message comes from the event loop that serves the clients, so that a blocked loop is detected. Notification
never waits and never fails the daemon: what the manager does not accept, because its queue is full or it restarts, is
sent again later. This is logged once, until it accepts messages again.
"""

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
_RETRY_S: Final = 1.0
"""Interval at which unaccepted messages are repeated where there is no watchdog."""


class ServiceManager:
    """The service manager that started the daemon.

    Parameters
    ----------
    environment : NOTIFY_SOCKET, a path or @abstract name; WATCHDOG_USEC, for process WATCHDOG_PID or for all.
    """

    def __init__(self, environment: Mapping[str, str]) -> None:
        self._address = environment.get("NOTIFY_SOCKET", "")
        # Environment variables are inherited: only the process that is named has a watchdog.
        is_for_us = environment.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        timeout_us = environment.get("WATCHDOG_USEC", "")
        has_watchdog = bool(self._address) and is_for_us and timeout_us.isdecimal()
        self.feed_s = int(timeout_us) / _US_PER_S / 2 if has_watchdog else 0.0
        """Interval of watchdog messages; 0 without a watchdog."""
        self._unsent: list[str] = []
        self._accepts = True

    @property
    def interval_s(self) -> float:
        """Seconds to the next message; 0: none."""
        return self.feed_s or (_RETRY_S if self._unsent else 0.0)

    def feed(self) -> None:
        """Repeat unsent messages, and send the watchdog message."""
        self.notify(*self._unsent, *([WATCHDOG] if self.feed_s else []))

    def notify(self, *messages: str) -> None:
        """Send messages, one per line; unaccepted ones are sent again later, except WATCHDOG."""
        if not self._address:
            return
        # An old watchdog message says nothing about now.
        self._unsent = [message for message in messages if message != WATCHDOG]
        # An abstract socket is written with @ in the variable and with a zero byte in the address.
        address = self._address.replace("@", "\0", 1) if self._address[0] == "@" else self._address
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
                # A full queue must not block the event loop.
                sender.setblocking(False)
                sender.sendto("\n".join(messages).encode(), address)
        except OSError as error:
            # Logged once per interruption.
            if self._accepts:
                log.warning("the service manager at %s does not listen: %s; trying again", self._address, error)
            self._accepts = False
            return
        if not self._accepts:
            log.warning("the service manager at %s listens again", self._address)
        self._accepts, self._unsent = True, []


@contextlib.asynccontextmanager
async def announced(manager: ServiceManager) -> AsyncIterator[None]:
    """Report that the daemon is ready, and feed the watchdog meanwhile."""
    manager.notify(READY)
    feeding = asyncio.create_task(_feed(manager)) if manager.interval_s else None
    try:
        yield
    finally:
        if feeding is not None:
            feeding.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await feeding


async def _feed(manager: ServiceManager) -> None:
    while manager.interval_s:
        manager.feed()
        await asyncio.sleep(manager.interval_s)
